"""Whether an older calibration still holds, by what it predicts of new measurements."""

from __future__ import annotations

from collections.abc import Iterator

from calib_pin.estimation.evidence import Finding
from calib_pin.units import DISPLAY
from calib_pin.validation.summaries import Jump, Recalibration, ToolAccuracy

HOLDS = 1.5
"""Error of the tool, by the promised one, up to which an older calibration holds."""

SEPARATE = {
    "base": "state the base frame as known, from fixed points beside the robot",
    "tool": "measure with a tool of known geometry, stated as known",
    "joint": "measure more configurations",
}
"""Measurements that tell changes apart, by the first word of one of them."""


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
    moved = [jump for jump in step.jumps if _of_robot(jump)]
    off = step.error > HOLDS * step.promised
    by = f"it predicts these measurements with {told}, chi-square {step.chi2:.0f} "
    by += f"(expected: {step.dof})"
    if step.promised > 0.0:
        by += f", and a tool error of {_shown(step.error, 'm')} over the workspace "
        by += f"(promised: {_shown(step.promised, 'm')})"
    names = {f"joint {k}": j.name or j.kind for k, j in enumerate(step.jumps, 1)}
    sizes = {f"change {k}": j.change for k, j in enumerate(step.jumps, 1)}
    evidence = {"chi2": step.chi2, "dof": float(step.dof), **names, **sizes}
    words = ", and ".join(map(_words, step.jumps))
    if moved or off:
        words = words or "no single change that was tried explains it"
        yield Finding(
            "old-calibration-no-longer-holds",
            "warning",
            f"the older calibration{day} no longer holds: {words}; {by}",
            evidence,
            "; ".join(_remedies(step.jumps)) or "measure more configurations",
        )
        return
    new = accuracies[0].workspace if accuracies else None
    expected = 0.0 if new is None else new.calibrated[0]
    yield Finding(
        "old-calibration-holds",
        "info",
        f"the older calibration{day} still holds{': ' + words if words else ''}; {by}",
        evidence,
        f"use the older calibration, which promises {_shown(step.promised, 'm')}, "
        f"rather than this one: {_shown(expected, 'm')}"
        if step.promised < expected
        else "",
    )


def _of_robot(jump: Jump) -> bool:
    """Whether a change is, or may be, one of the robot."""
    return any(not w.startswith(("base", "tool")) for w in (jump.kind, *jump.instead))


def _remedies(jumps: tuple[Jump, ...]) -> Iterator[str]:
    kinds = {jump.kind for jump in jumps}
    if "robot" in kinds:
        yield "look whether this is another robot of the type, by its serial number"
    yield "look for what was hit, loosened or exchanged"
    words = dict.fromkeys(w.split(" ")[0] for jump in jumps for w in jump.instead)
    frames = {j.kind for j in jumps if j.instead} & {"base", "tool"}
    for word in sorted(frames | words.keys()):
        yield f"to tell it from {word}s, {SEPARATE[word]}"


def _words(jump: Jump) -> str:
    """A sudden change in words."""
    instead = f" (or instead {' or '.join(jump.instead)})" if jump.instead else ""
    if jump.kind == "offset":
        unit, factor = DISPLAY[jump.unit]
        value, sigma = factor * abs(jump.change), factor * jump.sigma
        return (
            f"the offset of '{jump.name}' has changed by {value:.2g} +- {sigma:.1g} "
            f"{unit}{instead}"
        )
    of = f"'{jump.name}'" if jump.name else "the whole robot"
    if jump.kind in ("base", "tool"):
        of = f"the {jump.kind}" + (f" '{jump.name}'" if jump.name else "")
    sizes = [(jump.change, "m"), (jump.turn, "rad")]
    moved = " and ".join(_shown(size, unit) for size, unit in sizes if size > 0.0)
    other = ", or this is another robot of the type" if jump.kind == "robot" else ""
    beside = " and ".join(jump.beside)
    beside = f" (the offset of {beside} would not show beside it)" if beside else ""
    return f"{of} has moved by {moved}{instead}{beside}{other}"


def _shown(size: float, unit: str) -> str:
    shown, factor = DISPLAY[unit]
    return f"{factor * size:.2g} {shown}"
