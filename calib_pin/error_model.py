"""The error model: a chain, its error parameters, and the two frames at its ends.

    T(q, theta) = B(theta) F(q, theta) E(theta) X(theta)

B is the base link in the measuring frame, F the chain with corrected placements, E an
error of the tip, and X the tool in the tip frame. Every parameter is a unit screw at
one place, so with the regressor R of the places the Jacobian is

    dT/dtheta = R(q) B(theta)

where `B` does not depend on q.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin

from calib_pin.chain import Chain
from calib_pin.parameterizations import Screw, frame_screws, parameterization
from calib_pin.parameters import ParameterSet
from calib_pin.spatial import Floats, adjoint, invert

__all__ = ["ErrorModel"]


@dataclass(frozen=True)
class ErrorModel:
    """A chain with error parameters.

    Attributes:
        chain: The nominal chain with n joints.
        screws: One screw per parameter, place by place from base to tool.
        base: Reference pose of the base link in the measuring frame.
        tool: Reference pose of the tool in the tip frame.

    Example:
        >>> import numpy as np, calib_pin
        >>> from calib_pin.error_model import ErrorModel
        >>> model = ErrorModel.create(calib_pin.load_chain("space6"), ["placement"])
        >>> T, J = model.jacobian(np.zeros((2, 6)), np.zeros(len(model.parameters)))
        >>> T.shape, J.shape
        ((2, 4, 4), (2, 6, 48))
    """

    chain: Chain
    screws: tuple[Screw, ...]
    base: pin.SE3
    tool: pin.SE3

    @staticmethod
    def create(
        chain: Chain,
        parameterizations: Sequence[str],
        *,
        estimate_base: bool = True,
        estimate_tool: bool = True,
    ) -> ErrorModel:
        """Combine parameterizations and the two frames.

        Args:
            chain: The chain.
            parameterizations: Names of parameterizations.
            estimate_base: Whether the base frame is free.
            estimate_tool: Whether the tool frame is free.

        Raises:
            OptionError: If a name is unknown, or two members define one parameter.
        """
        robot = [
            s
            for name in parameterizations
            for s in parameterization(name).screws(chain)
        ]
        count = len(chain.joints)
        screws = [
            *frame_screws("base", 0, free=estimate_base),
            # A stable sort: within a place the order of each member stands.
            *sorted(robot, key=lambda screw: screw.place),
            *frame_screws("tool", count + 2, free=estimate_tool),
        ]
        identity = pin.SE3.Identity()
        return ErrorModel(chain, tuple(screws), identity, identity)

    def with_frames(self, base: pin.SE3, tool: pin.SE3) -> ErrorModel:
        """The same model about other reference poses of base and tool."""
        return replace(self, base=base, tool=tool)

    @cached_property
    def parameters(self) -> ParameterSet:
        """The parameters, in the order of the screws."""
        return ParameterSet(tuple(screw.parameter for screw in self.screws))

    @property
    def places(self) -> int:
        """Number of places: base, n joints, tip, tool."""
        return len(self.chain.joints) + 3

    def corrections(self, theta: Floats) -> list[pin.SE3]:
        """Product of the screws at every place, `Exp(S_1 t_1) Exp(S_2 t_2) ...`."""
        result = [pin.SE3.Identity() for _ in range(self.places)]
        for screw, amount in zip(self.screws, theta, strict=True):
            if amount != 0.0:
                result[screw.place] *= pin.exp6(screw.twist * amount)
        return result

    def poses(self, q: Floats, theta: Floats) -> Floats:
        """Tool poses in the measuring frame.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            theta: Parameter values, shape (P,).

        Returns:
            Poses, shape (N, 4, 4).
        """
        base, placements, tip, tool = self._placed(self.corrections(theta))
        F = self.chain.poses(q, placements)
        return np.asarray(base.homogeneous @ F @ (tip * tool).homogeneous)

    def tip_poses(self, q: Floats, theta: Floats) -> Floats:
        """Poses of the corrected tip in the base link, shape (N, 4, 4)."""
        _, placements, tip, _ = self._placed(self.corrections(theta))
        return np.asarray(self.chain.poses(q, placements) @ tip.homogeneous)

    def jacobian(self, q: Floats, theta: Floats) -> tuple[Floats, Floats]:
        """Tool poses and their derivative.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            theta: Parameter values, shape (P,).

        Returns:
            Poses, shape (N, 4, 4), and body twists of the tool per parameter, shape
            (N, 6, P), rows (linear, angular).
        """
        base, placements, tip, tool = self._placed(self.corrections(theta))
        F, R = self.chain.regressor(q, placements)
        end = (tip * tool).homogeneous
        count = len(self.chain.joints)
        place = np.array([screw.place for screw in self.screws])
        columns = self._columns(theta)

        joints = (place >= 1) & (place <= count)
        B = np.zeros((6 * count, int(joints.sum())))
        for k, (where, column) in enumerate(
            zip(place[joints], columns.T[joints], strict=True)
        ):
            B[6 * (where - 1) : 6 * where, k] = column
        J = np.empty((len(q), 6, len(self.screws)))
        # One product with all rows; then from the tip to the tool.
        twists = (R.reshape(-1, 6 * count) @ B).reshape(len(q), 6, -1)
        J[:, :, joints] = adjoint(invert(end)) @ twists
        J[:, :, place == 0] = adjoint(invert(F @ end)) @ columns[:, place == 0]
        to_tool = adjoint(invert(tool.homogeneous))
        J[:, :, place == count + 1] = to_tool @ columns[:, place == count + 1]
        J[:, :, place == count + 2] = columns[:, place == count + 2]
        return np.asarray(base.homogeneous @ F @ end), J

    def _columns(self, theta: Floats) -> Floats:
        """Body twist at its own place per parameter, shape (6, P).

        The screws behind it in the product carry a twist along by their adjoint.
        """
        columns = np.empty((6, len(self.screws)))
        behind = [pin.SE3.Identity() for _ in range(self.places)]
        for k in reversed(range(len(self.screws))):
            screw = self.screws[k]
            after = behind[screw.place]
            columns[:, k] = after.toActionMatrixInverse() @ screw.twist
            if theta[k] != 0.0:
                behind[screw.place] = pin.exp6(screw.twist * theta[k]) * after
        return columns

    def _placed(
        self, corrections: Sequence[pin.SE3]
    ) -> tuple[pin.SE3, list[pin.SE3], pin.SE3, pin.SE3]:
        placements = [
            nominal * correction
            for nominal, correction in zip(
                self.chain.placements, corrections[1:-2], strict=True
            )
        ]
        base, tool = self.base * corrections[0], self.tool * corrections[-1]
        return base, placements, corrections[-2], tool
