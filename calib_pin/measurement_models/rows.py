"""What is known of rows by their measurement model and target alone."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.base import MeasurementModel
from calib_pin.measurement_models.mixed import Mixed
from calib_pin.observations import rows_by_part


def assumed_sigma(measurement: MeasurementModel, noise: Mapping[str, float]) -> Floats:
    """Standard deviation of the residual components where rows state none, (d,)."""
    return np.concatenate(
        [
            np.full(
                quantity.columns.stop - quantity.columns.start,
                noise.get(quantity.noise or quantity.name, quantity.sigma),
            )
            for quantity in measurement.quantities
        ]
    )


def absent(measurement: MeasurementModel, target: Sequence[str]) -> Floats | None:
    """Standard deviations of mixed rows that state none, see `Measurements.sigma`."""
    if not isinstance(measurement, Mixed):
        return None
    return measurement.unstated(target)


def relative_rows(
    measurement: MeasurementModel, target: Sequence[str]
) -> NDArray[np.bool_]:
    """The rows that are measured relative to a start, shape (N,)."""
    return _rows_where(measurement, target, lambda part: part.relative)


def contact_rows(
    measurement: MeasurementModel, target: Sequence[str]
) -> NDArray[np.bool_]:
    """The rows at which the tool touches something, shape (N,)."""
    return _rows_where(measurement, target, lambda part: part.contact)


def _rows_where(
    measurement: MeasurementModel,
    target: Sequence[str],
    holds: Callable[[MeasurementModel], bool],
) -> NDArray[np.bool_]:
    """The rows of whose measurement model something holds, shape (N,).

    Args:
        measurement: The measurement model.
        target: Target of each row.
        holds: Whether it does of a model, a part of a mixed one.
    """
    if not isinstance(measurement, Mixed):
        return np.full(len(target), holds(measurement))
    result = np.zeros(len(target), bool)
    for name, rows in rows_by_part(target).items():
        result[rows] = holds(measurement.parts[name])
    return result
