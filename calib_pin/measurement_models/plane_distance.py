"""The distance along a laser beam to a plane (Liu et al. 2012)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.spatial import Floats, skew
from calib_pin.measurement_models.base import (
    Batch,
    Geometry,
    Linearization,
    MeasurementModel,
)
from calib_pin.measurement_models.contact import planes_of_setup
from calib_pin.measurement_models.declaration import (
    INSTRUMENT,
    Declaration,
    Naming,
    Quantity,
)
from calib_pin.measurement_models.references import (
    Plane,
    ReferenceObject,
    locate,
    turned_planes,
    turned_rows,
)
from calib_pin.measurement_models.registration import register_plane
from calib_pin.observations import Booleans, Indices, Measurements, Targets
from calib_pin.setup import RangerSetup, Setup

GRAZING = 1e-3
"""Cosine to the normal below which a beam counts as parallel to the plane."""


@dataclass(frozen=True)
class PlaneDistance(MeasurementModel):
    """`h = -(n . p + f) / (n . b)`, p the tool origin and b the tool's z axis.

    Attributes:
        planes: The planes, by the order of their parameters.
        near: Shortest distance that the instrument measures [m].
        reach: Longest distance that it measures [m].
        incidence: Largest angle between beam and normal at which it measures [rad].
    """

    planes: tuple[Plane, ...] = (Plane("plane"),)
    near: float = RangerSetup.range[0]
    reach: float = RangerSetup.range[1]
    incidence: float = RangerSetup.incidence

    declaration = Declaration(
        name="plane-distance",
        help="distances along a laser beam on the tool to planes",
        components=("distance",),
        quantities=(Quantity("distance", "m", slice(0, 1), 1e-4),),
        naming=Naming("plane"),
        inferred="part",
        yardstick=INSTRUMENT,
        unmeasurable="the beam misses the plane, meets it too flat or too far away",
    )

    @classmethod
    def from_setup(cls, setup: Setup, targets: Sequence[str]) -> PlaneDistance:
        """The planes and the window of the instrument."""
        near, reach = setup.ranger.range
        planes = planes_of_setup(setup, targets)
        return cls(planes, near, reach, setup.ranger.incidence)

    @property
    def missing(self) -> str:
        """Planes that nobody has given."""
        if any(plane.normal is None for plane in self.planes):
            return "give its 'planes' in a setup file (--setup)"
        return ""

    @property
    def targets(self) -> Sequence[str]:
        """Names of the planes."""
        return tuple(plane.name for plane in self.planes)

    @property
    def references(self) -> Sequence[Plane]:
        """The planes."""
        return self.planes

    def with_references(self, references: Sequence[ReferenceObject]) -> PlaneDistance:
        """The same about other planes."""
        planes = tuple(plane for plane in references if isinstance(plane, Plane))
        return replace(self, planes=planes)

    def predict(self, T: Floats, instrument: Floats, target: Targets) -> Floats:
        """Distances along the beam, shape (N, 1) [m]; negative behind the tool."""
        normal, offset, _ = self._rows(instrument, target)
        return self._distance(T, normal, offset)[:, None]

    def observable(self, T: Floats, instrument: Floats, target: Targets) -> Booleans:
        """Where the beam meets the plane in front, within range and not too flat."""
        normal, offset, _ = self._rows(instrument, target)
        cosine = np.abs(np.einsum("ni,ni->n", normal, T[:, :3, 2]))
        h = self._distance(T, normal, offset)
        steep = cosine > np.cos(self.incidence)
        return np.asarray((h > self.near) & (h < self.reach) & steep)

    def linearize(
        self, T: Floats, instrument: Floats, data: Measurements
    ) -> Linearization:
        """Derivatives by the beam and by the plane.

        With `c = n . b`: `dh = -n . dp / c - h n . db / c`, `dp = R v` and
        `db = R (w x e_z)`; by the plane `dh = -(p + h b) . dn / c - df / c`.
        """
        normal, offset, by_turn = self._rows(instrument, data.target)
        index = self._index(data.target)
        R, p = T[:, :3, :3], T[:, :3, 3]
        b = R[:, :, 2]
        h = self._distance(T, normal, offset)
        c = np.einsum("ni,ni->n", normal, b)
        with np.errstate(divide="ignore", invalid="ignore"):
            n_tool = np.einsum("ni,nij->nj", normal, R) / c[:, None]
            hit = (p + h[:, None] * b) / c[:, None]
            slope = 1.0 / c
            # n . R (w x e_z) = -n . R [e_z]x w
            by_turn_of_beam = h[:, None] * (n_tool @ skew(np.array([0.0, 0.0, 1.0])))
        J_pose = np.concatenate([-n_tool, by_turn_of_beam], axis=1)[:, None, :]
        J_instrument = np.zeros((len(T), 1, 3 * len(self.planes)))
        row = np.arange(len(T))
        for k in range(2):
            J_instrument[row, 0, 3 * index + k] = -np.einsum(
                "ni,ni->n", hit, by_turn[:, :, k]
            )
        J_instrument[row, 0, 3 * index + 2] = -slope
        return Linearization(h[:, None] - data.values, J_pose, J_instrument)

    def batches(self, data: Measurements, weights: Floats) -> Sequence[Batch]:
        """Carries the origin and the beam of the tool to the base."""
        rows, index = np.arange(len(data)), self._index(data.target)

        def geometry(instrument: Floats) -> Geometry:
            planes = turned_planes(self.planes, instrument)
            return Geometry(np.zeros((len(instrument), 1, 3)), planes)

        origin = np.zeros_like(rows)
        return [Batch("beam", rows, origin, index, data.values, weights, geometry)]

    def register(
        self, F: Floats, data: Measurements, base: pin.SE3 | None, tool: pin.SE3 | None
    ) -> tuple[PlaneDistance, pin.SE3, pin.SE3]:
        """Planes through the points that the nominal beam hits.

        A base and a tool that are not given stay where the URDF puts them.

        Raises:
            InputError: If a nominal beam runs parallel to its plane.
        """
        base, tool = base or pin.SE3.Identity(), tool or pin.SE3.Identity()
        T = base.homogeneous @ F @ tool.homogeneous
        hits = T[:, :3, 3] + data.values * T[:, :3, 2]
        index = self._index(data.target, data)
        planes = list(self.planes)
        for k, plane in enumerate(planes):
            if plane.normal is None:
                normal, offset = register_plane(hits[index == k])
                planes[k] = replace(plane, normal=normal, offset=offset)
        # Rows may reach farther than the setup says or a simulation would.
        farthest = float(np.abs(data.values).max())
        reach = self.reach if farthest <= self.reach else 1.5 * farthest
        registered = replace(self, planes=tuple(planes), reach=reach)
        normals, _, _ = registered._rows(np.zeros(3 * len(planes)), data.target)
        cosine = np.abs(np.einsum("ni,ni->n", normals, T[:, :3, 2]))
        if (cosine < GRAZING).any():
            row = int(np.argmin(cosine))
            name = planes[index[row]].name
            raise data.error(row, f"the beam is parallel to the plane '{name}'")
        return registered, base, tool

    def _index(self, target: Targets, data: Measurements | None = None) -> Indices:
        """Position of each row's plane; data tell where a wrong name stands."""
        return locate(target, self.planes, "plane", data)

    def _rows(
        self, instrument: Floats, target: Targets
    ) -> tuple[Floats, Floats, Floats]:
        """Normal (N, 3), offset (N,) and derivative (N, 3, 2) of each row's plane."""
        index = self._index(target)
        return turned_rows(self.planes, index, instrument.reshape(-1, 3)[index])

    @staticmethod
    def _distance(T: Floats, normal: Floats, offset: Floats) -> Floats:
        p, b = T[:, :3, 3], T[:, :3, 2]
        with np.errstate(divide="ignore", invalid="ignore"):
            h = -(np.einsum("ni,ni->n", normal, p) + offset) / np.einsum(
                "ni,ni->n", normal, b
            )
        return np.asarray(h)
