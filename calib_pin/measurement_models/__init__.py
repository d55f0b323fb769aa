"""Measurement models: how the pose of the tool becomes a measured value.

A new one is a file with a `MeasurementModel` and its line in the list here, or an entry
point of another package, see `plugins`.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from calib_pin.errors import require_known
from calib_pin.measurement_models.base import (
    Batch,
    BatchedModel,
    Linearization,
    MeasurementModel,
)
from calib_pin.measurement_models.camera import CameraModel
from calib_pin.measurement_models.contact import PlaneContact, SphereContact
from calib_pin.measurement_models.declaration import (
    Declaration,
    Quantity,
)
from calib_pin.measurement_models.distance import PointDistance, RelativeDistance
from calib_pin.measurement_models.fixed_point import FixedPoint
from calib_pin.measurement_models.orientations import NORM, normalized
from calib_pin.measurement_models.plane_distance import PlaneDistance
from calib_pin.measurement_models.pose import Pose
from calib_pin.measurement_models.position import Position
from calib_pin.observations import Measurements
from calib_pin.plugins import Members
from calib_pin.setup import Setup

__all__ = [
    "MEASUREMENT_MODELS",
    "Batch",
    "BatchedModel",
    "Declaration",
    "Linearization",
    "MeasurementModel",
    "Quantity",
    "as_declared",
    "declared",
    "measurement_model",
]


def _fault(name: str, model: object) -> str:
    """Why an object of another package cannot be a member; empty where it can."""
    if not (isinstance(model, type) and issubclass(model, MeasurementModel)):
        return "it is no MeasurementModel"
    given = getattr(model, "declaration", None)
    if not isinstance(given, Declaration):
        return "it has no declaration"
    return "" if given.name == name else f"it declares the name '{given.name}'"


MEMBERS: Sequence[type[MeasurementModel]] = (
    *(Position, Pose, PlaneDistance, PointDistance, RelativeDistance),
    *(FixedPoint, PlaneContact, SphereContact, CameraModel),
)

MEASUREMENT_MODELS: Mapping[str, type[MeasurementModel]] = Members(
    "calib_pin.measurement_models",
    {model.declaration.name: model for model in MEMBERS},
    _fault,
)
"""The measurement models by name: those that come with calib-pin, then others."""


def declared(name: str) -> Declaration:
    """The declaration of a measurement model, by its name.

    Raises:
        OptionError: If there is none; names the nearest.
    """
    require_known("measurement model", name, MEASUREMENT_MODELS)
    return MEASUREMENT_MODELS[name].declaration


def as_declared(data: Measurements) -> Measurements:
    """Measurements with the columns of their model, and quaternions of length one.

    Raises:
        OptionError: If there is no such model.
        InputError: If columns differ, or a quaternion has another length.
    """
    kind = declared(data.model)
    for name, columns in (("values", kind.values), ("sigma", kind.components)):
        table = getattr(data, name)
        # Contacts may have no values, or deviations that a gauge reads.
        widths = (0, len(kind.components)) if kind.contact else (len(columns),)
        if table is not None and table.shape[1] not in widths:
            reason = f"'{name}' of a {data.model} has {table.shape[1]} columns"
            raise data.error(0, reason, allowed=", ".join(columns) or "none")
    if not kind.oriented:
        return data
    given = data.values[:, -4:]
    norm, unit = normalized(given)
    off = abs(norm - 1.0)
    if (off > NORM).any():
        row = int(off.argmax())
        reason = f"'values': the norm of the quaternion is {norm[row]:.6g}"
        raise data.error(row, reason, allowed="0.99 to 1.01")
    if np.array_equal(unit, given):
        return data
    return replace(data, values=np.hstack([data.values[:, :-4], unit]))


def measurement_model(
    name: str, setup: Setup, targets: Sequence[str] = ()
) -> MeasurementModel:
    """The measurement model of a name.

    Args:
        name: Name of the model, such as `position`.
        setup: The setup of the user, such as its planes.
        targets: The targets that measurements name, each once.

    Raises:
        OptionError: If there is no such model, or the setup lacks what it needs.
    """
    declared(name)
    return MEASUREMENT_MODELS[name].from_setup(setup, tuple(targets))
