"""Instruments that were moved, and tools that were mounted again, during a job.

Measurements before and after a move have frames of their own; with one frame for both
the errors have a plateau. In the order of the files every line is tried as the one
after which a frame differs: to first order the gain of a second frame is a likelihood
ratio, and all lines together take as long as one (prefix sums). The best of them
divides the measurements, everything is fitted anew, and so on, as long as it pays
(binary segmentation).
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import CalibPinError
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.problem import EXACT, Problem, error_table
from calib_pin.estimation.statistics.distributions import f_tail
from calib_pin.estimation.terms import FRAME, Term
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Indices
from calib_pin.parameterizations.base import expected_size
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.file_order import KINDS, Job, Kind, Move
from calib_pin.validation.findings.quick_fit import QuickFit


@dataclass(frozen=True)
class MoveOptions:
    """Limits of what counts as a move.

    Attributes:
        looked_at: Part of the errors that a further frame must leave at most, to first
            order, for a closer look: of errors without a plateau 0.88 and more.
        large: Errors of the nominal robot, in expected sizes, that are looked at
            closely in any case: first order says little of them.
        left: Part of the errors that all moves together leave at most. A drift of the
            instrument, which is no move, leaves one half with one frame more.
        each: Part that each of them leaves at most, while there may be more: of two
            tools in turn most moves explain little before the last of them is found.
        last: Part that the last of them leaves at most, if it does not stand out.
        further: Times the squares of a further move that one explains that stands out.
        bent: Part of what a drift in a bent curve leaves that it leaves at most.
        chance: Probability that noise explains as much.
        settled: Errors that small ones leave at most, by those of the fit without what
            it has set aside.
        configurations: Least number of configurations on each side.
        aside: Part of the measurements that may be outliers.
        measurements: Measurements that are looked at; the line is found among all.
        moves: Most moves that are sought.
        tried: Most frames that are tried for each of them.
        rounds: Most corrections of the place of each of them.
        seen: Part of what a change does that the fit cannot do, below which it is none.
        unknowns: Most parameters of a job that is looked at.
    """

    looked_at: float = 0.87
    large: float = 20.0
    left: float = 1.0 / 3.0
    each: float = 0.97
    last: float = 0.5
    further: float = 4.0
    bent: float = 0.9
    chance: float = 1e-6
    settled: float = 1.5
    configurations: int = 6
    aside: float = 0.25
    measurements: int = 300
    moves: int = 10
    tried: int = 3
    rounds: int = 4
    seen: float = 1e-4
    unknowns: int = 500


OPTIONS = MoveOptions()


@dataclass(frozen=True)
class Trial(QuickFit):
    """Measurements with a frame of their own behind every move, fitted.

    Attributes:
        job: The measurements, not divided.
        moves: The moves, in the order in which they divide the measurements.
        rank: Place of each divided measurement in the order of the files, shape (N,).
    """

    job: Job
    moves: tuple[Move, ...]
    rank: Indices

    @staticmethod
    def divided(plain: Problem, job: Job, moves: tuple[Move, ...]) -> Trial:
        """Measurements of the chains and the setup of a problem, fitted.

        Raises:
            CalibPinError: If a part of the measurements cannot be registered.
        """
        own, _ = job.divided(moves)
        problem = make_problem(plain.chains, own.data, plain.setup)
        return Trial.of(problem, job=job, moves=moves, rank=own.rank)

    def candidates(self) -> list[tuple[float, Move]]:
        """The best place of a move of each frame, the best first.

        With the part of the sum of squares that it leaves to first order.
        """
        (_, b), (Q, r) = self.system, self.unexplained
        data, groups, found = self.problem.data, self.problem.data.groups(), []
        for kind, keys, own in self._frames():
            has = np.array([block.key in keys for block in data.blocks])
            rows = np.flatnonzero(has[data.block_of])
            rows = rows[np.argsort(self.rank[rows])]
            allowed = divisible(groups[rows])
            if allowed.any():
                gain = np.where(allowed, self._gains(Q, r, own, rows), 0.0)
                best = int(np.argmax(gain))
                left = 1.0 - gain[best] / max(float(b @ b), 1e-300)
                found.append((left, Move(kind, keys, int(self.rank[rows[best]]))))
        return sorted(found, key=lambda candidate: candidate[0])

    def _frames(self) -> Iterator[tuple[Kind, frozenset[BlockKey], NDArray[np.intp]]]:
        """Frames that may have moved: their blocks and free parameters."""
        for kind in KINDS:
            found: dict[str, list[Term]] = {}
            for term in self.problem.terms.values():
                found.setdefault(getattr(term.frames, kind), []).append(term)
            for terms in found.values():
                index, count = terms[0].index, len(terms[0].error.screws)
                own = index[:FRAME] if kind == "station" else index[:count][-FRAME:]
                own = own[self.problem.parameters.free[own]]
                if len(own):
                    yield kind, frozenset(term.key for term in terms), own

    def _gains(self, Q: Floats, r: Floats, own: Indices, rows: Indices) -> Floats:
        """Squares that another frame from each of some measurements on explains.

        Args:
            Q: Orthonormal basis of what is explained already, shape (M', k).
            r: What that leaves, shape (M',).
            own: Positions of the parameters of the frame.
            rows: Its measurements in the order of the files, shape (n,).
        """
        row, J = self.problem.layout.row, self.linear[1]
        place = np.full(len(self.problem.data), -1)
        place[rows] = np.arange(len(rows))
        some = np.argsort(place[row], kind="stable")
        some = some[place[row[some]] >= 0]
        B, first = J[np.ix_(some, own)], np.flatnonzero(np.diff(row[some], prepend=-1))

        def after(values: Floats) -> Floats:
            summed = np.add.reduceat(values, first)
            return sums_behind(summed)

        g = after(B * r[some, None])
        C = after(Q[some][:, :, None] * B[:, None, :])
        G = after(B[:, :, None] * B[:, None, :]) - np.swapaxes(C, 1, 2) @ C
        inverse = np.linalg.pinv(G, rcond=1e-8, hermitian=True)
        return np.asarray(np.einsum("ni,nij,nj->n", g, inverse, g))

    def plain(self, before: Trial) -> bool:
        """Whether the last move stands out from all else that errors do in time.

        It explains more than a drift in a bent curve, and far more than a further move
        would: of unmodeled errors along a path one explains about as much as another.

        Args:
            before: The trial without this move.
        """
        squares, left = before.rms**2 * before.left, self.rms**2 * self.left
        rest = next((rest for rest, _ in self.candidates()), 1.0)
        gain, further = squares - left, left * (1.0 - rest)
        own = next(
            own for _, keys, own in before._frames() if keys == self.moves[-1].keys
        )
        time = before.rank[before.problem.layout.row] / len(before.rank)
        columns = before.linear[1][:, own]
        bent = np.hstack([columns * time[:, None] ** k for k in (1, 2)])
        return (
            self.left > 0
            and gain > OPTIONS.further * further
            and left < OPTIONS.bent * squares * before.score(bent).left
            and f_tail((gain / FRAME) / (left / self.left), FRAME, self.left)
            < OPTIONS.chance / len(before.rank)
        )

    def concerned(self, k: int, job: Job) -> Indices:
        """Those of some measurements that have the frame of a move, in their order."""
        own, index = job.divided(self.moves[:k])
        has = np.array([block.key in self.moves[k].keys for block in own.data.blocks])
        found = index[has[own.data.block_of]]
        return np.asarray(found[np.argsort(job.rank[found])])

    def place(self, k: int, job: Job) -> int:
        """The best rank of a move if nothing else changes.

        Args:
            k: Position of the move.
            job: Measurements, not divided, among which it is sought.
        """
        move = self.moves[k]
        others = [other.rank for other in self.moves if other.rank != move.rank]
        first = max((at for at in others if at < move.rank), default=0)
        last = min((at for at in others if at > move.rank), default=np.inf)
        job = job.rows((job.rank >= first) & (job.rank < last))
        squares = np.zeros((2, len(job.data)))
        for side, at in enumerate((int(job.rank.max()) + 1, 0)):
            moves = [*self.moves[:k], move._replace(rank=at), *self.moves[k + 1 :]]
            own, index = job.divided(moves)
            if any(key not in self.problem.terms for key in own.data.keys):
                return move.rank
            there = replace(self.problem, data=own.data)
            row = there.layout.row
            r = there.residual(self.theta)[: len(row)]
            r = np.where(np.isfinite(r), r, 1e6)
            squares[side, index] = np.bincount(row, r**2, len(index))
        mine = self.concerned(k, job)
        # Those before a place have the old frame, the others the new one.
        old, new = squares[:, mine]
        total = np.cumsum(old) - old + sums_behind(new)
        allowed = divisible(job.data.groups()[mine])
        if not allowed.any():
            return move.rank
        return int(job.rank[mine[np.argmin(np.where(allowed, total, np.inf))]])


@serial_blas
def moved(case: Case) -> tuple[Trial, Trial] | None:
    """The measurements of a fit with one frame, and with one behind every move.

    None where nothing has moved.

    Args:
        case: The case; what its fit has set aside is looked at as well.
    """
    problem = case.fit.problem
    # Trials fit the robot's errors only where measurements tell them.
    fit = case.fit if case.fit.redundant else replace(case.fit, whole=False)
    if problem.parameters.free.sum() > OPTIONS.unknowns or fit.rms < EXACT:
        return None
    job = Job.of(case.data).sample(OPTIONS.measurements)
    plain = replace(problem, data=job.data, units=np.zeros(0))
    whole = len(job.data) == len(problem.data)
    nominal = case.nominal_table if whole else error_table(plain, case.nominal)
    if not _suspicious(Trial(plain, case.fit.theta, job, (), job.rank), nominal):
        return None
    trials = list(_settled(plain, job, ()))
    while 0 < len(trials) <= OPTIONS.moves:
        last = trials[-1]
        tried = [move for _, move in last.candidates()[: OPTIONS.tried]]
        found = [t for m in tried for t in _settled(plain, job, (*last.moves, m))]
        best = min(found, key=lambda trial: trial.rms, default=last)
        if not best.rms <= OPTIONS.each * last.rms:
            break
        trials.append(best)
    if not trials:
        return None
    while len(trials) > 1 and not (
        trials[-1].rms <= OPTIONS.last * trials[-2].rms or trials[-1].plain(trials[-2])
    ):
        trials.pop()
    first, last = trials[0], trials[-1]
    if _few_aside(case) and fit.rms <= OPTIONS.settled * last.rms:
        return None
    if last.rms <= OPTIONS.left * first.rms:
        return first, last
    # Outliers look like small moves; of these the fit without outliers leaves no more.
    settled = last.rms <= OPTIONS.settled * fit.rms
    small = settled and len(trials) > 1
    small = small and all(b.plain(a) for a, b in pairwise(trials))
    return (first, last) if small else None


def _few_aside(case: Case) -> bool:
    """Whether a fit has set aside some measurements that are no stretch of the files.

    Fewer than a move concerns, or a small part that stands scattered.
    """
    data = case.fit.problem.data
    out = data.weight == 0.0
    if not out.any():
        return False
    few = len(np.unique(data.groups()[out])) < OPTIONS.configurations
    places = np.flatnonzero(out[np.argsort(case.rank)])
    scattered = np.ptp(places) > 2 * len(places)
    return few or bool(scattered and out.mean() <= OPTIONS.aside)


def _suspicious(trial: Trial, nominal: Floats) -> bool:
    """Whether some errors look like a plateau, or are large altogether.

    Args:
        trial: The measurements with the solution of a fit.
        nominal: Errors of the registered nominal robot, shape (N, D).
    """
    if any(left < OPTIONS.looked_at**2 for left, _ in trial.candidates()):
        return True
    return any(
        np.sqrt(np.mean(q.errors(nominal) ** 2)) > OPTIONS.large * expected_size(q.unit)
        for q in trial.problem.layout.quantities
    )


def _settled(plain: Problem, job: Job, moves: tuple[Move, ...]) -> Iterator[Trial]:
    """The trial of some moves, all of them where both of their frames fit best.

    None where a part of the measurements cannot be registered.
    """
    try:
        trial = Trial.divided(plain, job, moves)
        for _ in range(OPTIONS.rounds):
            places = [trial.place(k, job) for k in range(len(moves))]
            moves = tuple(
                m._replace(rank=k) for m, k in zip(moves, places, strict=True)
            )
            if moves == trial.moves:
                break
            trial = Trial.divided(plain, job, moves)
        yield trial
    except (CalibPinError, np.linalg.LinAlgError):
        return


def sums_behind(values: Floats) -> Floats:
    """Sums of each value and all behind it, along the first axis."""
    return np.asarray(np.cumsum(values[::-1], axis=0)[::-1])


def divisible(labels: Indices) -> NDArray[np.bool_]:
    """Whether there are enough configurations before each measurement and from it on.

    Args:
        labels: Label of the configuration of each, in their order, shape (n,).
    """

    def different(order: Indices) -> Indices:
        new = np.zeros(len(order), np.int64)
        new[np.unique(order, return_index=True)[1]] = 1
        return np.cumsum(new)

    before, after = different(labels), different(labels[::-1])
    least = OPTIONS.configurations
    return np.asarray((np.append(0, before[:-1]) >= least) & (after[::-1] >= least))
