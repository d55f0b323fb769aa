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
    problem, theta = model.fit.problem.rebased(model.fit.theta)
    learned, data = model.learned, problem.data
    assert learned is not None
    things = data.things()
    told = [np.isin(things[mask], things[~mask]).all() for mask in masks]
    parts = [mask for mask, all_told in zip(masks, told, strict=True) if all_told]
    rng = np.random.default_rng(seed)
    corrections = iter(left_out(learned, model.fit, problem, theta, parts, rng))
    found = list[ModelErrors | None]()
    for mask, all_told in zip(masks, told, strict=True):
        if all_told:
            without = with_learned(problem, next(corrections))
            own = replace(model, problem=without)
            found.append(model_errors(own, data.rows(mask), np.flatnonzero(mask)))
        else:
            found.append(None)
    return found
