"""Figures of a calibration and of a plan, one module per kind; they touch no files."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from functools import partial
from typing import TypeVar

from matplotlib.figure import Figure

from calib_pin.io.robot_shapes import robot_shapes
from calib_pin.kinematics.shapes import Shape
from calib_pin.planning.plan import Plan
from calib_pin.report.figures.acceptance import Judged, poses_tested
from calib_pin.report.figures.canvas import COLORS, Drawn, drawing
from calib_pin.report.figures.cumulative import cumulative_errors
from calib_pin.report.figures.estimates import parameter_intervals
from calib_pin.report.figures.fleet import (
    Foreseen,
    accuracy_by_configurations,
    errors_in_fleet,
)
from calib_pin.report.figures.identifiability import singular_values
from calib_pin.report.figures.measurement_errors import errors_per_measurement
from calib_pin.report.figures.plans import (
    criterion_by_count,
    planned_positions,
)
from calib_pin.report.figures.residuals_along import (
    residuals_by_joint,
    residuals_over_order,
)
from calib_pin.report.figures.robot_errors import robot_errors
from calib_pin.report.figures.searches import convergence, model_ladder
from calib_pin.report.figures.workspace import (
    drift_in_workspace,
    error_vectors,
    tip_by_count,
    tip_in_workspace,
)
from calib_pin.validation.fleet import FleetRow
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.tip_drift import TipDrift

__all__ = [
    "COLORS",
    "NAMES",
    "Drawn",
    "Foreseen",
    "Judged",
    "acceptance_figures",
    "calibration_figures",
    "comparison_figures",
    "figures",
    "fleet_figures",
    "outlook_figures",
    "plan_figures",
]

OF_CALIBRATION: tuple[Callable[[CalibrationResult], Drawn | None], ...] = (
    cumulative_errors,
    errors_per_measurement,
    error_vectors,
    residuals_over_order,
    residuals_by_joint,
    singular_values,
    parameter_intervals,
    convergence,
    tip_by_count,
    tip_in_workspace,
    model_ladder,
)

OF_PLAN: tuple[Callable[[Plan], Drawn | None], ...] = (
    criterion_by_count,
    planned_positions,
)

NAMES: Mapping[str, tuple[str, ...]] = {
    "calibration": (
        "robot-errors",
        "cumulative-errors",
        "errors-per-measurement",
        "error-vectors",
        "errors-in-workspace",
        "residuals-over-order",
        "residuals-by-joint",
        "singular-values",
        "parameter-intervals",
        "convergence",
        "tip-error-by-count",
        "tip-accuracy-in-workspace",
        "model-ladder",
    ),
    "plan": ("criterion-by-count", "planned-positions"),
    "comparison": ("tip-drift",),
    "acceptance": ("poses-tested",),
    "fleet": ("errors-in-fleet",),
    "outlook": ("accuracy-by-configurations",),
}
"""Names of all figures, by their subject."""

_Subject = TypeVar("_Subject")


def calibration_figures(
    result: CalibrationResult, shapes: Sequence[Shape] = ()
) -> Iterator[Drawn]:
    """Figures of a calibration, those for which there is something to show.

    Args:
        result: The calibration.
        shapes: Shapes of the robot's links, see `io.robot_shapes`; simple solids where
            there are none.
    """
    yield from _drawn((partial(robot_errors, shapes=shapes),), result)
    yield from _drawn(OF_CALIBRATION, result)


def figures(result: CalibrationResult) -> dict[str, Figure]:
    """The same as matplotlib figures by name, see `CalibrationResult.figures`."""
    shapes = robot_shapes(result.model.chains.robot).parts
    return {drawn.name: drawn.figure for drawn in calibration_figures(result, shapes)}


def plan_figures(plan: Plan) -> Iterator[Drawn]:
    """Figures of a plan, those for which there is something to show."""
    yield from _drawn(OF_PLAN, plan)


def comparison_figures(drift: TipDrift) -> Iterator[Drawn]:
    """Figures of the difference between two calibrations."""
    yield from _drawn((drift_in_workspace,), drift)


def acceptance_figures(found: Judged) -> Iterator[Drawn]:
    """Figures of an acceptance test."""
    yield from _drawn((poses_tested,), found)


def fleet_figures(rows: Sequence[FleetRow]) -> Iterator[Drawn]:
    """Figures of a fleet."""
    yield from _drawn((errors_in_fleet,), rows)


def outlook_figures(found: Foreseen) -> Iterator[Drawn]:
    """Figures of a Monte Carlo study."""
    yield from _drawn((accuracy_by_configurations,), found)


def _drawn(
    figures: Iterable[Callable[[_Subject], Drawn | None]], subject: _Subject
) -> Iterator[Drawn]:
    for draw in figures:
        # Whoever takes the figures one by one keeps a style of their own.
        with drawing():
            drawn = draw(subject)
        if drawn is not None:
            yield drawn
