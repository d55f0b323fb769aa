"""A kinematic chain of a URDF robot, from a base frame to a tip frame.

The two frames may stand anywhere in the tree. Joints on the way from the base up to
the common ancestor are traversed from child to parent; the regressor takes care of
their sign:
with `T_base_tip = T_root_base^-1 T_root_tip` the body twist of the tip is

    R_tip xi - Ad(T_base_tip^-1) R_base xi

where R are Pinocchio's kinematic regressors (LOCAL) for right-multiplied placement
errors `M_j Exp(xi_j)`. Joints above the common ancestor cancel and are locked.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from functools import cached_property
from typing import TypeAlias

import numpy as np
import pinocchio as pin

from calib_pin.errors import RobotError, counted
from calib_pin.kinematics.joint_space import JointSpace
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.spatial import Floats, adjoint, invert, so3_exp, times
from calib_pin.kinematics.threads import PerThread, workspace
from calib_pin.kinematics.tree import LINK, Configurations, link_frame, reduced, support
from calib_pin.setup import Payload
from calib_pin.setup.arguments import as_array, checked
from calib_pin.setup.values import LARGEST_LENGTH

Placement: TypeAlias = "pin.SE3 | Floats"
"""Placement of a joint: one, or one of each configuration, shape (N, 4, 4)."""

Sweep: TypeAlias = Callable[[Floats, Sequence[Placement]], tuple[Floats, ...]]
"""Computes arrays of N configurations, shape (N, n), with joints at placements."""

RECENT, REMEMBERED = 4, 2**14
"""Sweeps whose results are kept, and most joint positions of one that are."""


def matrix(pose: Placement) -> Floats:
    """A pose as a matrix, shape (4, 4), or those of each configuration, (N, 4, 4)."""
    return np.asarray(pose.homogeneous if isinstance(pose, pin.SE3) else pose)


class Chain:
    """Kinematics from `base` to `tip` on Pinocchio.

    Args:
        robot: The robot.
        base: Link the chain starts at; default the root link.
        tip: Link the chain ends at; default the only leaf.

    Attributes:
        joints: Names of the n moving joints, from base to tip; none from a link to
            itself, which stands still.
        mimics: The mimic joints among them; a leader need not be.
        revolute: True for revolute and continuous joints, shape (n,).
        reversed: True for joints traversed from child to parent, shape (n,).
        lower: Lower position limits, shape (n,) [rad, m], see `JointSpace`.
        upper: Upper position limits, shape (n,) [rad, m].
        inverted: Names of joints with inverted limits in the URDF; they count as none.
        axes: Unit axes in the joint frames, shape (n, 3).
        placements: Nominal joint placements in the frame of the chain's joint before
            them in the tree, else in the root link at zero joint positions, n SE3.
        tip_placement: Tip in the frame of its own moving joint, SE3.
        ends: Base and tip, each in the frame of the chain's joint that carries it, else
            in the root link at zero joint positions, two SE3.
        tip_joint: Fixed joint that carries the tip, if the chain ends with one; the
            URDF can hold an error of the tip there.

    Raises:
        RobotError: If a frame is unknown, the tip is ambiguous, there is no moving
            joint between two links, or one with several degrees of freedom; if one end
            is farther from the other than any robot reaches.

    Examples:
        >>> import calib_pin
        >>> chain = calib_pin.load_chain("space6")
        >>> len(chain.joints)
        6
    """

    @checked
    def __init__(
        self, robot: Robot, base: str | None = None, tip: str | None = None
    ) -> None:
        """Find the path and build the reduced Pinocchio model."""
        self.robot = robot
        self.base = robot.link(robot.root if base is None else base, "base")
        self.tip = robot.link(robot.only_tip(self.base) if tip is None else tip, "tip")

        full = robot.model
        up = support(full, self.base)
        down = support(full, self.tip)
        shared = sum(1 for a, b in zip(up, down, strict=False) if a == b)
        path = [*reversed(up[shared:]), *down[shared:]]
        if not path and self.base != self.tip:
            raise RobotError(
                f"no moving joint between '{self.base}' and '{self.tip}'",
                file=robot.file,
            )
        self.joints: tuple[str, ...] = tuple(full.names[j] for j in path)
        for name in self.joints:
            if name in robot.refused:
                raise RobotError(
                    f"joint '{name}' between '{self.base}' and '{self.tip}' is "
                    f"{robot.refused[name]}, which a chain cannot contain; start "
                    f"behind it with --base {robot.carried(name)}",
                    file=robot.file,
                )
        locked = sorted({*range(1, full.njoints)}.difference(path))
        self._model = reduced(full, locked)
        self._workspace = PerThread(workspace, self._model)
        self._recent = PerThread[dict[tuple[object, ...], tuple[Floats, ...]]](dict)
        self._ids = [self._model.getJointId(name) for name in self.joints]
        # The regressor has six columns per joint in the order of the tree.
        ids = np.array(self._ids, np.intp)
        columns = (6 * (ids - 1)[:, None] + np.arange(6)).reshape(-1)
        in_order = np.array_equal(columns, np.arange(len(columns)))
        self._columns = slice(None) if in_order else columns
        self._base_id = link_frame(self._model, LINK + self.base)
        self._tip_id = link_frame(self._model, LINK + self.tip)

        count = len(path)
        self.reversed = np.arange(count) < len(up) - shared
        if path:  # Pinocchio crashes where nothing moves.
            pin.computeJointJacobians(*self._workspace.value, pin.neutral(self._model))
        subspaces = np.array([self._subspace(j) for j in self._ids]).reshape(-1, 6)
        space = self._space = JointSpace(full, self.joints, robot.mimics)
        self.mimics = space.mimics
        self.revolute = space.revolute[:count]
        self.lower, self.upper = space.lower[:count], space.upper[:count]
        self.inverted = tuple(name for name in space.inverted if name in self.joints)
        self.axes: Floats = np.where(
            self.revolute[:, None], subspaces[:, 3:], subspaces[:, :3]
        )
        # A continuous joint has two entries in q and one in the velocities.
        self._v_index = np.array([self._model.idx_vs[j] for j in self._ids], np.intp)
        self._configurations = Configurations(self._model, self._ids)
        self.placements: tuple[pin.SE3, ...] = tuple(
            self._model.jointPlacements[j].copy() for j in self._ids
        )
        tip_frame = full.frames[link_frame(full, self.tip)]
        self.tip_placement: pin.SE3 = tip_frame.placement.copy()
        self.ends: tuple[pin.SE3, pin.SE3] = (
            self._model.frames[self._base_id].placement.copy(),
            self._model.frames[self._tip_id].placement.copy(),
        )
        on_path = self.tip in robot.fixed_parents and not self.reversed[-1:].any()
        self.tip_joint: str | None = (
            robot.fixed_parents[self.tip] if path and on_path else None
        )
        away = float(np.linalg.norm(self.poses(np.zeros((1, count)))[0, :3, 3]))
        if away > LARGEST_LENGTH:
            raise RobotError(
                f"'{self.tip}' is {away:.4g} m from '{self.base}'; a URDF states "
                "lengths in m, not in mm",
                file=robot.file,
            )

    def __repr__(self) -> str:
        """The robot, the ends and the number of joints."""
        ends = f"{self.base} to {self.tip}, {counted(len(self.joints), 'joint')}"
        return f"Chain({self.robot.name}: {ends})"

    def poses(self, q: Floats, placements: Sequence[Placement] | None = None) -> Floats:
        """Tip poses in the base frame.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            placements: Joint placements in chain order; default the nominal ones.
                One of each configuration, shape (N, 4, 4), where they differ.

        Returns:
            `T_base_tip`, shape (N, 4, 4).
        """
        return self._cached_sweep(self._poses, q, placements)[0]

    def regressor(
        self, q: Floats, placements: Sequence[Placement] | None = None
    ) -> tuple[Floats, Floats]:
        """Tip poses and their derivative by right-multiplied placement errors.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            placements: As for `poses`.

        Returns:
            `T_base_tip`, shape (N, 4, 4), and R, shape (N, 6, 6 n): the body twist of
            the tip per placement twist, joints in chain order.
        """
        T, R = self._cached_sweep(self._regressor, q, placements)
        return T, R

    def jacobian(
        self, q: Floats, placements: Sequence[Placement] | None = None
    ) -> tuple[Floats, Floats]:
        """Tip poses and their derivative by the joint positions.

        The columns of the regressor along the joints' own motions, in less time.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            placements: As for `poses`.

        Returns:
            `T_base_tip`, shape (N, 4, 4), and body twists of the tip, (N, 6, n).
        """
        T, J = self._differentiate(
            self._rows(q),
            placements,
            self._model.nv,
            pin.computeJointJacobians,
            pin.getFrameJacobian,
        )
        return T, J[:, :, self._v_index]

    @property
    def motions(self) -> Floats:
        """Unit twists of the joints' own motions in the joint frames, shape (n, 6)."""
        result = np.zeros((len(self.joints), 6))
        result[self.revolute, 3:] = self.axes[self.revolute]
        result[~self.revolute, :3] = self.axes[~self.revolute]
        return result

    def gravity_torques(
        self, q: Floats, gravity: Sequence[float], payload: Payload | None = None
    ) -> Floats:
        """Torques that gravity exerts on the joints at nominal geometry.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            gravity: Its acceleration in the base link at zero joint positions, (3,)
                [m/s^2]; the root of the robot stands still.
            payload: Carried by the tip.

        Returns:
            Torques, shape (N, n) [Nm, N for prismatic joints].
        """
        q = self._rows(q)
        if not self.joints:
            return np.empty(q.shape)
        model, data = self._weighed(gravity, payload)
        held = [
            pin.computeGeneralizedGravity(model, data, full)
            for full in self._configurations(q)
        ]
        return -np.array(held).reshape(-1, model.nv)[:, self._v_index]

    def gravity_moments(
        self, q: Floats, gravity: Sequence[float], payload: Payload | None = None
    ) -> Floats:
        """Moments of gravity about the joints, in the frames before they move.

        Arguments as for `gravity_torques`.

        Returns:
            Moments, shape (N, n, 3) [Nm].
        """
        q, (model, data) = self._rows(q), self._weighed(gravity, payload)
        held, still = np.empty((len(q), len(self.joints), 6)), np.zeros(model.nv)
        for row, full in zip(held, self._configurations(q), strict=True):
            pin.rnea(model, data, full, still, still)
            row[:] = [data.f[joint].vector for joint in self._ids]
        # From the frames that have moved, by a turn or by a shift.
        motion, revolute = q[:, :, None] * self.axes, self.revolute[:, None]
        shift = np.where(revolute, 0.0, motion)
        moments = held[:, :, 3:] + np.cross(shift, held[:, :, :3])
        return -times(so3_exp(np.where(revolute, motion, 0.0)), moments)

    def _weighed(
        self, gravity: Sequence[float], payload: Payload | None
    ) -> tuple[pin.Model, pin.Data]:
        """A model of its own under gravity, with what the tip carries."""
        model, tip = self._model.copy(), self._model.frames[self._tip_id]
        model.gravity.linear = self._base_at_zero.rotation @ np.asarray(gravity, float)
        if payload is not None and tip.parentJoint:
            center = tip.placement.act(np.array(payload.com))
            point = pin.Inertia(payload.mass, center, np.zeros((3, 3)))
            model.inertias[tip.parentJoint] = model.inertias[tip.parentJoint] + point
        return model, model.createData()

    def joint_frames(self) -> Floats:
        """Joint frames in the base frame at zero joint positions, shape (n, 4, 4)."""
        base, at_zero = self._base_at_zero, self._at_zero
        frames = [base.actInv(at_zero(joint)).homogeneous for joint in self._ids]
        return np.array(frames).reshape(-1, 4, 4)

    @checked
    def random_configurations(self, count: int, rng: np.random.Generator) -> Floats:
        """Configurations drawn uniformly within the limits, shape (count, n).

        Mimic joints follow their leaders.
        """
        q = self._space.random_configurations(count, rng)
        return q[:, : len(self.joints)]

    def _rows(self, q: Floats) -> Floats:
        """Joint positions, shape (N, n); those of one configuration as a row."""
        return as_array("q", q, "N", len(self.joints))

    @cached_property
    def _base_at_zero(self) -> pin.SE3:
        """Base in the root at zero joint positions."""
        frame = self._model.frames[self._base_id]
        return self._at_zero(frame.parentJoint) * frame.placement

    def _at_zero(self, joint: int) -> pin.SE3:
        """Nominal frame of a joint in the root at zero joint positions."""
        placed = dict(zip(self._ids, self.placements, strict=True))
        frame = pin.SE3.Identity()
        while joint:
            frame, joint = placed[joint] * frame, self._model.parents[joint]
        return frame

    def _cached_sweep(
        self, sweep: Sweep, q: Floats, placements: Sequence[Placement] | None
    ) -> tuple[Floats, ...]:
        """The results of a sweep, or those of the same one a moment ago.

        Frames and instruments are located while the robot stands where it stood.
        """
        q = self._rows(q)
        chosen = self.placements if placements is None else placements
        if q.size > REMEMBERED:
            return sweep(q, chosen)
        recent, places = self._recent.value, map(matrix, chosen)
        key = (sweep.__name__, q.shape, *(rows.tobytes() for rows in (q, *places)))
        if key not in recent:
            if len(recent) == RECENT:
                del recent[next(iter(recent))]
            recent[key] = sweep(q, chosen)
        # Those who asked may write what they get.
        return tuple(result.copy() for result in recent[key])

    def _poses(self, q: Floats, placements: Sequence[Placement]) -> tuple[Floats]:
        return (self._sweep(q, placements, pin.forwardKinematics),)

    def _regressor(
        self, q: Floats, placements: Sequence[Placement]
    ) -> tuple[Floats, Floats]:
        T, R = self._differentiate(
            q,
            placements,
            6 * (self._model.njoints - 1),
            pin.forwardKinematics,
            pin.computeFrameKinematicRegressor,
        )
        return T, R[:, :, self._columns]

    def _differentiate(
        self,
        q: Floats,
        placements: Sequence[Placement] | None,
        width: int,
        prepare: Callable[..., object],
        of_frame: Callable[..., Floats],
    ) -> tuple[Floats, Floats]:
        """Tip poses in the base frame, and body twists of the tip, (N, 6, width).

        Pinocchio's function `prepare` is called for each configuration, then
        `of_frame`, which gives local twists of a frame, shape (6, width).
        """
        if not self.joints:
            return self.poses(q), np.empty((len(q), 6, 0))
        (model, data), local = self._workspace.value, pin.LOCAL
        tip_id, base_id = self._tip_id, self._base_id
        at_tip = np.empty((len(q), 6, width))
        at_base = np.empty(at_tip.shape) if self.reversed.any() else None
        # Of a robot with one joint Pinocchio returns a vector.
        shape = (6, width) if width > 1 else (6,)
        tip_rows = at_tip.reshape(len(q), *shape)
        base_rows = None if at_base is None else at_base.reshape(len(q), *shape)

        def fill(i: int) -> None:
            tip_rows[i] = of_frame(model, data, tip_id, local)
            if base_rows is not None:
                base_rows[i] = of_frame(model, data, base_id, local)

        T = self._sweep(q, placements, prepare, fill)
        if at_base is not None:
            at_tip -= adjoint(invert(T)) @ at_base
        return T, at_tip

    def _sweep(
        self,
        q: Floats,
        placements: Sequence[Placement] | None,
        prepare: Callable[..., object],
        fill: Callable[[int], None] | None = None,
    ) -> Floats:
        """Tip poses in the base frame; `fill` is called at each configuration."""
        (model, data), place = self._workspace.value, pin.updateFramePlacement
        tip_id, base_id = self._tip_id, self._base_id
        varied = self._place(model, placements)
        tip = np.empty((len(q), 4, 4))
        # Without a joint between them the base stands still in the root.
        bases = len(q) if self.reversed.any() else min(len(q), 1)
        base = np.empty((bases, 4, 4))
        for i, configuration in enumerate(self._configurations(q)):
            for joint, of_rows in varied:
                model.jointPlacements[joint] = pin.SE3(of_rows[i])
            prepare(model, data, configuration)
            tip[i] = place(model, data, tip_id).homogeneous
            if i < bases:
                base[i] = place(model, data, base_id).homogeneous
            if fill is not None:
                fill(i)
        return invert(base) @ tip

    def _subspace(self, joint: int) -> Floats:
        """Unit twist of a joint in its own frame: the axis, linear or angular."""
        J = pin.getJointJacobian(*self._workspace.value, joint, pin.LOCAL)
        # With a single degree of freedom Pinocchio returns a plain vector.
        return np.asarray(J.reshape(6, -1)[:, self._model.idx_vs[joint]])

    def _place(
        self, model: pin.Model, placements: Sequence[Placement] | None
    ) -> Sequence[tuple[int, Floats]]:
        """Place all joints; those are returned that stand elsewhere row by row."""
        chosen = self.placements if placements is None else placements
        varied = []
        for joint, placement in zip(self._ids, chosen, strict=True):
            if isinstance(placement, np.ndarray):
                varied.append((joint, placement))
            else:
                model.jointPlacements[joint] = placement
        return varied
