"""The targets of a descent, and its effort."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from calib_pin.control.joints import Indices, Joints, Kinematics
from calib_pin.kinematics.spatial import Floats, so3_log


@dataclass(frozen=True)
class Task:
    """Targets that a chain of n joints shall reach.

    Attributes:
        evaluate: The kinematics.
        targets: Poses, shape (N, 4, 4).
        start: Joint positions that solutions shall be close to, shape (N, n) [rad, m].
        joints: Limits, which are never left.
        orientation: Whether orientations count; else only positions do.
    """

    evaluate: Kinematics
    targets: Floats
    start: Floats
    joints: Joints
    orientation: bool

    @property
    def size(self) -> int:
        """Number m of components of a target."""
        return 6 if self.orientation else 3

    @property
    def rank(self) -> int:
        """Number of components that the joints can move."""
        _, J = self.evaluate(self.joints.samples(8))
        return int(np.linalg.matrix_rank(J[:, : self.size], tol=1e-9).max())

    def rows(self, rows: Indices | slice) -> Task:
        """Some of the rows."""
        return replace(self, targets=self.targets[rows], start=self.start[rows])

    def errors(self, q: Floats) -> tuple[Floats, Floats]:
        """Errors in the axes of the tool, (N, m), and body twists, (N, 6, n)."""
        T, J = self.evaluate(q)
        R_transposed = np.swapaxes(T[:, :3, :3], 1, 2)
        way = self.targets[:, :3, 3] - T[:, :3, 3]
        position = np.asarray((R_transposed @ way[:, :, None])[:, :, 0])
        if not self.orientation:
            return position, J
        turn = so3_log(R_transposed @ self.targets[:, :3, :3])
        return np.hstack([position, turn]), J


@dataclass(frozen=True)
class Effort:
    """Tolerance and number of steps of a descent.

    Attributes:
        error: Error at which a row is finished [m, rad].
        iterations: Largest number of steps.
        slides: Steps along the self-motion, before the joints stop where they are.
    """

    error: float
    iterations: int
    slides: int


ROUGH = Effort(1e-2, 12, 0)
"""Enough to see whether a start leads near a target."""

THOROUGH = Effort(1e-6, 30, 0)
"""Enough to see whether it leads there."""

EXACT = Effort(1e-10, 50, 0)
"""To the target, on no particular way."""

FULL = Effort(1e-10, 100, 60)
"""To the target, and along the self-motion to the start."""
