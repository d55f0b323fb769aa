"""Derivatives of tool poses by the error parameters.

Every parameter is a unit screw in one frame of the chain, so with the regressor R of
the frames the Jacobian is

    dT/dtheta = R(q) B(theta)

where `B` does not depend on q. The column of a parameter with a basis function is
multiplied by that, phi_p(q). Where a place bends by twists xi, what stands before it
goes through the bend row by row, and the twist xi itself acts through the Jacobian of
the exponential.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats, adjoint, invert
from calib_pin.parameterizations.base import Screw
from calib_pin.parameterizations.bending import Bends


@dataclass(frozen=True)
class PoseLinearization:
    """Tool poses of N configurations and their dependence on P parameters.

    Attributes:
        T: Tool poses in the measurement frame, shape (N, 4, 4).
        regressor: Body twist of the tip per placement twist, shape (N, 6, 6 n).
        to_base: Tool poses in the base link, before the learned motion of the tool,
            shape (N, 4, 4).
        to_tip: Tool pose in the tip of the chain, shape (4, 4).
        to_tool: Tool pose in the corrected tip, shape (4, 4).
        columns: Body twist in its own frame per parameter, shape (6, P).
        frames: Frame index of each parameter, ascending.
        axes: Unit twists of the joints' own motions, shape (n, 6).
        varying: Positions of the parameters with a basis function, shape (C,).
        basis: Basis functions that multiply their screws, shape (N, C).
        bends: How places are bent.
        learned: Motion of the tool that was learned, shape (N, 4, 4), None for none.
        fading: The rest of poses at which the learned correction fades, None for none.
    """

    T: Floats
    regressor: Floats
    to_base: Floats
    to_tip: Floats
    to_tool: Floats
    columns: Floats
    frames: tuple[int, ...]
    axes: Floats
    varying: NDArray[np.intp]
    basis: Floats
    bends: Bends = field(default_factory=Bends)
    learned: Floats | None = None
    fading: Fading | None = None

    def joint_twists(self) -> Floats:
        """Body twists of the tool by the joint positions, shape (N, 6, n).

        They are those of the whole learned correction where it fades.
        """
        if self.fading is not None:
            return self.fading.whole.joint_twists()
        blocks = self.regressor.reshape(len(self.T), 6, len(self.axes), 6)
        at_tip = np.einsum("nakb,kb->nak", blocks, self.axes)
        behind = self.to_tip if self.learned is None else self.to_tip @ self.learned
        return np.asarray(adjoint(invert(behind)) @ at_tip)

    def derivative(self, J_pose: Floats) -> Floats:
        """Derivative by the parameters of a function of the tool pose.

        The few rows per configuration go through the chain from the left; the twists
        themselves, twice as large for a position, are never formed.

        Args:
            J_pose: Its derivative by the tool's body twist, shape (N, d, 6).

        Returns:
            Derivative, shape (N, d, P).
        """
        if self.fading is not None:
            of_plain, of_whole, whole = self.fading
            plain = replace(self, fading=None).derivative(J_pose @ of_plain)
            return plain + whole.derivative(J_pose @ of_whole)
        if self.learned is not None:
            J_pose = J_pose @ adjoint(invert(self.learned))
        rows, size = J_pose.shape[:2]
        width = self.regressor.shape[2]
        base, joints, tip = np.searchsorted(
            self.frames, [0, width // 6, width // 6 + 1], side="right"
        )
        result = np.empty((rows, size, len(self.frames)))
        last = width // 6 + 2
        at_base = J_pose @ adjoint(invert(self.to_base))
        at_base = self.bends.before(0, at_base)
        result[:, :, :base] = at_base @ self.columns[:, :base]
        # The parameters of the joints: one block of six rows for each frame.
        B = np.zeros((width, joints - base))
        for k in range(base, joints):
            row = 6 * (self.frames[k] - 1)
            B[row : row + 6, k - base] = self.columns[:, k]
        at_joints = J_pose @ adjoint(invert(self.to_tip)) @ self.regressor
        of_joints = at_joints.reshape(rows * size, width) @ B
        result[:, :, base:joints] = of_joints.reshape(rows, size, joints - base)
        at_tip = J_pose @ adjoint(invert(self.to_tool))
        at_tip = self.bends.before(last - 1, at_tip)
        result[:, :, joints:tip] = at_tip @ self.columns[:, joints:tip]
        at_tool = self.bends.before(last, J_pose)
        result[:, :, tip:] = at_tool @ self.columns[:, tip:]
        for frame in self.bends.twists:
            at = {0: at_base, last - 1: at_tip, last: at_tool}.get(frame)
            if at is None:
                behind = at_joints[:, :, 6 * frame - 6 : 6 * frame]
                at = self.bends.before(frame, behind)
            self._bend(result, frame, at)
        result[:, :, self.varying] *= self.basis[:, None, :]
        return result

    def _bend(self, result: Floats, frame: int, before: Floats) -> None:
        """Take a bend into the columns of its frame, but for the basis functions.

        Args:
            result: Columns of all parameters, shape (N, d, P), those at a joint as if
                they stood behind its bend; changed in place.
            frame: The frame that is bent.
            before: Derivative by body twists before the bend, shape (N, d, 6).
        """
        by_twist = self.bends.by_twist(frame, before)
        flexures, varying = set(self.bends.flexures), set(self.varying)
        first, stop = np.searchsorted(self.frames, [frame, frame + 1])
        for k in range(first, stop):
            if k in flexures:
                result[:, :, k] = by_twist @ self.columns[:, k]
            elif k not in varying:
                result[:, :, k] = before @ self.columns[:, k]


class Fading(NamedTuple):
    """A pose between that of the parameters alone and that with the correction.

    Attributes:
        of_plain: Its body twist by that of the former, shape (N, 6, 6).
        of_whole: The same by that of the latter.
        whole: Linearization with the whole learned correction; the one that holds this
            has none of it.
    """

    of_plain: Floats
    of_whole: Floats
    whole: PoseLinearization


def ordered_screws(
    screws: Sequence[Screw], theta: Floats, frames: int
) -> tuple[Floats, list[pin.SE3]]:
    """Body twist per parameter at the end of its frame's product, and the products.

    A twist is transformed by the adjoint of the screws behind it in the product.

    Args:
        screws: One screw per parameter, in the order they apply within a frame.
        theta: Parameter values, shape (P,).
        frames: Number of frames.

    Returns:
        Twists, shape (6, P), and the product `Exp(S_1 t_1) Exp(S_2 t_2) ...` of every
        frame.
    """
    columns = np.empty((6, len(screws)))
    behind: list[pin.SE3 | None] = [None] * frames
    for k in reversed(range(len(screws))):
        screw, amount = screws[k], theta[k]
        after = behind[screw.frame]
        columns[:, k] = screw.twist
        # What has a basis function comes behind all other screws of its frame.
        if after is not None and screw.basis is None:
            columns[:, k] = after.toActionMatrixInverse() @ screw.twist
        if amount != 0.0 and screw.basis is None:
            motion = pin.exp6(screw.twist * amount)
            behind[screw.frame] = motion if after is None else motion * after
    identity = pin.SE3.Identity()
    return columns, [identity if b is None else b for b in behind]
