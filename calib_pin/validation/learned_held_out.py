"""Errors of left-out measurements where something was learned.

The geometry is that of the fit of all, and what was learned takes the left-out ones'
part of it away, see `residual_models.gaussian_process`: the shift of the geometry that
belongs to a correction is found anew with it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.fit import FittedModel
from calib_pin.estimation.learning import left_out, with_learned
from calib_pin.kinematics.spatial import Floats
from calib_pin.validation.left_out import Linear, without
from calib_pin.validation.model_errors import (
    ModelErrors,
    errors_of_registered,
    registered,
)


def learned_left_out(
    model: FittedModel, masks: Sequence[NDArray[np.bool_]], seed: int
) -> list[ModelErrors | None]:
    """Errors of each part of the measurements by what the others teach.

    Args:
        model: The fitted model, with a learned correction.
        masks: The parts, each of shape (N,).
        seed: Seed of whatever is learned anew.

    Returns:
        The errors; None for a part whose others do not tell the geometry.
    """
    fit, learned = model.fit, model.learned
    problem, theta = fit.problem.rebased(fit.theta)
    assert learned is not None
    robots, row = Linear.of(fit), problem.layout.row

    def beside(mask: NDArray[np.bool_]) -> tuple[Floats, Floats] | None:
        """Nominal and fitted robot without a part, shape (P,) each."""
        if problem.many:  # Among so many, no part has a say.
            return fit.before, fit.theta
        before, after = (without(robot, mask[row]) for robot in robots)
        if before is None or after is None or after.alone.any():
            return None
        return before.theta, after.theta

    geometries = [beside(mask) for mask in masks]
    parts = [m for m, found in zip(masks, geometries, strict=True) if found]
    rng = np.random.default_rng(seed)
    others = iter(left_out(learned, fit, problem, theta, parts, rng))
    of_error = np.concatenate([term.of_error for term in problem.terms.values()])
    result = list[ModelErrors | None]()
    for mask, geometry in zip(masks, geometries, strict=True):
        if geometry is None:
            result.append(None)
            continue
        rows, correction = problem.data.rows(mask), next(others)
        nominal, fitted = geometry
        step = np.zeros_like(theta)
        step[of_error] = (fitted - fit.theta)[of_error]
        # What was learned stands on the geometry; where it fades, that remains.
        own = replace(correction, shift=correction.shift - step)
        before = registered(fit.problem, nominal, rows)
        after = registered(with_learned(problem, own), theta + step, rows)
        positions = np.flatnonzero(mask)
        result.append(errors_of_registered(model, before, after, positions))
    return result
