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
from calib_pin.validation.findings.sentences import finding, shown
from calib_pin.validation.result import CalibrationResult, Jump
from calib_pin.validation.tip_drift import tip_drift

HOLDS = 1.5
"""Error of the tool, by the promised one, up to which an older calibration holds."""

SEPARATE = {
    "base": "state the base frame as known, from fixed points beside the robot",
    "tool": "measure with a tool of known geometry, stated as known",
}
"""Measurements that tell frames that moved from joints."""


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
        {given.joint: given for given in joints if given != JointMap(given.joint)}
        for joints in (model.setup.joints.values() for model in (first, second))
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
    day = f" of {step.created[:10]}" if step.created else ""
    sizes = [(n, shown(x.rms, unit)) for n, unit, x in new.recalibration.errors]
    errors = " and ".join(f"{name} errors of {size} rms" for name, size in sizes)
    basis = f"it predicts these measurements with {errors}, chi-square {step.chi2:.0f} "
    basis += f"(expected: {step.dof})"
    before, after = (result.accuracy.workspace for result in (older, new))
    promised = np.nan if before is None else before.calibrated[0]
    expected = np.nan if after is None else after.calibrated[0]
    apart = tip_drift(older.model.of(), new.model.of(), base=True, tool=True).position
    error = float(np.hypot(apart.rms, expected))
    if before and after and chi_square_tail(step.chi2, step.dof) > CHANCE:
        # Errors that no parameter describes are as before, though few measurements may
        # show more of them by chance.
        instead = before.unmodeled[0] ** 2 - after.unmodeled[0] ** 2
        error = float(np.sqrt(max(error**2 + instead, 0.0)))
    numbers: dict[str, Any] = {"chi2": step.chi2, "dof": step.dof}
    if np.isfinite(error):
        numbers["error"] = error
        basis += f", and is off by {shown(error, 'm')} over the workspace "
        basis += f"(promised: {shown(promised, 'm')})"
    for k, jump in enumerate(step.jumps, 1):
        numbers |= {f"joint {k}": jump.name or jump.kind, f"change {k}": jump.change}
    holds = all(map(_of_frame, step.jumps)) and not error > HOLDS * promised
    remedy = "; ".join(_remedies(step.jumps))
    if holds:
        better = f"use the older one: this one is off by {shown(expected, 'm')}"
        remedy = better if promised < expected else ""
    words = "; ".join(map(_change_text, step.jumps))
    words = words or "nothing is found to have changed at once"
    code, verdict = "old-calibration-holds", "still holds"
    if not holds:
        code, verdict = "old-calibration-no-longer-holds", "no longer holds"
    text = f"the older calibration{day} {verdict}: {words}; {basis}"
    yield finding(code, text, numbers, remedy, info=holds)


def _of_frame(jump: Jump) -> bool:
    """Whether a change is one of a frame, and cannot be one of the robot instead."""
    return jump.kind in SEPARATE and not any(w.startswith("j") for w in jump.instead)


def _remedies(jumps: tuple[Jump, ...]) -> Iterator[str]:
    yield "look for what was hit, loosened or exchanged"
    if any(jump.kind == "robot" for jump in jumps):
        yield "look whether its serial number is that of another robot"
    words = {w.split(" ")[0] for j in jumps if j.instead for w in (j.kind, *j.instead)}
    for word in SEPARATE:
        if word in words:
            yield f"to tell a {word} that moved from a joint, {SEPARATE[word]}"
    if not jumps or "joint" in words:
        yield "measure more configurations"


def _change_text(jump: Jump) -> str:
    """A sudden change in words."""
    note = f" (or instead {' or '.join(jump.instead)})" if jump.instead else ""
    if jump.beside:
        note += f" (beside it an offset of {' or '.join(jump.beside)} does not show)"
    if jump.kind == "offset":
        value = shown(abs(jump.change), jump.unit).split()[0]
        sigma = shown(jump.sigma, jump.unit, 1)
        return f"the offset of '{jump.name}' has changed by {value} +- {sigma}{note}"
    subject = f"'{jump.name}'" if jump.name else "the whole robot"
    if jump.kind in SEPARATE:
        subject = " ".join(filter(None, ("the", jump.kind, jump.name)))
    elif jump.kind == "robot":
        note = ", or this is another robot of its type"
    sizes = [(jump.change, "m"), (jump.turn, "rad")]
    moved = " and ".join(shown(size, unit) for size, unit in sizes if size > 0.0)
    return f"{subject} has moved by {moved}{note}"
