"""Changes in the course of a job: at a row, or evenly.

A frame is six columns of the Jacobian and the zero of a joint is one. A change is a
step of these columns at a row. In the order of the files every row is tried as the
first one behind a change: to first order the gain is a likelihood ratio, and all rows
together take as long as one (prefix sums). The best of them divides the measurements,
everything is fitted anew, and so on, as long as it pays (binary segmentation). A drift
is a ramp of the same columns. It must explain more than other curves of about the same
smoothness do, cosines of two half waves and more over the files; a step more than bent
ramps.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any, Literal, NamedTuple

import numpy as np
import pinocchio as pin

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import CalibPinError
from calib_pin.estimation.evidence import Finding, Severity
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.identifiability import column_space
from calib_pin.estimation.problem import EXACT, Problem
from calib_pin.estimation.terms import FRAME
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.measurement_models.readings import place_of, with_positions
from calib_pin.observations import (
    FRAMES,
    BlockKey,
    Booleans,
    Indices,
    Labels,
    Observations,
    apart,
)
from calib_pin.parameterizations.base import COMPONENTS, expected_size
from calib_pin.parameterizations.drift import INCREMENTS, InstrumentDrift
from calib_pin.parameterizations.thermal import WarmUp
from calib_pin.setup import AXES, ReadingSetup
from calib_pin.validation.findings.alternatives import FITTED, Alternative, Explanation
from calib_pin.validation.findings.case import (
    CHANCE,
    FOREIGN,
    SOME,
    Case,
    QuickFit,
    Score,
    by_chance,
    fit_factors,
    squares,
    surpasses,
    unlikely,
)
from calib_pin.validation.findings.sentences import (
    finding,
    named,
    shown,
    with_sigma,
)

Kind = Literal["station", "tool", "joint"]

CHANGED: dict[Kind, tuple[str, str, str]] = {
    "station": ("instrument-moved", "the instrument{} moved", "moved"),
    "tool": ("tool-remounted", "the tool{} was re-mounted", "remounted"),
    "joint": ("joint-rehomed", "the zero of joint{} changed", ""),
}
"""Code and words of a change, and its key in the section `reading`, by what changes."""

LEAST = -2.0 * unlikely()
"""Change of the logarithm of the likelihood, doubled, that another change asks for."""

FURTHER = 4.0
"""How many times the squares of a further change a change explains."""

LOOKED_AT = 0.76
"""Part of the squares that a change leaves at most, to first order, for a closer look:
without a plateau it is as much and more."""

LEFT, SETTLED = 0.25, 1.5
"""Part of the errors that all changes leave at most where much was set aside, and that
another robot leaves (a drift of the instrument leaves one half with one frame more).
And errors that changes leave, by those of the fit without what it has set aside."""

CONFIGURATIONS, VALUES, ROBOT = 3, 3, 6
"""Least configurations on each side of a change of a frame, and values there by its
unknowns: it can follow one outlier of four positions, but not one of three poses. And
configurations on each side of a change of the robot or of one of its joints."""

SEEN = 1e-4
"""Part of what a change does that the fit cannot do, below which it is none."""

MOST, STEPS = 10, 6
"""Changes that are sought, and steps in which their rows are found."""

FEW = 1.0 / 3.0
"""Part of the redundant values up to which smooth errors of all joints are rivals."""

UNKNOWNS = 500
"""Most parameters of a job that is looked at."""

LASTING, NEAR, LARGE = 0.85, 1.1, 0.3
"""Part of the errors that a drift leaves at most if more than so many times the stated
noise is left:
what bends in real robots leaves 0.88 and more, drifts that cost twice the noise less
than 0.8. And errors that it causes, in expected sizes, from which it takes the trust,
if it leaves half of them at most; from as many a change does, whatever it leaves."""

WAVES = range(2, 10)
"""Half waves of the curves that it is compared with."""

TENTHS = np.linspace(0.1, 0.9, 9)
"""Places in the files at which what drifts may as well change at once."""


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

    @property
    def subject(self) -> tuple[Kind, frozenset[BlockKey], int]:
        """Kind, blocks and joint: all but the row and the size."""
        return self.kind, self.keys, self.joint


def subjects(problem: Problem) -> Iterator[Change]:
    """The frames and joint zeros that may change in a problem."""
    data = problem.data
    for kind in FRAMES:
        names = {k: getattr(term.frames, kind) for k, term in problem.terms.items()}
        for name in dict.fromkeys(names.values()):
            yield Change(kind, frozenset(k for k in names if names[k] == name))
    if not any(block.start.size for block in data.blocks):
        for joint in range(len(data.joints)):
            yield Change("joint", frozenset(data.keys), joint)


def concerned(data: Observations, change: Change) -> Booleans:
    """Mask of the measurements that have what changes, shape (N,)."""
    has = np.array([key in change.keys for key in data.keys])
    return np.asarray(has[data.block_of])


def with_changes(
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
    q, moved, index = data.q.copy(), data, np.arange(len(rank))
    for k, change in enumerate(changes, 1):
        behind = concerned(data, change) & (rank >= change.rank)
        if change.kind == "joint":
            q[behind, change.joint] += change.size
        else:
            names = Labels(("", f"~{k}"), behind[index].astype(np.int64))
            moved, rows = apart(moved, change.kind, names)
            index = index[rows]
    return with_positions(moved, q[index]), index


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

    def settled(self, changes: tuple[Change, ...]) -> Trial | None:
        """The trial of changes at the rows where both sides of each fit best.

        None where a part of the measurements cannot be registered.
        """
        try:
            for _ in range(STEPS):
                trial = self._at(changes)
                changes = tuple(
                    change._replace(rank=trial.place(k, self.plain.data, self.rank))
                    for k, change in enumerate(trial.changes)
                )
                if changes == trial.changes:
                    break
            return trial
        except (CalibPinError, np.linalg.LinAlgError):
            return None

    def _at(self, changes: tuple[Change, ...]) -> Trial:
        """A fit with changes at these rows."""
        plain, rank = self.plain, self.rank
        data, index = with_changes(plain.data, rank, changes)
        problem = make_problem(plain.chains, data, plain.setup)
        trial = Trial.of(problem, plain=plain, rank=rank, changes=changes, index=index)
        zeros = [change for change in changes if change.kind == "joint"]

        def sized(sizes: Floats) -> tuple[Change, ...]:
            of = dict(zip(zeros, sizes.tolist(), strict=True))
            return tuple(c._replace(size=of.get(c, 0.0)) for c in changes)

        trial, sizes = fit_factors(
            trial,
            np.array([change.size for change in zeros]),
            lambda fit: np.hstack([fit.step(change) for change in zeros]),
            lambda sizes: with_changes(plain.data, rank, sized(sizes))[0],
        )
        return replace(trial, changes=sized(sizes))

    def rows(self, change: Change) -> Indices:
        """The measurements that have what changes, in the order of the files."""
        rows = np.flatnonzero(concerned(self.plain.data, change)[self.index])
        return rows[np.argsort(self.rank[self.index[rows]])]

    def columns(self, change: Change) -> Floats:
        """Whitened residual by what changes, if it does so everywhere, shape (M, k)."""
        if change.kind == "joint":
            return self.by_joints[:, [change.joint]]
        data, ends = self.problem.data, set[tuple[int, ...]]()
        for block in np.unique(data.block_of[self.rows(change)]):
            term = self.problem.terms[data.keys[block]]
            screws = term.index[: len(term.error.screws)]
            end = screws[:FRAME] if change.kind == "station" else screws[-FRAME:]
            ends.add(tuple(end.tolist()))
        J = self.linear[1] * self.problem.parameters.free
        # Each measurement has one of these frames alone.
        X = sum((J[:, end] for end in ends), np.zeros((len(J), FRAME)))
        return X[:, X.any(axis=0)]

    def step(self, change: Change) -> Floats:
        """The same of what changes at its row."""
        behind = self.rank[self.index] >= change.rank
        return self.columns(change) * behind[self.problem.layout.row, None]

    def _least(self, change: Change, unknowns: int) -> int:
        """Least configurations on each side of a change with so many unknowns."""
        rows = self.rows(change)
        values = int(np.isin(self.problem.layout.row, rows).sum())
        configurations = len(np.unique(self.problem.data.groups()[rows]))
        few = ROBOT if change.kind == "joint" else CONFIGURATIONS
        return max(few, -(-VALUES * unknowns * configurations // max(values, 1)))

    @property
    def candidates(self) -> list[tuple[float, float, Change]]:
        """The best row of each change, the likeliest first.

        With the change of the likelihood, twice its negative logarithm and what its
        parameters are worth (BIC), and the part of the squares that it leaves, both to
        first order.
        """
        result = []
        for change in subjects(self.plain):
            columns, rows = self.columns(change), self.rows(change)
            if not columns.size:
                continue
            rank, (count, unknowns) = self.rank[self.index[rows]], columns.shape
            # What comes and goes within a few measurements is an outlier.
            cuts = sorted(c.rank for c in self.changes if c.subject == change.subject)
            places = np.searchsorted(rank, cuts).tolist()
            best, part = self.best(columns, rows, self._least(change, unknowns), places)
            cost = count * np.log(part) + unknowns * np.log(count)
            result.append((cost, part, change._replace(rank=int(rank[best]))))
        return sorted(result, key=lambda candidate: candidate[0])

    def best(
        self, columns: Floats, rows: Indices, least: int, cuts: Sequence[int] = ()
    ) -> tuple[int, float]:
        """Where a change explains most, and the part of the squares that it leaves.

        Args:
            columns: See `columns`.
            rows: The n measurements that it concerns, in the order of the files.
            least: Least configurations on each side of it.
            cuts: Places among these where it has other sides already.
        """
        (Q, r), row = self.unexplained, self.problem.layout.row
        place = np.full(len(self.problem.data), len(rows))
        place[rows] = np.arange(len(rows))
        order = np.argsort(place[row], kind="stable")[: np.sum(place[row] < len(rows))]
        B, first = columns[order], np.flatnonzero(np.diff(row[order], prepend=-1))
        B = B / np.maximum(np.linalg.norm(B, axis=0), 1e-300)

        def behind(values: Floats) -> Floats:
            return sums_behind(np.add.reduceat(values, first))

        g = behind(B * r[order, None])
        C = behind(Q[order][:, :, None] * B[:, None, :])
        G = behind(B[:, :, None] * B[:, None, :]) - np.swapaxes(C, 1, 2) @ C
        sizes, V = np.linalg.eigh(G)
        # What the fit can do already leaves rounding.
        along = np.einsum("ni,nij->nj", g, V) ** 2
        gains = np.where(sizes > SEEN, along / np.maximum(sizes, SEEN), 0.0).sum(axis=1)
        parts = np.split(self.problem.data.groups()[rows], cuts)
        allowed = np.concatenate([divisible(labels, least) for labels in parts])
        gains = np.where(allowed, gains, 0.0) / max(float(r @ r), 1e-300)
        return int(np.argmax(gains)), max(1.0 - float(gains.max()), 1e-12)

    def stands_out(self, before: Trial) -> bool:
        """Whether the last changes are more than all else that errors do in time.

        Of unmodeled errors along a path one change explains as much as the next.

        Args:
            before: The trial without these changes.
        """
        new, remaining = self.changes[len(before.changes) :], squares(self)
        further = min((part for _, part, _ in self.candidates), default=1.0)
        if squares(before) - remaining < FURTHER * remaining * (1.0 - further):
            return False
        columns, row = before.columns(new[0]), before.problem.layout.row
        time = (self.rank[before.index] / max(int(self.rank.max()), 1))[row, None]
        q, joints = before.problem.data.q[row], before.by_joints
        smooth = [joints * shape for shape in (time, time**2, q, np.sin(q), np.cos(q))]
        rivals = np.hstack([columns * time, columns * time**2, *smooth])
        if rivals.shape[1] >= FEW * before.dof:
            rivals = rivals[:, : 2 * columns.shape[1]]
        count = len(new) * columns.shape[1]
        return surpasses(before, remaining, count, rivals, len(self.rank))

    def place(self, k: int, data: Observations, rank: Indices) -> int:
        """The best rank of a change if nothing else does.

        Args:
            k: Position of the change.
            data: The measurements among which it is sought.
            rank: Place of each in the order of the files, shape (N,).
        """
        change = self.changes[k]
        ranks = [c.rank for c in self.changes if c.subject == change.subject]
        ends = sorted([0, *ranks, int(rank.max()) + 1])
        first, last = (ends[ends.index(change.rank) + side] for side in (-1, 1))
        squares = np.zeros((2, len(rank)))
        for side, at in enumerate((last, first)):
            others = [c._replace(rank=at) if c is change else c for c in self.changes]
            moved, index = with_changes(data, rank, others)
            if any(key not in self.problem.terms for key in moved.keys):
                return change.rank
            problem = replace(self.problem, data=moved)
            row = problem.layout.row
            r = problem.residual(self.theta)[: len(row)]
            r = np.where(np.isfinite(r), r, 1e6)
            squares[side, index] = np.bincount(row, r**2, len(index))
        within = concerned(data, change) & (rank >= first) & (rank < last)
        mine = np.flatnonzero(within)[np.argsort(rank[within])]
        # Those before a row have the old one, the others the new one.
        old, new = squares[:, mine]
        total = np.cumsum(old) - old + sums_behind(new)
        least = self._least(change, self.columns(change).shape[1])
        allowed = divisible(data.groups()[mine], least)
        allowed |= rank[mine] == change.rank
        return int(rank[mine[np.argmin(np.where(allowed, total, np.inf))]])


@serial_blas
def changes_of(case: Case, unchanged: Trial) -> tuple[Trial, Trial] | None:
    """The measurements of a fit without changes, and with all that are found.

    None where nothing has changed.

    Args:
        case: The case.
        unchanged: Its fit without changes, see `unchanged_fit`.
    """
    if all(part > LOOKED_AT for _, part, _ in unchanged.candidates):
        return None
    trials, trial = list[Trial](), unchanged.settled(())
    while trial is not None and (not trials or trial.rms < trials[-1].rms):
        trials.append(trial)
        likely = [change for gain, _, change in trial.candidates if gain < LEAST]
        more = likely and len(trials) <= MOST
        trial = unchanged.settled((*trial.changes, likely[0])) if more else None
    while len(trials) > 1 and not trials[-1].stands_out(trials[-2]):
        trials.pop()
    if len(trials) < 2:
        return None
    first, last = trials[0], trials[-1]
    # Outliers look like moves; of true ones the fit without outliers leaves no more, or
    # it has set aside more than outliers are.
    inliers = replace(case.fit, problem=replace(case.fit.problem, units=np.zeros(0)))
    limit = SETTLED * inliers.rms
    if np.mean(case.fit.problem.data.weight == 0.0) > SOME:
        limit = max(LEFT * first.rms, limit)
    return (first, last) if last.rms <= limit and last.stands_out(first) else None


def unchanged_fit(case: Case) -> Trial:
    """The fit of a case without changes, with what it has set aside."""
    problem, count = case.fit.problem, len(case.rank)
    data = problem.data.weighted(np.ones(count))
    plain = replace(problem, data=data, units=np.zeros(0))
    return Trial(plain, case.fit.theta, plain, case.rank, (), np.arange(count))


def sums_behind(values: Floats) -> Floats:
    """Sums of each value and all behind it, along the first axis."""
    return np.asarray(np.cumsum(values[::-1], axis=0)[::-1])


def divisible(labels: Indices, least: int) -> Booleans:
    """Whether there are enough configurations before each measurement and from it on.

    Args:
        labels: Label of the configuration of each, in their order, shape (n,).
        least: Number of those that are enough.
    """
    place, count = np.arange(len(labels)), len(labels)
    first = np.unique(labels, return_index=True)[1]
    last = count - 1 - np.unique(labels[::-1], return_index=True)[1]
    before = np.searchsorted(np.sort(first), place)
    behind = len(last) - np.searchsorted(np.sort(last), place)
    return np.asarray(np.minimum(before, behind) >= least)


def changes(case: Case) -> Explanation | None:
    """Frames and joint zeros that changed at a row, in their order, or all at once."""
    if case.fit.problem.parameters.free.sum() > UNKNOWNS or case.fit.rms < EXACT:
        return None
    unchanged = unchanged_fit(case)
    trials = changes_of(case, unchanged)
    if trials is None:
        return _another_robot(case, unchanged, LEFT) if case.doubtful else None
    (first, last), steps = trials, trials[1].changes
    part = last.rms / first.rms
    another = _another_robot(case, unchanged, max(LEFT, part))
    # Who moves an instrument homes no joint, and mounts no tool.
    places = np.searchsorted(np.sort(case.rank), [c.rank for c in steps])
    at_once = len({c.kind for c in steps}) > 1 and np.ptp(places) < CONFIGURATIONS
    if another and (at_once or another.part < FITTED * part):
        return another
    # Two or three things change on a bad day; more are what steps make of a drift.
    # Where what no robot has is left, there is another fault as well.
    foreign = last.errors > FOREIGN * expected_size(case.fit.quantity.unit)
    if foreign or len({c.subject for c in steps}) > 3:
        return None
    data = case.data.weighted(np.ones(len(case.data)))
    rank = np.argsort(data.in_order)
    # It may be a row that was not looked at.
    rows = [(last.place(k, data, rank), k) for k in range(len(steps))]
    faults = tuple(_change(case, last, k, at, rank) for at, k in sorted(rows))
    costly = _costs(case, first.errors, last.errors) > LARGE
    judged: Severity | None = "error" if costly else None
    return Explanation(faults, first.errors, last.errors, judged=judged)


def _costs(case: Case, before: float, after: float) -> float:
    """Errors that are caused by what leaves less of them, in expected sizes."""
    size = float(np.sqrt(max(before**2 - after**2, 0.0)))
    return size / expected_size(case.fit.quantity.unit)


def _change(case: Case, trial: Trial, k: int, at: int, rank: Indices) -> Alternative:
    """A change of a trial, with the row from which on it is there.

    Args:
        case: The case.
        trial: The trial of all changes.
        k: Position of the change among them.
        at: Place of the first measurement behind it, in the order of the files.
        rank: Place of every measurement, shape (N,).
    """
    data, change = case.data, trial.changes[k]
    kind, (code, words, key) = change.kind, CHANGED[change.kind]
    before, behind = _rows_around(concerned(data, change), rank, at).tolist()
    if kind == "joint":
        name = data.joints[change.joint]
        size = shown(abs(change.size), case.unit(name))
        numbers: dict[str, Any] = {"joint": name, "offset": change.size}
        advice = "measure anew, or calibrate what was measured before and behind apart"
    else:
        name = getattr(data.blocks[data.block_of[before]], kind)
        size, numbers = _frame(trial, k)
        advice = f"give the two parts different {kind}s (a column '{kind}')"
    lines: dict[str, Any] = {key: (place_of(data, behind),)} if key else {}
    owner = " at station" * (kind == "station") + f" '{name}'" if name else ""
    file, line = data.files[before], int(data.lines[before] or rank[before] + 1)
    where = f"after {named(data, [before])}"
    if data.files[behind] != file:
        where = f"between {file} and {data.files[behind]}"
    return Alternative(
        code,
        f"{words.format(owner)} {where} ({size})",
        f"{kind} {name}",
        ReadingSetup(**lines),
        advice=advice,
        figure="over-order",
        joint=name if kind == "joint" else "",
        numbers=numbers | {"file": file, "line": line},
    )


def _another_robot(case: Case, fit: Trial, most: float) -> Explanation | None:
    """Another robot, or whatever else was measured from some row on.

    All errors and frames are others there: to first order, each part has a fit of its
    own. Contacts fit to any robot, if it is small enough.

    Args:
        case: The case.
        fit: Its fit without changes.
        most: Part of the errors that it leaves at most.
    """
    columns = column_space(fit.linear[1][:, fit.problem.parameters.free])
    data, order, count = fit.problem.data, np.argsort(case.rank), columns.shape[1]
    best, remaining = fit.best(columns, order, ROBOT)
    dof = fit.dof - count
    if dof < 1 or any(declared(model).contact for model in case.data.models):
        return None
    part = float(np.sqrt(remaining * fit.dof / dof))
    if part > most or by_chance(1.0, remaining, count, dof) * len(order) > CHANCE:
        return None
    row = int(order[best - 1])
    fault = Alternative(
        "outlying-stretch",
        f"something else was measured after {named(data, [row])}, another robot say",
        "robot",
        advice="calibrate the two parts apart",
        figure="over-order",
        numbers={"file": data.files[row], "line": int(data.lines[row]) or best},
    )
    return Explanation((fault,), fit.errors, part * fit.errors, judged="error")


def _rows_around(mask: Booleans, rank: Indices, at: int) -> Indices:
    """The last of some measurements before a rank, and the first one from it on."""
    rows = np.flatnonzero(mask)[np.argsort(rank[mask])]
    return rows[np.searchsorted(rank[rows], at) + np.array([-1, 0])]


def _frame(trial: Trial, k: int) -> tuple[str, dict[str, float]]:
    """How far the frame of a change stands from where it stood."""
    change, data = trial.changes[k], trial.problem.data
    mask = concerned(trial.plain.data, change)[trial.index]
    rows = _rows_around(mask, trial.rank[trial.index], change.rank)
    terms = trial.problem.rebased(trial.theta)[0].terms
    before, behind = (terms[data.keys[k]] for k in data.block_of[rows])
    A, B = before.error.tool, behind.error.tool
    if change.kind == "station":
        # Where the instrument stands, in the base link.
        A, B = before.error.base.inverse(), behind.error.base.inverse()
    apart = A.inverse() * B
    distance = float(np.linalg.norm(apart.translation))
    size, vector = shown(distance, "m", 3), apart.translation.tolist()
    numbers = {"distance": distance}
    # Of a single point nobody knows how it is turned.
    if change.kind == "station" or len(before.measurement.quantities) > 1:
        vector += pin.log3(apart.rotation).tolist()
        numbers["angle"] = angle = float(np.linalg.norm(vector[3:]))
        size += f", {shown(angle, 'rad', 3)}"
    return size, numbers | dict(zip(COMPONENTS, vector, strict=False))


def drift(case: Case) -> Explanation | None:
    """A drift of the instrument or of the joints, whichever explains more."""
    fit, candidates = case.fit, []
    if not (case.informed and fit.rms > EXACT):
        return None
    time = (case.rank / max(int(case.rank.max()), 1))[fit.problem.layout.row, None]
    for fault_of, columns, names in _drifts(case):
        score, count = fit.score(columns * time), columns.shape[1]
        waves = np.hstack([columns * np.cos(np.pi * k * time) for k in WAVES])
        steps = (fit.score(columns * (time >= at)).remaining for at in TENTHS)
        stands_out = surpasses(fit, squares(fit) * score.remaining, count, waves)
        # What comes at once is no drift.
        if stands_out and score.remaining < min(steps):
            # One of more parts takes a part of what a simpler one explains.
            cost = fit.dof * np.log(score.remaining) + count * unlikely()
            candidates.append((cost, fault_of(case, score, names), columns * time))
    if not candidates:
        return None
    _, fault, ramp = min(candidates, key=lambda candidate: candidate[0])
    first, without = fit.problem.layout.component == 0, fit.explaining(ramp)
    rest, r = (f.unexplained[1][: len(first)][first] for f in (without, fit))
    before, part = fit.errors, float(np.linalg.norm(rest) / np.linalg.norm(r))
    noise = case.fitted.noise if case.fitted else ()
    known = [n.stated and part * n.estimate < NEAR * n.given for n in noise]
    if part > LASTING and not (known and all(known)):
        return None
    costly = _costs(case, before, part * before) > LARGE
    judged: Severity | None = None if costly else "warning"
    return Explanation((fault,), before, part * before, judged=judged)


FaultOf = Callable[[Case, Score, Sequence[str]], Alternative]
"""Makes the row of a drift from its score and the names of its columns."""

ALL_ALONG = "from the first measurement to the last"
ROAMS = f"the instrument drifts against the robot {ALL_ALONG}"

DRIFT = partial(Alternative, subject="time", figure="over-order")
"""A row of the table that is a drift."""


def _drifts(case: Case) -> Iterator[tuple[FaultOf, Floats, Sequence[str]]]:
    """The kinds of drift: what tells them, their columns and the names of these."""
    fit, problem, joints = case.fit, case.fit.problem, case.data.joints
    terms = [*problem.terms.values()]
    base = terms[0].index[:FRAME]
    values = {tuple(declared(model).columns)[:3] for model in case.data.models}
    if len({term.frames.station for term in terms}) == 1:
        J, scales = fit.linear[1][:, base], problem.parameters.scales[base]
        if problem.parameters.free[base].all():
            if values == {AXES}:
                rotation = terms[0].error.base.rotation
                yield _instrument_drift, J[:, :3] / scales[:3] @ rotation.T, AXES
            yield _instrument_drift, J, COMPONENTS
        elif values == {("distance",)}:
            yield _instrument_drift, 1.0 / problem.sigma[:, None], ("distance",)
    # Of few measurements one joint may stand out, but not six.
    for k in range(len(joints)):
        yield _joint_drift, fit.by_joints[:, [k]], joints[k : k + 1]
    yield _joint_drift, fit.by_joints, joints


def _instrument_drift(case: Case, score: Score, names: Sequence[str]) -> Alternative:
    """A displacement of what is measured can be taken out, one that also turns not."""
    families = ",".join((*case.setup.parameters, InstrumentDrift.name))
    advice = "measure the job in parts, each with an entry of its own in a column "
    advice += "'station', or when everything is warm; or estimate it: --parameters "
    advice += f"{families}, with a column 'time'"
    fault = DRIFT("instrument-drift", ROAMS, advice=advice)
    if names == COMPONENTS:
        return fault
    size = float(np.linalg.norm(score.values))
    sigma = float(np.linalg.norm(score.values / size * score.deviations))
    words = f"the measured values drift by {with_sigma(size, sigma, 'm')} {ALL_ALONG}"
    numbers = dict(zip(names, score.values.tolist(), strict=True))
    # Of distances it is one number.
    x, y, z = [*(float(f"{v:.3g}") for v in numbers.values()), 0.0, 0.0][:3]
    reading = ReadingSetup(drift=(x, y, z))
    numbers |= {"drift": size, "sigma": sigma}
    return replace(fault, words=words, reading=reading, numbers=numbers)


def _joint_drift(case: Case, score: Score, names: Sequence[str]) -> Alternative:
    """Joint positions that drift, as those of a robot that grows warm."""
    worst = int(np.argmax(np.abs(score.values) / score.deviations))
    value, sigma = float(score.values[worst]), float(score.deviations[worst])
    name, advice = names[worst], "let the robot warm up before it is measured"
    text = f"the joint positions drift {ALL_ALONG}, most of all '{name}' by "
    text += with_sigma(value, sigma, case.unit(name))
    numbers = {"joint": name, "drift": value, "sigma": sigma}
    return DRIFT("robot-drift", text, advice=advice, numbers=numbers)


def modeled_drift(case: Case) -> Iterator[Finding]:
    """How far every instrument went, and from where to where in the end."""
    if InstrumentDrift.name not in case.setup.parameters or case.fitted is None:
        return
    values = dict(zip(case.fit.problem.parameters.names, case.fit.theta, strict=True))
    for station, (first, last) in case.setup.drift.spans.items():
        name, steps = f"{station}.{InstrumentDrift.name}.", range(1, INCREMENTS + 1)
        rows = [[values.get(f"{name}{a}{k}", 0.0) for a in COMPONENTS] for k in steps]
        path = np.cumsum(rows, axis=0)
        shift, turn = (np.linalg.norm(path[:, k : k + 3], axis=1) for k in (0, 3))
        owner = "" if station == "base" else f" at station '{station}'"
        text = f"the instrument{owner} has drifted by {shown(shift[-1], 'm')} and "
        text += f"{shown(turn[-1], 'rad')} in {(last - first) / 60.0:.3g} min"
        numbers = {"station": station, "seconds": last - first}
        numbers |= {"shift": shift[-1], "turn": turn[-1]}
        numbers |= {"largest_shift": shift.max(), "largest_turn": turn.max()}
        yield finding("modeled-drift", text, numbers, info=True)


def modeled_warm_up(case: Case) -> Iterator[Finding]:
    """How far the tool moves as the robot warms up, rms where it was measured."""
    if WarmUp.name not in case.setup.parameters or case.fitted is None:
        return
    problem, thermal, moved = case.fit.problem, case.fit.problem.setup.thermal, []
    for block in problem.data.blocks:
        term = problem.terms[block.key]
        q, theta = block.q[:, term.columns], case.fit.theta[term.of_error]
        times = np.full(len(q), thermal.switched_on[0]), np.zeros(0)
        states = (replace(block.conditions, time=time) for time in times)
        bases = (term.error.basis(q, state) for state in states)
        cold, warm = (term.error.poses(q, theta, basis)[:, :3, 3] for basis in bases)
        moved.append(cold - warm)
    size = float(np.sqrt(np.mean(np.sum(np.concatenate(moved) ** 2, axis=1))))
    constant = thermal.warm_up_time or 0.0
    text = f"the cold robot has its tool {shown(size, 'm')} (rms) from where the warm "
    text += f"one has it, and covers 63 % of that in {constant / 60.0:.3g} min; the "
    text += "geometry is that of the warm robot"
    numbers = {"cold": size, "time_constant": constant}
    yield finding("modeled-warm-up", text, numbers, info=True)


MODELED = (modeled_drift, modeled_warm_up)
"""Remarks on drifts that are modeled."""
