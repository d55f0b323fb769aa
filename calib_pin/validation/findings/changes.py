"""Changes at a row: a frame, or the zero of a joint, that differs from there on.

A frame is six columns of the Jacobian and a zero is one. In the order of the files
every row is tried as the first one behind a change: to first order the gain is a
likelihood ratio, and all rows together take as long as one (prefix sums). The best of
them divides the measurements, everything is fitted anew, and so on, as long as it pays
(binary segmentation).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import CalibPinError
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.problem import EXACT, Problem
from calib_pin.estimation.statistics.distributions import f_tail
from calib_pin.estimation.terms import FRAME, Term
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.readings import with_positions
from calib_pin.observations import (
    BlockKey,
    Booleans,
    Indices,
    Labels,
    Observations,
    apart,
)
from calib_pin.parameterizations.base import expected_size
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.joint_motions import refitted
from calib_pin.validation.findings.quick_fit import QuickFit

Kind = Literal["station", "tool", "joint"]
KINDS: tuple[Literal["station", "tool"], ...] = ("station", "tool")

CHANCE = 1e-6
"""Probability that noise explains as much as an alternative, all that are tried taken
together: the one level of significance of all that happens in the course of time."""

LEAST = 2.0 * np.log(CHANCE)
"""Logarithm of the likelihood that a change changes at least."""

CLEARER = 0.95
"""Part of the errors that its rivals leave that an alternative leaves at most."""

FURTHER = 4.0
"""Times the squares of a further change that one explains that stands out."""

LOOKED_AT = 0.76
"""Part of the squares that a change must leave at most, to first order, for a closer
look: of errors without a plateau that is as much and more."""

LARGE = 20.0
"""Errors of the nominal robot, in expected sizes, that are looked at closely in any
case: first order says little of them."""

LEFT, LAST = 1.0 / 3.0, 0.5
"""Parts of the errors that all changes together leave at most (a drift of the
instrument leaves one half with one frame more), and the last of them if it does not
stand out."""

SETTLED = 1.5
"""Errors that small changes leave at most, by those of the fit without what it has set
aside."""

CONFIGURATIONS, FULL, ASIDE = 6, 0.5, 0.25
"""Configurations and part of the rows of a stretch of the files, and part of all
measurements from which what was set aside is no outliers."""

SEEN = 1e-4
"""Part of what a change does that the fit cannot do, below which it is none."""

MOST, TRIED, ALIKE, STEPS = 10, 3, 0.5, 6
"""Changes that are sought; those that are fitted for each of them, if what they gain to
first order is this part of the most; and steps in which rows and sizes are found."""

WAYS, FEW = 5, 1.0 / 3.0
"""Shapes of a smooth error of a joint, and the part of the redundant values up to which
those of all joints are rivals."""

STILL, SAME = 0.1, 0.99
"""Change of a size, in its standard deviations, and part of the errors that the last
step leaves at least."""

UNKNOWNS = 500
"""Most parameters of a job that is looked at."""


class Change(NamedTuple):
    """What differs from some measurement on.

    Attributes:
        kind: Whose frame, or the zero of a joint.
        keys: Blocks that it concerns, before they are divided.
        rank: Place of the first measurement behind it, in the order of the files.
        joint: Column of the joint.
        size: How much farther that joint stands [rad, m].
    """

    kind: Kind
    keys: frozenset[BlockKey]
    rank: int = 0
    joint: int = 0
    size: float = 0.0


@dataclass(frozen=True)
class Job:
    """Measurements in the order of their files.

    Attributes:
        data: The measurements.
        rank: Place of each in that order among all of the job, shape (N,).
    """

    data: Observations
    rank: Indices

    @staticmethod
    def of(data: Observations) -> Job:
        """All measurements of a job, none of them set aside."""
        return Job(data.weighted(np.ones(len(data))), np.argsort(data.in_order))

    def rows(self, index: NDArray[np.generic]) -> Job:
        """Those of a mask, or of ascending positions."""
        return Job(self.data.rows(index), self.rank[index])

    def concerned(self, change: Change) -> Booleans:
        """Mask of the measurements that have what changes, shape (N,)."""
        has = np.array([key in change.keys for key in self.data.keys])
        return np.asarray(has[self.data.block_of])

    def changed(self, changes: Sequence[Change]) -> tuple[Job, Indices]:
        """The same with a name of its own for each frame, and joints where they stood.

        Returns:
            The measurements in their new blocks, and the position of each of these
            among what they were.
        """
        job, index = self, np.arange(len(self.data))
        for number, change in enumerate(changes):
            behind = job.concerned(change) & (job.rank >= change.rank)
            if change.kind == "joint":
                q = job.data.q.copy()
                q[behind, change.joint] += change.size
                job = replace(job, data=with_positions(job.data, q))
                continue
            names = Labels(("", f"~{number}"), behind.astype(np.int64))
            data, own = apart(job.data, change.kind, names)
            job, index = Job(data, job.rank[own]), index[own]
        return job, index


@dataclass(frozen=True)
class Trial(QuickFit):
    """Measurements with their changes, fitted.

    Attributes:
        job: The measurements without changes.
        changes: The changes, in the order in which they were found.
        fitted: The measurements with them.
    """

    job: Job
    changes: tuple[Change, ...]
    fitted: Job

    @staticmethod
    def at(plain: Problem, job: Job, changes: tuple[Change, ...]) -> Trial:
        """A fit of the chains and the setup of a problem, with changes at these rows.

        Raises:
            CalibPinError: If a part of the measurements cannot be registered.
            LinAlgError: If their errors have no derivative where the robot is.
        """
        own, _ = job.changed(changes)
        problem = make_problem(plain.chains, own.data, plain.setup)
        trial = Trial.of(problem, job=job, changes=changes, fitted=own)
        zeros = [k for k, change in enumerate(changes) if change.kind == "joint"]
        for _ in range(STEPS if zeros else 0):
            score = trial.score(np.hstack([trial.step(changes[k]) for k in zeros]))
            sized = [*trial.changes]
            for k, more in zip(zeros, score.values.tolist(), strict=True):
                sized[k] = sized[k]._replace(size=sized[k].size + more)
            own, _ = job.changed(sized)
            before, fit = trial.rms, refitted(trial, own.data)
            trial = replace(
                trial,
                theta=fit.theta,
                problem=fit.problem,
                changes=tuple(sized),
                fitted=own,
            )
            still = (np.abs(score.values) < STILL * score.deviations).all()
            if still and trial.rms > SAME * before:
                break
        return trial

    @staticmethod
    def settled(
        plain: Problem, job: Job, changes: tuple[Change, ...]
    ) -> Iterator[Trial]:
        """The trial of changes at the rows where both sides of each fit best.

        None where a part of the measurements cannot be registered.
        """
        try:
            trial = Trial.at(plain, job, changes)
            for _ in range(STEPS):
                moved = tuple(
                    change._replace(rank=trial.place(k, job))
                    for k, change in enumerate(trial.changes)
                )
                if moved == trial.changes:
                    break
                trial = Trial.at(plain, job, moved)
            yield trial
        except (CalibPinError, np.linalg.LinAlgError):
            return

    @property
    def cost(self) -> float:
        """Logarithm of its likelihood, by what its parameters are worth."""
        count = len(self.problem.layout.row)
        worth = -self.left * np.log(count)
        return float(count * np.log(max(squares(self), 1e-300)) + worth)

    @property
    def subjects(self) -> Iterator[Change]:
        """What may have changed."""
        data = self.problem.data
        for kind in KINDS:
            found: dict[str, list[Term]] = {}
            for term in self.problem.terms.values():
                found.setdefault(getattr(term.frames, kind), []).append(term)
            for terms in found.values():
                yield Change(kind, frozenset(term.key for term in terms))
        if not any(block.start.size for block in data.blocks):
            for joint in range(len(data.joints)):
                yield Change("joint", frozenset(data.keys), joint=joint)

    def columns(self, change: Change) -> Floats:
        """Whitened residual by what changes, if it does so everywhere, shape (M, k)."""
        if change.kind == "joint":
            return self.by_joints[:, [change.joint]]
        term = next(self.problem.terms[key] for key in change.keys)
        count = len(term.error.screws)
        own = term.index[:FRAME]
        if change.kind == "tool":
            own = term.index[:count][-FRAME:]
        own = own[self.problem.parameters.free[own]]
        concerned = self.fitted.concerned(change)[self.problem.layout.row]
        return np.asarray(self.linear[1][:, own] * concerned[:, None])

    def step(self, change: Change) -> Floats:
        """The same of what changes at its row."""
        behind = self.fitted.rank >= change.rank
        return self.columns(change) * behind[self.problem.layout.row, None]

    @property
    def candidates(self) -> list[tuple[float, float, Change]]:
        """The best row of each change, the likeliest first.

        With the logarithm of its likelihood, by what its parameters are worth, and the
        part of the sum of squares that it leaves to first order.
        """
        found, groups = [], self.problem.data.groups()
        for subject in self.subjects:
            columns = self.columns(subject)
            rows = np.flatnonzero(self.fitted.concerned(subject))
            rows = rows[np.argsort(self.fitted.rank[rows])]
            allowed = divisible(groups[rows])
            if not columns.shape[1] or not allowed.any():
                continue
            gain = np.where(allowed, self._gains(columns, rows), 0.0)
            best, count = int(np.argmax(gain)), len(columns)
            left = max(1.0 - gain[best], 1e-12)
            cost = count * np.log(left) + columns.shape[1] * np.log(count)
            at = subject._replace(rank=int(self.fitted.rank[rows[best]]))
            found.append((cost, left, at))
        return sorted(found, key=lambda candidate: candidate[0])

    def _gains(self, columns: Floats, rows: Indices) -> Floats:
        """Part of the squares that a change at each of some measurements explains.

        Args:
            columns: See `columns`.
            rows: The n measurements that it concerns, in the order of the files.
        """
        (Q, r), row = self.unexplained, self.problem.layout.row
        place = np.full(len(self.problem.data), -1)
        place[rows] = np.arange(len(rows))
        some = np.argsort(place[row], kind="stable")
        some = some[place[row[some]] >= 0]
        B, first = columns[some], np.flatnonzero(np.diff(row[some], prepend=-1))
        B = B / np.maximum(np.linalg.norm(B, axis=0), 1e-300)

        def after(values: Floats) -> Floats:
            return sums_behind(np.add.reduceat(values, first))

        g = after(B * r[some, None])
        C = after(Q[some][:, :, None] * B[:, None, :])
        G = after(B[:, :, None] * B[:, None, :]) - np.swapaxes(C, 1, 2) @ C
        sizes, V = np.linalg.eigh(G)
        # What the fit can do already leaves rounding.
        along = np.einsum("ni,nij->nj", g, V) ** 2
        gains = np.where(sizes > SEEN, along / np.maximum(sizes, SEEN), 0.0)
        return np.asarray(gains.sum(axis=1) / max(float(r @ r), 1e-300))

    def stands_out(self, before: Trial) -> bool:
        """Whether the last changes are more than all else that errors do in time.

        Of unmodeled errors along a path one change explains as much as the next.

        Args:
            before: The trial without these changes.
        """
        new = self.changes[len(before.changes) :]
        columns, left = before.columns(new[0]), squares(self)
        further = min((left for _, left, _ in self.candidates), default=1.0)
        if squares(before) - left < FURTHER * left * (1.0 - further):
            return False
        rivals = smooth(before, columns, before.fitted.rank)
        count, tried = len(new) * columns.shape[1], len(before.fitted.rank)
        return surpasses(before, left, count, rivals, tried)

    def concerned(self, k: int, job: Job) -> Indices:
        """Those of some measurements that a change concerns, in their order."""
        own, index = job.changed(self.changes[:k])
        found = index[own.concerned(self.changes[k])]
        return np.asarray(found[np.argsort(job.rank[found])])

    def place(self, k: int, job: Job) -> int:
        """The best rank of a change if nothing else does.

        Args:
            k: Position of the change.
            job: Measurements without changes among which it is sought.
        """
        change = self.changes[k]
        others = [other.rank for other in self.changes if other.rank != change.rank]
        first = max((at for at in others if at < change.rank), default=0)
        last = min((at for at in others if at > change.rank), default=np.inf)
        job = job.rows((job.rank >= first) & (job.rank < last))
        squares = np.zeros((2, len(job.data)))
        for side, at in enumerate((int(job.rank.max()) + 1, 0)):
            moved = change._replace(rank=at)
            own, index = job.changed((*self.changes[:k], moved, *self.changes[k + 1 :]))
            if any(key not in self.problem.terms for key in own.data.keys):
                return change.rank
            there = replace(self.problem, data=own.data)
            row = there.layout.row
            r = there.residual(self.theta)[: len(row)]
            r = np.where(np.isfinite(r), r, 1e6)
            squares[side, index] = np.bincount(row, r**2, len(index))
        mine = self.concerned(k, job)
        # Those before a row have the old one, the others the new one.
        old, new = squares[:, mine]
        total = np.cumsum(old) - old + sums_behind(new)
        allowed = divisible(job.data.groups()[mine])
        if not allowed.any():
            return change.rank
        return int(job.rank[mine[np.argmin(np.where(allowed, total, np.inf))]])


@serial_blas
def changes_of(case: Case) -> tuple[Trial, Trial] | None:
    """The measurements of a fit without changes, and with all that are found.

    None where nothing has changed.

    Args:
        case: The case; what its fit has set aside is looked at as well.
    """
    problem = case.fit.problem
    # Trials fit the robot's errors only where measurements tell them.
    fit = case.fit if case.fit.redundant else replace(case.fit, whole=False)
    if problem.parameters.free.sum() > UNKNOWNS or fit.rms < EXACT:
        return None
    data = problem.data
    job = Job(data.weighted(np.ones(len(data))), case.rank)
    plain = replace(problem, data=job.data, units=np.zeros(0))
    first = Trial(plain, case.fit.theta, job, (), job)
    sizes = (
        q.errors(case.nominal_table) / expected_size(q.unit)
        for q in problem.layout.quantities
    )
    large = any(np.sqrt(np.mean(size**2)) > LARGE for size in sizes)
    if not large and all(left > LOOKED_AT for _, left, _ in first.candidates):
        return None
    trials = list(Trial.settled(plain, job, ()))
    while 0 < len(trials) <= MOST:
        last = trials[-1]
        found = [(cost, change) for cost, _, change in last.candidates[:TRIED]]
        worth = min([ALIKE * cost for cost, _ in found] + [LEAST])
        tried = [change for cost, change in found if cost <= worth]
        fitted = [
            t for c in tried for t in Trial.settled(plain, job, (*last.changes, c))
        ]
        best = min(fitted, key=lambda trial: trial.cost, default=last)
        if not best.cost < last.cost + LEAST:
            break
        trials.append(best)
    while len(trials) > 1 and not (
        trials[-1].rms <= LAST * trials[-2].rms or trials[-1].stands_out(trials[-2])
    ):
        trials.pop()
    if len(trials) < 2:
        return None
    first, last = trials[0], trials[-1]
    if _few_aside(case) and fit.rms <= SETTLED * last.rms:
        return None
    # Outliers look like small moves; of these the fit without outliers leaves no more.
    if (last.rms <= LEFT * first.rms and last.stands_out(first)) or (
        last.rms <= SETTLED * fit.rms
        and all(b.stands_out(a) for a, b in pairwise(trials))
    ):
        return first, last
    return None


def squares(fit: QuickFit) -> float:
    """Sum of the squared errors of a fit, in standard deviations."""
    return fit.rms**2 * fit.left


def smooth(fit: QuickFit, columns: Floats, rank: Indices) -> Floats:
    """Columns of errors that are smooth in time, and of joints, in place as well.

    Args:
        fit: The fit.
        columns: Whitened residual by what may change, shape (M, k).
        rank: Place of each measurement in the order of the files, shape (N,).
    """
    row = fit.problem.layout.row
    time, q = (rank / max(int(rank.max()), 1))[row, None], fit.problem.data.q[row]
    found = [columns * time, columns * time**2]
    if WAYS * q.shape[1] < FEW * fit.left:
        shapes = (time, time**2, q, np.sin(q), np.cos(q))
        found += [fit.by_joints * shape for shape in shapes]
    return np.hstack(found)


def surpasses(
    fit: QuickFit, left: float, count: int, rivals: Floats, tried: int
) -> bool:
    """Whether an alternative explains more than chance and its rivals do.

    Args:
        fit: The fit without it.
        left: Sum of the squared errors that it leaves.
        count: Number of its parameters.
        rivals: Columns of what else may be, shape (M, k).
        tried: Number of alternatives among which it is the best.
    """
    dof, rest = fit.left - count, fit.left - rivals.shape[1]
    if min(dof, rest) < 1:
        return False  # There are too few measurements to compare.
    F = (squares(fit) - left) / count / max(left / dof, 1e-300)
    others = squares(fit) * fit.score(rivals).left / rest
    beyond = f_tail(F, count, dof) * tried < CHANCE
    return beyond and left / dof < CLEARER**2 * others


def is_stretch(data: Observations, rows: NDArray[np.generic]) -> bool:
    """Whether some measurements are one stretch of the files, and not of chance."""
    places = np.argsort(data.in_order)[rows]
    enough = len(np.unique(data.groups()[rows])) >= CONFIGURATIONS
    return enough and np.ptp(places) < len(places) / FULL


def _few_aside(case: Case) -> bool:
    """Whether what a fit has set aside is little, and no stretch of the files."""
    data = case.fit.problem.data
    out = data.weight == 0.0
    return bool(out.any() and out.mean() <= ASIDE and not is_stretch(data, out))


def sums_behind(values: Floats) -> Floats:
    """Sums of each value and all behind it, along the first axis."""
    return np.asarray(np.cumsum(values[::-1], axis=0)[::-1])


def divisible(labels: Indices) -> Booleans:
    """Whether there are enough configurations before each measurement and from it on.

    Args:
        labels: Label of the configuration of each, in their order, shape (n,).
    """

    def different(order: Indices) -> Indices:
        new = np.zeros(len(order), np.int64)
        new[np.unique(order, return_index=True)[1]] = 1
        return np.cumsum(new)

    before, after = different(labels), different(labels[::-1])
    enough = np.append(0, before[:-1]) >= CONFIGURATIONS
    return np.asarray(enough & (after[::-1] >= CONFIGURATIONS))
