"""Whether an older calibration still holds, by what it predicts of new measurements."""

from __future__ import annotations

from collections.abc import Iterator

from calib_pin.estimation.evidence import Finding, Severity
from calib_pin.units import DISPLAY
from calib_pin.validation.summaries import Jump, Recalibration, ToolAccuracy

HOLDS = 1.5
"""Error of the tool, by the promised one, up to which an older calibration holds."""

SEPARATE = {
    "base": "state the base frame as known, from fixed points beside the robot",
    "tool": "measure with a tool of known geometry, stated as known",
}
"""Measurements that tell frames that moved from joints."""


def older_calibration(
    found: Recalibration, *accuracies: ToolAccuracy
) -> Iterator[Finding]:
    """What has changed since an older calibration, or that it holds.

    Args:
        found: How the calibration went on from it.
        accuracies: Those of the new calibration by its chains; the first counts.
    """
    step = found.last
    day = f" of {step.created[:10]}" if step.created else ""
    told = " and ".join(
        f"{name} errors of {_shown(accuracy.rms, unit)} rms"
        for name, unit, accuracy in found.errors
    )
    by = f"it predicts these measurements with {told}, chi-square {step.chi2:.0f} "
    by += f"(expected: {step.dof})"
    if step.promised > 0.0:
        by += f", and is off by {_shown(step.error, 'm')} over the workspace "
        by += f"(promised: {_shown(step.promised, 'm')})"
    names = {f"joint {k}": j.name or j.kind for k, j in enumerate(step.jumps, 1)}
    sizes = {f"change {k}": j.change for k, j in enumerate(step.jumps, 1)}
    words, remedy = "; ".join(map(_words, step.jumps)), ""
    severity: Severity = "info"
    holds = not step.error > HOLDS * step.promised
    if holds and all(_aside(jump) for jump in step.jumps):
        new = accuracies[0].workspace if accuracies else None
        if new is not None and step.promised < new.calibrated[0]:
            remedy = "use the older calibration, which promises less than this one: "
            remedy += f"{_shown(new.calibrated[0], 'm')}"
        code, verb = "old-calibration-holds", "still holds"
    else:
        code, severity = "old-calibration-no-longer-holds", "warning"
        verb, words = "no longer holds", words or "no single change explains it"
        remedy = "; ".join(_remedies(step.jumps))
    message = ": ".join(filter(None, (f"the older calibration{day} {verb}", words)))
    evidence = {"chi2": step.chi2, "dof": float(step.dof), **names, **sizes}
    yield Finding(code, severity, f"{message}; {by}", evidence, remedy)


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
    if not words & SEPARATE.keys():
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
