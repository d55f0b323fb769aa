"""The cost of a laser distance sensor and a plane, written without calib-pin.

space6 with errors of its DH parameters and of the plane's direction; the same numbers
as those of the library, which `evolution` checks.
"""

from __future__ import annotations

import numpy as np
import pinocchio as pin

from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.references import Plane

DH = np.array(
    [
        # theta, d, a, alpha, beta
        (0.0, 0.80, 0.10, -np.pi / 2, 0.0),
        (0.0, 0.00, 0.85, 0.0, 0.0),
        (0.0, 0.15, 0.05, np.pi / 2, 0.0),
        (0.0, 0.75, 0.00, -np.pi / 2, 0.0),
        (0.0, 0.00, 0.00, np.pi / 2, 0.0),
        (0.0, 0.20, 0.00, 0.0, 0.0),
    ]
)

ERRORS = (
    *(0, 1, 2, 3),
    *(5, 7, 8, 9),  # beta in place of d before a parallel axis
    *(10, 11, 12, 13),
    *(15, 16, 17, 18),
    *(20, 21, 22, 23),
    *(25, 26, 27, 28),
)
"""Where the 24 errors go in the table, row by row."""

SIGN = np.ones(24)
SIGN[[14, 15]] = -1.0
"""The library lets x of joint 4 point the other way, hence a and alpha."""


class Ranger:
    """Half the whitened sum of squares in three ways.

    The parameters x are the 24 errors and the plane's u and v.

    Args:
        problem: The measurements.
        plane: The nominal plane.
    """

    def __init__(self, problem: Problem, plane: Plane) -> None:
        """Compute all that is independent of the parameters."""
        assert plane.normal is not None
        ((part, data, *_),) = problem.blocks
        self._q = data.q
        self._c, self._s = np.cos(self._q).T, np.sin(self._q).T
        self._h, self._sigma = data.values[:, 0], problem.sigma
        self._axes = np.array([plane.normal, *plane.tangents])
        self._offset = plane.offset
        self._model = part.error.chain.robot.model.copy()
        self._data = self._model.createData()

    def loop(self, x: Floats) -> float:
        """One member, shape (26,): Pinocchio in a loop over the configurations."""
        R, p, normal = self._geometry(x[:, None])
        for i in range(5):
            self._model.jointPlacements[i + 2] = pin.SE3(R[0, i], p[0, i])
        tool = pin.SE3(R[0, 5], p[0, 5]).homogeneous
        T = np.empty((len(self._q), 4, 4))
        for k, q in enumerate(self._q):
            pin.forwardKinematics(self._model, self._data, q)
            T[k] = self._data.oMi[6].homogeneous
        T = T @ tool
        return float(self._cost(T[:, :3, 3], T[:, :3, 2], normal[0]))

    def matrices(self, x: Floats) -> Floats:
        """Many members, shape (26, S) -> (S,): rotations and positions multiplied.

        A joint's rotation mixes two columns; a link is one product for all
        configurations of a member.
        """
        R, p, normal = self._geometry(x)
        count, rows = x.shape[1], len(self._q)
        links = np.concatenate([R, p[..., None]], axis=3)
        turned = np.zeros((count, rows, 3, 3))
        turned[..., 0, 0], turned[..., 0, 1] = self._c[0], -self._s[0]
        turned[..., 1, 0], turned[..., 1, 1] = self._s[0], self._c[0]
        turned[..., 2, 2] = 1.0
        position = np.zeros((count, rows, 3))
        for i in range(6):
            moved = turned.reshape(count, 3 * rows, 3) @ links[:, i]
            moved = moved.reshape(count, rows, 3, 4)
            rotation, position = moved[..., :3], position + moved[..., 3]
            if i < 5:
                c, s = self._c[i + 1][:, None], self._s[i + 1][:, None]
                turned = np.empty((count, rows, 3, 3))
                turned[..., 0] = c * rotation[..., 0] + s * rotation[..., 1]
                turned[..., 1] = c * rotation[..., 1] - s * rotation[..., 0]
                turned[..., 2] = rotation[..., 2]
        return self._cost(position, rotation[..., 2], normal[:, None])

    def vectors(self, x: Floats) -> Floats:
        """Many members, shape (26, S) -> (S,): as the kernel, from tool to base.

        No matrix of a pose is formed, only the tool's origin and beam are carried.
        """
        R, p, normal = self._geometry(x)
        count, rows = x.shape[1], len(self._q)
        carried = np.empty((count, 3, 2 * rows))
        carried[:, :, :rows] = p[:, 5, :, None]
        carried[:, :, rows:] = R[:, 5, :, 2:]
        for i in range(5, -1, -1):
            c, s = np.tile(self._c[i], 2), np.tile(self._s[i], 2)
            turned = np.empty_like(carried)
            turned[:, 0] = c * carried[:, 0] - s * carried[:, 1]
            turned[:, 1] = s * carried[:, 0] + c * carried[:, 1]
            turned[:, 2] = carried[:, 2]
            if i > 0:
                carried = R[:, i - 1] @ turned
                carried[:, :, :rows] += p[:, i - 1, :, None]
        origin, beam = turned[:, :, :rows], turned[:, :, rows:]
        n = normal[:, None]
        return self._whitened((n @ origin)[:, 0], (n @ beam)[:, 0])

    def _geometry(self, x: Floats) -> tuple[Floats, Floats, Floats]:
        """Links (S, 6, 3, 3) and (S, 6, 3), and normals of the plane (S, 3)."""
        table = np.tile(DH.reshape(-1), (x.shape[1], 1))
        table[:, ERRORS] += (SIGN[:, None] * x[:24]).T
        theta, d, a, alpha, beta = np.moveaxis(table.reshape(-1, 6, 5), 2, 0)
        ct, st, ca, sa = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
        cb, sb = np.cos(beta), np.sin(beta)
        R = np.empty((*theta.shape, 3, 3))  # Rz(theta) Rx(alpha) Ry(beta)
        R[..., 0, 0], R[..., 0, 1] = ct * cb - st * sa * sb, -st * ca
        R[..., 0, 2] = ct * sb + st * sa * cb
        R[..., 1, 0], R[..., 1, 1] = st * cb + ct * sa * sb, ct * ca
        R[..., 1, 2] = st * sb - ct * sa * cb
        R[..., 2, 0], R[..., 2, 1], R[..., 2, 2] = -ca * sb, sa, ca * cb
        p = np.stack([ct * a, st * a, d], axis=-1)
        u, v = x[24], x[25]
        turn = np.stack([np.cos(v) * np.cos(u), np.sin(v), -np.cos(v) * np.sin(u)])
        return R, p, turn.T @ self._axes

    def _cost(self, origin: Floats, beam: Floats, normal: Floats) -> Floats:
        """Costs from vectors (..., K, 3) and normals (..., 1, 3) or (3,)."""
        along = np.sum(normal * origin, axis=-1), np.sum(normal * beam, axis=-1)
        return self._whitened(*along)

    def _whitened(self, origin: Floats, beam: Floats) -> Floats:
        """Costs from components along the normal, (..., K) each."""
        r = (-(origin + self._offset) / beam - self._h) / self._sigma
        return np.asarray(0.5 * np.sum(r**2, axis=-1))
