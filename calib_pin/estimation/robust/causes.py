"""Causes that outliers have in common."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.problem import Problem, current_units
from calib_pin.estimation.robust.studentized import Studentized
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import AT, Observations


@dataclass(frozen=True)
class CauseOptions:
    """Limits from which outliers share a cause.

    Attributes:
        largest_share: Share of the rows of a target that must be out to blame the
            target.
        few: Rows below which a share says nothing.
        chance: Probability that so long a stretch comes about by chance.
        pairs: Rows among which exchanged pairs are sought; with more, that is not
            the trouble.
        fits: Part of its own size that the residual of an exchanged value may have;
            less where so many pairs of so few values fit as well by chance.
    """

    largest_share: float = 0.7
    few: int = 3
    chance: float = 0.01
    pairs: int = 100
    fits: float = 0.2


OPTIONS = CauseOptions()

_Causes: TypeAlias = Iterator[tuple[list[int], str]]


def causes(
    problem: Problem,
    theta: Floats,
    out: NDArray[np.bool_],
    found: Studentized,
    scale: Floats,
) -> dict[int, str]:
    """The cause that outliers share with each other, by row; most telling first.

    Args:
        problem: The fitted problem.
        theta: The solution, shape (P,).
        out: The outliers, shape (N,).
        found: Residuals about the solution.
        scale: Their scale by quantity, shape (Q,).
    """
    result: dict[int, str] = {}
    if not out.any():
        return result
    for rows, cause in (
        *_targets(problem, out),
        *_exchanged(problem, theta, out, found, scale),
        *_places(problem, out),
        *_stretches(problem, out),
        *_configurations(problem, out),
    ):
        for row in rows:
            result.setdefault(row, cause)
    return result


def _targets(problem: Problem, out: NDArray[np.bool_]) -> _Causes:
    """Targets most of whose rows are out, where those of others are not."""
    target = problem.data.target
    size = len(target.names)
    counts = np.bincount(target.codes, minlength=size)
    lost = np.bincount(target.codes[out], minlength=size)
    if np.count_nonzero(counts) < 2:
        return
    for k in np.flatnonzero(lost).tolist():
        others = (int(out.sum()) - lost[k]) / max(len(target) - counts[k], 1)
        most = max(OPTIONS.few, OPTIONS.largest_share * counts[k])
        if lost[k] >= most and others < 0.5 * OPTIONS.largest_share:
            rows = np.flatnonzero(out & (target.codes == k)).tolist()
            yield rows, f"target {target.names[k]}"


def _places(problem: Problem, out: NDArray[np.bool_]) -> _Causes:
    """The place, of several with sockets, at which most of what is out was measured."""
    from scipy.special import bdtrc

    target = problem.data.target
    names = [name.rpartition(AT)[2].rpartition("/")[0] for name in target.names]
    place = np.array(names)[target.codes]
    counts, lost = Counter(place.tolist()), Counter(place[out].tolist())
    name, number = lost.most_common(1)[0]
    share, total = counts[name] / len(place), int(out.sum())
    if not name or len(counts) < 2 or number < max(OPTIONS.few, 0.5 * total):
        return
    # Binomial: so many there if it were a place like the others.
    if bdtrc(number - 1, total, share) < OPTIONS.chance:
        yield np.flatnonzero(out & (place == name)).tolist(), f"place {name}"


def _stretches(problem: Problem, out: NDArray[np.bool_]) -> _Causes:
    """Runs of successive rows that are out, too long to be chance.

    Of N rows of which a share p is out, runs of length L are to be expected N p^L
    times.
    """
    data, share = problem.data, float(out.mean())
    labels, order = data.groups(), data.in_order
    edges = np.flatnonzero(np.diff(np.concatenate([[0], out[order], [0]]).astype(int)))
    for begin, end in edges.reshape(-1, 2).tolist():
        rows = order[begin:end]
        # Rows of one configuration are out together anyway.
        length = len(np.unique(labels[rows]))
        one_file = len(np.unique(data.files.codes[rows])) == 1
        unlikely = len(out) * share**length < OPTIONS.chance
        if one_file and length >= OPTIONS.few and unlikely:
            first, last = rows[0], rows[-1]
            where = f"rows {first} to {last}"
            if data.files[first]:
                where = f"lines {data.lines[first]} to {data.lines[last]}"
            yield rows.tolist(), where


def _configurations(problem: Problem, out: NDArray[np.bool_]) -> _Causes:
    """Configurations in which more than one measurement was taken, all of them out."""
    labels = problem.data.groups()
    sizes, lost = np.bincount(labels), np.bincount(labels, out)
    for label in np.flatnonzero((sizes > 1) & (lost == sizes)).tolist():
        rows = np.flatnonzero(labels == label).tolist()
        yield rows, f"configuration of {problem.data.source(rows[0])}"


def _exchanged(
    problem: Problem,
    theta: Floats,
    out: NDArray[np.bool_],
    found: Studentized,
    scale: Floats,
) -> _Causes:
    """Pairs of rows each of which fits what was measured in the other."""
    if not 2 <= out.sum() <= OPTIONS.pairs:
        return
    own, data = found.sizes(scale), problem.data
    units = scale * current_units(problem)
    sigma = problem.given_sigma * units[problem.layout.component]
    for block in problem.blocks:
        rows = np.flatnonzero(out[block.rows])
        if not block.data.values.shape[1] or len(rows) < 2:
            continue
        i, j = (rows[k] for k in np.triu_indices(len(rows), 1))
        labels, codes = found.labels[block.rows], block.data.target.codes
        alike = (codes[i] == codes[j]) & (labels[i] != labels[j])
        i, j = i[alike], j[alike]
        instrument = block.term.values(theta)[1]
        poses = block.term.poses(theta, block.data.rows(rows))
        fits = []
        for a, b in ((i, j), (j, i)):
            T = poses[np.searchsorted(rows, a)]
            there = replace(block.data.rows(a), values=block.data.values[b])
            with np.errstate(invalid="ignore", over="ignore"):
                r = block.term.measurement.residual(T, instrument, there)
                size = np.linalg.norm(r / block.table(sigma)[a], axis=1)
            # The parts of wrong values are anywhere in a ball of two pairs of values.
            by_chance = (OPTIONS.chance / max(len(i), 1)) ** (0.5 / r.shape[1])
            fits.append(size < min(OPTIONS.fits, by_chance) * own[block.rows][a])
        for k in np.flatnonzero(fits[0] & fits[1]).tolist():
            a, b = int(i[k]) + block.rows.start, int(j[k]) + block.rows.start
            yield [a], exchanged_with(data, b)
            yield [b], exchanged_with(data, a)


def exchanged_with(data: Observations, row: int) -> str:
    """The cause of an outlier whose values stand at another measurement."""
    return f"exchanged with {data.source(row)}"
