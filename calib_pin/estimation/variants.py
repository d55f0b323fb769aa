"""Problems with the same measurements that differ in how much these count."""

from __future__ import annotations

from dataclasses import replace

from calib_pin.estimation.problem import Problem
from calib_pin.estimation.row_blocks import Expected
from calib_pin.kinematics.spatial import Floats


def expecting(problem: Problem, expected: Expected) -> Problem:
    """The problem with errors of the robot that are expected to be so large."""
    return replace(problem, expected=expected)


def in_units(problem: Problem, units: Floats) -> Problem:
    """The problem with other standard deviations of unit weight, shape (K,)."""
    return replace(problem, units=units)


def reweighted(problem: Problem, weight: Floats) -> Problem:
    """The problem with other weights of its measurements, shape (N,)."""
    return replace(problem, data=problem.data.weighted(weight))
