"""The error model: a chain, its error parameters, and the two frames at its ends.

    T(q, theta) = B(theta) F(q + dq(q, theta), theta) E(theta) X(theta)

B is the base link in the measurement frame, F the chain with corrected placements, E an
error of the tip, and X the tool in the tip frame. Every parameter is a unit screw in
one of these frames. A joint correction `dq_j = sum_p theta_p phi_p(q)` is a screw along
the motion of joint j, multiplied by basis functions phi_p of the commanded q. Other
screws with basis functions bend their place row by row, see `bending`; see
`linearization` for the derivatives.

A learned correction, if there is one, moves the joints (adds to dq) or the tool (is
multiplied from the right), and shifts the parameters. Far from its training
configurations the pose goes back to that of the parameters alone.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Literal, Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.errors import OptionError
from calib_pin.kinematics.chain import Chain, Placement, matrix
from calib_pin.kinematics.spatial import (
    Floats,
    interpolate,
    interpolated_twists,
    se3_exp,
)
from calib_pin.observations.conditions import UNSTATED, Conditions
from calib_pin.observations.labels import Labels
from calib_pin.parameterizations import (
    BasisFunctions,
    Screw,
    frame_screws,
    parameterization,
)
from calib_pin.parameterizations.bending import Bends, carried, joined
from calib_pin.parameterizations.linearization import (
    Fading,
    PoseLinearization,
    ordered_screws,
)
from calib_pin.parameters import ParameterSet
from calib_pin.setup import Setup


class Learned(Protocol):
    """A learned correction, which has no error parameters."""

    @property
    def space(self) -> Literal["joint", "tip"]:
        """Space of the correction: joint positions, or a body twist of the tool."""
        ...

    @property
    def shift(self) -> Floats:
        """Change of the parameters that belongs to it, shape (P,).

        A fit without the correction is biased by what the correction explains.
        """
        ...

    def weight(self, q: Floats) -> Floats:
        """Weight from 1 near training configurations to 0 far away, shape (N,)."""
        ...

    def __call__(self, q: Floats) -> Floats:
        """Corrections of commanded joint positions, (N, n) -> (N, n) or (N, 6)."""
        ...


@dataclass(frozen=True)
class ErrorModel:
    """A chain with error parameters.

    Attributes:
        chain: The nominal chain with n joints.
        screws: The P screws, frame by frame from base to tool. Where mimic joints
            follow a leader several screws have one parameter; its value then stands in
            theta once for each of them, and its derivative is the sum of theirs.
        base: Reference pose of the base link in the measurement frame.
        tool: Reference pose of the tool in the tip frame.
        learned: Learned correction beside the parameters, None for none.
        payload: Payload where measurements name none.

    Examples:
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
            setup: Statements about the robot that these need, such as the payload.
            estimate_base: Whether the base frame is free.
            estimate_tool: Whether the tool frame is free.

        Raises:
            OptionError: If a name is unknown, two members define one parameter, or a
                parameterization does not suit the chain.
        """
        robot: list[Screw] = []
        for name in parameterizations:
            defined = {screw.parameter.name for screw in robot}
            new = parameterization(name, setup).screws(chain)
            for screw in new:
                if screw.parameter.name in defined:
                    raise OptionError(
                        f"parameter '{screw.parameter.name}' is defined twice"
                    )
            robot += new
        count = len(chain.joints)
        screws = [
            *frame_screws("base", 0, free=estimate_base),
            # A stable sort: within a frame the order of each member stands.
            *sorted(robot, key=lambda screw: screw.frame),
            *frame_screws("tool", count + 2, free=estimate_tool),
        ]
        identity = pin.SE3.Identity()
        model = ErrorModel(chain, tuple(screws), identity, identity)
        _ = model.parameters  # Checks that no name has two meanings.
        return model

    def with_frames(self, base: pin.SE3, tool: pin.SE3) -> ErrorModel:
        """The model rebased at other reference poses of base and tool."""
        return replace(self, base=base, tool=tool)

    def carrying(self, payload: str) -> ErrorModel:
        """The model with a payload where measurements name none."""
        return replace(self, payload=payload)

    @cached_property
    def parameters(self) -> ParameterSet:
        """The parameter of each screw; one of mimic joints stands at each of them."""
        return ParameterSet(tuple(screw.parameter for screw in self.screws))

    @property
    def _frames(self) -> int:
        """Number of frames: base, n joints, tip, tool."""
        return len(self.chain.joints) + 3

    @cached_property
    def joint_corrections(self) -> NDArray[np.intp]:
        """Positions of the parameters that correct a joint's own motion, shape (J,)."""
        return self._varying[self._along]

    @property
    def geometric(self) -> bool:
        """Whether all errors are geometric, so that a URDF can hold them."""
        return self.learned is None and len(beyond_urdf(self)) == 0

    @cached_property
    def _varying(self) -> NDArray[np.intp]:
        index = [k for k, s in enumerate(self.screws) if s.basis is not None]
        return np.array(index, np.intp)

    @cached_property
    def _along(self) -> NDArray[np.bool_]:
        """Of parameters with a basis function, whether they move a joint, (C,)."""
        motions = [np.zeros(6), *self.chain.motions, np.zeros(6), np.zeros(6)]
        screws = [self.screws[k] for k in self._varying]
        return np.array(
            [np.array_equal(s.twist, motions[s.frame]) for s in screws], bool
        )

    def basis(self, q: Floats, conditions: Conditions = UNSTATED) -> Floats:
        """Basis functions that multiply the screws that vary, shape (N, C).

        Args:
            q: Commanded joint positions, shape (N, n) [rad, m].
            conditions: What holds at each configuration; by default nothing is
                stated, and the only payload that there is is carried.

        Raises:
            InputError: If there are several payloads, or none of that name.
        """
        values: dict[BasisFunctions, Floats] = {}
        if self.payload and not any(conditions.payload.distinct):
            carried = Labels.all(self.payload, len(q))
            conditions = replace(conditions, payload=carried)
        # Function by function, as they are computed and as kernels take them.
        result = np.empty((len(self._varying), len(q)))
        for k, position in enumerate(self._varying):
            function = self.screws[position].basis
            assert function is not None
            if function.functions not in values:
                values[function.functions] = function.functions(q, conditions)
            result[k] = values[function.functions][:, function.column]
        return result.T

    def joint_positions(self, q: Floats, theta: Floats) -> Floats:
        """Actual joint positions, `q + dq`.

        Args:
            q: Commanded joint positions, shape (N, n) [rad, m].
            theta: Parameter values, shape (P,).
        """
        return self._corrected(q, self._shifted(theta), self.basis(q))

    def corrections(self, theta: Floats) -> list[pin.SE3]:
        """Product of the screws of every frame, `Exp(S_1 t_1) Exp(S_2 t_2) ...`."""
        result = [pin.SE3.Identity() for _ in range(self._frames)]
        for screw, amount in zip(self.screws, theta, strict=True):
            if amount != 0.0 and screw.basis is None:
                result[screw.frame] *= pin.exp6(screw.twist * amount)
        return result

    def poses(self, q: Floats, theta: Floats, basis: Floats | None = None) -> Floats:
        """Tool poses in the measurement frame.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            theta: Parameter values, shape (P,).
            basis: Basis functions at q, where they are known already.

        Returns:
            Poses, shape (N, 4, 4).
        """
        basis = self.basis(q) if basis is None else basis
        shifted = self._shifted(theta)
        bends = self._bends(shifted, basis)
        base, placements, tip, tool = self._placed(self.corrections(shifted), bends)
        F = self.chain.poses(self._corrected(q, shifted, basis), placements)
        T = matrix(base) @ F @ matrix(joined(tip, tool))
        if self.learned is None:
            return np.asarray(T)
        if self.learned.space == "tip":
            T = T @ se3_exp(self.learned(q))
        weight = self.learned.weight(q)
        if (weight == 1.0).all():
            return np.asarray(T)
        return interpolate(
            replace(self, learned=None).poses(q, theta, basis), T, weight
        )

    def tip_poses(
        self, q: Floats, theta: Floats, conditions: Conditions = UNSTATED
    ) -> Floats:
        """Poses of the corrected tip in the base link, shape (N, 4, 4).

        A learned motion of the tool is left out: it stands behind the tool.
        Arguments as for `basis` and `poses`.
        """
        theta = self._shifted(theta)
        basis = self.basis(q, conditions)
        bends = self._bends(theta, basis)
        _, placements, tip, _ = self._placed(self.corrections(theta), bends)
        moved = self._corrected(q, theta, basis)
        return np.asarray(self.chain.poses(moved, placements) @ matrix(tip))

    def linearize(
        self, q: Floats, theta: Floats, basis: Floats | None = None
    ) -> PoseLinearization:
        """Tool poses with the derivatives of functions of them.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            theta: Parameter values, shape (P,).
            basis: Basis functions at q, where they are known already.
        """
        basis = self.basis(q) if basis is None else basis
        if self.learned is None or (self.learned.weight(q) == 1.0).all():
            return self._linearize_whole(q, theta, basis)
        # The weight belongs to the commands, which no parameter changes.
        weight = self.learned.weight(q)
        plain = replace(self, learned=None).linearize(q, theta, basis)
        whole = self._linearize_whole(q, theta, basis)
        twists = interpolated_twists(plain.T, whole.T, weight)
        T = self.poses(q, theta, basis)
        return replace(plain, T=T, fading=Fading(*twists, whole))

    def _linearize_whole(
        self, q: Floats, theta: Floats, basis: Floats
    ) -> PoseLinearization:
        """The same where the learned correction counts fully."""
        theta = self._shifted(theta)
        columns, corrections = ordered_screws(self.screws, theta, self._frames)
        bends = self._bends(theta, basis)
        base, placements, tip, tool = self._placed(corrections, bends)
        F, R = self.chain.regressor(self._corrected(q, theta, basis), placements)
        to_tip = matrix(joined(tip, tool))
        to_base = F @ to_tip
        T, motion = matrix(base) @ to_base, None
        if self.learned is not None and self.learned.space == "tip":
            motion = se3_exp(self.learned(q))
            T = T @ motion
        return PoseLinearization(
            T=T,
            regressor=R,
            to_base=to_base,
            to_tip=to_tip,
            to_tool=matrix(tool),
            columns=columns,
            frames=tuple(screw.frame for screw in self.screws),
            axes=self.chain.motions,
            varying=self._varying,
            basis=basis,
            bends=bends,
            learned=motion,
        )

    def kinematics(
        self, q: Floats, theta: Floats, conditions: Conditions = UNSTATED
    ) -> tuple[Floats, Floats]:
        """Tool poses and their derivative by the joint positions.

        The derivatives of joint corrections and of a fading correction are neglected.

        Args:
            q: Commanded joint positions, shape (N, n) [rad, m].
            theta: Parameter values, shape (P,).
            conditions: As for `basis`.

        Returns:
            Poses, shape (N, 4, 4), and body twists of the tool, shape (N, 6, n).
        """
        if self.learned is not None:
            linear = self.linearize(q, theta, self.basis(q, conditions))
            return linear.T, linear.joint_twists()
        moved, bends = q, Bends()
        if theta[self._varying].any():
            basis = self.basis(q, conditions)
            moved, bends = self._corrected(q, theta, basis), self._bends(theta, basis)
        base, placements, tip, tool = self._placed(self.corrections(theta), bends)
        F, J = self.chain.jacobian(moved, placements)
        to_tool = joined(tip, tool)
        return matrix(base) @ F @ matrix(to_tool), carried(to_tool, J)

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
        """Parameter values with the shift that belongs to the learned correction."""
        return theta if self.learned is None else theta + self.learned.shift

    def _corrected(self, q: Floats, theta: Floats, basis: Floats) -> Floats:
        """Joint positions with all corrections; q itself where there are none."""
        amounts = theta[self.joint_corrections]
        result = q
        if amounts.any():
            joints = [self.screws[k].frame - 1 for k in self.joint_corrections]
            functions = basis if self._along.all() else basis[:, self._along]
            result = result + (functions * amounts) @ np.eye(q.shape[1])[joints]
        if self.learned is not None and self.learned.space == "joint":
            result = result + self.learned(q)
        return result

    def _bends(self, theta: Floats, basis: Floats) -> Bends:
        """How the places are bent, by basis functions of shape (N, C)."""
        amounts = theta[flexures(self)]
        return Bends.of(self.screws, flexures(self), amounts, basis[:, ~self._along])

    def _placed(
        self, corrections: Sequence[pin.SE3], bends: Bends
    ) -> tuple[Placement, list[Placement], Placement, Placement]:
        """Base, joints, tip and tool, each with its errors."""
        base, *links, tip, tool = corrections
        bent, last = bends.bent, self._frames - 1
        placements = [
            bent(frame, nominal * link)
            for frame, (nominal, link) in enumerate(
                zip(self.chain.placements, links, strict=True), start=1
            )
        ]
        ends = bent(0, self.base * base), bent(last, self.tool * tool)
        return ends[0], placements, bent(last - 1, tip), ends[1]


def varying(model: ErrorModel) -> NDArray[np.intp]:
    """Positions of the parameters with a basis function, shape (C,)."""
    return model._varying


def flexures(model: ErrorModel) -> NDArray[np.intp]:
    """Those of them that bend the place where they stand."""
    return model._varying[~model._along]


def beyond_urdf(model: ErrorModel) -> NDArray[np.intp]:
    """Those of them that are errors of the robot, which a URDF cannot hold."""
    return model._varying[~model.parameters.nuisance[model._varying]]
