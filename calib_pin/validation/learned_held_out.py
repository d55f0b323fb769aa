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

from calib_pin.estimation.directions import visible_nuisances
from calib_pin.estimation.fit import FittedModel
from calib_pin.estimation.learning import left_out, with_learned
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
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
        The errors; None for a part that has all that is known of some target.
    """
    fit, learned = model.fit, model.learned
    problem, theta = fit.problem.rebased(fit.theta)
    assert learned is not None
    data, things = problem.data, problem.data.things()
    told = [bool(np.isin(things[mask], things[~mask]).all()) for mask in masks]
    parts = [mask for mask, known in zip(masks, told, strict=True) if known]
    rng = np.random.default_rng(seed)
    others = iter(left_out(learned, fit, problem, theta, parts, rng))
    registration = fit.registered
    frames = visible_nuisances(registration[1], problem.parameters)
    _, held, moved = fit.held
    of_error = np.concatenate([part.of_error for part in problem.parts.values()])
    found = list[ModelErrors | None]()
    for mask, known in zip(masks, told, strict=True):
        if not known:
            found.append(None)
            continue
        rows, correction = data.rows(mask), next(others)
        nominal = fit.before + _step(fit.problem, mask, registration, frames)
        step = np.zeros_like(theta)
        linear = _step(fit.problem, mask, (held.fun, held.jac), moved)
        step[of_error] = linear[of_error]
        # What was learned stands on the geometry; where it fades, that remains.
        own = replace(correction, shift=correction.shift - step)
        before = registered(fit.problem, nominal, rows)
        after = registered(with_learned(problem, own), theta + step, rows)
        positions = np.flatnonzero(mask)
        found.append(errors_of_registered(model, before, after, positions))
    return found


def _step(
    problem: Problem,
    mask: NDArray[np.bool_],
    linear: tuple[Floats, Floats],
    moved: Floats,
) -> Floats:
    """How parameters move when some measurements are left out, shape (P,).

    Args:
        problem: The problem.
        mask: The measurements, shape (N,).
        linear: Whitened residual and Jacobian where all of them are fitted.
        moved: Directions of the parameters, in their scales, shape (P, k).
    """
    if problem.many:  # Among so many, no part has a say.
        return np.zeros(len(moved))
    residual, J = linear
    kept = np.ones(len(residual), bool)  # Priors stand behind the measurements.
    kept[: len(problem.layout.row)] = ~mask[problem.layout.row]
    basis = problem.parameters.scales[:, None] * moved
    A = J[kept] @ basis
    return np.asarray(-basis @ np.linalg.lstsq(A, residual[kept], rcond=None)[0])
