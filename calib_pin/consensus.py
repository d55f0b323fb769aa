"""Registration that survives measurements which are wrong.

A closed-form registration of all rows is as wrong as the worst of them. Here it is made
from small random subsets of the configurations, each is improved by its better half
(concentration steps of least trimmed squares: Rousseeuw and Van Driessen, Computing LTS
regression for large data sets, 2006, section 3), and the one whose better half fits
best is taken. The errors of the nominal robot, millimeters, are noise to it.
"""

from __future__ import annotations

from dataclasses import replace
from math import ceil, log

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import CalibPinError
from calib_pin.problem import Problem
from calib_pin.spatial import Floats

__all__ = ["consensus"]

TRIALS = 30
"""Most subsets; with four of ten configurations spoiled, concentration leads most
subsets to the right half, and 30 miss it once in many thousand times."""

MISSED = 1e-3
"""Probability to have met no subset without a spoiled configuration."""

ROWS = 300
"""Rows that are looked at; more do not make a better start."""

CONCENTRATIONS = 2
"""Steps from a subset to its better half; they gain little after the second."""

INLIER = 9.0
"""Squares, in medians, up to which a row agrees with a registration."""


def consensus(problem: Problem, rng: np.random.Generator) -> Problem:
    """The problem about references that most of its rows agree with.

    Every target keeps half of its own rows, for without them nothing says where it is.

    Args:
        problem: The problem, with the robot at nominal.
        rng: Random generator of the subsets.
    """
    few = replace(problem, data=problem.data.sample(ROWS))
    theta = np.zeros(len(problem.parameters))
    targets = _targets(few)
    size = _subset(few, len(targets))
    best, least = problem, np.inf
    trials, tried = float(TRIALS), 0
    while tried < min(trials, TRIALS):
        tried += 1
        rows = _drawn(few, targets, size, rng)
        squares = np.full(len(few.data), np.inf)
        about = None
        for _ in range(1 + CONCENTRATIONS):
            try:
                about = replace(few, data=few.data.rows(rows)).register(theta)
            except (CalibPinError, np.linalg.LinAlgError):
                # Such a subset does not say where everything is.
                break
            squares = _squares(replace(about, data=few.data), theta)
            rows = np.sort(
                np.concatenate(
                    [own[np.argsort(squares[own], kind="stable")[: _half(own)]]
                     for own in targets]
                )
            )
        if about is None:
            continue
        total = float(squares[rows].sum())
        if total < least:
            best, least = replace(about, data=problem.data), total
            agree = squares <= INLIER * np.median(squares)
            clean = float(agree.mean()) ** (size * len(targets))
            trials = log(MISSED) / log(1.0 - clean) if 0.0 < clean < 1.0 else TRIALS
    return best


def _targets(problem: Problem) -> list[NDArray[np.intp]]:
    """The rows of each target."""
    names = np.array(problem.data.target)
    return [np.flatnonzero(names == name) for name in dict.fromkeys(names.tolist())]


def _subset(problem: Problem, targets: int) -> int:
    """Rows of each target in a subset: one more than what is unknown needs."""
    unknown = int((problem.parameters.free & problem.parameters.nuisance).sum())
    values = max(problem.values / max(len(problem.data), 1), 1.0)
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


def _half(rows: NDArray[np.intp]) -> int:
    """How many rows are the better half."""
    return max(ceil(0.5 * len(rows)), min(len(rows), 3))


def _squares(problem: Problem, theta: Floats) -> Floats:
    """Sum of whitened squares of each row, shape (N,); infinite if not predicted."""
    with np.errstate(over="ignore", invalid="ignore"):
        r = problem.errors(theta) / problem.sigma
        squares = np.where(np.isfinite(problem.sigma), r**2, 0.0).sum(axis=1)
    return np.where(np.isfinite(squares), squares, np.inf)
