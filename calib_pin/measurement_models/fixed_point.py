"""A ball on the tool that rests in sockets: the same place from many sides."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.contact_registration import register_sockets
from calib_pin.measurement_models.declaration import Declaration, Naming, Quantity
from calib_pin.measurement_models.named_points import (
    given_names,
    located_tool,
    named_points,
    tip_points,
)
from calib_pin.measurement_models.references import Point
from calib_pin.measurement_models.registration import register_points
from calib_pin.measurement_models.tool_point import PointMeasurement, PointModel
from calib_pin.observations import Indices, Measurements
from calib_pin.setup import Setup


@dataclass(frozen=True)
class FixedPoint(PointModel):
    """`residual = p - c_s`, the ball's center against that of its socket [m].

    The center is as unknown as the ball's place on the tool. A robot whose lengths are
    all too large by one factor has its ball in the sockets just as well: only a known
    distance between sockets, or something else that is known, sets the scale.
    """

    declaration = Declaration(
        name="fixed-point",
        help="a ball on the tool rests in sockets, each from several sides",
        components=("x", "y", "z"),
        quantities=(Quantity("position", "m", slice(0, 3), 1e-4),),
        contact=True,
        naming=Naming("socket", "every", configurations=2),
    )
    comparison = "position"
    unknown = staticmethod(partial(Point, kind="socket"))

    @classmethod
    def sites_of_setup(cls, setup: Setup, names: Sequence[str]) -> tuple[Point, ...]:
        """The sockets."""
        return named_points(setup.sockets, given_names(names, "socket"), "socket")

    def compare(self, p: Floats, site: Indices, values: Floats) -> PointMeasurement:
        """From the socket to the ball."""
        identity = np.broadcast_to(np.eye(3), (len(p), 3, 3))
        centers = self._centers[site] + values
        return PointMeasurement(p - centers, identity, -identity)

    def seen(self, values: Floats) -> Floats:
        """Centers of the sockets."""
        return self._centers + values.reshape(len(values), -1, 3)

    @property
    def _centers(self) -> Floats:
        sockets = [s for s in self.sites if isinstance(s, Point)]
        return np.array([socket.xyz for socket in sockets])

    def register(
        self, F: Floats, data: Measurements, base: pin.SE3 | None, tool: pin.SE3 | None
    ) -> tuple[FixedPoint, pin.SE3, pin.SE3]:
        """Ball and sockets by linear least squares.

        A base that is not given is found where all sockets are known, else it stays
        where the URDF puts it.
        """
        label, socket = self.names(data.target, data)
        tip = tip_points(self.points, tool)
        given = [
            np.full(3, np.nan) if s.xyz is None else s.xyz
            for s in self.sites
            if isinstance(s, Point)
        ]
        if base is None and len(given) >= 3 and not np.isnan(given).any():
            seen = np.array(given)[socket]
            R, b, _ = register_points(F, seen, tool=tip, label=label)
            base = pin.SE3(R, b)
        base = base or pin.SE3.Identity()
        centers = (np.array(given) - base.translation) @ base.rotation
        tip, xyz = register_sockets(F, tip, label, centers, socket)
        points, tool = located_tool(tip, self.points, tool)
        xyz = np.nan_to_num(xyz) @ base.rotation.T + base.translation
        sites = tuple(
            site if site.located else replace(site, xyz=xyz[k])
            for k, site in enumerate(self.sites)
            if isinstance(site, Point)
        )
        return replace(self, points=points, sites=sites), base, tool
