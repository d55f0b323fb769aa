"""Problems with the same measurements that differ in how much these count.

What was prepared for very many measurements is kept.
"""

from __future__ import annotations

from dataclasses import replace

from calib_pin.estimation.problem import Problem
from calib_pin.estimation.row_blocks import Expected
from calib_pin.kinematics.spatial import Floats


def expecting(problem: Problem, expected: Expected) -> Problem:
    """The problem with errors of the robot that are expected to be so large."""
    result = replace(problem, expected=expected)
    return _prepared(result, problem, "sigma", "evaluators")


def in_units(problem: Problem, units: Floats) -> Problem:
    """The problem with other standard deviations of unit weight, shape (K,)."""
    return _weighted(_prepared(replace(problem, units=units), problem), problem)


def reweighted(problem: Problem, weight: Floats) -> Problem:
    """The problem with other weights of its measurements, shape (N,)."""
    result = replace(problem, data=problem.data.weighted(weight))
    for name in ("layout", "given_sigma"):
        result.__dict__[name] = getattr(problem, name)
    return _weighted(result, problem)


def _weighted(result: Problem, problem: Problem) -> Problem:
    """The problem with the evaluators of one that whitens in another way, if any."""
    if "evaluators" in problem.__dict__:
        result.__dict__["evaluators"] = {
            one.weighted(result.sigma): positions
            for one, positions in problem.evaluators.items()
        }
    return result


def _prepared(result: Problem, problem: Problem, *more: str) -> Problem:
    """The same measurements: very many take time to prepare."""
    for name in ("layout", "blocks", "given_sigma", *more):
        result.__dict__[name] = getattr(problem, name)
    return result
