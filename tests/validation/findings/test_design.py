"""Configurations that are too much alike are told for what they are."""

from __future__ import annotations

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.setup import FrameSetup, Setup


@pytest.fixture(scope="module")
def judged():
    """Findings of a whole calibration by the configurations that were measured."""
    chain = calib_pin.load_chain("example:ur10_robot", base="base_link", tip="tool0")
    setup = Setup(tool_frame=FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1)))
    problem = nominal_problem(chain, "position", setup)
    theta = calib_pin.draw_errors(problem.parameters, np.random.default_rng(0))

    def of(q):
        rng = np.random.default_rng(1)
        rows = calib_pin.simulate(problem, theta, rng, q=q, noise=1e-4)
        result = calib_pin.calibrate(chain, rows, Setup(), validate=False)
        return {f.code: f for f in result.findings}

    return of


def test_a_third_of_the_range_is_a_warning_where_far_more_is_expected(judged) -> None:
    q = np.random.default_rng(2).uniform(-1.0, 1.0, (60, 6))
    assert judged(q)["small-range"].severity == "warning"
    q = np.random.default_rng(2).uniform(-np.pi, np.pi, (60, 6))
    assert judged(q * [1, 1, 1, 1, 1, 0.2])["small-range"].severity == "info"
    # Of the whole range the order does not matter, also if it is that of a path.
    assert judged(q[np.argsort(q[:, 0])]) == {}


def test_few_configurations_are_too_few_and_nothing_else(judged) -> None:
    """Three anywhere lie in a tenth of a joint's range, and move in two directions."""
    q = np.random.default_rng(3).uniform(-np.pi, np.pi, (3, 6))
    q[:, 5] = 0.5 + 0.3 * q[:, 5]
    assert set(judged(np.repeat(q, 20, axis=0))) == {"few-configurations"}
