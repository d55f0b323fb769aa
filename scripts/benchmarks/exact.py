"""Problems of noise-free measurements."""

from __future__ import annotations

from dataclasses import replace

from calib_pin.estimation.nominal import unmeasured
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import (
    UNSTATED,
    Conditions,
    Measurements,
    Observations,
    Targets,
)


def exact_problem(
    problem: Problem,
    theta: Floats,
    q: Floats,
    target: Targets,
    start: Floats | None = None,
    conditions: Conditions = UNSTATED,
) -> Problem:
    """The problem with noise-free measurements of its first block elsewhere.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).
        q: Joint positions, shape (K, n) [rad, m].
        target: Target of each measurement.
        start: Where relative measurements start, shape (K, n); default the
            configuration before each.
        conditions: What holds at each, as for `unmeasured`.
    """
    at = unmeasured(problem, problem.only.key, q, target, conditions, start)
    return exact_at(problem, theta, at)


def exact_at(problem: Problem, theta: Floats, *at: Measurements) -> Problem:
    """The problem with noise-free measurements at configurations of its blocks.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).
        at: Measurements of each block.
    """
    exact = [replace(block, values=problem.predict(theta, block)) for block in at]
    return replace(problem, data=Observations.of(*exact))
