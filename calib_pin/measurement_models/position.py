"""The position of points on the tool: laser tracker, motion capture."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.declaration import (
    INSTRUMENT,
    Declaration,
    Naming,
    Quantity,
)
from calib_pin.measurement_models.named_points import located_tool, tip_points
from calib_pin.measurement_models.registration import register_points
from calib_pin.measurement_models.tool_point import PointMeasurement, PointModel
from calib_pin.observations import Indices, Measurements


@dataclass(frozen=True)
class Position(PointModel):
    """`residual = p - y`, a point of the tool in the measurement frame [m].

    Points have no orientation: of the tool's origin alone `tool.frame.rx|ry|rz` are
    unidentifiable. With several named points nothing but positions is measured, and
    all residuals share one unit (Wu et al., partial pose measurements).
    """

    declaration = Declaration(
        name="position",
        help="x, y, z of a point on the tool: laser tracker, motion capture",
        components=("x", "y", "z"),
        quantities=(Quantity("position", "m", slice(0, 3), 1e-4),),
        external=True,
        at_once=True,
        tracks="point",
        naming=Naming("point of the tool"),
        inferred="part",
        yardstick=INSTRUMENT,
    )
    comparison = "position"
    alone = True

    def compare(self, p: Floats, site: Indices, values: Floats) -> PointMeasurement:
        """The point itself."""
        identity = np.broadcast_to(np.eye(3), (len(p), 3, 3))
        return PointMeasurement(p, identity, np.zeros((len(p), 3, 0)))

    def seen(self, values: Floats) -> Floats:
        """Nothing: values alone."""
        return np.zeros((len(values), 1, 3))

    def register(
        self, F: Floats, data: Measurements, base: pin.SE3 | None, tool: pin.SE3 | None
    ) -> tuple[Position, pin.SE3, pin.SE3]:
        """Absolute orientation, with the unknown points eliminated."""
        label, _ = self.names(data.target, data)
        tip = tip_points(self.points, tool)
        known = None if base is None else (base.rotation, base.translation)
        R, b, tip = register_points(F, data.values, base=known, tool=tip, label=label)
        points, tool = located_tool(tip, self.points, tool)
        return replace(self, points=points), base or pin.SE3(R, b), tool
