"""The split of measurements into those to fit and those to check the fit with."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, OptionError
from calib_pin.measurement_models.side_by_side import by_part
from calib_pin.observations import Measurements, fitted_and_held_out
from calib_pin.setup import Setup
from calib_pin.validation.splits import Grouping


def split(
    measurements: Measurements,
    setup: Setup,
    validation: Measurements | None,
    holdout: float | None,
    seed: int,
) -> tuple[Measurements, Measurements | None, str]:
    """Training measurements, validation measurements if any, and how they were chosen.

    Raises:
        InputError: If no measurement is left to fit, or none of one model.
        OptionError: If the holdout is out of range, or validation measurements are
            given as well.
    """
    if validation is not None and holdout is not None:
        raise OptionError("give validation measurements or a holdout, not both")
    training, marked = fitted_and_held_out(measurements)
    if len(training) == 0:
        raise InputError("no measurement is left to fit: all are marked for validation")
    _require_parts(training, marked, "all are marked for validation")
    if validation is not None:
        if len(validation) == 0:
            raise InputError("there are no measurements to validate with")
        if validation.model != measurements.model:
            raise InputError(
                f"cannot check '{measurements.model}' measurements with "
                f"'{validation.model}' ones"
            )
        return training, validation, "file"
    if holdout is not None:
        mask = _held_out(training, setup, holdout, seed)
        kept, left = training.rows(~mask), training.rows(mask)
        _require_parts(kept, left, "the holdout took all")
        return kept, left, "holdout"
    return training, marked if len(marked) else None, "set"


def _held_out(
    measurements: Measurements, setup: Setup, holdout: float, seed: int
) -> NDArray[np.bool_]:
    """The mask of a holdout, which takes whole groups, shape (N,).

    Raises:
        OptionError: If it is out of range or leaves nothing.
    """
    if not 0.0 < holdout < 1.0:
        raise OptionError(
            "holdout is out of range", value=holdout, allowed="between 0 and 1"
        )
    grouping = Grouping.of(measurements, setup)
    labels, order = grouping.groups, grouping.shuffled(seed)
    count = max(1, round(holdout * len(measurements)))
    size = np.cumsum(np.bincount(labels)[order])
    chosen = np.zeros(len(order), bool)
    chosen[order[: int(np.searchsorted(size, count)) + 1]] = True
    mask = np.asarray(chosen[labels])
    if mask.all():
        raise OptionError("holdout leaves no measurement to fit", value=holdout)
    return mask


def _require_parts(training: Measurements, left: Measurements, why: str) -> None:
    """Refuse mixed measurements of which one model has none to fit.

    Raises:
        InputError: If there is such a model.
    """
    for model, (_, measurements) in by_part(left).items():
        if model not in by_part(training):
            raise measurements.error(
                0, f"no '{model}' measurement is left to fit: {why}", column="set"
            )
