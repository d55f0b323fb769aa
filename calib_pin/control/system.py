"""The linear system of one step of inverse kinematics, for many rows at once."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from calib_pin.control.joints import Booleans, Indices
from calib_pin.kinematics.spatial import Floats

WEIGHT = 1e3
"""Weight of the directions of the target in a Hessian."""

LEAST = 0.05
"""Least curvature along the self-motion."""

ROUNDING = 1e-12
"""Least square of a singular value that is a direction of the target."""


@dataclass
class System:
    """The linear system of a step.

    Attributes:
        J: Derivative of the components of the target, shape (A, m, n).
        e: Errors, shape (A, m).
        pull: Way towards the start, shape (A, n).
        damping: Squares of singular values below it are not inverted, shape (A,).
        held: Joints that do not take part, shape (A, n).
        moves: Steps of these, zero for others, shape (A, n).
        hessian: Second derivative by dq, shape (A, n, n); None for unity.
    """

    J: Floats
    e: Floats
    pull: Floats
    damping: Floats
    held: Booleans
    moves: Floats
    hessian: Floats | None

    def take(self, rows: Indices) -> System:
        """Some of the rows."""
        return System(
            J=self.J[rows],
            e=self.e[rows],
            pull=self.pull[rows],
            damping=self.damping[rows],
            held=self.held[rows],
            moves=self.moves[rows],
            hessian=None if self.hessian is None else self.hessian[rows],
        )

    def solve(self) -> tuple[Floats, Floats]:
        """Steps, shape (A, n), and multipliers of the pose, shape (A, m)."""
        J = np.where(self.held[:, None], 0.0, self.J)
        m, n = J.shape[1:]
        e = self.e - times(self.J, self.moves)
        if self.hessian is None:
            pull, Y = np.where(self.held, 0.0, self.pull), np.swapaxes(J, 1, 2)
        else:
            pull = self.pull - times(self.hessian, self.moves)
            pull = np.where(self.held, 0.0, pull)
            either = self.held[:, :, None] | self.held[:, None, :]
            H = np.where(either, 0.0, self.hessian)
            H[:, range(n), range(n)] += self.held
            both = np.concatenate([pull[:, :, None], np.swapaxes(J, 1, 2)], axis=2)
            solved = np.linalg.solve(H, both)
            pull, Y = solved[:, :, 0], solved[:, :, 1:]
        S = J @ Y
        S[:, range(m), range(m)] += self.damping[:, None]
        y = np.linalg.solve(S, (e - times(J, pull))[:, :, None])[:, :, 0]
        return self.moves + pull + times(Y, y), y

    def force(self, dq: Floats, y: Floats) -> Floats:
        """Force on each joint, shape (A, n); zero for those that are not held."""
        resistance = dq if self.hessian is None else times(self.hessian, dq)
        return np.asarray(self.pull + times(np.swapaxes(self.J, 1, 2), y) - resistance)

    def curve(self, J: Floats, y: Floats, sliding: Booleans) -> None:
        """Add the second derivative of the pose, weighted by multipliers.

        It follows from the twists: with columns (v, w), for i <= j the position bends
        by w_i x v_j and the orientation by half of w_i x w_j, which is zero for i = j.

        Args:
            J: Body twists of the tool, shape (A, 6, n).
            y: Multipliers, shape (A, m).
            sliding: Rows that need it, shape (A,).
        """
        y = np.where(sliding[:, None], y, 0.0)
        v, w = np.swapaxes(J[:, :3], 1, 2), np.swapaxes(J[:, 3:], 1, 2)
        bends = np.cross(y[:, None, :3], w) @ np.swapaxes(v, 1, 2)
        if y.shape[1] == 6:
            bends += 0.5 * np.cross(y[:, None, 3:], w) @ np.swapaxes(w, 1, 2)
        upper = np.triu(bends)
        unity = np.eye(J.shape[2])
        H = unity - upper - np.swapaxes(np.triu(bends, 1), 1, 2)
        (far,) = np.nonzero(np.linalg.norm(H - unity, axis=(1, 2)) > 0.5)
        if len(far):
            H[far] = self._definite(far, H[far])
        self.hessian = H

    def _definite(self, rows: Indices, H: Floats) -> Floats:
        """Hessians that are definite along the self-motion, shape (K, n, n).

        A large weight on the directions of the target changes no step, since the step
        is given there; a curvature that is still negative lies along the self-motion.
        """
        held, J = self.held[rows], self.J[rows]
        J = np.where(held[:, None], 0.0, J)
        S = J @ np.swapaxes(J, 1, 2)
        S[:, range(S.shape[1]), range(S.shape[1])] += ROUNDING
        pseudo_inverse = np.swapaxes(np.linalg.solve(S, J), 1, 2)
        size = 1.0 + np.linalg.norm(H, axis=(1, 2))
        weight = WEIGHT * size**2
        self.pull[rows] += weight[:, None] * times(pseudo_inverse, self.e[rows])
        H = H + weight[:, None, None] * (pseudo_inverse @ J)
        block = np.where(held[:, :, None] | held[:, None, :], 0.0, H)
        values, vectors = np.linalg.eigh(0.5 * (block + np.swapaxes(block, 1, 2)))
        # Uphill turns into downhill, and level ground into a gentle slope.
        change = (np.maximum(np.abs(values), LEAST) - values)[:, None]
        return np.asarray(H + (vectors * change) @ np.swapaxes(vectors, 1, 2))


def times(A: Floats, x: Floats) -> Floats:
    """Matrices times vectors, shapes (N, m, n) and (N, n) to (N, m)."""
    return np.asarray((A @ x[:, :, None])[:, :, 0])
