"""The rows of a configuration in the identification matrix.

The rows are whitened by the noise, their columns are scaled and reduced to the
identifiable subspace, with the nuisances (base, tool, instrument) before the robot.
Those of all that is measured at a configuration stand below one another.

They can be differentiated by the configuration without new kinematics: if joint k turns
behind the place of parameter p, the body twist V_p of the tool changes by the Lie
bracket

    dV_p / dq_k = [V_p, xi_k]

with the joint's own twist xi_k, else not at all; how the instrument's rows change with
the pose is seen by moving the tool a little either way.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.problem import Problem, assumed_sigma
from calib_pin.kinematics.spatial import Floats, se3_exp
from calib_pin.observations import Indices, Labels
from calib_pin.parameterizations.linearization import PoseLinearization
from calib_pin.planning.workspace import Aims, Look

STEP = 2e-6
"""Motion of the tool that shows how an instrument's rows change [m, rad]. A search
needs slopes to a millionth; these are exact to 1e-8, also where a beam
all but grazes a plane."""

Pullback = Callable[[Floats], Floats]
"""Derivative by the rows, (N, d, m), to derivative by the configurations, (N, n)."""


@dataclass(frozen=True)
class LookRows:
    """Rows of an instrument, of L targets at a configuration.

    Attributes:
        look: The instrument, and which targets it measures.
        basis: Columns in its parameters, shape (p, m).
        sigma: Standard deviation of each component, shape (d,).
    """

    look: Look
    basis: Floats
    sigma: Floats

    def rows(self, q: Floats, aim: Indices) -> Floats:
        """Rows of configurations, shape (N, d, m).

        Where there are more measurements than unknowns that they depend on, the pose
        of the tool and the instrument, rows with the same information stand for them.

        Args:
            q: Configurations of all joints, shape (N, n) [rad, m].
            aim: What is measured at each, shape (N,).
        """
        poses, J, _ = self._linear(q, aim)
        if J.shape[1] > J.shape[2]:
            J = np.asarray(np.linalg.qr(J, mode="r"))
        of_robot, of_instrument = self._bases
        count, d = J.shape[:2]
        rows = poses.derivative(J[:, :, :6]).reshape(count * d, -1) @ of_robot
        rows += J[:, :, 6:].reshape(count * d, -1) @ of_instrument
        return np.asarray(rows.reshape(count, d, -1))

    def linearize(self, q: Floats, aim: Indices) -> tuple[Floats, Pullback]:
        """Rows of configurations, and what carries derivatives by them back.

        Args:
            q: Configurations of all joints, shape (N, n) [rad, m].
            aim: What is measured at each, shape (N,).

        Returns:
            Rows target by target, shape (N, L d, m), and the derivative by all joints.
        """
        term, each = self.look.term, self.look.each
        assert term.error.geometric
        poses, J, measured = self._linear(q, aim)
        of_robot, of_instrument = self._bases
        V = poses.derivative(np.tile(np.eye(6), (len(q), 1, 1)))
        rows = J[:, :, :6] @ (V @ of_robot) + J[:, :, 6:] @ of_instrument
        place, names = self._measured(aim, measured)
        slopes = self._slopes(poses.T[place], q[place][:, term.columns], names)
        xi = poses.joint_twists()

        def pullback(by_rows: Floats) -> Floats:
            G = by_rows @ of_robot.T
            weighted = by_rows / np.tile(self.sigma, each)[:, None]
            # The instrument's rows change with the pose, whichever joint moves it.
            by_L = weighted @ np.swapaxes(V @ of_robot, 1, 2)
            both = np.concatenate([by_L, weighted @ of_instrument.T], axis=2)
            one_by_one = both.reshape(len(q) * each, len(self.sigma), -1)[measured]
            bent = np.einsum("nab,cnab->nc", one_by_one, slopes)
            e = np.zeros((len(q), 6))
            np.add.at(e, place, bent)
            # F . [V, xi] = xi . (F_v x w + 0, F_v x v + F_w x w) with V = (v, w).
            F = np.swapaxes(J[:, :, :6], 1, 2) @ G
            by_place = np.cumsum(_coadjoint(V, F), axis=2)
            ahead = np.concatenate([np.zeros_like(by_place[:, :, :1]), by_place], 2)
            by_joints = e[:, :, None] + ahead[:, :, self._carried]
            result = np.zeros(q.shape)
            result[:, term.columns] = np.einsum("nck,nck->nk", xi, by_joints)
            return result

        return np.asarray(rows), pullback

    def _slopes(self, T: Floats, q: Floats, target: Labels) -> Floats:
        """Changes of the derivatives by pose and instrument, shape (6, n, d, 6 + K).

        Args:
            T: Poses of the tool, shape (n, 4, 4).
            q: Joint positions of the chain, shape (n, k) [rad, m].
            target: What is measured at each.
        """
        twists = STEP * np.vstack([np.eye(6), -np.eye(6)])
        moved = (T @ se3_exp(twists)[:, None]).reshape(-1, 4, 4)
        names = Labels(target.names, np.tile(target.codes, len(twists)))
        about = self._instrument, np.tile(q, (len(twists), 1)), names
        linear = self.look.term.linearized(moved, *about)
        both = np.concatenate([linear.J_pose, linear.J_instrument], axis=2)
        ahead, behind = both.reshape(2, 6, len(T), *both.shape[1:])
        return np.asarray((ahead - behind) / (2.0 * STEP))

    @property
    def _instrument(self) -> Floats:
        return np.zeros(len(self.look.term.measurement.parameters))

    @property
    def _bases(self) -> tuple[Floats, Floats]:
        """Rows of the basis that belong to the error model and to the instrument."""
        count = len(self.look.term.error.screws)
        return self.basis[:count], self.basis[count:]

    @cached_property
    def _carried(self) -> NDArray[np.intp]:
        """Number of leading parameters whose twist each joint turns, shape (n,).

        A joint traversed from child to parent turns before its own placement does.
        """
        error = self.look.term.error
        places = [screw.frame for screw in error.screws]
        joints = np.arange(1, len(error.chain.joints) + 1)
        return np.searchsorted(places, joints - error.chain.reversed, side="right")

    def _linear(
        self, q: Floats, aim: Indices
    ) -> tuple[PoseLinearization, Floats, Indices]:
        """Poses, and the whitened derivatives by the pose and by the instrument.

        Returns:
            The poses, the derivatives target by target, shape (N, L d, 6 + K), zero of
            targets out of sight, and the positions of those that are measured,
            counted target by target.
        """
        term, each, size = self.look.term, self.look.each, len(self.sigma)
        local = q[:, term.columns]
        basis = term.error.basis(local, self.look.conditions(aim))
        poses = term.error.linearize(local, np.zeros(len(term.error.screws)), basis)
        # Where only one is measured, `Workspace` allows only what sees it.
        measured = np.arange(len(q))
        if self.look.at_once:
            measured = np.flatnonzero(self.look.seen(q, aim))
        place, names = self._measured(aim, measured)
        instrument = self._instrument
        linear = term.linearized(poses.T[place], instrument, local[place], names)
        J = np.zeros((len(q) * each, size, 6 + len(instrument)))
        both = np.concatenate([linear.J_pose, linear.J_instrument], axis=2)
        J[measured] = both / self.sigma[:, None]
        return poses, J.reshape(len(q), each * size, J.shape[2]), measured

    def _measured(self, aim: Indices, measured: Indices) -> tuple[Indices, Labels]:
        """Configuration and target of what is measured."""
        codes = self.look.targets(aim).reshape(-1)[measured]
        return measured // self.look.each, Labels(self.look.names, codes)


@dataclass(frozen=True)
class IdentificationRows:
    """Rows of all that is measured at a configuration, at nominal geometry.

    Attributes:
        problem: The problem about its registered references.
        basis: Columns in parameters, each a direction times the scales, shape (P, m).
        nuisances: How many of them, the first ones, are directions of nuisances.
        aims: What can be measured at a configuration.
    """

    problem: Problem
    basis: Floats
    nuisances: int
    aims: Aims

    @property
    def differentiable(self) -> bool:
        """Whether there are second derivatives; of joint corrections there are none."""
        return all(look.term.error.geometric for look in self.aims.looks)

    def rows(self, q: Floats, aim: Indices) -> Floats:
        """Rows of configurations.

        Args:
            q: Configurations, shape (N, n) [rad, m].
            aim: Position of what is measured there among `aims`, shape (N,).

        Returns:
            Rows, shape (N, d, m), zero where fewer are measured.
        """
        parts = [(at, look.rows(q[at], aim[at])) for look, at in self._looking(aim)]
        result, _ = self._stacked(len(q), parts)
        if result.shape[1] > result.shape[2]:
            result = np.asarray(np.linalg.qr(result, mode="r"))
        return result

    def linearize(self, q: Floats, aim: Indices) -> tuple[Floats, Pullback]:
        """Rows, one for each measured value, and what carries derivatives back.

        Args:
            q: Configurations, shape (N, n) [rad, m].
            aim: Position of what is measured there among `aims`, shape (N,).
        """
        parts = [
            (where, *look.linearize(q[where], aim[where]))
            for look, where in self._looking(aim)
        ]
        rows, columns = self._stacked(len(q), [(at, rows) for at, rows, _ in parts])
        n = q.shape[1]
        ends = self.problem.chains.follow(np.concatenate([np.zeros((1, n)), np.eye(n)]))

        def pullback(by_rows: Floats) -> Floats:
            total = np.zeros(q.shape)
            for (where, _, back), of_look in zip(parts, columns, strict=True):
                total[where] += back(by_rows[where[:, None], of_look])
            # A mimic joint moves with its leader, and not by itself.
            return np.asarray(total @ (ends[1:] - ends[0]).T)

        return rows, pullback

    @cached_property
    def _looks(self) -> list[LookRows]:
        """The rows of each instrument."""
        setup = self.problem.setup
        return [
            LookRows(look, self.basis[look.term.index], assumed_sigma(look.term, setup))
            for look in self.aims.looks
        ]

    def _looking(self, aim: Indices) -> Iterator[tuple[LookRows, NDArray[np.intp]]]:
        """The rows of each instrument, and the configurations where it measures."""
        for look in self._looks:
            where = np.flatnonzero(look.look.of_aim[aim] >= 0)
            if len(where):
                yield look, where

    def _stacked(
        self,
        count: int,
        parts: Sequence[tuple[NDArray[np.intp], Floats]],
    ) -> tuple[Floats, list[Indices]]:
        """Rows of all instruments below one another, and where those of each stand.

        Args:
            count: Number N of configurations.
            parts: Configurations of each instrument, and its rows there.

        Returns:
            Rows, shape (N, d, m), and by instrument positions below d, shape (k, d').
        """
        used, columns = np.zeros(count, np.int64), []
        for where, rows in parts:
            columns.append(used[where, None] + np.arange(rows.shape[1]))
            used[where] += rows.shape[1]
        result = np.zeros((count, used.max(initial=0), self.basis.shape[1]))
        for (where, rows), of_look in zip(parts, columns, strict=True):
            result[where[:, None], of_look] = rows
        return result, columns


def _coadjoint(V: Floats, F: Floats) -> Floats:
    """`c` with `F . [V, xi] = c . xi` for every xi, each (N, 6, P).

    With `V = (v, w)`, `F = (f, t)`: `c = (f x w, f x v + t x w)`.
    """
    v, w = V[:, :3], V[:, 3:]
    f, t = F[:, :3], F[:, 3:]
    by_shift, by_turn = (np.cross(part, w, axis=1) for part in (f, t))
    return np.concatenate([by_shift, np.cross(f, v, axis=1) + by_turn], axis=1)
