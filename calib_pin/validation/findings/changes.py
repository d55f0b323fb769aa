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
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import CalibPinError
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.problem import EXACT, Problem, measured_count
from calib_pin.estimation.statistics.distributions import f_tail
from calib_pin.estimation.terms import FRAME
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.readings import with_positions
from calib_pin.observations import (
    FRAMES,
    BlockKey,
    Booleans,
    Indices,
    Labels,
    Observations,
    apart,
)
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.joint_motions import refitted
from calib_pin.validation.findings.quick_fit import QuickFit

Kind = Literal["station", "tool", "joint"]

CHANCE = 1e-6
"""Probability that noise explains as much as an alternative, all rows taken together:
the one level of significance of what happens in the course of time."""

LEAST = 2.0 * np.log(CHANCE)
"""Change of the logarithm of the likelihood, doubled and negative, that it asks for."""

CLEARER, FURTHER = 0.95, 4.0
"""Part of the errors that its rivals leave that an alternative leaves at most, and how
many times the squares of a further change it explains."""

LOOKED_AT = 0.76
"""Part of the squares that a change leaves at most, to first order, for a closer look:
without a plateau it is as much and more."""

LEFT, SETTLED = 1.0 / 3.0, 1.5
"""Part of the errors that all changes leave at most (a drift of the instrument leaves
one half with one frame more), and errors that small ones leave, by those of the fit
without what it has set aside."""

CONFIGURATIONS = 6
"""Least configurations on each side of a change."""

SEEN = 1e-4
"""Part of what a change does that the fit cannot do, below which it is none."""

MOST, STEPS = 10, 6
"""Changes that are sought, and steps in which rows and sizes are found."""

STILL, SAME = 0.1, 0.99
"""Change of a size, in its standard deviations, and part of the errors that the last
step leaves at least."""

FEW = 1.0 / 3.0
"""Part of the redundant values up to which smooth errors of all joints are rivals."""

UNKNOWNS = 500
"""Most parameters of a job that is looked at."""


class Change(NamedTuple):
    """A frame, or the zero of a joint, that differs from some measurement on.

    Attributes:
        kind: Whose frame, or the zero of a joint.
        keys: Blocks that it concerns.
        joint: Column of the joint.
        rank: Place of the first measurement behind it, in the order of the files.
        size: How much farther that joint stands [rad, m].
    """

    kind: Kind
    keys: frozenset[BlockKey]
    joint: int = 0
    rank: int = 0
    size: float = 0.0


def subjects(problem: Problem) -> Iterator[Change]:
    """The frames and joint zeros that may change in a problem."""
    data = problem.data
    for kind in FRAMES:
        found: dict[str, list[BlockKey]] = {}
        for key, term in problem.terms.items():
            found.setdefault(getattr(term.frames, kind), []).append(key)
        for keys in found.values():
            yield Change(kind, frozenset(keys))
    if not any(block.start.size for block in data.blocks):
        for joint in range(len(data.joints)):
            yield Change("joint", frozenset(data.keys), joint)


def concerned(data: Observations, change: Change) -> Booleans:
    """Mask of the measurements that have what changes, shape (N,)."""
    has = np.array([key in change.keys for key in data.keys])
    return np.asarray(has[data.block_of])


def changed(
    data: Observations, rank: Indices, changes: Sequence[Change]
) -> tuple[Observations, Indices]:
    """Measurements with names of their own for frames, and joints where they stood.

    Args:
        data: The measurements.
        rank: Place of each in the order of the files, shape (N,).
        changes: What has changed.

    Returns:
        The measurements in their new blocks, and the position of each of these among
        what they were.
    """
    q, behind = data.q.copy(), np.zeros((len(FRAMES), len(rank)), int)
    for change in changes:
        own = concerned(data, change) & (rank >= change.rank)
        if change.kind == "joint":
            q[own, change.joint] += change.size
        else:
            behind[FRAMES.index(change.kind)] += own
    data, index = with_positions(data, q), np.arange(len(q))
    names = ("", *(f"~{k + 1}" for k in range(len(changes))))
    for kind, count in zip(FRAMES, behind, strict=True):
        data, rows = apart(data, kind, Labels(names, count[index]))
        index = index[rows]
    return data, index


@dataclass(frozen=True)
class Trial(QuickFit):
    """Measurements with their changes, fitted.

    Attributes:
        plain: The problem of these without changes.
        rank: Place of each in the order of the files, shape (N,).
        changes: The changes, in the order in which they were found.
        index: Position of each measurement in its new block among those, shape (N,).
    """

    plain: Problem
    rank: Indices
    changes: tuple[Change, ...]
    index: Indices

    @staticmethod
    def at(plain: Problem, rank: Indices, changes: tuple[Change, ...]) -> Trial:
        """A fit with changes at these rows.

        Raises:
            CalibPinError: If a part of the measurements cannot be registered.
            LinAlgError: If their errors have no derivative where the robot is.
        """
        data, index = changed(plain.data, rank, changes)
        problem = make_problem(plain.chains, data, plain.setup)
        trial = Trial.of(problem, plain=plain, rank=rank, changes=changes, index=index)
        zeros = [k for k, change in enumerate(changes) if change.kind == "joint"]
        for _ in range(STEPS if zeros else 0):
            before, sized = trial.rms, [*trial.changes]
            score = trial.score(np.hstack([trial.step(sized[k]) for k in zeros]))
            for k, more in zip(zeros, score.values.tolist(), strict=True):
                sized[k] = sized[k]._replace(size=sized[k].size + more)
            fit = refitted(trial, changed(plain.data, rank, sized)[0])
            trial = replace(
                trial, problem=fit.problem, theta=fit.theta, changes=tuple(sized)
            )
            still = (np.abs(score.values) < STILL * score.deviations).all()
            if still and trial.rms > SAME * before:
                break
        return trial

    def settled(self, changes: tuple[Change, ...]) -> Trial | None:
        """The trial of changes at the rows where both sides of each fit best.

        None where a part of the measurements cannot be registered.
        """
        try:
            for _ in range(STEPS):
                trial = Trial.at(self.plain, self.rank, changes)
                changes = tuple(
                    change._replace(rank=trial.place(k, self.plain.data, self.rank))
                    for k, change in enumerate(trial.changes)
                )
                if changes == trial.changes:
                    break
            return trial
        except (CalibPinError, np.linalg.LinAlgError):
            return None

    @cached_property
    def redundant(self) -> bool:
        """Whether errors of the robot are fitted: steps stand out of fewer values."""
        free = int(self.problem.parameters.free.sum())
        return measured_count(self.problem) > free

    def columns(self, change: Change) -> Floats:
        """Whitened residual by what changes, if it does so everywhere, shape (M, k)."""
        if change.kind == "joint":
            return self.by_joints[:, [change.joint]]
        data, row, own = self.problem.data, self.problem.layout.row, []
        for term in map(self.problem.terms.__getitem__, data.keys):
            screws = slice(len(term.error.screws) - FRAME, len(term.error.screws))
            own.append(term.index[slice(FRAME) if change.kind == "station" else screws])
        columns = np.array(own)[data.block_of[row]]
        seen = self.problem.parameters.free[columns]
        seen &= concerned(self.plain.data, change)[self.index][row, None]
        found = np.take_along_axis(self.linear[1], columns, axis=1) * seen
        return found[:, found.any(axis=0)]

    def step(self, change: Change) -> Floats:
        """The same of what changes at its row."""
        behind = self.rank[self.index] >= change.rank
        return self.columns(change) * behind[self.problem.layout.row, None]

    @property
    def candidates(self) -> list[tuple[float, float, Change]]:
        """The best row of each change, the likeliest first.

        With the change of the likelihood, twice its negative logarithm and what its
        parameters are worth (BIC), and the part of the squares that it leaves, both to
        first order.
        """
        found, rank, groups = [], self.rank[self.index], self.problem.data.groups()
        for subject in subjects(self.plain):
            columns = self.columns(subject)
            rows = np.flatnonzero(concerned(self.plain.data, subject)[self.index])
            rows = rows[np.argsort(rank[rows])]
            allowed = divisible(groups[rows])
            if not columns.size or not allowed.any():
                continue
            gain = np.where(allowed, self._gains(columns, rows), 0.0)
            best, count = int(np.argmax(gain)), len(columns)
            left = max(1.0 - gain[best], 1e-12)
            cost = count * np.log(left) + columns.shape[1] * np.log(count)
            found.append((cost, left, subject._replace(rank=int(rank[rows[best]]))))
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
        new, left = self.changes[len(before.changes) :], squares(self)
        further = min((left for _, left, _ in self.candidates), default=1.0)
        if squares(before) - left < FURTHER * left * (1.0 - further):
            return False
        columns, row = before.columns(new[0]), before.problem.layout.row
        time = (self.rank[before.index] / max(int(self.rank.max()), 1))[row, None]
        q, joints = before.problem.data.q[row], before.by_joints
        shapes = (time, time**2, q, np.sin(q), np.cos(q))
        rivals = np.hstack([columns * time, columns * time**2])
        smooth = np.hstack([rivals, *(joints * shape for shape in shapes)])
        if smooth.shape[1] < FEW * before.left:
            rivals = smooth
        count = len(new) * columns.shape[1]
        return surpasses(before, left, count, rivals, len(self.rank))

    def place(self, k: int, data: Observations, rank: Indices) -> int:
        """The best rank of a change if nothing else does.

        Args:
            k: Position of the change.
            data: The measurements among which it is sought.
            rank: Place of each in the order of the files, shape (N,).
        """
        change, others = self.changes[k], [*self.changes[:k], *self.changes[k + 1 :]]
        ranks = [c.rank for c in others if c[:3] == change[:3]]
        first = max((at for at in ranks if at <= change.rank), default=0)
        last = min((at for at in ranks if at > change.rank), default=rank.max() + 1)
        squares = np.zeros((2, len(rank)))
        for side, at in enumerate((last, first)):
            there, index = changed(data, rank, [*others, change._replace(rank=at)])
            if any(key not in self.problem.terms for key in there.keys):
                return change.rank
            problem = replace(self.problem, data=there)
            row = problem.layout.row
            r = problem.residual(self.theta)[: len(row)]
            r = np.where(np.isfinite(r), r, 1e6)
            squares[side, index] = np.bincount(row, r**2, len(index))
        within = concerned(data, change) & (rank >= first) & (rank < last)
        mine = np.flatnonzero(within)[np.argsort(rank[within])]
        # Those before a row have the old one, the others the new one.
        old, new = squares[:, mine]
        total = np.cumsum(old) - old + sums_behind(new)
        allowed = divisible(data.groups()[mine]) | (rank[mine] == change.rank)
        return int(rank[mine[np.argmin(np.where(allowed, total, np.inf))]])


@serial_blas
def changes_of(case: Case) -> tuple[Trial, Trial] | None:
    """The measurements of a fit without changes, and with all that are found.

    None where nothing has changed.

    Args:
        case: The case; what its fit has set aside is looked at as well.
    """
    fit, problem = case.fit, case.fit.problem
    if problem.parameters.free.sum() > UNKNOWNS or fit.rms < EXACT:
        return None
    data, rank = problem.data.weighted(np.ones(len(case.rank))), case.rank
    plain = replace(problem, data=data, units=np.zeros(0))
    seen = Trial(plain, fit.theta, plain, rank, (), np.arange(len(rank)))
    if all(left > LOOKED_AT for _, left, _ in seen.candidates):
        return None
    trials, more = list[Trial](), seen.settled(())
    while more is not None and (not trials or more.rms < trials[-1].rms):
        trials.append(more)
        likely = [change for gain, _, change in more.candidates if gain < LEAST]
        on = likely and len(trials) <= MOST
        more = seen.settled((*more.changes, likely[0])) if on else None
    while len(trials) > 1 and not trials[-1].stands_out(trials[-2]):
        trials.pop()
    if len(trials) < 2:
        return None
    first, last = trials[0], trials[-1]
    # Outliers look like small moves; of these the fit without outliers leaves no more.
    clear = last.rms <= max(LEFT * first.rms, SETTLED * fit.rms)
    return (first, last) if clear and last.stands_out(first) else None


def squares(fit: QuickFit) -> float:
    """Sum of the squared errors of a fit, in standard deviations."""
    return fit.rms**2 * fit.left


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

    before = np.append(0, different(labels)[:-1])
    behind = different(labels[::-1])[::-1]
    return np.asarray(np.minimum(before, behind) >= CONFIGURATIONS)
