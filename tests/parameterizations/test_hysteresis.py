"""Lost motion: its sign, its columns, and what measurements tell of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import calib_pin
from calib_pin.calibration import calibrate
from calib_pin.errors import InputError
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.problem import repeated
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import Conditions, Observations, approached
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.setup import FrameSetup, Setup
from calib_pin.simulation import draw_errors, simulate
from tests.shared import refused

LOST = {1: 2e-3, 2: 5e-4, 4: 1e-3}
"""Backlash by the position of a joint [rad]."""


SETUP = Setup(
    parameters=("placement", "hysteresis"),
    tool_frame=FrameSetup((0.1, 0.05, 0.15), estimate=True),
)


def lost_motion(chain: Chain) -> dict[str, float]:
    return {f"{chain.joints[k]}.hysteresis.backlash": b for k, b in LOST.items()}


def test_joints_stand_short_of_where_they_are_sent() -> None:
    chain = calib_pin.load_chain("space6")
    model = ErrorModel.create(chain, ["hysteresis"])
    theta = model.parameters.vector(lost_motion(chain))
    q = np.zeros((2, 6))
    up = Conditions(direction=np.array([[1] * 6, [-1] * 6], np.int8))
    halves = np.array([0.0, 1e-3, 2.5e-4, 0.0, 5e-4, 0.0])
    expected = chain.poses(np.outer([-1.0, 1.0], halves))
    found = model.tip_poses(q, theta, up)
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)
    # Nothing is known of where the joints came from: they stand between both.
    np.testing.assert_array_equal(model.tip_poses(q, theta), chain.poses(q))


def measured(
    chain: Chain, count: int, seed: int, noise: float = 3e-5
) -> tuple[Observations, dict[str, float]]:
    """Measurements of a robot with errors of its geometry and lost motion."""
    problem = nominal_problem(chain, "position", SETUP)
    rng = np.random.default_rng(seed)
    theta = draw_errors(problem.parameters, rng)
    names = problem.parameters.names
    truth = dict(zip(names, theta.tolist(), strict=True))
    truth |= {name: 0.0 for name in names if ".hysteresis." in name}
    truth |= lost_motion(chain)
    theta = problem.parameters.vector(truth)
    return simulate(problem, theta, rng, count=count, noise=noise), truth


def test_lost_motion_is_estimated() -> None:
    chain = calib_pin.load_chain("space6")
    rows, truth = measured(chain, 80, 0)
    result = calibrate(chain, rows, SETUP)
    names = result.model.given.names
    theta, found = result.model.theta, 0
    for k, name in enumerate(names):
        if ".hysteresis." in name:
            sigma = float(np.sqrt(result.covariance[k, k]))
            assert 0.0 < sigma < 1e-4
            assert abs(theta[k] - truth[name]) < 4.5 * sigma
            found += 1
    assert found == 6
    kinds = [e for e in result.robot_errors if e.kind == "backlash"]
    assert [e.of for e in kinds] == [(joint,) for joint in chain.joints]


def test_measurements_in_no_order_are_refused() -> None:
    chain = calib_pin.load_chain("space6")
    rows, _ = measured(chain, 20, 0)
    setup = Setup(parameters=("hysteresis",))
    unknown = Observations.of(replace(rows.only, conditions=Conditions()))
    with refused(InputError):
        make_problem(chain, unknown, setup)
    stated = Conditions(direction=approached(rows.q), source="columns")
    make_problem(chain, Observations.of(replace(rows.only, conditions=stated)), setup)


def test_one_configuration_from_two_sides_is_no_repetition() -> None:
    """Both together tell the lost motion, and nothing of the noise."""
    chain = calib_pin.load_chain("space6")
    problem = nominal_problem(chain, "position", SETUP)
    rng = np.random.default_rng(2)
    theta = problem.parameters.vector(lost_motion(chain))
    q = np.repeat(chain.random_configurations(30, rng), 2, axis=0)
    sides = np.tile(np.array([[1] * 6, [-1] * 6], np.int8), (30, 1))
    held = Conditions(direction=sides)
    rows = simulate(problem, theta, rng, q=q, conditions=held, noise=3e-5)
    told = make_problem(chain, rows, SETUP)
    assert len(np.unique(repeated(told))) == 60
    # Without lost motion in the model they are what one configuration scatters by.
    plain = make_problem(chain, rows, replace(SETUP, parameters=("placement",)))
    assert len(np.unique(repeated(plain))) == 30
    # Split they are together, for each tells nearly all of the other.
    assert rows.configurations == 30
    result = calibrate(chain, rows, SETUP)
    assert result.verdict == "good"
    found = result.statistics.sigma0
    assert 0.8 < found < 1.2
