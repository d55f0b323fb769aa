"""The error model: a chain, its error parameters, and the two frames at its ends.

    T(q, theta) = B(theta) F(q, theta) E(theta) X(theta)

B is the base link in the measuring frame, F the chain with corrected placements, E an
error of the tip, and X the tool in the tip frame. Every parameter is a unit screw at
one place, so with the regressor R of the places the Jacobian is

    dT/dtheta = R(q) B(theta)

where `B` does not depend on q. `PoseLinearization` holds the two factors.
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

__all__ = ["ErrorModel", "PoseLinearization", "ordered_screws"]


@dataclass(frozen=True)
class PoseLinearization:
    """Tool poses of N configurations and their dependence on P parameters.

    Attributes:
        T: Tool poses in the measuring frame, shape (N, 4, 4).
        regressor: Body twist of the tip per placement twist, shape (N, 6, 6 n).
        to_base: Tool poses in the base link, shape (N, 4, 4).
        to_tip: Tool pose in the tip of the chain, shape (4, 4).
        to_tool: Tool pose in the corrected tip, shape (4, 4).
        columns: Body twist at its own place per parameter, shape (6, P).
        places: Place of each parameter, ascending.
    """

    T: Floats
    regressor: Floats
    to_base: Floats
    to_tip: Floats
    to_tool: Floats
    columns: Floats
    places: tuple[int, ...]

    def derivative(self, by_twist: Floats) -> Floats:
        """Derivative by the parameters of something that depends on the tool pose.

        The few rows per configuration go through the chain from the left; the twists
        themselves, twice as large for a position, are never formed.

        Args:
            by_twist: Its derivative by the tool's body twist, shape (N, d, 6).

        Returns:
            Derivative, shape (N, d, P).
        """
        rows, size = by_twist.shape[:2]
        width = self.regressor.shape[2]
        base, joints, tip = np.searchsorted(
            self.places, [0, width // 6, width // 6 + 1], side="right"
        )
        result = np.empty((rows, size, len(self.places)))
        at_base = by_twist @ adjoint(invert(self.to_base))
        result[:, :, :base] = at_base @ self.columns[:, :base]
        # The parameters of the joints: one block of six rows for each place.
        B = np.zeros((width, joints - base))
        for k in range(base, joints):
            row = 6 * (self.places[k] - 1)
            B[row : row + 6, k - base] = self.columns[:, k]
        at_joints = by_twist @ adjoint(invert(self.to_tip)) @ self.regressor
        of_joints = at_joints.reshape(-1, width) @ B
        result[:, :, base:joints] = of_joints.reshape(rows, size, -1)
        at_tip = by_twist @ adjoint(invert(self.to_tool))
        result[:, :, joints:tip] = at_tip @ self.columns[:, joints:tip]
        result[:, :, tip:] = by_twist @ self.columns[:, tip:]
        return result


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
        model = ErrorModel(chain, tuple(screws), identity, identity)
        _ = model.parameters  # Checks that no name stands twice.
        return model

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

    def linearize(self, q: Floats, theta: Floats) -> PoseLinearization:
        """Tool poses and what is needed for derivatives of functions of them.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            theta: Parameter values, shape (P,).
        """
        columns, corrections = ordered_screws(self.screws, theta, self.places)
        base, placements, tip, tool = self._placed(corrections)
        F, R = self.chain.regressor(q, placements)
        to_tip = (tip * tool).homogeneous
        to_base = F @ to_tip
        return PoseLinearization(
            T=base.homogeneous @ to_base,
            regressor=R,
            to_base=to_base,
            to_tip=to_tip,
            to_tool=tool.homogeneous,
            columns=columns,
            places=tuple(screw.place for screw in self.screws),
        )

    def jacobian(self, q: Floats, theta: Floats) -> tuple[Floats, Floats]:
        """Tool poses and their derivative.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            theta: Parameter values, shape (P,).

        Returns:
            Poses, shape (N, 4, 4), and body twists of the tool per parameter, shape
            (N, 6, P), rows (linear, angular).
        """
        linear = self.linearize(q, theta)
        return linear.T, linear.derivative(np.tile(np.eye(6), (len(q), 1, 1)))

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


def ordered_screws(
    screws: Sequence[Screw], theta: Floats, places: int
) -> tuple[Floats, list[pin.SE3]]:
    """Body twist at the end of its own place per parameter, and the places' products.

    The screws behind it in the product carry a twist along by their adjoint.

    Args:
        screws: One screw per parameter, in the order they apply within a place.
        theta: Parameter values, shape (P,).
        places: Number of places.

    Returns:
        Twists, shape (6, P), and the product `Exp(S_1 t_1) Exp(S_2 t_2) ...` of every
        place.
    """
    columns = np.empty((6, len(screws)))
    behind: list[pin.SE3 | None] = [None] * places
    for k in reversed(range(len(screws))):
        screw, amount = screws[k], theta[k]
        after = behind[screw.place]
        columns[:, k] = screw.twist
        if after is not None:
            columns[:, k] = after.toActionMatrixInverse() @ screw.twist
        if amount != 0.0:
            motion = pin.exp6(screw.twist * amount)
            behind[screw.place] = motion if after is None else motion * after
    identity = pin.SE3.Identity()
    return columns, [identity if b is None else b for b in behind]
