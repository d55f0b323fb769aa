"""Two calibrations: whether the older one still holds, and both are of one robot."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from calib_pin.errors import enumerated
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.statistics.distributions import chi_square_tail
from calib_pin.parameterizations.base import LENGTH_SCALE
from calib_pin.setup import JointMap
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.findings.case import CHANCE, FOREIGN
from calib_pin.validation.findings.sentences import finding, shown, with_sigma
from calib_pin.validation.result import CalibrationResult, Jump
from calib_pin.validation.tip_drift import tip_drift

HOLDS = 1.5
"""Error of the tool, by the promised one, up to which an older calibration holds."""


def different_robots(
    first: CalibratedModel, second: CalibratedModel, same_nominal: bool, apart: float
) -> tuple[Finding, ...]:
    """Why the tool points of two calibrations are so far apart.

    None where they are not.

    Args:
        first: One robot.
        second: The other.
        same_nominal: Whether both have corrected the same robot.
        apart: How far their tool points are apart, rms over the workspace [m].
    """
    if apart <= FOREIGN * LENGTH_SCALE:
        return ()
    maps = [
        {m.joint: m for m in model.setup.joints.values() if m != JointMap(m.joint)}
        for model in (first, second)
    ]
    differ = [j for j in {**maps[0], **maps[1]} if maps[0].get(j) != maps[1].get(j)]
    reason = "no robot changes so much on its own"
    remedy = "check its mastering, and how the measurements of both are read"
    if not same_nominal:
        reason, remedy = "their nominal robots differ", "compare those of one robot"
    elif differ:
        reason = f"they read the column of {enumerated(differ)} differently"
        remedy = "state the same 'joints' in the setup of both"
    text = f"the tool points are {1e3 * apart:.0f} mm rms apart: {reason}"
    error = bool(differ) or not same_nominal
    return (finding("different-robots", text, {"rms": apart}, remedy, error=error),)


def older_calibration(
    older: CalibrationResult, new: CalibrationResult
) -> Iterator[Finding]:
    """Changes since an older calibration, or that it holds.

    Args:
        older: The older calibration.
        new: The one that began with it.
    """
    assert new.recalibration is not None
    step = new.recalibration.last
    errors = " and ".join(
        f"{name} errors of {shown(error.rms, unit)} rms"
        for name, unit, error in new.recalibration.errors
    )
    basis = f"it predicts these measurements with {errors}, chi-square {step.chi2:.0f} "
    basis += f"(expected: {step.dof})"
    numbers: dict[str, Any] = {"chi2": step.chi2, "dof": step.dof}
    before, after = (result.accuracy.workspace for result in (older, new))
    holds, remedy = all(map(_of_frame, step.jumps)), ""
    if before is not None and after is not None:
        promised, expected = before.calibrated[0], after.calibrated[0]
        drift = tip_drift(older.model.of(), new.model.of(), base=True, tool=True)
        square = drift.position.rms**2 + expected**2
        if chi_square_tail(step.chi2, step.dof) > CHANCE:
            # Errors that no parameter describes are as before, though few measurements
            # may show more of them by chance.
            square += before.unmodeled[0] ** 2 - after.unmodeled[0] ** 2
        numbers["error"] = error = float(np.sqrt(max(square, 0.0)))
        basis += f", and is off by {shown(error, 'm')} over the workspace "
        basis += f"(promised: {shown(promised, 'm')})"
        holds &= not error > HOLDS * promised
        if promised < expected:
            remedy = f"use the older one: this one is off by {shown(expected, 'm')}"
    for k, jump in enumerate(step.jumps, 1):
        numbers |= {f"joint {k}": jump.name or jump.kind, f"change {k}": jump.change}
    code, verdict = "old-calibration-holds", "still holds"
    if not holds:
        code, verdict = "old-calibration-no-longer-holds", "no longer holds"
        remedy = "look for what was hit, loosened or exchanged"
        if not step.jumps or any(jump.instead for jump in step.jumps):
            remedy += "; to tell what it was, measure more configurations, with base "
            remedy += "and tool stated as known"
    words = "; ".join(map(_change_text, step.jumps))
    words = words or "nothing is found to have changed at once"
    day = f" of {step.created[:10]}" if step.created else ""
    text = f"the older calibration{day} {verdict}: {words}; {basis}"
    yield finding(code, text, numbers, remedy, info=holds)


def _of_frame(jump: Jump) -> bool:
    """Whether a change is one of a frame, and cannot be one of the robot instead."""
    joint = any(words.startswith("j") for words in jump.instead)
    return jump.kind in ("base", "tool") and not joint


def _change_text(jump: Jump) -> str:
    """A sudden change in words."""
    note = f" (or instead {' or '.join(jump.instead)})" if jump.instead else ""
    if jump.beside:
        note += f" (beside it an offset of {' or '.join(jump.beside)} does not show)"
    if jump.kind == "offset":
        size = with_sigma(abs(jump.change), jump.sigma, jump.unit)
        return f"the offset of '{jump.name}' has changed by {size}{note}"
    subject = f"the {jump.kind} {jump.name}".rstrip()
    if jump.kind == "robot":
        subject, note = "the whole robot", ", or this is another robot of its type"
    elif jump.kind == "placement":
        subject = f"'{jump.name}'"
    sizes = [(jump.change, "m"), (jump.turn, "rad")]
    moved = " and ".join(shown(size, unit) for size, unit in sizes if size > 0.0)
    return f"{subject} has moved by {moved}{note}"
