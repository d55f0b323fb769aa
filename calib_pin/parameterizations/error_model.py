"""The error model: a chain, its error parameters, and the two frames at its ends.

    T(q, theta) = B(theta) F(q + dq(q, theta), theta) E(theta) X(theta)

B is the base link in the measuring frame, F the chain with corrected placements, E an
error of the tip, and X the tool in the tip frame. Every parameter is a unit screw at
one place, so with the regressor R of the places the Jacobian is

    dT/dtheta = R(q) B(theta)

where `B` does not depend on q. A joint correction `dq_j = sum_p theta_p phi_p(q)` is a
screw along the motion of joint j as well; its column is multiplied by phi_p(q), q as
it is commanded. `PoseLinearization` holds these factors.

What has been learned beside the parameters, if anything, moves the joints (adds to dq)
or the tool (is multiplied from the right), and shifts the parameters. Far from where it
was learned the pose goes back to that of the parameters alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, NamedTuple, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import (
    Floats,
    adjoint,
    interpolate,
    interpolated_twists,
    invert,
    se3_exp,
)
from calib_pin.parameterizations import (
    JointFunctions,
    Screw,
    frame_screws,
    parameterization,
)
from calib_pin.parameters import ParameterSet
from calib_pin.setup import Setup

__all__ = ["ErrorModel", "Learned", "PoseLinearization", "ordered_screws"]


class Learned(Protocol):
    """A correction that was learned and has no error parameters."""

    @property
    def space(self) -> Literal["joint", "tip"]:
        """What it moves: the joint positions, or the tool by a body twist."""
        ...

    @property
    def shift(self) -> Floats:
        """Change of the parameters that belongs to it, shape (P,).

        A fit without the correction is biased by what the correction explains.
        """
        ...

    def weight(self, q: Floats) -> Floats:
        """How far it counts, from 1 where it was learned to 0 far away, shape (N,)."""
        ...

    def __call__(self, q: Floats) -> Floats:
        """Corrections of commanded joint positions, (N, n) -> (N, n) or (N, 6)."""
        ...


@dataclass(frozen=True)
class PoseLinearization:
    """Tool poses of N configurations and their dependence on P parameters.

    Attributes:
        T: Tool poses in the measuring frame, shape (N, 4, 4).
        regressor: Body twist of the tip per placement twist, shape (N, 6, 6 n).
        to_base: Tool poses in the base link, before the tool is moved by what was
            learned, shape (N, 4, 4).
        to_tip: Tool pose in the tip of the chain, shape (4, 4).
        to_tool: Tool pose in the corrected tip, shape (4, 4).
        columns: Body twist at its own place per parameter, shape (6, P).
        places: Place of each parameter, ascending.
        axes: Unit twists of the joints' own motions, shape (n, 6).
        corrections: Positions of the parameters that are joint corrections, shape (C,).
        factors: What the screws of these are multiplied by, shape (N, C).
        learned: Motion of the tool that was learned, shape (N, 4, 4), None for none.
        fading: The rest of poses at which what was learned fades, None for none.
    """

    T: Floats
    regressor: Floats
    to_base: Floats
    to_tip: Floats
    to_tool: Floats
    columns: Floats
    places: tuple[int, ...]
    axes: Floats
    corrections: NDArray[np.intp]
    factors: Floats
    learned: Floats | None = None
    fading: Fading | None = None

    def joint_twists(self) -> Floats:
        """Body twists of the tool by the joint positions, shape (N, 6, n)."""
        if self.fading is not None:
            of_plain, of_whole, whole = self.fading
            plain = replace(self, fading=None).joint_twists()
            return np.asarray(of_plain @ plain + of_whole @ whole.joint_twists())
        blocks = self.regressor.reshape(len(self.T), 6, -1, 6)
        at_tip = np.einsum("nakb,kb->nak", blocks, self.axes)
        behind = self.to_tip if self.learned is None else self.to_tip @ self.learned
        return np.asarray(adjoint(invert(behind)) @ at_tip)

    def derivative(self, J_pose: Floats) -> Floats:
        """Derivative by the parameters of something that depends on the tool pose.

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
            self.places, [0, width // 6, width // 6 + 1], side="right"
        )
        result = np.empty((rows, size, len(self.places)))
        at_base = J_pose @ adjoint(invert(self.to_base))
        result[:, :, :base] = at_base @ self.columns[:, :base]
        # The parameters of the joints: one block of six rows for each place.
        B = np.zeros((width, joints - base))
        for k in range(base, joints):
            row = 6 * (self.places[k] - 1)
            B[row : row + 6, k - base] = self.columns[:, k]
        at_joints = J_pose @ adjoint(invert(self.to_tip)) @ self.regressor
        of_joints = at_joints.reshape(-1, width) @ B
        result[:, :, base:joints] = of_joints.reshape(rows, size, -1)
        at_tip = J_pose @ adjoint(invert(self.to_tool))
        result[:, :, joints:tip] = at_tip @ self.columns[:, joints:tip]
        result[:, :, tip:] = J_pose @ self.columns[:, tip:]
        result[:, :, self.corrections] *= self.factors[:, None, :]
        return result


class Fading(NamedTuple):
    """A pose between that of the parameters and that with what was learned.

    Attributes:
        of_plain: Its body twist by that of the former, shape (N, 6, 6).
        of_whole: The same by that of the latter.
        whole: Linearization with all that was learned; the one that holds this has
            none of it.
    """

    of_plain: Floats
    of_whole: Floats
    whole: PoseLinearization


@dataclass(frozen=True)
class ErrorModel:
    """A chain with error parameters.

    Attributes:
        chain: The nominal chain with n joints.
        screws: One screw per parameter, place by place from base to tool.
        base: Reference pose of the base link in the measuring frame.
        tool: Reference pose of the tool in the tip frame.
        learned: What was learned beside the parameters.
        payload: Name of what the robot carries where rows do not say.

    Example:
        >>> import numpy as np, calib_pin
        >>> from calib_pin.parameterizations.error_model import ErrorModel
        >>> model = ErrorModel.create(calib_pin.load_chain("space6"), ["placement"])
        >>> T, J = model.jacobian(np.zeros((2, 6)), np.zeros(len(model.parameters)))
        >>> T.shape, J.shape
        ((2, 4, 4), (2, 6, 48))
    """

    chain: Chain
    screws: tuple[Screw, ...]
    base: pin.SE3
    tool: pin.SE3
    learned: Learned | None = None
    payload: str = ""

    @staticmethod
    def create(
        chain: Chain,
        parameterizations: Sequence[str],
        *,
        setup: Setup | None = None,
        estimate_base: bool = True,
        estimate_tool: bool = True,
    ) -> ErrorModel:
        """Combine parameterizations and the two frames.

        Args:
            chain: The chain.
            parameterizations: Names of parameterizations.
            setup: What these need to know beside the chain, such as the payload.
            estimate_base: Whether the base frame is free.
            estimate_tool: Whether the tool frame is free.

        Raises:
            OptionError: If a name is unknown, two members define one parameter, or a
                parameterization does not suit the chain.
        """
        robot = [
            s
            for name in parameterizations
            for s in parameterization(name, setup).screws(chain)
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

    def with_learned(self, learned: Learned | None) -> ErrorModel:
        """The same model with another learned correction, or without one."""
        return replace(self, learned=learned)

    def carrying(self, payload: str) -> ErrorModel:
        """The same model with what the robot carries where rows do not say."""
        return replace(self, payload=payload)

    @cached_property
    def parameters(self) -> ParameterSet:
        """The parameters, in the order of the screws."""
        return ParameterSet(tuple(screw.parameter for screw in self.screws))

    @property
    def places(self) -> int:
        """Number of places: base, n joints, tip, tool."""
        return len(self.chain.joints) + 3

    @cached_property
    def joint_corrections(self) -> NDArray[np.intp]:
        """Positions of the parameters that are joint corrections, shape (C,)."""
        found = [k for k, s in enumerate(self.screws) if s.factor is not None]
        return np.array(found, np.intp)

    @property
    def geometric(self) -> bool:
        """Whether there is nothing but geometry, which a URDF can hold."""
        return self.learned is None and len(self.joint_corrections) == 0

    def factors(self, q: Floats, payload: Sequence[str] = ()) -> Floats:
        """What the screws of joint corrections are multiplied by, shape (N, C).

        Args:
            q: Commanded joint positions, shape (N, n) [rad, m].
            payload: Name of what the robot carries in each row; default the only
                payload that there is.

        Raises:
            InputError: If there are several payloads, or none of that name.
        """
        values: dict[JointFunctions, Floats] = {}
        if self.payload and not any(payload):
            payload = (self.payload,) * len(q)
        result = np.empty((len(q), len(self.joint_corrections)))
        for k, position in enumerate(self.joint_corrections):
            factor = self.screws[position].factor
            assert factor is not None
            if factor.functions not in values:
                values[factor.functions] = factor.functions(q, payload)
            result[:, k] = values[factor.functions][:, factor.column]
        return result

    def joint_positions(self, q: Floats, theta: Floats) -> Floats:
        """Where the joints really are, `q + dq`.

        Args:
            q: Commanded joint positions, shape (N, n) [rad, m].
            theta: Parameter values, shape (P,).
        """
        return self._moved(q, self._shifted(theta), self.factors(q))

    def corrections(self, theta: Floats) -> list[pin.SE3]:
        """Product of the screws at every place, `Exp(S_1 t_1) Exp(S_2 t_2) ...`."""
        result = [pin.SE3.Identity() for _ in range(self.places)]
        for screw, amount in zip(self.screws, theta, strict=True):
            if amount != 0.0 and screw.factor is None:
                result[screw.place] *= pin.exp6(screw.twist * amount)
        return result

    def poses(self, q: Floats, theta: Floats, factors: Floats | None = None) -> Floats:
        """Tool poses in the measuring frame.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            theta: Parameter values, shape (P,).
            factors: Those at q, where they are known already.

        Returns:
            Poses, shape (N, 4, 4).
        """
        factors = self.factors(q) if factors is None else factors
        shifted = self._shifted(theta)
        base, placements, tip, tool = self._placed(self.corrections(shifted))
        F = self.chain.poses(self._moved(q, shifted, factors), placements)
        T = base.homogeneous @ F @ (tip * tool).homogeneous
        if self.learned is None:
            return np.asarray(T)
        if self.learned.space == "tip":
            T = T @ se3_exp(self.learned(q))
        weight = self.learned.weight(q)
        if (weight == 1.0).all():
            return np.asarray(T)
        return interpolate(self.with_learned(None).poses(q, theta, factors), T, weight)

    def tip_poses(
        self, q: Floats, theta: Floats, payload: Sequence[str] = ()
    ) -> Floats:
        """Poses of the corrected tip in the base link, shape (N, 4, 4).

        A motion of the tool that was learned is left out: it stands behind the tool.
        Arguments as for `factors` and `poses`.
        """
        theta = self._shifted(theta)
        _, placements, tip, _ = self._placed(self.corrections(theta))
        moved = self._moved(q, theta, self.factors(q, payload))
        return np.asarray(self.chain.poses(moved, placements) @ tip.homogeneous)

    def linearize(
        self, q: Floats, theta: Floats, factors: Floats | None = None
    ) -> PoseLinearization:
        """Tool poses and what is needed for derivatives of functions of them.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            theta: Parameter values, shape (P,).
            factors: Those at q, where they are known already.
        """
        factors = self.factors(q) if factors is None else factors
        if self.learned is None or (self.learned.weight(q) == 1.0).all():
            return self._linearize_whole(q, theta, factors)
        # The weight belongs to the commands, which no parameter changes.
        weight = self.learned.weight(q)
        plain = self.with_learned(None).linearize(q, theta, factors)
        whole = self._linearize_whole(q, theta, factors)
        twists = interpolated_twists(plain.T, whole.T, weight)
        T = self.poses(q, theta, factors)
        return replace(plain, T=T, fading=Fading(*twists, whole))

    def _linearize_whole(
        self, q: Floats, theta: Floats, factors: Floats
    ) -> PoseLinearization:
        """The same where what was learned counts fully."""
        theta = self._shifted(theta)
        columns, corrections = ordered_screws(self.screws, theta, self.places)
        base, placements, tip, tool = self._placed(corrections)
        F, R = self.chain.regressor(self._moved(q, theta, factors), placements)
        to_tip = (tip * tool).homogeneous
        to_base = F @ to_tip
        T, motion = base.homogeneous @ to_base, None
        if self.learned is not None and self.learned.space == "tip":
            motion = se3_exp(self.learned(q))
            T = T @ motion
        return PoseLinearization(
            T=T,
            regressor=R,
            to_base=to_base,
            to_tip=to_tip,
            to_tool=tool.homogeneous,
            columns=columns,
            places=tuple(screw.place for screw in self.screws),
            axes=self.chain.motions,
            corrections=self.joint_corrections,
            factors=factors,
            learned=motion,
        )

    def kinematics(
        self, q: Floats, theta: Floats, payload: Sequence[str] = ()
    ) -> tuple[Floats, Floats]:
        """Tool poses and their derivative by the joint positions.

        That of the corrections of joint positions by these is neglected, and so is the
        change of what fades.

        Args:
            q: Commanded joint positions, shape (N, n) [rad, m].
            theta: Parameter values, shape (P,).
            payload: As for `factors`.

        Returns:
            Poses, shape (N, 4, 4), and body twists of the tool, shape (N, 6, n).
        """
        if self.learned is not None:
            linear = self.linearize(q, theta, self.factors(q, payload))
            return linear.T, linear.joint_twists()
        base, placements, tip, tool = self._placed(self.corrections(theta))
        moved = q
        if theta[self.joint_corrections].any():
            moved = self._moved(q, theta, self.factors(q, payload))
        F, J = self.chain.jacobian(moved, placements)
        to_tool = tip * tool
        T = base.homogeneous @ F @ to_tool.homogeneous
        return T, np.asarray(to_tool.toActionMatrixInverse() @ J)

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

    def _shifted(self, theta: Floats) -> Floats:
        """Parameter values with the change that belongs to what was learned."""
        return theta if self.learned is None else theta + self.learned.shift

    def _moved(self, q: Floats, theta: Floats, factors: Floats) -> Floats:
        """Joint positions with all corrections; q itself where there are none."""
        amounts = theta[self.joint_corrections]
        moved = q
        if amounts.any():
            joints = [self.screws[k].place - 1 for k in self.joint_corrections]
            moved = moved + (factors * amounts) @ np.eye(q.shape[1])[joints]
        if self.learned is not None and self.learned.space == "joint":
            moved = moved + self.learned(q)
        return moved

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
        # A joint's own motion comes behind all screws of its place.
        if after is not None and screw.factor is None:
            columns[:, k] = after.toActionMatrixInverse() @ screw.twist
        if amount != 0.0 and screw.factor is None:
            motion = pin.exp6(screw.twist * amount)
            behind[screw.place] = motion if after is None else motion * after
    identity = pin.SE3.Identity()
    return columns, [identity if b is None else b for b in behind]
