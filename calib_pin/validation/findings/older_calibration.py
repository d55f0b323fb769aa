"""Whether an older calibration still holds, by what it predicts of new measurements."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib_pin.estimation.evidence import Finding
from calib_pin.units import DISPLAY
from calib_pin.validation.result import CalibrationResult, Jump
from calib_pin.validation.tip_drift import tip_drift

HOLDS = 1.5
"""Error of the tool, by the promised one, up to which an older calibration holds."""

SEPARATE = {
    "base": "state the base frame as known, from fixed points beside the robot",
    "tool": "measure with a tool of known geometry, stated as known",
}
"""Measurements that tell frames that moved from joints."""


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
    words = "; ".join(map(_words, step.jumps))
    day = f" of {step.created[:10]}" if step.created else ""
    told = " and ".join(
        f"{name} errors of {_shown(accuracy.rms, unit)} rms"
        for name, unit, accuracy in new.recalibration.errors
    )
    by = f"it predicts these measurements with {told}, chi-square {step.chi2:.0f} "
    by += f"(expected: {step.dof})"
    promises = [one.accuracy.workspace for one in (older, new)]
    promised, expected = (np.nan if p is None else p.calibrated[0] for p in promises)
    apart = tip_drift(older.model.of(), new.model.of(), base=True, tool=True).position
    error = float(np.hypot(apart.rms, expected))
    evidence: dict[str, float | str] = {"chi2": step.chi2, "dof": step.dof}
    if np.isfinite(error):
        evidence["error"] = error
        by += f", and is off by {_shown(error, 'm')} over the workspace "
        by += f"(promised: {_shown(promised, 'm')})"
    for k, jump in enumerate(step.jumps, 1):
        evidence |= {f"joint {k}": jump.name or jump.kind, f"change {k}": jump.change}
    holds = all(map(_aside, step.jumps)) and not error > HOLDS * promised
    better = f"use the older one: this one is off by {_shown(expected, 'm')}"
    yield Finding(
        "old-calibration-holds" if holds else "old-calibration-no-longer-holds",
        "info" if holds else "warning",
        f"the older calibration{day} {'still' if holds else 'no longer'} holds: "
        f"{words or 'nothing is found to have changed at once'}; {by}",
        evidence,
        (better if promised < expected else "")
        if holds
        else "; ".join(_remedies(step.jumps)),
    )


def _aside(jump: Jump) -> bool:
    """Whether a change is one of a frame, and cannot be one of the robot instead."""
    return jump.kind in SEPARATE and not any(w.startswith("j") for w in jump.instead)


def _remedies(jumps: tuple[Jump, ...]) -> Iterator[str]:
    yield "look for what was hit, loosened or exchanged"
    if any(jump.kind == "robot" for jump in jumps):
        yield "look whether its serial number is that of another robot"
    words = {w.split(" ")[0] for j in jumps if j.instead for w in (j.kind, *j.instead)}
    for word in [word for word in SEPARATE if word in words]:
        yield f"to tell a {word} that moved from a joint, {SEPARATE[word]}"
    if not jumps or "joint" in words:
        yield "measure more configurations"


def _words(jump: Jump) -> str:
    """A sudden change in words."""
    other = f" (or instead {' or '.join(jump.instead)})" if jump.instead else ""
    if jump.beside:
        other += f" (beside it an offset of {' or '.join(jump.beside)} does not show)"
    if jump.kind == "offset":
        unit, factor = DISPLAY[jump.unit]
        value, sigma = factor * abs(jump.change), factor * jump.sigma
        moved = f"changed by {value:.2g} +- {sigma:.1g} {unit}"
        return f"the offset of '{jump.name}' has {moved}{other}"
    of = f"'{jump.name}'" if jump.name else "the whole robot"
    if jump.kind in SEPARATE:
        of = " ".join(filter(None, ("the", jump.kind, jump.name)))
    elif jump.kind == "robot":
        other = ", or this is another robot of its type"
    sizes = [(jump.change, "m"), (jump.turn, "rad")]
    moved = " and ".join(_shown(size, unit) for size, unit in sizes if size > 0.0)
    return f"{of} has moved by {moved}{other}"


def _shown(size: float, unit: str) -> str:
    shown, factor = DISPLAY[unit]
    return f"{factor * size:.2g} {shown}"
