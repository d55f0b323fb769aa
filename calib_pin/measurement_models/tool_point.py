"""Models of a point of the tool: what they share.

A row names the point of the tool that is measured, the place that it is measured
against, or both as `point@place`. Without a point it is the origin of the tool frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Self

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.kinematics.spatial import Floats, skew
from calib_pin.measurement_models.base import (
    Batch,
    Curvature,
    DeclaredModel,
    Linearization,
    References,
    rotation_curvature,
)
from calib_pin.measurement_models.features import Feature, Point, locate
from calib_pin.measurement_models.named_points import (
    named_points,
    split_names,
)
from calib_pin.observations import AT, Measurements
from calib_pin.setup import Setup


@dataclass(frozen=True)
class PointMeasurement:
    """What is measured of N points, and its derivatives.

    Attributes:
        value: Values, shape (N, d).
        by_point: Derivative by the point, shape (N, d, 3).
        by_place: Derivative by the parameters of the place, shape (N, d, k).
    """

    value: Floats
    by_point: Floats
    by_place: Floats


@dataclass(frozen=True)
class PointCurvature:
    """How the derivatives of a `PointMeasurement` change with the point.

    Attributes:
        by_point: Of `PointMeasurement.by_point`, shape (N, d, 3, 3), the point last.
        by_place: Of `PointMeasurement.by_place`, shape (N, d, k, 3).
    """

    by_point: Floats
    by_place: Floats


@dataclass(frozen=True)
class PointsAndPlaces(DeclaredModel):
    """Points of the tool, and the places that they are measured against.

    Attributes:
        points: Named points of the tool; rows without a name mean its origin.
        places: What points are measured against.
        origin: Whether rows look at the origin of the tool frame.
    """

    points: tuple[Point, ...] = ()
    places: tuple[Feature, ...] = ()
    origin: bool = True

    alone: ClassVar[bool] = False
    """Whether a target names a point and nothing behind it, no place and no start."""

    @classmethod
    def places_of_setup(cls, setup: Setup, names: Sequence[str]) -> tuple[Feature, ...]:
        """What points are measured against; empty where points are by themselves.

        Args:
            setup: What the user states.
            names: The names behind points that measurements give.
        """
        return ()

    @property
    def sees_tool(self) -> bool:
        """Where it looks at the origin, or at points known in the tool frame."""
        return self.origin or not all(point.estimate for point in self.points)

    @property
    def missing(self) -> str:
        """Points and places that nobody has given."""
        lacking = [f for f in self.features if not f.placed]
        if not lacking:
            return ""
        section = lacking[0].section
        what = f"its '{section}'"
        if any(f.placed for f in self.features if f.section == section):
            names = ", ".join(f"'{f.name}'" for f in lacking if f.section == section)
            what = f"{names} of {what}"
        return f"give {what} in a setup file (--setup)"

    @property
    def targets(self) -> Sequence[str]:
        """Points, places, or their combinations."""
        points = [*([""] if self.origin else []), *(p.name for p in self.points)]
        if not self.places:
            return tuple(points) if self.points else ()
        return tuple(
            f"{point}{AT}{place.name}" if point else place.name
            for place in self.places
            for point in points
        )

    @property
    def features(self) -> Sequence[Feature]:
        """Points, then places."""
        return (*self.points, *self.places)

    def with_features(self, features: Sequence[Feature]) -> Self:
        """The same about other references of points and places."""
        count = len(self.points)
        points = tuple(f for f in features[:count] if isinstance(f, Point))
        return replace(self, points=points, places=tuple(features[count:]))

    def names(
        self, target: Sequence[str], data: Measurements | None = None
    ) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Position of each row's point, the last for the origin, and of its place.

        Raises:
            InputError: If a row names what is not there; data tell where.
        """
        number = {name: k for k, name in enumerate(dict.fromkeys(target))}
        if data is None and len(number) < len(target):
            # Rows are many and their names few.
            point, place = self.names(tuple(number))
            rows = np.fromiter(map(number.__getitem__, target), np.int64, len(target))
            return point[rows], place[rows]
        points, places = self.split(target)
        point = np.full(len(target), len(self.points))
        if self.points and any(points):
            of = np.flatnonzero([bool(name) for name in points])
            about = None if data is None else data.rows(of)
            named = [points[k] for k in of]
            point[of] = locate(named, self.points, "target", about, alone=False)
        unnamed = point == len(self.points)
        if self.points and not self.origin and unnamed.any():
            row = int(np.argmax(unnamed))
            error = InputError if data is None else partial(data.error, row)
            raise error(
                "the row names no target, others do",
                column="target",
                allowed=", ".join(p.name for p in self.points),
            )
        place = np.zeros(len(target), np.int64)
        if self.places:
            what = self.places[0].section[:-1]
            place = locate(places, self.places, what, data)
        return point, place

    def split(self, target: Sequence[str]) -> tuple[tuple[str, ...], tuple[str, ...]]:
        """The point and the place that each row names."""
        return split_names(target, not self.alone)

    def places_of(self, target: Sequence[str]) -> tuple[str, ...]:
        """The place that each row names; the only one where it names none."""
        only = self.places[0].name if len(self.places) == 1 else ""
        return tuple(name or only for name in split_names(target, True)[1])


@dataclass(frozen=True)
class PointModel(PointsAndPlaces):
    """A measurement of a point of the tool, against a place or by itself.

    A member says what is measured of a point (`compare`) and how that bends; this does
    the rest: names, the way from the tool frame to the point, features.
    """

    comparison: ClassVar[str] = ""
    """How a kernel compares a point with a place, see `kernels.COMPARISONS`; empty
    where none does."""

    @classmethod
    def from_setup(cls, setup: Setup, targets: Sequence[str]) -> Self:
        """The points, the places and whether the origin is looked at."""
        points, names = split_names(targets, not cls.alone)
        used = {name: setup.targets[name] for name in points if name in setup.targets}
        # All of them count without measurements, or where one names what is not stated.
        wrong = any(name and name not in setup.targets for name in points)
        stated = setup.targets if wrong or not targets else used
        found = named_points(stated, points, "target")
        origin = "" in points if targets else not found
        places = cls.places_of_setup(setup, names)
        if targets and {place.name for place in places}.issuperset(names):
            # What nobody has placed and no measurement names cannot be found.
            places = tuple(p for p in places if p.placed or p.name in names)
        return cls(points=found, places=places, origin=origin)

    def predict(self, T: Floats, own: Floats, target: Sequence[str]) -> Floats:
        """Noise-free values, shape (N, d); none where nothing but contact is known."""
        value = self._look(T, own, target).touch.value
        return np.zeros((len(T), 0)) if self.contact else value

    def residual(self, T: Floats, own: Floats, data: Measurements) -> Floats:
        """Predicted minus measured value, shape (N, d)."""
        return self._deviation(self._look(T, own, data.target).touch.value, data)

    def linearize(self, T: Floats, own: Floats, data: Measurements) -> Linearization:
        """`dp = R (v + w x t)` for a body twist (v, w) and an offset t."""
        view = self._look(T, own, data.target)
        touch, J_pose = view.touch, view.J_pose(T)
        J_instrument = np.zeros((len(T), touch.value.shape[1], len(own)))
        row = np.arange(len(T))
        named = view.point < len(self.points)
        by_offset = touch.by_point @ view.by_offset
        for c in range(3):
            column = 3 * view.point[named] + c
            J_instrument[row[named], :, column] = by_offset[named, :, c]
        width = touch.by_place.shape[2]
        for c in range(width if self.places else 0):
            column = 3 * len(self.points) + width * view.place + c
            J_instrument[row, :, column] = touch.by_place[:, :, c]
        residual = self._deviation(touch.value, data)
        return Linearization(residual, touch.by_point @ J_pose, J_instrument)

    def curvature(self, T: Floats, own: Floats, target: Sequence[str]) -> Curvature:
        """Second derivatives: the point moves, and its own motion turns."""
        view = self._look(T, own, target)
        bend = self.bend(view.p, view.place, view.of_place)
        G, P, rows = view.touch.by_point, view.J_pose(T), np.arange(len(T))
        turning = rotation_curvature(T[:, :3, :3])
        # P = (R, -R [t]x)
        by_P = np.concatenate(
            [turning, -np.einsum("nacb,ncd->nadb", turning, skew(view.offset))], axis=2
        )
        H = bend.by_point @ P[:, None]
        J_pose = np.einsum("ndcb,nca->ndab", H, P)
        J_pose += np.einsum("ndc,ncab->ndab", G, by_P)
        J_instrument = np.zeros((*G.shape[:2], len(own), 6))
        named = view.point < len(self.points)
        R = view.by_offset
        by_offset = np.einsum("ndcb,nca->ndab", H, R)
        by_offset += np.einsum("ndc,ncab->ndab", G, turning)
        for c in range(3):
            column = 3 * view.point[named] + c
            J_instrument[rows[named], :, column] = by_offset[named, :, c]
        width = bend.by_place.shape[2]
        by_place = bend.by_place @ P[:, None]
        for c in range(width if self.places else 0):
            column = 3 * len(self.points) + width * view.place + c
            J_instrument[rows, :, column] = by_place[:, :, c]
        return Curvature(J_pose, J_instrument)

    def compare(
        self, p: Floats, place: NDArray[np.int64], own: Floats
    ) -> PointMeasurement:
        """What is measured of points.

        Args:
            p: Points in the measuring frame, shape (N, 3) [m].
            place: Position of each row's place, shape (N,).
            own: Parameters of each row's place, shape (N, k).
        """
        raise NotImplementedError

    def bend(self, p: Floats, place: NDArray[np.int64], own: Floats) -> PointCurvature:
        """How that changes with the points; arguments as for `compare`."""
        raise NotImplementedError

    def seen(self, own: Floats) -> Floats:
        """Places of many members as a kernel compares them, (S, K) -> (S, L, w).

        Args:
            own: Parameters of the places.
        """
        raise NotImplementedError

    def batches(self, data: Measurements, weights: Floats) -> Sequence[Batch]:
        """Carries the points of the tool to the base, if a kernel can compare them."""
        if not self.comparison:
            return []
        point, place = self.names(data.target)
        known = np.array([p.xyz for p in self.points] + [np.zeros(3)])
        size = 3 * len(self.points)

        def references(own: Floats) -> References:
            points = np.tile(known, (len(own), 1, 1))
            # The last is the origin.
            points[:, :-1] += own[:, :size].reshape(len(own), -1, 3)
            return References(points, self.seen(own[:, size:]))

        rows, values = np.arange(len(data)), data.values
        if self.contact:
            values = np.zeros_like(weights)
        how = self.comparison
        return [Batch(how, rows, point, place, values, weights, references)]

    def new(self, name: str) -> Feature:
        """A place that nobody has given."""
        raise NotImplementedError

    def extended(self, T: Floats, data: Measurements) -> Self:
        """With a place for each that is new, by the rows that name it."""
        if not self.places:
            return self
        known = {place.name for place in self.places}
        names = dict.fromkeys(self.places_of(data.target))
        new = [name for name in names if name not in known]
        if not new:
            return self
        wider = replace(self, places=(*self.places, *map(self.new, new)))
        identity = pin.SE3.Identity()
        return wider.register(T, data, identity, identity)[0]

    def register(
        self, F: Floats, data: Measurements, base: pin.SE3 | None, tool: pin.SE3 | None
    ) -> tuple[Self, pin.SE3, pin.SE3]:
        """Closed-form references, see `MeasurementModel`."""
        raise NotImplementedError

    def _deviation(self, value: Floats, data: Measurements) -> Floats:
        """Predicted minus measured value; angles within half a turn of zero."""
        if self.contact:
            return value
        result = value - data.values
        for quantity in self.quantities:
            if quantity.unit == "rad":
                angles = result[:, quantity.columns]
                # Half a turn itself stays positive: the interval is (-pi, pi].
                angles -= 2.0 * np.pi * np.ceil(angles / (2.0 * np.pi) - 0.5)
        return result

    def _look(self, T: Floats, own: Floats, target: Sequence[str]) -> _View:
        point, place = self.names(target)
        offsets = np.zeros((len(self.points) + 1, 3))
        for k, feature in enumerate(self.points):
            offsets[k] = feature.at(own[3 * k : 3 * k + 3])
        offset = offsets[point]  # The last one is the origin.
        rest = own[3 * len(self.points) :]
        of_place = np.zeros((len(T), 0))
        if self.places:
            of_place = rest.reshape(len(self.places), -1)[place]
        p, by_offset = self._reach(T, offset)
        touch = self.compare(p, place, of_place)
        return _View(point, place, offset, of_place, p, by_offset, touch)

    def _reach(self, T: Floats, offset: Floats) -> tuple[Floats, Floats]:
        """Where points of the tool are, (N, 3), and the derivative by the offset."""
        R = T[:, :3, :3]
        return np.einsum("nij,nj->ni", R, offset) + T[:, :3, 3], R


@dataclass(frozen=True)
class _View:
    """What rows look at.

    Attributes:
        point: Position of each row's point, the last for the origin, shape (N,).
        place: Position of its place, shape (N,).
        offset: The point in the tool frame, shape (N, 3) [m].
        of_place: Parameters of the place, shape (N, k).
        p: The point in the measuring frame, shape (N, 3) [m].
        by_offset: Derivative of p by the offset, shape (N, 3, 3).
        touch: What is measured of it.
    """

    point: NDArray[np.int64]
    place: NDArray[np.int64]
    offset: Floats
    of_place: Floats
    p: Floats
    by_offset: Floats
    touch: PointMeasurement

    def J_pose(self, T: Floats) -> Floats:
        """Derivative of p by the body twist of the tool, shape (N, 3, 6)."""
        R = T[:, :3, :3]
        return np.concatenate([R, -R @ skew(self.offset)], axis=2)
