"""Values that a controller computed from the joints, and no instrument measured."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np

from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.problem import error_table
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.units import DISPLAY
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.coarse_values import coarse_step

COMPUTED = 3e-6
"""Errors of the nominal robot, in parts of how far the tool moved, below which it has
computed them: a micrometer in a meter is what six digits leave, and the best tracker
sees ten times that on a robot without errors."""

FINE, ROUNDED = 1e-5, 1.2
"""Steps of written values up to which errors of so many times what rounding makes are
those of a controller that rounds: no robot is as near to its URDF [m]."""

FEWEST = 8
"""Configurations below which frames alone may explain positions."""


def spread(blocks: Sequence[Floats]) -> float:
    """Root mean square distance of points from the mean of their block.

    Args:
        blocks: Points, each of shape (N, k).
    """
    away = np.concatenate([np.sum((p - p.mean(0)) ** 2, axis=1) for p in blocks])
    return float(np.sqrt(away.mean()))


def constant_orientation(case: Case) -> Iterator[Finding]:
    """Orientations that are the same at all configurations, and were not measured."""
    blocks = [b for b in case.data.blocks if declared(b.model).oriented]
    if case.data.configurations < FEWEST or not blocks:
        return
    if not any(np.ptp(block.values[:, 3:], axis=0).any() for block in blocks):
        yield Finding(
            "constant-orientation",
            "error",
            "the measured orientation is the same at all configurations: no instrument "
            "has measured it",
            {"configurations": float(case.data.configurations)},
            "take the positions alone: --model position",
        )


def computed_values(case: Case) -> Iterator[Finding]:
    """Positions that fit to the nominal robot as those of no instrument can."""
    problem = case.fit.problem
    blocks = [b for b in problem.data.blocks if b.model in ("position", "pose")]
    if not blocks or problem.data.configurations < FEWEST:
        return
    errors = error_table(problem, case.nominal)
    # Beside those of another model they have its name too, and rows of nan.
    named = (q for q in problem.layout.quantities if q.name.startswith("position"))
    rms = min(float(np.sqrt(np.nanmean(q.errors(errors) ** 2))) for q in named)
    moved = spread([block.values[:, :3] for block in blocks])
    step = max(coarse_step(b.values[:, :3].ravel(), "m") for b in blocks)
    rounding = ROUNDED * step * np.sqrt(3.0 / 12.0) if step <= FINE else 0.0
    if rms < max(COMPUTED * moved, rounding):
        unit, factor = DISPLAY["m"]
        yield Finding(
            "computed-values",
            "error",
            f"the positions fit to the nominal robot to {factor * rms:.2g} {unit}, "
            "which no instrument does: they were computed from the joints",
            {"rms": rms, "moved": moved},
            "take the columns that an instrument measured; 'calib-pin init' finds them",
        )
