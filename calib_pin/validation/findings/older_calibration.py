"""Whether an older calibration still holds, by what it predicts of new measurements."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib_pin.estimation.evidence import Finding
from calib_pin.units import DISPLAY
from calib_pin.validation.summaries import Jump, Recalibration


def older_calibration(found: Recalibration) -> Iterator[Finding]:
    """Sudden changes of a robot since an older calibration, or that there are none."""
    step = found.last
    day = f" of {step.created[:10]}" if step.created else ""
    told = " and ".join(
        f"{name} errors of {_shown(accuracy.rms, unit)} rms"
        for name, unit, accuracy in found.errors
    )
    by = f"chi-square {step.chi2:.0f} where {step.dof} is expected"
    evidence = {"chi2": step.chi2, "dof": float(step.dof)}
    if not step.jumps:
        yield Finding(
            "old-calibration-holds",
            "info",
            f"the older calibration{day} still holds: it predicts these measurements "
            f"with {told}, {by}",
            evidence,
        )
        return
    names = {f"joint {k}": jump.name or "all" for k, jump in enumerate(step.jumps, 1)}
    sizes = {f"change {k}": jump.change for k, jump in enumerate(step.jumps, 1)}
    yield Finding(
        "old-calibration-no-longer-holds",
        "warning",
        f"the older calibration{day} no longer holds: it predicts these measurements "
        f"with {told}, {by}; {', and '.join(map(_words, step.jumps))}",
        {**evidence, **names, **sizes},
        "look for what was hit, loosened or exchanged; what has changed is estimated "
        "anew from these measurements alone, and more of them tell it better",
    )


def _words(jump: Jump) -> str:
    """A sudden change in words."""
    if jump.kind == "offset":
        unit, factor = DISPLAY[jump.unit]
        value, sigma = factor * abs(jump.change), factor * jump.sigma
        return (
            f"the offset of '{jump.name}' has changed by {value:.2g} +- {sigma:.1g} "
            f"{unit}"
        )
    of = f"'{jump.name}'" if jump.name else "the whole robot"
    sizes = [(jump.change, "m"), (jump.turn, "rad")]
    moved = " and ".join(_shown(size, unit) for size, unit in sizes if size > 0.0)
    return f"{of} has moved by {moved}"


def _shown(size: float, unit: str) -> str:
    shown, factor = DISPLAY[unit]
    return f"{factor * size:.2g} {shown}" if np.isfinite(size) else "unknown size"
