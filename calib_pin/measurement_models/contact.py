"""A tool point that touches a plane or a sphere: touch probe, dial gauge, ball."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OptionError
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.contact_registration import (
    Reached,
    register_distances,
    register_touched_plane,
)
from calib_pin.measurement_models.declaration import Declaration, Naming, Quantity
from calib_pin.measurement_models.named_points import (
    given_names,
    xyz_or_none,
)
from calib_pin.measurement_models.planes import Plane, turned_planes
from calib_pin.measurement_models.references import Anchor, ReferenceObject, Sphere
from calib_pin.measurement_models.registered_sites import SiteModel
from calib_pin.measurement_models.tool_point import (
    PointCurvature,
    PointMeasurement,
)
from calib_pin.observations import Measurements
from calib_pin.setup import Setup

GAP = (Quantity("contact", "m", slice(0, 1), 1e-4),)


@dataclass(frozen=True)
class PlaneContact(SiteModel):
    """`residual = n . p + f`, the height of the tool point above a plane [m]."""

    declaration = Declaration(
        name="plane-contact",
        help="a tool point touches planes: touch probe, dial gauge",
        components=("contact",),
        quantities=GAP,
        contact=True,
        naming=Naming("plane", "all or none"),
    )
    comparison = "height"

    @classmethod
    def sites_of_setup(cls, setup: Setup, names: Sequence[str]) -> tuple[Plane, ...]:
        """The planes."""
        return planes_of_setup(setup, names)

    def compare(
        self, p: Floats, site: NDArray[np.int64], values: Floats
    ) -> PointMeasurement:
        """The height, with the plane turned by (u, v) and shifted by f."""
        n, f, by_turn = self._planes(site, values)
        height = np.einsum("ni,ni->n", n, p) + f
        by_plane = np.concatenate(
            [np.einsum("ni,nik->nk", p, by_turn), np.ones((len(p), 1))], axis=1
        )
        return PointMeasurement(height[:, None], n[:, None], by_plane[:, None])

    def seen(self, values: Floats) -> Floats:
        """Normals and offsets."""
        planes = [plane for plane in self.sites if isinstance(plane, Plane)]
        return turned_planes(planes, values)

    def bend(
        self, p: Floats, site: NDArray[np.int64], values: Floats
    ) -> PointCurvature:
        """A plane is flat; what it turns about is as far as the point."""
        _, _, by_turn = self._planes(site, values)
        by_plane = np.zeros((len(p), 1, 3, 3))
        by_plane[:, 0, :2] = np.swapaxes(by_turn, 1, 2)
        return PointCurvature(np.zeros((len(p), 1, 3, 3)), by_plane)

    def reached(
        self, F: Floats, data: Measurements, point: Floats | None, site: ReferenceObject
    ) -> Reached:
        """The plane through the points."""
        return register_touched_plane(F, point)

    def found(self, site: ReferenceObject, reached: Reached) -> ReferenceObject:
        """The plane with normal and offset."""
        assert isinstance(site, Plane)
        return replace(site, normal=reached.site, offset=reached.size)

    def new(self, name: str) -> Plane:
        """A plane that nobody has given."""
        return Plane(name)

    def _planes(
        self, site: NDArray[np.int64], values: Floats
    ) -> tuple[Floats, Floats, Floats]:
        """Normal (N, 3), offset (N,), derivative (N, 3, 2) of each row's plane."""
        # Rows of one plane share its parameters.
        first = {int(k): int(np.argmax(site == k)) for k in np.unique(site)}
        count = len(self.sites)
        normals, offsets = np.zeros((count, 3)), np.zeros(count)
        slopes = np.zeros((count, 3, 2))
        for k, row in first.items():
            plane = self.sites[k]
            assert isinstance(plane, Plane)
            normals[k], offsets[k], slopes[k] = plane.turned(values[row])
        return normals[site], offsets[site], slopes[site]


@dataclass(frozen=True)
class SphereContact(SiteModel):
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
    comparison = "distance"

    @classmethod
    def sites_of_setup(cls, setup: Setup, names: Sequence[str]) -> tuple[Sphere, ...]:
        """The spheres; a radius that is not given is estimated."""
        spheres = []
        for name, stated in setup.spheres.items():
            free = stated.estimate_radius
            if free is None:
                free = stated.radius is None
            xyz = xyz_or_none(stated.xyz)
            spheres.append(Sphere(name, xyz, stated.radius, stated.estimate, free))
        return tuple(spheres) or tuple(map(Sphere, given_names(names, "sphere")))

    def compare(
        self, p: Floats, site: NDArray[np.int64], values: Floats
    ) -> PointMeasurement:
        """The height."""
        e, distance = rays(p, self.sites, site, values)
        height = distance - self._radii[site] - values[:, 3]
        by_sphere = np.concatenate([-e, np.full((len(p), 1), -1.0)], axis=1)
        return PointMeasurement(height[:, None], e[:, None], by_sphere[:, None])

    def seen(self, values: Floats) -> Floats:
        """Centers, and radii to be subtracted."""
        larger = values.reshape(len(values), -1, 4) * [1.0, 1.0, 1.0, -1.0]
        return rounds(self.sites, -self._radii) + larger

    @property
    def _radii(self) -> Floats:
        spheres = [s for s in self.sites if isinstance(s, Sphere)]
        return np.array([sphere.radius for sphere in spheres], float)

    def bend(
        self, p: Floats, site: NDArray[np.int64], values: Floats
    ) -> PointCurvature:
        """As round as the point is far from the center."""
        e, distance = rays(p, self.sites, site, values)
        return round_bend(e, distance)

    def reached(
        self, F: Floats, data: Measurements, point: Floats | None, site: ReferenceObject
    ) -> Reached:
        """The sphere through the points."""
        assert isinstance(site, Sphere)
        if site.radius is None:
            return register_distances(F, None, point)
        return register_distances(F, np.full(len(F), site.radius), point)

    def found(self, site: ReferenceObject, reached: Reached) -> ReferenceObject:
        """The sphere with its center, and the radius where it was unknown."""
        assert isinstance(site, Sphere)
        radius = reached.size if site.radius is None else site.radius
        return replace(site, xyz=reached.site, radius=radius)

    def new(self, name: str) -> Sphere:
        """A sphere that nobody has given."""
        return Sphere(name)


def planes_of_setup(setup: Setup, names: Sequence[str]) -> tuple[Plane, ...]:
    """The planes that a setup states, or else those that measurements name.

    Raises:
        OptionError: If a plane has no normal.
    """
    planes = []
    for name, stated in setup.planes.items():
        normal = np.array(stated.normal, float)
        length = float(np.linalg.norm(normal))
        if not 0.0 < length < np.inf:
            raise OptionError(
                f"the normal of the plane '{name}' has no direction",
                value=list(stated.normal),
            )
        planes.append(
            Plane(name, normal / length, stated.offset / length, stated.estimate)
        )
    return tuple(planes) or tuple(map(Plane, given_names(names, "plane")))


def rays(
    p: Floats, sites: Sequence[ReferenceObject], site: NDArray[np.int64], values: Floats
) -> tuple[Floats, Floats]:
    """Directions and lengths from the centers of spheres or anchors to points.

    Args:
        p: Points in the measuring frame, shape (N, 3) [m].
        sites: The spheres or anchors.
        site: Position of each row's, shape (N,).
        values: Its parameters, the coordinates first, shape (N, k).
    """
    return directions(p - _centers(sites)[site] - values[:, :3])


def rounds(sites: Sequence[ReferenceObject], added: Floats) -> Floats:
    """Centers of L spheres or anchors, and what is added to distances, (L, 4)."""
    return np.column_stack([_centers(sites), added])


def _centers(sites: Sequence[ReferenceObject]) -> Floats:
    return np.array([s.xyz for s in sites if isinstance(s, Sphere | Anchor)])


def directions(x: Floats) -> tuple[Floats, Floats]:
    """Unit vectors, shape (N, 3), and lengths, shape (N,); NaN at zero."""
    length = np.linalg.norm(x, axis=1)
    with np.errstate(invalid="ignore", divide="ignore"):
        return x / length[:, None], length


def round_bend(e: Floats, distance: Floats) -> PointCurvature:
    """How a distance bends; its place has three coordinates and one number more."""
    across = np.eye(3) - e[:, :, None] * e[:, None, :]
    H = across / distance[:, None, None]
    by_site = np.concatenate([-H, np.zeros((len(e), 1, 3))], axis=1)
    return PointCurvature(H[:, None], by_site[:, None])
