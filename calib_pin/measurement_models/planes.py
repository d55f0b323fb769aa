"""Planes that are measured against, and how they turn."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib_pin.kinematics.spatial import Floats, so3_exp
from calib_pin.measurement_models.references import nuisances, triple
from calib_pin.parameters import Parameter
from calib_pin.setup import PlaneSetup


@dataclass(frozen=True)
class Plane:
    """Reference of a plane `n . p + f = 0` in the measuring frame.

    Attributes:
        name: Name that rows give as their target.
        normal: Unit normal n, shape (3,); None until it is registered.
        offset: Offset f [m].
        estimate: Whether the plane is estimated.
    """

    name: str
    normal: Floats | None = None
    offset: float = 0.0
    estimate: bool = True

    section = "planes"

    @property
    def located(self) -> bool:
        """Whether it is given or registered."""
        return self.normal is not None

    @property
    def parameters(self) -> Sequence[Parameter]:
        """`<plane>.plane.u|v|f`."""
        units = (("u", "rad"), ("v", "rad"), ("f", "m"))
        return nuisances(self.name, "plane", ((c, u, self.estimate) for c, u in units))

    @cached_property
    def tangents(self) -> Floats:
        """Two unit tangents, rows of a (2, 3) array; a fixed choice per normal."""
        assert self.normal is not None
        # Of components that are equal but for rounding, the first.
        helper = np.eye(3)[np.argmin(np.round(np.abs(self.normal), 9))]
        first = np.cross(self.normal, helper)
        first /= np.linalg.norm(first)
        return np.array([first, np.cross(self.normal, first)])

    def turned(self, values: Floats) -> tuple[Floats, float, Floats]:
        """Normal and offset at parameters (u, v, f), and the normal's derivative.

        The normal turns about its two tangents, `n = Exp(u t_1) Exp(v t_2) n_0`.

        Returns:
            Normal (3,), offset [m], and the normal's derivative by u and v, (3, 2).
        """
        assert self.normal is not None
        t_1, t_2 = self.tangents
        first, second = so3_exp(values[0] * t_1), so3_exp(values[1] * t_2)
        halfway = second @ self.normal
        normal = first @ halfway
        by_u = np.cross(t_1, normal)
        by_v = first @ np.cross(t_2, halfway)
        return normal, self.offset + float(values[2]), np.column_stack([by_u, by_v])

    def turned_many(self, values: Floats) -> Floats:
        """Normals and offsets at many parameters, shape (S, 3) -> (S, 4)."""
        assert self.normal is not None
        # Exp(u t_1) Exp(v t_2) n_0 = sin(v) t_1 + cos(v) (cos(u) n_0 - sin(u) t_2)
        # Element by element: a product of matrices may round by the place of a row.
        t_1, t_2 = self.tangents
        u, v = values[:, :1], values[:, 1:2]
        normals = np.sin(v) * t_1 + np.cos(v) * (
            np.cos(u) * self.normal - np.sin(u) * t_2
        )
        return np.column_stack([normals, self.offset + values[:, 2]])

    def rebased(self, values: Floats) -> Plane:
        """Turned and shifted by (u, v, f)."""
        normal, offset, _ = self.turned(values)
        return replace(self, normal=normal, offset=offset)

    def stated(self) -> PlaneSetup:
        """Its normal and offset."""
        normal = triple(self.normal)
        assert normal is not None
        return PlaneSetup(normal, float(self.offset), self.estimate)


def turned_planes(planes: Sequence[Plane], values: Floats) -> Floats:
    """Normals and offsets of L planes at many parameters, (S, 3 L) -> (S, L, 4)."""
    parts = [values[:, 3 * k : 3 * k + 3] for k in range(len(planes))]
    turned = [p.turned_many(part) for p, part in zip(planes, parts, strict=True)]
    return np.stack(turned, axis=1)
