"""Models of a tool point against places that are registered from measurements."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Self

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.contact_registration import Reached
from calib_pin.measurement_models.named_points import located_tool, tip_points
from calib_pin.measurement_models.references import ReferenceObject
from calib_pin.measurement_models.tool_point import PointModel
from calib_pin.observations import Measurements


@dataclass(frozen=True)
class SiteModel(PointModel):
    """A point of the tool against places that are registered from rows of theirs."""

    def reached(
        self, F: Floats, data: Measurements, point: Floats | None, site: ReferenceObject
    ) -> Reached:
        """What the rows of one place and one point tell in closed form.

        Args:
            F: Tip poses in the measuring frame, shape (N, 4, 4).
            data: The rows.
            point: The point in the tip frame where it is known, shape (3,) [m].
            site: The place, not placed yet.
        """
        raise NotImplementedError

    def found(self, site: ReferenceObject, reached: Reached) -> ReferenceObject:
        """The place where that has put it."""
        raise NotImplementedError

    def register(
        self, F: Floats, data: Measurements, base: pin.SE3 | None, tool: pin.SE3 | None
    ) -> tuple[Self, pin.SE3, pin.SE3]:
        """Unknown points by all their places, then unknown places by all rows.

        A base that is not given stays where the URDF puts it.
        """
        base = base or pin.SE3.Identity()
        label, site = self.names(data.target, data)
        F = base.homogeneous @ F
        tip = tip_points(self.points, tool)
        for k in np.unique(label[np.isnan(tip[label, 0])]):
            found, sizes = [], []
            for s in np.unique(site[label == k]):
                rows = (label == k) & (site == s)
                reached = self.reached(F[rows], data.rows(rows), None, self.sites[s])
                found.append(reached.point)
                sizes.append(rows.sum())
            # The place with most rows: a poor one would spoil an average.
            tip[k] = found[int(np.argmax(sizes))]
        points, tool = located_tool(tip, self.points, tool)
        at = tip_points(points, tool)[label]
        # With the points in place, every row tells of its place.
        moved = F.copy()
        moved[:, :3, 3] += np.einsum("nij,nj->ni", F[:, :3, :3], at)
        sites = list(self.sites)
        for s, reference in enumerate(sites):
            rows = site == s
            if not reference.located and rows.any():
                reached = self.reached(
                    moved[rows], data.rows(rows), np.zeros(3), reference
                )
                sites[s] = self.found(reference, reached)
        return replace(self, points=points, sites=tuple(sites)), base, tool
