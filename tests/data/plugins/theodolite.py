"""A theodolite: azimuth and elevation of a point on the tool from a fixed station."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.declaration import (
    Declaration,
    Naming,
    Quantity,
)
from calib_pin.measurement_models.named_points import located_tool, tip_points
from calib_pin.measurement_models.tool_point import PointMeasurement, PointModel
from calib_pin.observations import Measurements


@dataclass(frozen=True)
class Theodolite(PointModel):
    """`residual = (atan2(y, x), atan2(z, rho)) - measured` of a tool point [rad].

    Azimuth counts from x towards y of the measurement frame, elevation from its
    horizontal plane. Angles tell no size: lengths are those of the robot.
    """

    declaration = Declaration(
        name="theodolite",
        help="azimuth and elevation of a point on the tool from a station",
        components=("azimuth", "elevation"),
        quantities=(Quantity("direction", "rad", slice(0, 2), np.pi / 200 * 5e-4),),
        external=True,
        tracks="point",
        naming=Naming("point of the tool"),
        inferred="part",
    )
    alone = True

    def compare(
        self, p: Floats, site: NDArray[np.int64], values: Floats
    ) -> PointMeasurement:
        """Both angles."""
        x, y, z = p.T
        rho, r2 = np.hypot(x, y), np.einsum("ni,ni->n", p, p)
        value = np.column_stack([np.arctan2(y, x), np.arctan2(z, rho)])
        by_point = np.zeros((len(p), 2, 3))
        by_point[:, 0, :2] = np.column_stack([-y, x]) / (rho**2)[:, None]
        by_point[:, 1] = np.column_stack([-x * z / rho, -y * z / rho, rho])
        by_point[:, 1] /= r2[:, None]
        return PointMeasurement(value, by_point, np.zeros((len(p), 2, 0)))

    def register(
        self, F: Floats, data: Measurements, base: pin.SE3 | None, tool: pin.SE3 | None
    ) -> tuple[Theodolite, pin.SE3, pin.SE3]:
        """The station by a linear resection, then the unknown points of the tool."""
        label, _ = self.names(data.target, data)
        tip = tip_points(self.points, tool)
        (sa, se), (ca, ce) = np.sin(data.values.T), np.cos(data.values.T)
        across = np.array([[-sa, ca, 0.0 * sa], [-se * ca, -se * sa, ce]])
        across = across.transpose(2, 0, 1)  # Two normals of each ray, (N, 2, 3).
        R, x = F[:, :3, :3], F[:, :3, 3]
        x = x + np.einsum("nij,nj->ni", R, np.nan_to_num(tip)[label])
        lost = [k for k in np.unique(label) if np.isnan(tip[k, 0])]
        if base is None:
            # p = C w with w = (1, x, R of each unknown point), and across . p = 0.
            turns = [(R * (label == k)[:, None, None]).reshape(-1, 9) for k in lost]
            w = np.column_stack([np.ones(len(x)), x, *turns])
            A = np.einsum("nka,nw->nkaw", across, w).reshape(2 * len(x), -1)
            C = np.linalg.svd(A)[2][-1].reshape(3, -1)
            ray = np.column_stack([ce * ca, ce * sa, se])
            C *= np.sign(np.median(np.einsum("ni,ij,nj->n", ray, C, w)))
            U, size, V = np.linalg.svd(C[:, 1:4])
            rotation = U @ np.diag([1.0, 1.0, np.linalg.det(U @ V)]) @ V
            base = pin.SE3(rotation, C[:, 0] / size.mean())
        for k in lost:
            rows = label == k
            A = (across[rows] @ base.rotation @ R[rows]).reshape(-1, 3)
            away = x[rows] @ base.rotation.T + base.translation
            right = -np.einsum("nka,na->nk", across[rows], away).reshape(-1)
            tip[k] = np.linalg.lstsq(A, right, rcond=None)[0]
        points, tool = located_tool(tip, self.points, tool)
        return replace(self, points=points), base, tool
