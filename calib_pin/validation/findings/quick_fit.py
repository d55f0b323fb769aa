"""A fit in a few steps, with which explanations of measurements are compared."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any, Self

import numpy as np

from calib_pin.estimation.identifiability import column_space, nuisance_basis
from calib_pin.estimation.nominal import registered
from calib_pin.estimation.problem import Problem, error_table, measured_count
from calib_pin.estimation.solve import refine
from calib_pin.estimation.statistics.distributions import f_tail
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.declaration import Quantity
from calib_pin.observations import Observations

REDUNDANCY = 2.0
"""Least number of values, by unknowns, to tell errors of the robot from others."""

SIZE = 10.0
"""Expected size of the robot's errors, in scales, while explanations are sought."""

STEPS = 2
"""Steps of a quick fit."""

SETTLED = 0.99
"""Part of the errors that a further step must leave at most."""

ROUGH = 1e-3
"""Part of the cost that a step must promise where frames are fitted in a trial."""

LOCATING = 10
"""Most steps in which frames are fitted in a trial: of a robot six are enough."""

FLAT = 0.03
"""Heights of points of a sheet, as parts of its size."""

STEP = 1e-7
"""Step of differences by joint positions [rad, m]: the motion that a fit can absorb is
known far better than that by which others are told."""


def located(problem: Problem, thorough: bool = False) -> Problem:
    """A problem about roughly registered frames and references.

    The closed form is enough to tell a robot from none; without a measurement frame
    there may be nothing in closed form, and it is fitted.

    Args:
        problem: The problem.
        thorough: Whether they are fitted in any case: of a camera the closed form is
            off by dozens of pixels where there are few images.
    """
    zero = np.zeros(len(problem.parameters))
    terms, problem = problem.terms.values(), registered(problem, zero)
    external = any(term.measurement.declaration.external for term in terms)
    if external and not thorough:
        return problem
    basis = nuisance_basis(problem.parameters)
    return problem.rebased(refine(problem, zero, basis, ROUGH, LOCATING).x)[0]


def below_sheet(problem: Problem) -> bool:
    """Whether a robot hangs upside down from the sheet whose points it touches.

    Points of a plane do not tell a robot from its mirror image, some of whose joints
    are reversed; where z = 0 the robot stands on them, unless a guess says otherwise.
    """
    base = problem.setup.base_frame
    if {*problem.data.models} != {"position"} or base.estimate is False or base.rpy:
        return False
    points = np.vstack([block.data.values for block in problem.blocks])
    flat = np.abs(points[:, 2]).max() < FLAT * np.ptp(points[:, :2], axis=0).max()
    up = [term.error.base.rotation[2, 2] for term in problem.by_chain.values()]
    return bool(flat and max(up) < -0.5)


@dataclass(frozen=True)
class Score:
    """The gain of further columns on the errors that a fit leaves, to first order.

    Attributes:
        left: Part of the sum of squares that they leave, 0 to 1.
        chance: Probability that chance explains as much (F test).
        values: Estimated factor of each column, shape (k,).
        deviations: Their standard deviations, shape (k,).
    """

    left: float
    chance: float
    values: Floats
    deviations: Floats


@dataclass(frozen=True)
class QuickFit:
    """Measurements with the errors of the robot fitted to them, in a few steps.

    Attributes:
        problem: The problem about its registered references.
        theta: Parameter values, shape (P,).
        whole: Whether the robot's errors count however few measurements there are.
        robot: Whether they count at all; only the frames are fitted otherwise.
    """

    problem: Problem
    theta: Floats
    whole: bool = field(default=False, kw_only=True)
    robot: bool = field(default=True, kw_only=True)

    @classmethod
    def of(
        cls,
        problem: Problem,
        steps: int = STEPS,
        *,
        thorough: bool = False,
        **more: Any,
    ) -> Self:
        """Register the nominal robot, and fit its errors where that says something.

        The best step counts: none where all of them lead away.

        Args:
            problem: The problem.
            steps: Most steps, of which each beyond the first ones must leave less.
            thorough: See `located`.
            **more: Further attributes.

        Raises:
            CalibPinError: If a part of the measurements cannot be registered.
            LinAlgError: If their errors have no derivative where the robot is.
        """
        problem = located(problem, thorough)
        trial = cls(problem, np.zeros(len(problem.parameters)), **more)
        best = trial
        free, scales = problem.parameters.free, problem.parameters.scales
        for step in range(steps if trial.redundant else 0):
            A, b = trial.system
            if not np.isfinite(A).all():
                raise np.linalg.LinAlgError("the errors have no derivative")
            theta = trial.theta.copy()
            theta[free] -= scales[free] * np.linalg.lstsq(A, b, rcond=1e-10)[0]
            stepped = replace(trial, theta=theta)
            if not np.isfinite(stepped.linear[0]).all():
                break  # A point came to lie behind the camera, say.
            if step >= STEPS and not stepped.rms < SETTLED * trial.rms:
                break
            trial = stepped
            best = trial if trial.rms < best.rms else best
        return best

    @cached_property
    def redundant(self) -> bool:
        """Whether the measurements tell errors of the robot from others."""
        free = int(self.problem.parameters.free.sum())
        return measured_count(self.problem) >= REDUNDANCY * free

    @cached_property
    def linear(self) -> tuple[Floats, Floats]:
        """Whitened residual (M,), and its Jacobian by scaled parameters, (M, P)."""
        r, J = self.problem.linearize_rows(self.theta)
        count = len(self.problem.layout.row)
        return r[:count], J[:count] * self.problem.parameters.scales

    @cached_property
    def system(self) -> tuple[Floats, Floats]:
        """Columns of what is free, and residuals, above known distances and sizes."""
        r, J = self.linear
        parameters, known = self.problem.parameters, self.problem.further.distances
        counts = self.robot and (self.redundant or self.whole)
        free = parameters.free & (parameters.nuisance | counts)
        robot = ~parameters.nuisance & free
        prior = np.diag(np.where(robot, 1.0 / SIZE, 0.0))[robot]
        # Without them contacts draw a robot together.
        of_known = known.jacobian(self.theta) * parameters.scales
        A = np.concatenate([J, of_known, prior])
        A[:, ~free] = 0.0
        pulls = prior @ (self.theta / parameters.scales)
        b = np.concatenate([r, known.residual(self.theta), pulls])
        return A[:, parameters.free], b

    @cached_property
    def unexplained(self) -> tuple[Floats, Floats]:
        """Orthonormal basis of what is explained, and what it leaves of `system`."""
        A, b = self.system
        Q = column_space(A)
        return Q, b - Q @ (Q.T @ b)

    @cached_property
    def left(self) -> int:
        """Number of values that unknowns do not use up."""
        (A, _), rows = self.system, len(self.problem.layout.row)
        if not rows:
            return 0
        R, rounding = np.linalg.qr(A[:rows], mode="r"), rows * np.finfo(float).eps
        rank = np.linalg.matrix_rank(R, rtol=rounding)
        return measured_count(self.problem) - int(rank)

    @cached_property
    def rms(self) -> float:
        """Errors left, in standard deviations, of what unknowns do not use up."""
        r, _ = self.linear
        return float(np.sqrt(r @ r / self.left)) if self.left > 0 else np.inf

    @property
    def largest_correction(self) -> float:
        """The largest correction of the robot, in expected sizes."""
        parameters = self.problem.parameters
        sizes = np.abs(self.theta / parameters.scales)[~parameters.nuisance]
        return float(sizes.max(initial=0.0))

    @cached_property
    def table(self) -> Floats:
        """Its errors, see `error_table`, of what was not set aside, shape (N, D)."""
        return error_table(self.problem, self.theta)[self.problem.data.weight > 0.0]

    @property
    def quantity(self) -> Quantity:
        """The first quantity, whose errors findings tell."""
        return self.problem.layout.quantities[0]

    @property
    def errors(self) -> float:
        """Errors left of the first quantity, rms [its unit].

        What was set aside does not count.
        """
        errors = self.quantity.errors(self.table)
        return float(np.sqrt(np.mean(errors**2)))

    @cached_property
    def by_joints(self) -> Floats:
        """Whitened residual by the position of every joint, shape (M, n).

        By differences; where a relative measurement starts does not move.
        """
        return self._by_positions("q")

    @cached_property
    def by_starts(self) -> Floats:
        """The same by the joint positions where relative measurements start, (M, n)."""
        return self._by_positions("start")

    def _by_positions(self, name: str) -> Floats:
        """Whitened residual by the positions of a name in every block, shape (M, n)."""
        here, _ = self.linear
        blocks, count = self.problem.data.blocks, len(self.problem.data.joints)
        if not any(getattr(block, name).size for block in blocks):
            return np.zeros((len(here), count))
        # All at once, one joint after the other: most of an evaluation is overhead.
        joint, moved = [], []
        for block in blocks:
            joint.append(np.repeat(np.arange(count), len(block)))
            copies = block.rows(np.tile(np.arange(len(block)), count))
            at = getattr(copies, name)
            there = at + STEP * np.eye(count)[joint[-1]] if at.size else at
            moved.append(replace(copies, **{name: there}))
        problem = replace(self.problem, data=Observations(tuple(moved)))
        row = problem.layout.row
        order = np.argsort(np.concatenate(joint)[row], kind="stable")
        there = problem.residual(self.theta)[: len(row)][order].reshape(count, -1)
        return (there.T - here[:, None]) / STEP

    def explaining(self, columns: Floats) -> Self:
        """The same fit as if further columns were in it, to first order.

        Args:
            columns: Change of the whitened residual by each, shape (M, k).
        """
        (Q, r), U = self.unexplained, column_space(self.beyond(columns))
        result = replace(self)
        result.__dict__.update(
            linear=self.linear,
            by_joints=self.by_joints,
            left=self.left - U.shape[1],
            unexplained=(np.hstack([Q, U]), r - U @ (U.T @ r)),
        )
        return result

    def beyond(self, columns: Floats) -> Floats:
        """That part of further columns that the fit cannot do, as rows of `system`."""
        Q, r = self.unexplained
        X = np.zeros((len(r), columns.shape[1]))
        X[: len(columns)] = columns
        X -= Q @ (Q.T @ X)
        return X

    def score(self, columns: Floats) -> Score:
        """Try further columns of the Jacobian, in units of their own.

        Args:
            columns: Change of the whitened residual by each, shape (M, k).
        """
        X, (_, r), count = self.beyond(columns), self.unexplained, columns.shape[1]
        U, s, Vt = np.linalg.svd(X, full_matrices=False)
        # What the fit can do already leaves rounding.
        kept = s > max(1e-6 * float(np.linalg.norm(columns)), 1e-300)
        U, inverse = U[:, kept], Vt[kept].T / s[kept]
        along, total, k = U.T @ r, float(r @ r), int(kept.sum())
        dof = self.left - k
        if not k or dof <= 0 or total <= 0.0:
            return Score(1.0, 1.0, np.zeros(count), np.full(count, np.inf))
        gain = float(along @ along)
        rest = max(total - gain, 1e-300)
        chance = f_tail((gain / k) / (rest / dof), k, dof)
        deviations = np.sqrt(rest / dof * np.sum(inverse**2, axis=1))
        return Score(rest / total, chance, -inverse @ along, deviations)
