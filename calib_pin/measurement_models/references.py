"""The objects that measurements refer to: points, planes, spheres, fixed points.

A reference object is frozen and carries a reference, that it may lack until it is
registered; its parameters are deviations from that. Measurements name it as their
target. Whatever has parameters beside the robot's is a reference object, so that a
measurement model is only the formula that relates a tool pose to some of them.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import ClassVar, Self

import numpy as np

from calib_pin.errors import InputError, nearest
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices, Labels, Measurements, Targets
from calib_pin.parameters import Parameter
from calib_pin.setup import (
    AnchorSetup,
    CameraSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    SphereSetup,
)
from calib_pin.setup.values import Triple

METER = 1.0
"""Scale of an unknown place [m]: where something stands is no error of a robot."""


Stated = PointSetup | PlaneSetup | SphereSetup | AnchorSetup | CameraSetup | FrameSetup
"""A reference as a setup file would state it."""


class ReferenceObject(ABC):
    """Something with a name that measurements refer to."""

    name: str
    """Name that measurements give."""

    kind: str
    """Its kind, as in the names of its parameters."""

    @property
    def section(self) -> str:
        """Where it stands in a setup file, such as `planes`."""
        return f"{self.kind}s"

    @property
    @abstractmethod
    def located(self) -> bool:
        """Whether its reference is given or registered."""

    @property
    def outer(self) -> bool:
        """Whether it stands where the base does and not on the tool."""
        return True

    @property
    def components(self) -> Iterable[tuple[str, str, bool]]:
        """Name and unit of each parameter, and whether it is estimated."""
        return ()

    @property
    def parameters(self) -> Sequence[Parameter]:
        """Deviations from the reference, `<name>.<kind>.<component>`."""
        return tuple(
            Parameter(
                f"{self.name}.{self.kind}.{name}", unit, METER, True, self.outer, free
            )
            for name, unit, free in self.components
        )

    @abstractmethod
    def rebased(self, values: Floats) -> Self:
        """The same with its parameters, shape (K,), moved into the reference."""

    def facing(self, points: Floats) -> Self:
        """The same with points, shape (N, 3) [m], on its outer side, if it has one."""
        return self

    @abstractmethod
    def stated(self) -> Stated:
        """Its reference as a setup file would state it."""


@dataclass(frozen=True)
class Point(ReferenceObject):
    """A point: of the tool in the tool frame, or of a socket in the measurement frame.

    Attributes:
        name: Name that measurements give.
        kind: `target` for a point of the tool or of a board, `socket` for a socket.
        xyz: Reference, shape (3,) [m]; None until it is registered.
        estimate: Whether it is estimated.
    """

    name: str
    kind: str
    xyz: Floats | None = None
    estimate: bool = True

    @property
    def located(self) -> bool:
        """Whether its place is given or registered."""
        return self.xyz is not None

    @property
    def outer(self) -> bool:
        """Whether it is no point of the tool."""
        return self.kind != "target"

    @property
    def components(self) -> Iterable[tuple[str, str, bool]]:
        """Its coordinates x, y, z."""
        return ((c, "m", self.estimate) for c in "xyz")

    def at(self, values: Floats) -> Floats:
        """Its place, shape (3,) [m]."""
        assert self.xyz is not None
        return np.asarray(self.xyz + values)

    def rebased(self, values: Floats) -> Point:
        """Moved by (x, y, z)."""
        return replace(self, xyz=self.at(values))

    def stated(self) -> PointSetup:
        """Its place."""
        return PointSetup(triple(self.xyz), self.estimate)


@dataclass(frozen=True)
class Plane(ReferenceObject):
    """Reference of a plane `n . p + f = 0` in the measurement frame.

    Attributes:
        name: Name that measurements give as their target.
        normal: Unit normal n, shape (3,); None until it is registered.
        offset: Offset f [m].
        estimate: Whether the plane is estimated.
    """

    name: str
    normal: Floats | None = None
    offset: float = 0.0
    estimate: bool = True

    kind = "plane"

    @property
    def located(self) -> bool:
        """Whether it is given or registered."""
        return self.normal is not None

    @property
    def components(self) -> Iterable[tuple[str, str, bool]]:
        """Its turns u and v about the tangents, and a shift f."""
        units = (("u", "rad"), ("v", "rad"), ("f", "m"))
        return ((name, unit, self.estimate) for name, unit in units)

    @cached_property
    def tangents(self) -> Floats:
        """Two unit tangents, rows of a (2, 3) array; a fixed choice per normal."""
        assert self.normal is not None
        # Of components that are equal but for rounding, the first.
        helper = np.eye(3)[np.argmin(np.round(np.abs(self.normal), 9))]
        first = np.cross(self.normal, helper)
        first /= np.linalg.norm(first)
        return np.array([first, np.cross(self.normal, first)])

    def turned(self, values: Floats) -> tuple[Floats, Floats, Floats]:
        """Normals and offsets at parameters (u, v, f), and derivatives of the normals.

        The normal turns about its two tangents, `n = Exp(u t_1) Exp(v t_2) n_0`.

        Args:
            values: Parameters, shape (..., 3).

        Returns:
            Normals (..., 3), offsets (...) [m], and derivatives of the normals by u and
            v, (..., 3, 2).
        """
        assert self.normal is not None
        # Element by element: a product of matrices may round by the place of a row.
        t_1, t_2 = self.tangents
        u, v = values[..., :1], values[..., 1:2]
        (sin_u, sin_v), (cos_u, cos_v) = np.sin([u, v]), np.cos([u, v])
        # Exp(u t_1) Exp(v t_2) n_0 = sin(v) t_1 + cos(v) (cos(u) n_0 - sin(u) t_2)
        halfway = cos_u * self.normal - sin_u * t_2
        normal = sin_v * t_1 + cos_v * halfway
        by_u = -cos_v * (sin_u * self.normal + cos_u * t_2)
        by_v = cos_v * t_1 - sin_v * halfway
        by_turn = np.stack([by_u, by_v], axis=-1)
        return normal, self.offset + values[..., 2], by_turn

    def rebased(self, values: Floats) -> Plane:
        """Turned and shifted by (u, v, f)."""
        normal, offset, _ = self.turned(values)
        return replace(self, normal=normal, offset=float(offset))

    def facing(self, points: Floats) -> Plane:
        """With a normal that points to the points."""
        assert self.normal is not None
        if np.mean(points @ self.normal) + self.offset >= 0.0:
            return self
        return replace(self, normal=-self.normal, offset=-self.offset)

    def stated(self) -> PlaneSetup:
        """Its normal and offset."""
        normal = triple(self.normal)
        assert normal is not None
        return PlaneSetup(normal, float(self.offset), self.estimate)


@dataclass(frozen=True)
class Center(ReferenceObject):
    """A point that distances are measured from, and a number that belongs to these.

    Attributes:
        name: Name that measurements give as their target.
        xyz: Place in the measurement frame, shape (3,) [m]; None until registered.
        size: The number [m]; None until registered.
        estimate: Whether the place is estimated.
        estimate_size: Whether the number is.
    """

    name: str
    xyz: Floats | None = None
    size: float | None = None
    estimate: bool = True
    estimate_size: bool = True

    component: ClassVar[str]
    """Name of the number among the parameters."""

    number: ClassVar[str]
    """Its key in a setup; `estimate_` and this says whether it is estimated."""

    statement: ClassVar[Callable[..., SphereSetup | AnchorSetup]]
    """Its section of a setup, by the place, the number, and what is estimated."""

    @property
    def located(self) -> bool:
        """Whether place and number are given or registered."""
        return self.xyz is not None and self.size is not None

    @property
    def components(self) -> Iterable[tuple[str, str, bool]]:
        """Its coordinates x, y, z and the number."""
        site = ((c, "m", self.estimate) for c in "xyz")
        return (*site, (self.component, "m", self.estimate_size))

    def rebased(self, values: Floats) -> Self:
        """Moved by (x, y, z), with another number."""
        assert self.xyz is not None and self.size is not None
        size = self.size + float(values[3])
        return replace(self, xyz=self.xyz + values[:3], size=size)

    def stated(self) -> Stated:
        """Its place and number."""
        values = triple(self.xyz), self.size, self.estimate, self.estimate_size
        return self.statement(*values)


class Sphere(Center):
    """A sphere about its center; the number is the radius."""

    kind = "sphere"
    component = "r"
    number = "radius"
    statement = SphereSetup


@dataclass(frozen=True)
class Anchor(Center):
    """A fixed reference point of distances; the number is the bias of its readings."""

    size: float | None = 0.0
    estimate_size: bool = False

    kind = "anchor"
    component = number = "bias"
    statement = AnchorSetup


def turned_rows(
    planes: Sequence[ReferenceObject], index: Indices, values: Floats
) -> tuple[Floats, Floats, Floats]:
    """Normal (N, 3), offset (N,), derivative (N, 3, 2) of each row's plane.

    Args:
        planes: The planes.
        index: Position of each row's, shape (N,).
        values: Its parameters, shape (N, 3); rows of one plane share them.
    """
    count = len(index)
    normals, offsets, slopes = (np.zeros((count, *n)) for n in ((3,), (), (3, 2)))
    for k in np.unique(index):
        mask, plane = index == k, planes[k]
        assert isinstance(plane, Plane)
        normals[mask], offsets[mask], slopes[mask] = plane.turned(values[mask][0])
    return normals, offsets, slopes


def turned_planes(planes: Sequence[Plane], values: Floats) -> Floats:
    """Normals and offsets of L planes at many parameters, (S, 3 L) -> (S, L, 4)."""
    parts = np.split(values, len(planes), axis=1)
    turned = (p.turned(part) for p, part in zip(planes, parts, strict=True))
    return np.stack([np.column_stack([n, f]) for n, f, _ in turned], axis=1)


def slices(references: Sequence[ReferenceObject]) -> list[slice]:
    """Where the parameters of each reference object stand among those of all."""
    ends = np.cumsum([0, *(len(reference.parameters) for reference in references)])
    return [slice(int(a), int(b)) for a, b in pairwise(ends)]


def locate(
    target: Targets,
    references: Sequence[ReferenceObject],
    what: str,
    data: Measurements | None = None,
    read: Callable[[str], str] = str,
    alone: bool = True,
) -> Indices:
    """Position of the reference object that each measurement names.

    Args:
        target: Target of each measurement.
        references: The reference objects.
        what: Their name in messages.
        data: Tells where a wrong name stands.
        read: The name of the reference object in a target.
        alone: Whether the name may be left out where there is one.

    Returns:
        Positions, shape (N,); where the name may not be left out, -1 where it is.

    Raises:
        InputError: If there is none of a name.
    """
    labels = Labels.of(target)
    known = {reference.name: k for k, reference in enumerate(references)}
    if not alone:
        known[""] = -1
    elif len(known) == 1:
        known[""] = 0
    # Measurements are many and names few.
    names = [read(name) for name in labels.names]
    position = np.array([known.get(name, -2) for name in names], np.int64)
    result = position[labels.codes]
    if (result > -2).all():
        return result
    row = int(np.argmin(result))
    name = names[int(labels.codes[row])]
    error = InputError if data is None else partial(data.error, row)
    raise error(
        f"there is no {what} '{name}'{nearest(name, known)}"
        if name
        else f"the row names no {what}",
        column="target",
        allowed=", ".join(reference.name for reference in references),
    )


def triple(values: Floats | None) -> Triple | None:
    """Coordinates as a setup file states them; None where there are none."""
    if values is None:
        return None
    x, y, z = (float(value) for value in values)
    return x, y, z
