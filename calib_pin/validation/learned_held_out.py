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
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.learning import left_out, with_learned
from calib_pin.kinematics.spatial import Floats
from calib_pin.validation.model_errors import ModelErrors, model_errors


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
    found = list[ModelErrors | None]()
    for mask, known in zip(masks, told, strict=True):
        if not known:
            found.append(None)
            continue
        one, step = next(others), _without(fit, mask)
        # What was learned stands on the geometry; where it fades, that remains.
        moved = with_learned(problem, replace(one, shift=one.shift - step))
        own = replace(model, problem=moved, theta=theta + step)
        found.append(model_errors(own, data.rows(mask), np.flatnonzero(mask)))
    return found


def _without(fit: Fit, mask: NDArray[np.bool_]) -> Floats:
    """How the parameters of the robot and its frames move without some rows, (P,)."""
    problem, (_, held, moved) = fit.problem, fit.held
    step = np.zeros(len(fit.theta))
    if problem.many:  # Of so many it is nothing.
        return step
    kept = np.append(~mask[problem.layout.row], np.ones(len(held.fun), bool))
    kept = kept[: len(held.fun)]
    basis = problem.parameters.scales[:, None] * moved
    J, r = held.jac[kept] @ basis, held.fun[kept]
    of_error = np.concatenate([part.of_error for part in problem.parts.values()])
    step[of_error] = -(basis @ np.linalg.lstsq(J, r, rcond=None)[0])[of_error]
    return step
