"""Models of a point of the tool: what they share.

A measurement names the point of the tool, the site that it is measured against,
or both as `point@site`. Without a point it is the origin of the tool frame.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import ClassVar, Self

import numpy as np
import pinocchio as pin

from calib_pin.errors import InputError, enumerated
from calib_pin.kinematics.spatial import Floats, skew
from calib_pin.measurement_models.base import (
    Batch,
    Geometry,
    Linearization,
    MeasurementModel,
)
from calib_pin.measurement_models.named_points import named_points, split_names
from calib_pin.measurement_models.references import Point, ReferenceObject, locate
from calib_pin.observations import AT, Indices, Measurements, Targets
from calib_pin.setup import Setup


@dataclass(frozen=True)
class PointMeasurement:
    """The measured quantity of N points, and its derivatives.

    Attributes:
        value: Values, shape (N, d).
        by_point: Derivative by the point, shape (N, d, 3).
        by_place: Derivative by the parameters of the place, shape (N, d, k).
    """

    value: Floats
    by_point: Floats
    by_site: Floats


@dataclass(frozen=True)
class PointsAndSites(MeasurementModel):
    """Points of the tool, and the sites that they are measured against.

    Attributes:
        points: Named points of the tool; without a name its origin is meant.
        sites: The sites that points are measured against.
        origin: Whether the origin of the tool frame is looked at.
    """

    points: tuple[Point, ...] = ()
    sites: tuple[ReferenceObject, ...] = ()
    origin: bool = True

    alone: ClassVar[bool] = False
    """Whether a target names a point and nothing behind it, no site and no start."""

    @classmethod
    def sites_of_setup(
        cls, setup: Setup, names: Sequence[str]
    ) -> tuple[ReferenceObject, ...]:
        """The sites of a setup; empty where points are measured by themselves.

        Args:
            setup: The setup of the user.
            names: The names behind points that measurements give.
        """
        return ()

    @property
    def sees_tool(self) -> bool:
        """Where it looks at the origin, or at points known in the tool frame."""
        return self.origin or not all(point.estimate for point in self.points)

    @property
    def missing(self) -> str:
        """Points and sites that nobody has given."""
        lacking = [f for f in self.references if not f.located]
        if not lacking:
            return ""
        section = lacking[0].section
        what = f"its '{section}'"
        if any(f.located for f in self.references if f.section == section):
            names = enumerated(f"'{f.name}'" for f in lacking if f.section == section)
            what = f"{names} of {what}"
        return f"give {what} in a setup file (--setup)"

    @property
    def targets(self) -> Sequence[str]:
        """Points, sites, or their combinations."""
        points = [*([""] if self.origin else []), *(p.name for p in self.points)]
        if not self.sites:
            return tuple(points) if self.points else ()
        return tuple(
            f"{point}{AT}{site.name}" if point else site.name
            for site in self.sites
            for point in points
        )

    @property
    def references(self) -> Sequence[ReferenceObject]:
        """Points, then sites."""
        return (*self.points, *self.sites)

    def with_references(self, references: Sequence[ReferenceObject]) -> Self:
        """The same about other references of points and sites."""
        count = len(self.points)
        points = tuple(f for f in references[:count] if isinstance(f, Point))
        return replace(self, points=points, sites=tuple(references[count:]))

    def names(
        self, target: Targets, data: Measurements | None = None
    ) -> tuple[Indices, Indices]:
        """Position of each row's point, the last for the origin, and of its site.

        Raises:
            InputError: If a measurement names what is not there; data tell where.
        """
        point_of, site_of = partial(self._half, 0), partial(self._half, 1)
        point = locate(target, self.points, "target", data, point_of, alone=False)
        if not self.points:
            point = np.full(len(target), -1)
        unnamed = point < 0
        if self.points and not self.origin and unnamed.any():
            row = int(np.argmax(unnamed))
            error = InputError if data is None else partial(data.error, row)
            raise error(
                "the row names no target, others do",
                column="target",
                allowed=", ".join(p.name for p in self.points),
            )
        point = np.where(unnamed, len(self.points), point)
        site = np.zeros(len(target), np.int64)
        if self.sites:
            what = self.sites[0].section[:-1]
            site = locate(target, self.sites, what, data, site_of)
        return point, site

    def _half(self, half: int, name: str) -> str:
        """The point, 0, or the site, 1, in a target; no point where there is none."""
        if half == 0 and not self.points:
            return ""
        return split_names((name,), not self.alone)[half][0]


@dataclass(frozen=True)
class PointModel(PointsAndSites):
    """A measurement of a point of the tool, against a site or by itself.

    A member says what is measured of a point (`compare`); this does the rest:
    names, the way from the tool frame to the point, references.
    """

    comparison: ClassVar[str] = ""
    """How a kernel compares a point with a site, see `kernels.COMPARISONS`; empty
    where none does."""

    @classmethod
    def from_setup(cls, setup: Setup, targets: Sequence[str]) -> Self:
        """The points, the places and whether the origin is looked at."""
        points, names = split_names(targets, not cls.alone)
        used = {name: setup.targets[name] for name in points if name in setup.targets}
        # All of them count without measurements, or where one names what is not stated.
        wrong = any(name and name not in setup.targets for name in points)
        setups = setup.targets if wrong or not targets else used
        references = named_points(setups, points, "target")
        origin = "" in points if targets else not references
        sites = cls.sites_of_setup(setup, names)
        if targets and {site.name for site in sites}.issuperset(names):
            # What nobody has placed and no measurement names cannot be found.
            sites = tuple(p for p in sites if p.located or p.name in names)
        return cls(points=references, sites=sites, origin=origin)

    def predict(self, T: Floats, instrument: Floats, target: Targets) -> Floats:
        """Noise-free values, shape (N, d); none where nothing but contact is known."""
        value = self._look(T, instrument, target).touch.value
        return np.zeros((len(T), 0)) if self.declaration.contact else value

    def residual(self, T: Floats, instrument: Floats, data: Measurements) -> Floats:
        """Predicted minus measured value, shape (N, d)."""
        return self._deviation(self._look(T, instrument, data.target).touch.value, data)

    def linearize(
        self, T: Floats, instrument: Floats, data: Measurements
    ) -> Linearization:
        """`dp = R (v + w x t)` for a body twist (v, w) and an offset t."""
        view = self._look(T, instrument, data.target)
        touch, J_pose = view.touch, view.J_pose(T)
        by_offset = touch.by_point @ view.by_offset
        J_instrument = self._columns(view, by_offset, touch.by_site, len(instrument))
        residual = self._deviation(touch.value, data)
        return Linearization(residual, touch.by_point @ J_pose, J_instrument)

    def compare(self, p: Floats, site: Indices, values: Floats) -> PointMeasurement:
        """The measured quantity of points, and its derivatives.

        Args:
            p: Points in the measurement frame, shape (N, 3) [m].
            site: Position of each row's site, shape (N,).
            values: Parameters of each row's site, shape (N, k).
        """
        raise NotImplementedError

    def seen(self, values: Floats) -> Floats:
        """Sites of many members as a kernel compares them, (S, K) -> (S, L, w).

        Args:
            values: Parameters of the sites.
        """
        raise NotImplementedError

    def batches(self, data: Measurements, weights: Floats) -> Sequence[Batch]:
        """Carries the points of the tool to the base, if a kernel can compare them."""
        if not self.comparison:
            return []
        point, site = self.names(data.target)
        known = np.array([p.xyz for p in self.points] + [np.zeros(3)])
        size = 3 * len(self.points)

        def geometry(instrument: Floats) -> Geometry:
            points = np.tile(known, (len(instrument), 1, 1))
            # The last is the origin.
            points[:, :-1] += instrument[:, :size].reshape(len(instrument), -1, 3)
            return Geometry(points, self.seen(instrument[:, size:]))

        rows, values = np.arange(len(data)), data.values
        if not values.shape[1]:  # A contact without readings.
            values = np.zeros_like(weights)
        how = self.comparison
        return [Batch(how, rows, point, site, values, weights, geometry)]

    @staticmethod
    def unknown(name: str) -> ReferenceObject:
        """A site that nobody has given."""
        raise NotImplementedError

    def extended(self, T: Floats, data: Measurements) -> Self:
        """With a site for each that is new, by the measurements that name it."""
        if not self.sites:
            return self
        # One that names none means the only one.
        known = {site.name for site in self.sites}
        known |= {""} if len(self.sites) == 1 else set()
        named = split_names(data.target.distinct, True)[1]
        new = [name for name in dict.fromkeys(named) if name not in known]
        if not new:
            return self
        wider = replace(self, sites=(*self.sites, *map(self.unknown, new)))
        identity = pin.SE3.Identity()
        return wider.register(T, data, identity, identity)[0]

    def register(
        self, F: Floats, data: Measurements, base: pin.SE3 | None, tool: pin.SE3 | None
    ) -> tuple[Self, pin.SE3, pin.SE3]:
        """Closed-form references, see `MeasurementModel`."""
        raise NotImplementedError

    def _columns(
        self, view: _View, by_offset: Floats, by_site: Floats, count: int
    ) -> Floats:
        """Derivatives of each row's point and site among all parameters, (N, d, K)."""
        result = np.zeros((*by_site.shape[:2], count))
        row, width = np.arange(len(by_site)), by_site.shape[2]
        named = view.point < len(self.points)
        for c in range(3):
            column = 3 * view.point[named] + c
            result[row[named], :, column] = by_offset[named, :, c]
        for c in range(width if self.sites else 0):
            column = 3 * len(self.points) + width * view.site + c
            result[row, :, column] = by_site[:, :, c]
        return result

    def _deviation(self, value: Floats, data: Measurements) -> Floats:
        """Predicted minus measured value; angles within half a turn of zero."""
        if not data.values.shape[1]:  # A contact without readings.
            return value
        result = value - data.values
        for quantity in self.quantities:
            if quantity.unit == "rad":
                angles = result[:, quantity.columns]
                # Half a turn itself stays positive: the interval is (-pi, pi].
                angles -= 2.0 * np.pi * np.ceil(angles / (2.0 * np.pi) - 0.5)
        return result

    def _look(self, T: Floats, instrument: Floats, target: Targets) -> _View:
        point, site = self.names(target)
        offsets = np.zeros((len(self.points) + 1, 3))
        for k, reference in enumerate(self.points):
            offsets[k] = reference.at(instrument[3 * k : 3 * k + 3])
        offset = offsets[point]  # The last one is the origin.
        rest = instrument[3 * len(self.points) :]
        of_site = np.zeros((len(T), 0))
        if self.sites:
            of_site = rest.reshape(len(self.sites), -1)[site]
        p, by_offset = self._reach(T, offset)
        touch = self.compare(p, site, of_site)
        return _View(point, site, offset, by_offset, touch)

    def _reach(self, T: Floats, offset: Floats) -> tuple[Floats, Floats]:
        """Where points of the tool are, (N, 3), and the derivative by the offset."""
        R = T[:, :3, :3]
        return np.einsum("nij,nj->ni", R, offset) + T[:, :3, 3], R


@dataclass(frozen=True)
class _View:
    """The points and sites of measurements.

    Attributes:
        point: Position of each row's point, the last for the origin, shape (N,).
        site: Position of its place, shape (N,).
        offset: The point in the tool frame, shape (N, 3) [m].
        by_offset: Derivative of the point in the measurement frame by that, (N, 3, 3).
        touch: The point measurement.
    """

    point: Indices
    site: Indices
    offset: Floats
    by_offset: Floats
    touch: PointMeasurement

    def J_pose(self, T: Floats) -> Floats:
        """Derivative of the point by the body twist of the tool, shape (N, 3, 6)."""
        R = T[:, :3, :3]
        return np.concatenate([R, -R @ skew(self.offset)], axis=2)
