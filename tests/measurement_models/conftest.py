"""Rows of a small robot, as fixtures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.setup import Setup


@pytest.fixture(scope="session")
def simulated() -> Callable[..., tuple[Problem, Floats]]:
    """Rows of `space6` without noise: `simulated(model, setup, count, size)`.

    Returns the problem with the rows, and the true errors: those of the robot have so
    many times their expected size.
    """

    def make(
        model: str, setup: Setup, count: int = 40, size: float = 0.0, seed: int = 0
    ) -> tuple[Problem, Floats]:
        rng = np.random.default_rng(seed)
        problem = nominal_problem(calib_pin.load_chain("space6"), model, setup)
        theta = size * calib_pin.draw_errors(problem.parameters, rng)
        rows = calib_pin.simulate(problem, theta, rng, count=count, noise=0.0)
        return replace(problem, data=rows), theta

    return make
