"""A tool point that touches a plane or a sphere: touch probe, dial gauge, ball."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import ClassVar, Self

import numpy as np
import pinocchio as pin

from calib_pin.errors import OptionError
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.contact_registration import (
    register_distances,
    register_touched_plane,
)
from calib_pin.measurement_models.declaration import Declaration, Naming, Quantity
from calib_pin.measurement_models.named_points import (
    given_names,
    located_tool,
    tip_points,
    xyz_or_none,
)
from calib_pin.measurement_models.references import (
    Center,
    Plane,
    ReferenceObject,
    Sphere,
    turned_planes,
    turned_rows,
)
from calib_pin.measurement_models.tool_point import PointMeasurement, PointModel
from calib_pin.observations import Indices, Measurements
from calib_pin.setup import Setup

GAP = (Quantity("contact", "m", slice(0, 1), 1e-4),)


@dataclass(frozen=True)
class SiteModel(PointModel):
    """A point of the tool against sites that are registered from measurements."""

    def fit_site(
        self, F: Floats, data: Measurements, point: Floats | None, site: ReferenceObject
    ) -> tuple[Floats, ReferenceObject]:
        """The point in the tip frame and its site in closed form.

        Args:
            F: Tip poses in the measurement frame, shape (N, 4, 4).
            data: The measurements of one point at one site.
            point: The point in the tip frame where it is known, shape (3,) [m].
            site: The site, not located yet.
        """
        raise NotImplementedError

    def register(
        self, F: Floats, data: Measurements, base: pin.SE3 | None, tool: pin.SE3 | None
    ) -> tuple[Self, pin.SE3, pin.SE3]:
        """Unknown points by all their sites, then unknown sites by all measurements.

        A base that is not given stays where the URDF puts it.
        """
        base = base or pin.SE3.Identity()
        label, site = self.names(data.target, data)
        F = base.homogeneous @ F
        tip = tip_points(self.points, tool)
        for k in np.unique(label[np.isnan(tip[label, 0])]):
            estimates, sizes = [], []
            for s in np.unique(site[label == k]):
                rows = (label == k) & (site == s)
                part = data.rows(rows)
                estimates.append(self.fit_site(F[rows], part, None, self.sites[s])[0])
                sizes.append(rows.sum())
            # The site with most measurements: a poor one would spoil an average.
            tip[k] = estimates[int(np.argmax(sizes))]
        points, tool = located_tool(tip, self.points, tool)
        at = tip_points(points, tool)[label]
        # With the points known, every measurement tells of its site.
        moved = F.copy()
        moved[:, :3, 3] += np.einsum("nij,nj->ni", F[:, :3, :3], at)
        sites = list(self.sites)
        for s, reference in enumerate(sites):
            rows = site == s
            if not rows.any():
                continue
            part, poses = data.rows(rows), moved[rows]
            if not reference.located:
                _, sites[s] = self.fit_site(poses, part, np.zeros(3), reference)
                if part.values.any():
                    sites[s] = sites[s].facing(F[rows, :3, 3])
        return replace(self, points=points, sites=tuple(sites)), base, tool


@dataclass(frozen=True)
class PlaneContact(SiteModel):
    """`residual = n . p + f`, the height of the tool point above a plane [m].

    Where a gauge reads that height, the normal points out of what is touched. One that
    nobody has given points to the tool.
    """

    declaration = Declaration(
        name="plane-contact",
        help="a tool point touches planes: touch probe, dial gauge",
        components=("contact",),
        quantities=GAP,
        contact=True,
        naming=Naming("plane", "all or none"),
    )
    comparison = "height"
    unknown = staticmethod(Plane)

    @classmethod
    def sites_of_setup(cls, setup: Setup, names: Sequence[str]) -> tuple[Plane, ...]:
        """The planes."""
        return planes_of_setup(setup, names)

    def compare(self, p: Floats, site: Indices, values: Floats) -> PointMeasurement:
        """The height, with the plane turned by (u, v) and shifted by f."""
        n, f, by_turn = turned_rows(self.sites, site, values)
        height = np.einsum("ni,ni->n", n, p) + f
        by_plane = np.concatenate(
            [np.einsum("ni,nik->nk", p, by_turn), np.ones((len(p), 1))], axis=1
        )
        return PointMeasurement(height[:, None], n[:, None], by_plane[:, None])

    def seen(self, values: Floats) -> Floats:
        """Normals and offsets."""
        planes = [plane for plane in self.sites if isinstance(plane, Plane)]
        return turned_planes(planes, values)

    def fit_site(
        self, F: Floats, data: Measurements, point: Floats | None, site: ReferenceObject
    ) -> tuple[Floats, Plane]:
        """The plane through the points."""
        assert isinstance(site, Plane)
        reached = register_touched_plane(F, point)
        return reached.point, replace(site, normal=reached.site, offset=reached.size)


@dataclass(frozen=True)
class RoundModel(SiteModel):
    """`|p - c| + b`, the distance from a center and a number more, such as a bias."""

    comparison = "distance"
    sign: ClassVar[float] = 1.0
    """Derivative by the last parameter of a site."""

    sites_kind: ClassVar[type[Center]]
    """Class of the sites."""

    @classmethod
    def unknown(cls, name: str) -> Center:
        """A site that nobody has given."""
        return cls.sites_kind(name)

    @classmethod
    def sites_of_setup(cls, setup: Setup, names: Sequence[str]) -> tuple[Center, ...]:
        """The sites; a number that is not given is estimated."""
        kind, sites = cls.sites_kind, list[Center]()
        for name, site in getattr(setup, f"{kind.kind}s").items():
            size = getattr(site, kind.number)
            free = getattr(site, f"estimate_{kind.number}")
            free = size is None if free is None else free
            values = xyz_or_none(site.xyz), size, site.estimate, free
            sites.append(kind(name, *values))
        return tuple(sites) or tuple(map(kind, given_names(names, kind.kind)))

    @property
    def added(self) -> Floats:
        """The number that is added at each site, shape (L,) [m]."""
        sizes = [site.size for site in self.sites if isinstance(site, Center)]
        return self.sign * np.array(sizes, float)

    def compare(self, p: Floats, site: Indices, values: Floats) -> PointMeasurement:
        """The distance with that number."""
        e, distance = directions(p - _centers(self.sites)[site] - values[:, :3])
        by_site = np.concatenate([-e, np.full((len(p), 1), self.sign)], axis=1)
        value = distance + self.added[site] + self.sign * values[:, 3]
        return PointMeasurement(value[:, None], e[:, None], by_site[:, None])

    def seen(self, values: Floats) -> Floats:
        """Centers, and these numbers."""
        shifts = values.reshape(len(values), -1, 4) * [1.0, 1.0, 1.0, self.sign]
        return np.column_stack([_centers(self.sites), self.added]) + shifts


@dataclass(frozen=True)
class SphereContact(RoundModel):
    """`residual = |p - c| - r`, the height of the tool point above a sphere [m].

    The radius is that of the sphere and of a ball at the tool point together.
    """

    declaration = Declaration(
        name="sphere-contact",
        help="a tool point touches spheres: touch probe, dial gauge",
        components=("contact",),
        quantities=GAP,
        contact=True,
        naming=Naming("sphere", "all or none"),
        yardstick="the radius of the sphere",
    )
    sites_kind = Sphere
    sign = -1.0

    def fit_site(
        self, F: Floats, data: Measurements, point: Floats | None, site: ReferenceObject
    ) -> tuple[Floats, Sphere]:
        """The sphere through the points, with its radius where that was unknown."""
        assert isinstance(site, Sphere)
        # Touches without readings are not off.
        known = None if site.size is None else site.size + data.values.sum(axis=1)
        reached = register_distances(F, known, point)
        radius = reached.size if site.size is None else site.size
        return reached.point, replace(site, xyz=reached.site, size=radius)


def planes_of_setup(setup: Setup, names: Sequence[str]) -> tuple[Plane, ...]:
    """The planes that a setup states, or else those that measurements name.

    Raises:
        OptionError: If a plane has no normal.
    """
    planes = []
    for name, plane in setup.planes.items():
        normal = np.array(plane.normal, float)
        length = float(np.linalg.norm(normal))
        # One that was normed already stays as it is, to the last bit.
        length = 1.0 if abs(length - 1.0) < 1e-14 else length
        if not 0.0 < length < np.inf:
            raise OptionError(
                f"the normal of the plane '{name}' has no direction",
                value=list(plane.normal),
            )
        planes.append(
            Plane(name, normal / length, plane.offset / length, plane.estimate)
        )
    return tuple(planes) or tuple(map(Plane, given_names(names, "plane")))


def _centers(sites: Sequence[ReferenceObject]) -> Floats:
    return np.array([s.xyz for s in sites if isinstance(s, Center)])


def directions(x: Floats) -> tuple[Floats, Floats]:
    """Unit vectors, shape (N, 3), and lengths, shape (N,); NaN at zero."""
    length = np.linalg.norm(x, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return x / length[:, None], length
