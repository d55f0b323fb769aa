"""Measurement models, by the names that users write."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

import numpy as np

from calib_pin.errors import OptionError, require_known
from calib_pin.measurement_models.base import (
    BatchedModel,
    Curvature,
    CurvedModel,
    Linearization,
    MeasurementModel,
    Quantity,
)
from calib_pin.measurement_models.plane_distance import Plane, PlaneDistance
from calib_pin.measurement_models.pose import Pose
from calib_pin.measurement_models.position import Position
from calib_pin.setup import Setup

__all__ = [
    "MEASUREMENT_MODELS",
    "BatchedModel",
    "Curvature",
    "CurvedModel",
    "Linearization",
    "MeasurementModel",
    "Quantity",
    "measurement_model",
]


def _plane_distance(setup: Setup, targets: Sequence[str]) -> PlaneDistance:
    planes = []
    for name, given in setup.planes.items():
        normal = np.array(given.normal, float)
        length = float(np.linalg.norm(normal))
        if not 0.0 < length < np.inf:
            raise OptionError(
                f"the normal of the plane '{name}' has no direction",
                value=list(given.normal),
            )
        planes.append(
            Plane(name, normal / length, given.offset / length, given.estimate)
        )
    if not planes:
        names = dict.fromkeys(name or "plane" for name in targets)
        planes = [Plane(name) for name in names or ("plane",)]
    near, reach = setup.ranger.range
    return PlaneDistance(tuple(planes), near, reach, setup.ranger.incidence)


MEASUREMENT_MODELS: Mapping[str, Callable[[Setup, Sequence[str]], MeasurementModel]] = {
    "position": lambda setup, targets: Position(),
    "pose": lambda setup, targets: Pose(),
    "plane-distance": _plane_distance,
}
"""How each measurement model is made from a setup and the targets that rows name."""


def measurement_model(
    name: str, setup: Setup, targets: Sequence[str] = ()
) -> MeasurementModel:
    """The measurement model of a name.

    Args:
        name: Name of the model.
        setup: What the user states about it, such as its planes.
        targets: The targets that the rows name.

    Raises:
        OptionError: If there is no such model, or a plane has no normal.
    """
    require_known("measurement model", name, MEASUREMENT_MODELS)
    return MEASUREMENT_MODELS[name](setup, targets)
