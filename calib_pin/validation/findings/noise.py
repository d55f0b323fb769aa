"""Standard deviations that the measurements contradict."""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

from calib_pin.estimation.evidence import Finding, VarianceComponent
from calib_pin.observations import states_sigmas
from calib_pin.units import DISPLAY
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.setup_lines import written

FACTOR = 2.0
"""Estimated by stated standard deviation, or the inverse, from which it is told."""

CHANCE = 1e-3
"""Probability by chance below which repetitions contradict what is stated."""


def noise(case: Case) -> Iterator[Finding]:
    """Stated standard deviations that are far from those of the measurements.

    Too large ones are wrong. Too small ones may leave no room for what no parameter
    describes, gears and compliance; they are wrong where repetitions scatter as much.
    """
    fitted = case.fitted
    if fitted is None:
        return
    known = [part for part in fitted.noise if _scatter(part)[0] > 0.0]
    lines: dict[str, dict[str, Any]] = {
        "noise": {part.quantity: float(f"{_scatter(part)[0]:.3g}") for part in known}
    }
    if states_sigmas(case.data):
        lines |= {"reading": {"sigmas": False}}
    for part in known:
        scatter, repeated = _scatter(part)
        factor = scatter / part.given
        if not (part.stated and part.contradicted and not _near(factor)):
            continue
        unit, to_shown = DISPLAY[part.unit]
        said, found = (f"{to_shown * x:.2g} {unit}" for x in (part.given, scatter))
        unclear = factor > 1.0 and not repeated
        if unclear and case.doubtful:
            continue  # There is more to it than noise.
        if unclear:
            message = (
                f"the errors of {part.quantity} are {factor:.3g} times the stated "
                f"{said}: sigma is too small, or no parameter describes them"
            )
        else:
            times = f"{factor:.2g} times too small"
            if factor < 1.0:
                times = f"{1.0 / factor:.2g} times too large"
            message = (
                f"the stated sigma of {part.quantity}, {said}, is {times}: the "
                f"measurements scatter by {found}"
            )
        # What shows as gears or as lack of fit is no fault of sigma.
        robot = fitted.effects is not None or part.pure is not None
        yield Finding(
            "noise",
            "info" if unclear and robot else "warning",
            message,
            {
                "quantity": part.quantity,
                "stated": part.given,
                "estimated": scatter,
                "factor": factor,
            },
            "repeat some configurations, which tells noise from unmodeled errors"
            if unclear
            else f"state in the setup file: {written(lines)}",
            lines,
        )


def _scatter(part: VarianceComponent) -> tuple[float, bool]:
    """Standard deviation of a quantity, and whether repetitions tell it."""
    if part.pure is not None and (part.pure_test or 0.0) < CHANCE:
        return part.pure, True
    return part.estimate, False


def _near(factor: float) -> bool:
    return 1.0 / FACTOR < factor < FACTOR
