"""Figures of a calibration, a test and a study, one function each; no files.

Each answers a question: where a robot errs, how much, which measurements are at fault,
which joint, whether more would help, and where the tool can be trusted.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from functools import partial
from typing import Any

from matplotlib.figure import Figure

from calib_pin.io.robot_shapes import robot_shapes
from calib_pin.kinematics.shapes import Shape
from calib_pin.report.figures import errors, robots, workspace
from calib_pin.report.figures.canvas import Drawn, drawing
from calib_pin.report.figures.robot_errors import robot_errors
from calib_pin.validation.result import CalibrationResult

__all__ = ["NAMES", "Drawn", "drawn"]

DRAWN: Mapping[str, Mapping[str, Callable[..., Drawn | None]]] = {
    "calibration": {
        "robot-errors": robot_errors,
        "cumulative-errors": errors.cumulative_errors,
        "errors-per-measurement": errors.errors_per_measurement,
        "residuals-over-order": errors.residuals_over_order,
        "residuals-by-joint": errors.residuals_by_joint,
        "tip-accuracy-in-workspace": workspace.tip_in_workspace,
    },
    "acceptance": {"poses-tested": robots.poses_tested},
    "outlook": {"accuracy-by-configurations": robots.accuracy_by_configurations},
}
"""All figures by their subject and name."""

NAMES: Mapping[str, tuple[str, ...]] = {of: (*names,) for of, names in DRAWN.items()}


def drawn(of: str, *subject: Any, shapes: Sequence[Shape] = ()) -> Iterator[Drawn]:
    """Figures of a subject, those for which there is something to show.

    Args:
        of: Its kind, one of `DRAWN`.
        subject: A calibration; tests and their limit; the outlooks of a study and the
            limit.
        shapes: Shapes of the links of a calibrated robot, see `io.robot_shapes`; simple
            solids where there are none.
    """
    for name, draw in DRAWN[of].items():
        if draw is robot_errors:
            draw = partial(robot_errors, shapes=shapes)
        # Whoever takes the figures one by one keeps a style of their own.
        with drawing():
            figure = draw(*subject)
        if figure is not None:
            yield replace(figure, name=name)


def figures(result: CalibrationResult) -> dict[str, Figure]:
    """Those of a calibration by name, see `CalibrationResult.figures`."""
    shapes = robot_shapes(result.model.chains.robot).parts
    pictures = drawn("calibration", result, shapes=shapes)
    return {figure.name: figure.figure for figure in pictures}
