"""Distances of a tool point: draw-wire encoder, ball bar, laser interferometer."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.contact import RoundModel, directions
from calib_pin.measurement_models.contact_registration import (
    register_distances,
    register_relative_distances,
)
from calib_pin.measurement_models.declaration import (
    INSTRUMENT,
    Declaration,
    Naming,
    Quantity,
)
from calib_pin.measurement_models.named_points import located_tool, tip_points
from calib_pin.measurement_models.references import Anchor, ReferenceObject
from calib_pin.measurement_models.tool_point import PointMeasurement, PointModel
from calib_pin.observations import AT, Indices, Measurements

QUANTITIES = (Quantity("distance", "m", slice(0, 1), 1e-4),)


@dataclass(frozen=True)
class PointDistance(RoundModel):
    """`h = |p - a| + b`, from a fixed point a to the tool point, with a bias b [m]."""

    declaration = Declaration(
        name="point-distance",
        help="distances of a tool point to fixed points: draw-wire encoder",
        components=("distance",),
        quantities=QUANTITIES,
        naming=Naming("anchor", "all or none"),
        yardstick=INSTRUMENT,
    )
    sites_kind = Anchor

    def fit_site(
        self, F: Floats, data: Measurements, point: Floats | None, site: ReferenceObject
    ) -> tuple[Floats, Anchor]:
        """The reference point at these distances, with its bias."""
        assert isinstance(site, Anchor)
        known = 0.0 if site.estimate_size or site.size is None else site.size
        distances, biased = data.values[:, 0] - known, site.estimate_size
        reached = register_distances(F, distances, point, biased=biased)
        return reached.point, replace(site, xyz=reached.site, size=reached.size + known)


@dataclass(frozen=True)
class RelativeDistance(PointModel):
    """`h = |p - p_0|`, how far the tool point is from where a row starts [m].

    Poses are those of the tool in the tool at the start, so that the point at the
    start is its offset: `h = |R t + p - t|`. Where the base stands is unobservable.
    Rows of one start share a name, which may follow that of a point, `point@name`.
    """

    declaration = Declaration(
        name="relative-distance",
        help="how far a tool point moved from a start: laser interferometer",
        components=("distance",),
        quantities=QUANTITIES,
        relative=True,
        naming=Naming("start"),
        yardstick=INSTRUMENT,
    )
    comparison = "distance"

    @property
    def targets(self) -> Sequence[str]:
        """Points, each before the name of a start that is yet to come."""
        return tuple(f"{name}{AT}" if name else "" for name in super().targets)

    def compare(self, p: Floats, site: Indices, values: Floats) -> PointMeasurement:
        """The length of the way."""
        e, distance = directions(p)
        return PointMeasurement(distance[:, None], e[:, None], np.zeros((len(p), 1, 0)))

    def seen(self, values: Floats) -> Floats:
        """The start, from which on the kernel counts."""
        return np.zeros((len(values), 1, 4))

    def register(
        self, F: Floats, data: Measurements, base: pin.SE3 | None, tool: pin.SE3 | None
    ) -> tuple[RelativeDistance, pin.SE3, pin.SE3]:
        """The points of the tool, each by its own rows; the base stays."""
        label, _ = self.names(data.target, data)
        tip = tip_points(self.points, tool)
        for k in np.unique(label[np.isnan(tip[label, 0])]):
            rows = label == k
            tip[k] = register_relative_distances(F[rows], data.values[rows, 0])
        points, tool = located_tool(tip, self.points, tool)
        return replace(self, points=points), base or pin.SE3.Identity(), tool

    def _reach(self, T: Floats, offset: Floats) -> tuple[Floats, Floats]:
        p, by_offset = super()._reach(T, offset)
        return p - offset, by_offset - np.eye(3)
