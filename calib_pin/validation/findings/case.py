"""The measurements in which faults are sought, and a fit to them in a few steps.

Faults are further columns of the Jacobian of this fit, whose gain is scored to first
order (`QuickFit.score`) and fitted with the robot (`fit_factors`), or other readings
of the file, of which such fits are compared (`alternatives`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from typing import Any, Self, TypeVar

import numpy as np

from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.identifiability import column_space, nuisance_basis
from calib_pin.estimation.nominal import analyze_structure, register, registered
from calib_pin.estimation.problem import (
    EXACT,
    Problem,
    distinct_values,
    error_table,
    measured_count,
)
from calib_pin.estimation.solve import refine
from calib_pin.estimation.statistics.distributions import f_tail
from calib_pin.estimation.statistics.variance_components import candidates, unplaced
from calib_pin.estimation.terms import FRAME
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.declaration import Quantity
from calib_pin.measurement_models.pinhole import Camera
from calib_pin.measurement_models.references import (
    Center,
    Plane,
    ReferenceObject,
    slices,
)
from calib_pin.observations import Indices, Observations
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.parameterizations.base import expected_size
from calib_pin.progress import Progress
from calib_pin.setup import Setup
from calib_pin.validation.result import ToolAccuracy

CHANCE = 1e-4
"""Probability that chance alone tells a fault: the one level of significance of all
kinds, corrected for the number of those that are tried."""

REDUNDANCY = 2.0
"""Least number of values, by those that unknowns use up, to tell errors of the robot
from others."""

SIZE = 10.0
"""Expected size of the robot's errors, in scales, while explanations are sought."""

STEPS = 2
"""Steps of a quick fit."""

CLEARER = 0.95
"""Part of the errors that its rivals leave that an alternative leaves at most, and part
of its own that another one beside it must leave to be worth a trial."""

SETTLED = 0.99
"""Part of the errors that a further step must leave at most."""

SIZINGS, STILL = 12, 0.1
"""Most steps in which factors of further columns are fitted (an offset of 60 deg takes
seven), and change of one, in its standard deviations, after which no more are taken, if
the robot has settled, too."""

ROUGH = 1e-3
"""Part of the cost that a step must promise where frames are fitted in a trial."""

LOCATING, ROUGHLY = 10, 4
"""Most steps in which frames are fitted in a trial: of a robot six are enough. And in
which those are that only tell which trials are worth more of them."""

KEPT, FEW = 0.75, 12
"""Part of the measurements that counts, as outliers may stand beside another fault, and
configurations from which it does: of fewer all are needed to tell anything."""

LOST = 1e6
"""Most that a measurement errs, in standard deviations: its beam meets no plane."""

FLAT = 0.03
"""Heights of points of a sheet, as parts of its size."""

STEP = 1e-7
"""Step of differences by joint positions [rad, m]: the motion that a fit can absorb is
known far better than that by which others are told."""

MEASUREMENTS = 300
"""Measurements that are looked at; more do not make it clearer."""

DOUBTFUL = 0.5
"""Remaining errors, in expected sizes of an error, from which explanations are sought.

A calibrated robot leaves less, unless its gears and links bend.
"""

FOREIGN = 20.0
"""Errors of a nominal robot, in the same sizes, that hardly any robot has."""

ABSURD = 200.0
"""Errors of a nominal robot, in the same sizes, that no robot has."""

IMPLAUSIBLE = 25.0
"""Correction of an origin, in the same sizes, that hardly any robot needs: one that
buys little takes the trust. A small set of a real TIAGo turns a joint by 15 for
nothing, and does no harm."""

FAR = 8.0
"""Errors of an outlier, in medians of those of the nominal robot."""

SOME = 0.1
"""Largest part of the measurements that are outliers of it; more are another fault."""

COMPARED = 8
"""Most steps of the fit to measurements that a robot is compared with."""

LACKING = 0.5
"""Part of the sum of squares that they leave at most."""

_Fitted = TypeVar("_Fitted", bound="QuickFit")


def unlikely(trials: int = 1) -> float:
    """Logarithm of the likelihood ratio that the best of so many has by no chance."""
    return float(np.log(max(trials, 1) / CHANCE))


def by_chance(before: float, after: float, count: int, dof: float) -> float:
    """Probability that chance explains as much (F test).

    Args:
        before: Sum of squared errors.
        after: The same with so many further numbers.
        count: Number of these.
        dof: Number of values that unknowns do not use up then.
    """
    gain = max(before - after, 0.0) / count
    return f_tail(gain / max(after / dof, 1e-300), count, dof)


def located(problem: Problem, thorough: bool = False) -> Problem:
    """A problem about roughly registered frames and references.

    The closed form is enough to tell a robot from none; without a measurement frame
    there may be nothing in closed form, and it is fitted in a few steps.

    Args:
        problem: The problem.
        thorough: Whether they are fitted in any case, and in more steps: of a camera
            the closed form is off by dozens of pixels where there are few images.
    """
    zero = np.zeros(len(problem.parameters))
    problem = registered(problem, zero)
    if _in_closed_form(problem) and not thorough:
        return problem
    basis = nuisance_basis(problem.parameters)
    steps = LOCATING if thorough else ROUGHLY
    return problem.rebased(refine(problem, zero, basis, ROUGH, steps).x)[0]


def _in_closed_form(problem: Problem) -> bool:
    """Whether there is a measurement frame, which a closed form locates."""
    terms = problem.terms.values()
    return any(term.measurement.declaration.external for term in terms)


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


def counted_part(problem: Problem) -> float:
    """Part of the measurements that counts."""
    return KEPT if problem.data.configurations >= FEW else 1.0


def mean_squares(problem: Problem, theta: Floats, scale: float = 1.0) -> Floats:
    """Squared error of each measurement, in standard deviations, shape (N,).

    Lengths that were scaled count in the unit of the file: what is scaled down is no
    better for that.
    """
    sigma = problem.layout.table(problem.given_sigma, len(problem.data))
    for quantity in problem.layout.quantities:
        if quantity.unit == "m":
            sigma[:, quantity.columns] *= scale
    squares = np.minimum((error_table(problem, theta) / sigma) ** 2, LOST**2)
    return np.asarray(np.nanmean(squares, axis=1))


def trimmed_errors(
    problem: Problem, bound: float = np.inf, scale: float = 1.0, thorough: bool = False
) -> tuple[float, Floats]:
    """Errors of the nominal robot where the best part of the measurements has it.

    They locate the robot once more without the others, which outliers are among, if
    they leave less than a bound, and where that takes no time or it should be thorough;
    see `mean_squares` for the scale, and `located`.

    Returns:
        Errors of that part, rms in standard deviations, and mean squares of all, (N,).
    """
    size, best = np.inf, np.zeros(len(problem.data))
    zero = np.zeros(len(problem.parameters))
    for again in (False, True):
        problem = located(problem, thorough)
        if below_sheet(problem):
            return np.inf, best
        squares = mean_squares(problem, zero, scale)
        limit = np.quantile(squares, counted_part(problem))
        rms = float(np.sqrt(np.mean(squares[squares <= limit])))
        # A board that has lost some of its corners may be located worse.
        if not again or rms < size:
            size, best = rms, squares
        if rms >= bound or not (thorough or _in_closed_form(problem)):
            break
        weight = (squares <= limit).astype(float)
        problem = replace(problem, data=problem.data.weighted(weight))
    return size if np.isfinite(size) else np.inf, best


@dataclass(frozen=True)
class Score:
    """The gain of further columns on the errors that a fit leaves, to first order.

    Attributes:
        remaining: Part of the sum of squares that they leave, 0 to 1.
        chance: Probability that chance explains as much (F test).
        values: Estimated factor of each column, shape (k,).
        deviations: Their standard deviations, shape (k,).
    """

    remaining: float
    chance: float
    values: Floats
    deviations: Floats


@dataclass(frozen=True)
class QuickFit:
    """Measurements with the errors of the robot fitted to them, in a few steps.

    Attributes:
        problem: The problem about its registered references.
        theta: Parameter values, shape (P,).
        robot: Whether the robot's errors are fitted, or the frames alone.
    """

    problem: Problem
    theta: Floats
    robot: bool = field(default=True, kw_only=True)

    @classmethod
    def of(
        cls,
        problem: Problem,
        steps: int = STEPS,
        thorough: bool = False,
        **more: Any,
    ) -> Self:
        """Register the nominal robot, and fit its errors.

        The best step counts: none where all of them lead away.

        Args:
            problem: The problem.
            steps: Most steps, of which each beyond the first ones must leave less.
            thorough: Whether frames and instruments are located as in `located`.
            **more: Further attributes.

        Raises:
            CalibPinError: If a part of the measurements cannot be registered.
            LinAlgError: If their errors have no derivative where the robot is.
        """
        problem = located(problem, thorough)
        best = trial = cls(problem, np.zeros(len(problem.parameters)), **more)
        for step in range(steps):
            following = stepped(trial)
            if not np.isfinite(following.linear[0]).all():
                break  # A point came to lie behind the camera, say.
            if step >= STEPS and not following.rms < SETTLED * trial.rms:
                break
            trial = following
            best = trial if trial.rms < best.rms else best
        return best

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
        free = parameters.free & (parameters.nuisance | self.robot)
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
    def dof(self) -> float:
        """Number of values that unknowns do not use up.

        Of the robot's errors each uses that part of one which the measurements tell.
        """
        of_values = self.unexplained[0][: len(self.problem.layout.row)]
        return measured_count(self.problem) - float(np.sum(of_values**2))

    @property
    def redundant(self) -> bool:
        """Whether the measurements tell errors of the robot from others."""
        return (1.0 - 1.0 / REDUNDANCY) * measured_count(self.problem) <= self.dof

    @cached_property
    def rms(self) -> float:
        """Errors left, in standard deviations, of what unknowns do not use up."""
        r, _ = self.linear
        return float(np.sqrt(r @ r / self.dof)) if self.dof >= 1 else np.inf

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
        r, _ = self.linear
        blocks, count = self.problem.data.blocks, len(self.problem.data.joints)
        if not any(getattr(block, name).size for block in blocks):
            return np.zeros((len(r), count))
        # All at once, one joint after the other: most of an evaluation is overhead.
        joint, moved = [], []
        for block in blocks:
            joint.append(np.repeat(np.arange(count), len(block)))
            copies = block.rows(np.tile(np.arange(len(block)), count))
            q = getattr(copies, name)
            q_moved = q + STEP * np.eye(count)[joint[-1]] if q.size else q
            moved.append(replace(copies, **{name: q_moved}))
        problem = replace(self.problem, data=Observations(tuple(moved)))
        row = problem.layout.row
        order = np.argsort(np.concatenate(joint)[row], kind="stable")
        r_moved = problem.residual(self.theta)[: len(row)][order].reshape(count, -1)
        return (r_moved.T - r[:, None]) / STEP

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
            dof=self.dof - U.shape[1],
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
        usable = s > max(1e-6 * float(np.linalg.norm(columns)), 1e-300)
        U, inverse = U[:, usable], Vt[usable].T / s[usable]
        along, total, k = U.T @ r, float(r @ r), int(usable.sum())
        dof = self.dof - k
        if not k or dof < 1 or total <= 0.0:
            return Score(1.0, 1.0, np.zeros(count), np.full(count, np.inf))
        remaining = max(total - float(along @ along), 1e-300)
        chance = by_chance(total, remaining, k, dof)
        deviations = np.sqrt(remaining / dof * np.sum(inverse**2, axis=1))
        return Score(remaining / total, chance, -inverse @ along, deviations)


def stepped(fit: _Fitted, data: Observations | None = None) -> _Fitted:
    """One more step, to the same measurements read otherwise if they are given.

    Raises:
        LinAlgError: If their errors have no derivative where the robot is.
    """
    if data is not None:
        fit = replace(fit, problem=replace(fit.problem, data=data))
    (A, b), parameters = fit.system, fit.problem.parameters
    if not (np.isfinite(A).all() and np.isfinite(b).all()):
        raise np.linalg.LinAlgError("the errors have no derivative")
    theta, free = fit.theta.copy(), parameters.free
    theta[free] -= parameters.scales[free] * np.linalg.lstsq(A, b, rcond=1e-10)[0]
    return replace(fit, theta=theta)


def fit_factors(
    fit: _Fitted,
    sizes: Floats,
    columns: Callable[[_Fitted], Floats],
    read: Callable[[Floats], Observations],
) -> tuple[_Fitted, Floats]:
    """A fit with further columns, and their factors, where both have settled.

    Args:
        fit: The fit without them.
        sizes: Factors to begin with, shape (k,).
        columns: Change of the whitened residual of a fit by each, (M, k).
        read: The measurements as they are read with some factors.
    """
    for _ in range(SIZINGS if len(sizes) else 0):
        score, before = fit.score(columns(fit)), fit.rms
        sizes = sizes + score.values
        fit = stepped(fit, read(sizes))
        still = (np.abs(score.values) < STILL * score.deviations).all()
        if still and fit.rms > SETTLED * before:
            break
    return fit, sizes


def squares(fit: QuickFit) -> float:
    """Sum of the squared errors that a fit leaves, in standard deviations."""
    return fit.rms**2 * fit.dof


def surpasses(
    fit: QuickFit, after: float, count: int, rivals: Floats, trials: int = 1
) -> bool:
    """Whether an alternative explains more than chance and its rivals do.

    Args:
        fit: The fit without it.
        after: Sum of the squared errors that it leaves.
        count: Number of its parameters.
        rivals: Columns of what else may be, shape (M, k).
        trials: Number of alternatives among which it is the best.
    """
    dof, rival_dof = fit.dof - count, fit.dof - rivals.shape[1]
    if min(dof, rival_dof) < 1:
        return False  # There are too few measurements to compare.
    rival = squares(fit) * fit.score(rivals).remaining / rival_dof
    significant = by_chance(squares(fit), after, count, dof) * trials < CHANCE
    return significant and after / dof < CLEARER**2 * rival


Others = Callable[[], Iterable[Chains]]
"""Chains with the same joints of other robots that may have been measured; asked only
where no robot explains the errors."""


@dataclass(frozen=True)
class Case:
    """Measurements, and a robot that was fitted to them.

    Attributes:
        data: The measurements that were fitted, with the weights of the fit.
        fit: The solution before some of them, in the order of the blocks.
        rank: Place of each of these in the order of the files, among all, (N,).
        nominal: Parameter values of the registered nominal robot, shape (P,).
        fitted: The whole fit; None where measurements are only compared with a robot.
        progress: Told how far the search for explanations is.
        others: Other robots that may have been measured.
        accuracies: Accuracy to expect of each chain; empty where nothing is known.
    """

    data: Observations
    fit: QuickFit
    rank: Indices
    nominal: Floats
    fitted: Fit | None = None
    progress: Progress | None = None
    others: Others = tuple
    accuracies: Mapping[str, ToolAccuracy] = field(default_factory=dict)

    @staticmethod
    def of(fitted: Fit, *more: Any, **named: Any) -> Case:
        """The case of a whole fit, with further attributes."""
        data = fitted.problem.data
        sample, rank = subset(data)
        problem = replace(fitted.problem, data=sample, expected=None)
        fit = QuickFit(problem, fitted.theta)
        return Case(data, fit, rank, fitted.before, fitted, *more, **named)

    @staticmethod
    def of_robot(
        chains: Chains, data: Observations, setup: Setup, others: Others = tuple
    ) -> Case:
        """The case of measurements that are only compared with a robot.

        Raises:
            CalibPinError: If a part of the measurements cannot be registered.
        """
        none = Case.of_none(chains, data, setup, others)
        problem = none.fit.problem
        fit = QuickFit.of(replace(problem, data=_without_outliers(problem)), COMPARED)
        nominal = np.where(fit.problem.parameters.nuisance, fit.theta, 0.0)
        return replace(none, fit=fit, nominal=nominal)

    @staticmethod
    def of_none(
        chains: Chains, data: Observations, setup: Setup, others: Others = tuple
    ) -> Case:
        """The case of measurements on which no robot can be registered.

        Raises:
            CalibPinError: If they make no problem.
        """
        sample, rank = subset(data)
        problem = make_problem(chains, sample, replace(setup, learned=None))
        zero = np.zeros(len(problem.parameters))
        return Case(data, QuickFit(problem, zero), rank, zero, others=others)

    def unit(self, joint: str) -> str:
        """Unit of a joint's position; one that is in no chain turns."""
        joints, revolute = self.chains.joints, self.chains.revolute
        turns = joint not in joints or revolute[joints.index(joint)]
        return "rad" if turns else "m"

    @property
    def chains(self) -> Chains:
        """The nominal chains."""
        return self.fit.problem.chains

    @property
    def setup(self) -> Setup:
        """The setup of the fit."""
        return self.fit.problem.setup

    @property
    def informed(self) -> bool:
        """Whether errors of the robot were fitted; few measurements only compare."""
        return self.fitted is not None or self.fit.redundant

    @cached_property
    def doubtful(self) -> bool:
        """Whether errors are left that ask for an explanation, more than stated noise.

        Without a whole fit nobody judges corrections that are as large as a robot. With
        one, it may have been fitted to measurements as small as the errors of a robot.
        """
        fitted, errors = self.fitted, self.remaining
        usual = errors <= (DOUBTFUL if self.informed else FOREIGN)
        if fitted is not None and fitted.noise:
            usual |= all(noise.as_stated for noise in fitted.noise)
        plausible = fitted is not None and self.fit.largest_correction <= IMPLAUSIBLE
        # What the model lacks may be all that is left.
        lacks, part = self.lacking
        modeled = plausible and PARAMETERIZATIONS.keys() >= {*lacks}
        if not (usual or (modeled and errors * np.sqrt(part) <= DOUBTFUL)):
            return True
        return self.errors_nominal > (ABSURD if plausible else FOREIGN)

    @cached_property
    def remaining(self) -> float:
        """Remaining errors, rms in expected sizes of an error, of the worst quantity.

        Neither what was set aside counts, nor the largest of the others: a beam that
        grazes its plane errs by far more than they do.
        """
        return self._errors(self.fit.table)

    @cached_property
    def errors_nominal(self) -> float:
        """The same of the registered nominal robot."""
        table = error_table(self.fit.problem, self.nominal)
        return self._errors(table[self.fit.problem.data.weight > 0.0])

    def _errors(self, table: Floats) -> float:
        sizes = [np.inf if below_sheet(self.fit.problem) else 0.0]
        for quantity in self.fit.problem.layout.quantities:
            squares = np.sort(quantity.errors(table) ** 2)
            usual = squares[: int(np.ceil((1.0 - SOME) * len(squares)))]
            if len(usual):
                size = float(np.sqrt(np.mean(usual)))
                sizes.append(size / expected_size(quantity.unit))
        return max(sizes)

    @cached_property
    def lacking(self) -> tuple[tuple[str, ...], float]:
        """Names of what else explains most, and the part of the squares that it leaves.

        None, and all of it, where nothing stands out. One or two families of parameters
        that were not asked for, and numbers of instruments that are held, are tried at
        once, with all columns that they add to the Jacobian; placements where only
        joint offsets were estimated.
        """
        fit = self.fit
        # No gear and no link is farther off.
        possible = self.fitted is not None and self.remaining <= FOREIGN
        if not (possible and self.setup.parameters and fit.rms > EXACT):
            return (), 1.0
        columns = {k: X for k, X in self.omitted.items() if np.isfinite(X).all()}
        # All points of a configuration share the errors of its pose, and repetitions
        # those of their value.
        poses = FRAME * fit.problem.data.configurations
        distinct = min(poses, distinct_values(fit.problem))
        dof = fit.dof - max(measured_count(fit.problem) - distinct, 0)
        trials = list[tuple[float, tuple[str, ...], float]]()
        for names in (*((kind,) for kind in columns), *combinations(columns, 2)):
            score = fit.score(np.hstack([columns[kind] for kind in names]))
            count = len(score.values)
            if count >= dof:
                continue  # They explain whatever a configuration errs by.
            part, chance = score.remaining, score.chance
            if dof < fit.dof:
                chance = by_chance(1.0, part, count, dof - count)
            if part < LACKING and chance < CHANCE:
                # By Schwarz's criterion: two families explain more than one anyway.
                cost = fit.dof * np.log(max(part, 1e-300))
                trials.append((cost + count * np.log(fit.dof), names, part))
        scaled = (trial[1:] for trial in sorted(trials) if self._scaled_with(trial[1]))
        return next(scaled, ((), 1.0))

    def _scaled_with(self, names: Sequence[str]) -> bool:
        """Whether the scale is known with further parameters, if it is without.

        Gains of prismatic joints free it, and then contacts draw a robot to a point,
        which leaves no errors at all.
        """
        new = [name for name in names if name in PARAMETERIZATIONS]
        if self.fitted is None or not (self.fitted.structure.scaled and new):
            return True
        parameters = tuple(dict.fromkeys((*self.setup.parameters, *new)))
        # A joint prior has no errors of further families.
        setup = replace(self.fit.problem.setup, parameters=parameters, prior={})
        wider = make_problem(self.chains, self.fit.problem.data, setup)
        problem, before = register(wider, np.zeros(len(wider.parameters)))
        return scale_known(problem, before.x)

    @cached_property
    def omitted(self) -> dict[str, Floats]:
        """Change of the whitened residual by what is not estimated, each (M, k).

        By family of parameters, and by what is held of instruments, see `held_as`.
        """
        problem, theta = self.fit.problem, self.fit.theta
        names = [
            name
            for name, family in PARAMETERIZATIONS.items()
            if family.effects and name not in self.setup.parameters
        ]
        columns = dict[str, Floats]()
        effects = candidates(problem, names + unplaced(self.setup))
        if effects is not None:
            X, kinds = effects.rows(problem, theta), np.array(effects.kinds)
            columns = {
                kind: X[:, kinds == kind] for kind in dict.fromkeys(effects.kinds)
            }
        held: dict[str, set[int]] = {}
        for term in problem.terms.values():
            references = term.measurement.references
            for reference, part in zip(references, slices(references), strict=True):
                index = term.of_instrument[part].tolist()
                # The number of a center is the last one.
                index = index[-1:] if isinstance(reference, Center) else index
                held.setdefault(held_as(reference), set()).update(index)
        J = self.fit.linear[1]
        return columns | {key: J[:, sorted(i)] for key, i in held.items() if key}


def scale_known(problem: Problem, before: Floats) -> bool:
    """Whether measurements tell how large a robot is.

    Args:
        problem: Their problem.
        before: Its parameters with the robot nominal, shape (P,): what is touched must
            be where the tool can touch it.
    """
    theta = np.where(problem.parameters.nuisance, before, 0.0)
    return analyze_structure(problem, theta, np.random.default_rng(0))[0].scaled


def held_as(reference: ReferenceObject) -> str:
    """Number of a sphere or an anchor, kind of a plane or a camera, if that is held.

    Empty where it is estimated, and of other references.
    """
    if isinstance(reference, Center):
        return "" if reference.estimate_size else reference.number
    if isinstance(reference, Plane | Camera):
        return "" if reference.estimate else reference.kind
    return ""


def _without_outliers(problem: Problem) -> Observations:
    """Measurements, without weight where the nominal robot fits them far worse.

    Than others of the same instrument: pixels may fit where positions are far off.
    """
    data, size = problem.data, np.sqrt(trimmed_errors(problem, thorough=True)[1])
    usual = np.ones(len(data))
    for model in {block.model for block in data.blocks}:
        of_model = np.array([b.model == model for b in data.blocks])[data.block_of]
        usual[of_model] = max(float(np.median(size[of_model])), 1.0)
    outlying = size > FAR * usual
    few = outlying.mean() <= SOME
    return data.weighted(np.where(outlying & few, 0.0, 1.0))


def subset(data: Observations) -> tuple[Observations, Indices]:
    """At most so many measurements, evenly over the files, and their places."""
    rank = np.argsort(data.in_order)
    if len(data) <= MEASUREMENTS:
        return data, rank
    ranks = np.linspace(0, len(data) - 1, MEASUREMENTS).astype(np.int64)
    chosen = np.isin(rank, ranks)
    return data.rows(chosen), rank[chosen]
