"""Measurement models, by the names that users write."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from calib_pin.errors import OptionError, require_known
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.base import (
    Batch,
    BatchedModel,
    Curvature,
    CurvedModel,
    Linearization,
    MeasurementModel,
    Quantity,
)
from calib_pin.measurement_models.camera import camera
from calib_pin.measurement_models.contact import PlaneContact, SphereContact
from calib_pin.measurement_models.distance import PointDistance, RelativeDistance
from calib_pin.measurement_models.features import (
    Anchor,
    Feature,
    Plane,
    Point,
    Sphere,
)
from calib_pin.measurement_models.fixed_point import FixedPoint
from calib_pin.measurement_models.mixed import Mixed, qualified
from calib_pin.measurement_models.plane_distance import PlaneDistance
from calib_pin.measurement_models.pose import Pose
from calib_pin.measurement_models.position import Position
from calib_pin.measurement_models.tool_point import (
    PointModel,
    named_points,
    split_names,
)
from calib_pin.observations import PLUS
from calib_pin.setup import Setup

__all__ = [
    "MEASUREMENT_MODELS",
    "Batch",
    "BatchedModel",
    "Curvature",
    "CurvedModel",
    "Feature",
    "Linearization",
    "MeasurementModel",
    "Mixed",
    "Quantity",
    "measurement_model",
]


def _planes(setup: Setup, names: Sequence[str]) -> tuple[Plane, ...]:
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
    return tuple(planes) or tuple(map(Plane, _known(names, "plane")))


def _sockets(setup: Setup, names: Sequence[str]) -> tuple[Point, ...]:
    return named_points(setup.sockets, _known(names, "socket"), "socket")


def _spheres(setup: Setup, names: Sequence[str]) -> tuple[Sphere, ...]:
    return tuple(
        Sphere(
            name,
            _array(given.xyz),
            given.radius,
            given.estimate,
            given.radius is None
            if given.estimate_radius is None
            else given.estimate_radius,
        )
        for name, given in setup.spheres.items()
    ) or tuple(map(Sphere, _known(names, "sphere")))


def _anchors(setup: Setup, names: Sequence[str]) -> tuple[Anchor, ...]:
    return tuple(
        Anchor(name, _array(given.xyz), given.bias, given.estimate, given.estimate_bias)
        for name, given in setup.anchors.items()
    ) or tuple(map(Anchor, _known(names, "anchor")))


def _plane_distance(setup: Setup, targets: Sequence[str]) -> PlaneDistance:
    near, reach = setup.ranger.range
    return PlaneDistance(_planes(setup, targets), near, reach, setup.ranger.incidence)


def _points(
    kind: type[PointModel],
    places: Callable[[Setup, Sequence[str]], tuple[Feature, ...]] | None = None,
    named: bool = True,
) -> Callable[[Setup, Sequence[str]], PointModel]:
    """How a model of tool points is made: its points, its places, its origin.

    Args:
        kind: The model.
        places: Its places out of a setup and the names that rows give; None for none.
        named: Whether rows name something behind the point.
    """

    def make(setup: Setup, targets: Sequence[str]) -> PointModel:
        points, names = split_names(targets, named)
        used = {name: setup.targets[name] for name in points if name in setup.targets}
        # Without rows, or where one names what is not stated, all of them count.
        wrong = any(name and name not in setup.targets for name in points)
        stated = setup.targets if wrong or not targets else used
        found = named_points(stated, points, "target")
        origin = "" in points if targets else not found
        given: tuple[Feature, ...] = ()
        if places is not None:
            given = places(setup, names)
            if targets and {place.name for place in given}.issuperset(names):
                # What nobody has placed and no row names cannot be found.
                given = tuple(p for p in given if p.placed or p.name in names)
        return kind(points=found, places=given, origin=origin)

    return make


MEASUREMENT_MODELS: Mapping[str, Callable[[Setup, Sequence[str]], Any]] = {
    "position": _points(Position, named=False),
    "pose": lambda setup, targets: Pose(),
    "plane-distance": _plane_distance,
    "point-distance": _points(PointDistance, _anchors),
    "relative-distance": _points(RelativeDistance),
    "fixed-point": _points(FixedPoint, _sockets),
    "plane-contact": _points(PlaneContact, _planes),
    "sphere-contact": _points(SphereContact, _spheres),
    "camera": camera,
}
"""How each measurement model is made from a setup and the targets that rows name."""


def measurement_model(
    name: str, setup: Setup, targets: Sequence[str] = ()
) -> MeasurementModel:
    """The measurement model of a name, or of several with a plus between them.

    Args:
        name: Name of the model, such as `position` or `position+fixed-point`.
        setup: What the user states about it, such as its planes.
        targets: The targets that the rows name; of several models qualified by theirs,
            see `mixed.qualified`.

    Raises:
        OptionError: If there is no such model, or a plane has no normal.
    """
    names = name.split(PLUS)
    for part in names:
        require_known("measurement model", part, MEASUREMENT_MODELS)
    if len(names) == 1:
        model: MeasurementModel = MEASUREMENT_MODELS[name](
            setup, tuple(dict.fromkeys(targets))
        )
        return model
    return Mixed.create(
        {
            part: MEASUREMENT_MODELS[part](setup, seen)
            for part, seen in qualified(names, targets).items()
        }
    )


def _known(names: Sequence[str], default: str) -> tuple[str, ...]:
    """Names that rows give; one of its kind where they give none."""
    return tuple(dict.fromkeys(name or default for name in names)) or (default,)


def _array(xyz: Sequence[float] | None) -> Floats | None:
    return None if xyz is None else np.array(xyz, float)
