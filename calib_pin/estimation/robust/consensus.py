"""Registration that survives measurements which are wrong.

A closed-form registration of all rows is as wrong as the worst of them. Here it is made
from small random subsets of the configurations, each is improved by its better half
(concentration steps of least trimmed squares: Rousseeuw and Van Driessen, Computing LTS
regression for large data sets, 2006, section 3), until two of them agree; the one whose
better half fits best is taken. The errors of the nominal robot, millimeters, are noise
to it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import CalibPinError
from calib_pin.estimation.problem import Problem, measured_count
from calib_pin.estimation.registration import registered
from calib_pin.kinematics.spatial import Floats


@dataclass(frozen=True)
class ConsensusOptions:
    """Limits of the search for a consensus.

    Attributes:
        trials: Most subsets; one in ten is free of wrong configurations if four
            of ten are.
        same: Relative difference in squares of two that agree: a nominal robot's
            errors make many minima close to the right one, and the wrong ones are
            far off.
        measurements: Measurements that are looked at; more do not make a better start.
        corners: The same of corners in images.
        images: Images of a subset: three tell where a camera is, and its intrinsics.
        agreements: Agreements of such subsets, of which two that are wrong may agree.
        concentrations: Steps from a subset to its better half: the weights that
            follow do the rest.
    """

    trials: int = 30
    same: float = 0.5
    measurements: int = 200
    corners: int = 2000
    images: int = 5
    agreements: int = 3
    concentrations: int = 1


OPTIONS = ConsensusOptions()


def consensus(problem: Problem, rng: np.random.Generator) -> Problem:
    """The problem about references that most of its rows agree with.

    Every target keeps half of its own rows, for without them nothing says where it is.

    Args:
        problem: The problem, with the robot at nominal.
        rng: Random generator of the subsets.
    """
    images = all(b.term.measurement.declaration.separable for b in problem.blocks)
    count = OPTIONS.corners if images else OPTIONS.measurements
    few = replace(problem, data=problem.data.sample(count))
    things = few.data.things()
    _, first = np.unique(things, return_index=True)
    targets = [np.flatnonzero(things == things[k]) for k in np.sort(first)]
    size = _subset(few, len(targets))
    best, least, agreed = problem, np.inf, 0
    for _ in range(OPTIONS.trials):
        drawn = _images(few, rng) if images else _drawn(few, targets, size, rng)
        about, total = _concentrated(few, drawn, targets)
        if about is None:
            continue
        agreed += abs(total - least) <= OPTIONS.same * least < np.inf
        if total < least:
            best, least = about, total
        if agreed >= (OPTIONS.agreements if images else 1):
            break
    return problem.with_terms(best.terms)


def _concentrated(
    problem: Problem, rows: NDArray[np.intp], targets: list[NDArray[np.intp]]
) -> tuple[Problem | None, float]:
    """Register by some rows, then by the better half of each target, until it stands.

    Returns:
        The problem about its references, and the squares of its better half; None
        where the rows do not say where everything is.
    """
    theta = np.zeros(len(problem.parameters))
    about, total = None, np.inf
    for _ in range(1 + OPTIONS.concentrations):
        try:
            found = registered(replace(problem, data=problem.data.rows(rows)), theta)
        except (CalibPinError, np.linalg.LinAlgError):
            break
        about, before = replace(found, data=problem.data), rows
        squares = _squares(about, theta)
        rows = np.sort(np.concatenate([_better(squares, own) for own in targets]))
        total = float(squares[rows].sum())
        if np.array_equal(rows, before):
            break
    return about, total


def _better(squares: Floats, rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """The half of some rows that has the smaller squares, and at least three."""
    count = max(ceil(0.5 * len(rows)), min(len(rows), 3))
    return rows[np.argsort(squares[rows], kind="stable")[:count]]


def _subset(problem: Problem, targets: int) -> int:
    """Rows of each target in a subset: one more than what is unknown needs."""
    unknown = int((problem.parameters.free & problem.parameters.nuisance).sum())
    values = max(measured_count(problem) / max(len(problem.data), 1), 1.0)
    return max(ceil(unknown / (values * targets)) + 1, 3)


def _drawn(
    problem: Problem,
    targets: list[NDArray[np.intp]],
    size: int,
    rng: np.random.Generator,
) -> NDArray[np.intp]:
    """Random rows of every target, of different configurations where there are."""
    labels = problem.data.groups()
    chosen = []
    for own in targets:
        order = rng.permutation(own)
        _, first = np.unique(labels[order], return_index=True)
        chosen.append(order[np.sort(first)][:size])
    return np.sort(np.concatenate(chosen))


def _images(problem: Problem, rng: np.random.Generator) -> NDArray[np.intp]:
    """Rows of some random images: each tells a pose by all its corners."""
    chosen = rng.permutation(problem.data.configurations)[: OPTIONS.images]
    return np.flatnonzero(np.isin(problem.data.groups(), chosen))


def _squares(problem: Problem, theta: Floats) -> Floats:
    """Sum of whitened squares of each row, shape (N,); infinite if not predicted."""
    with np.errstate(over="ignore", invalid="ignore"):
        r = problem.errors(theta) / problem.sigma
        r = np.where(np.isfinite(problem.sigma), r**2, 0.0)
        squares = np.bincount(problem.layout.row, r, len(problem.data))
    return np.where(np.isfinite(squares), squares, np.inf)
