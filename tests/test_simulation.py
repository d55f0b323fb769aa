"""Simulated measurements: the true robot, the stated noise, nothing else."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError, OptionError
from calib_pin.parameters import ParameterSet
from calib_pin.problem import Problem, nominal_problem
from calib_pin.setup import FrameSetup, PlaneSetup, Setup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.spatial import from_quaternion, so3_log

PLANES = {
    "wall": PlaneSetup((0, 1, 4.6), -0.69),
    "floor": PlaneSetup((0, 0, 1), 0.2),
}
SETUPS = {
    "position": Setup(base_frame=FrameSetup((1, 2, 3), (0.1, 0.2, 0.3))),
    "pose": Setup(),
    "plane-distance": Setup(planes=PLANES),
}


def make(model: str, **changes: object) -> Problem:
    chain = calib_pin.load_chain("space6")
    return nominal_problem(chain, model, replace(SETUPS[model], **changes))


@pytest.fixture(params=SETUPS)
def problem(request: pytest.FixtureRequest) -> Problem:
    return make(request.param)


def errors(problem: Problem, seed: int = 0) -> np.ndarray:
    return draw_errors(problem.parameters, np.random.default_rng(seed))


# --- true errors -------------------------------------------------------------------


def test_drawn_errors_fill_the_scales_of_the_robot(problem):
    parameters = problem.parameters
    drawn = np.array([errors(problem, seed) for seed in range(400)])
    robot = parameters.free & ~parameters.nuisance
    assert (drawn[:, ~robot] == 0.0).all()
    relative = drawn[:, robot] / parameters.scales[robot]
    assert np.abs(relative).max() <= 1.0
    # Uniform: variance 1/3, and a mean that vanishes.
    np.testing.assert_allclose(relative.var(axis=0), 1 / 3, atol=0.1)
    np.testing.assert_allclose(relative.mean(axis=0), 0.0, atol=0.12)


def test_fixed_parameters_have_no_errors():
    problem = make("pose", fixed=("*.placement.x", "joint_2.*"))
    for value, name in zip(errors(problem), problem.parameters.names, strict=True):
        fixed = name.endswith("placement.x") or name.startswith("joint_2.")
        frame = ".frame." in name
        assert (value == 0.0) == (fixed or frame), name


def test_no_parameters_no_errors():
    assert errors_of(()).shape == (0,)


def errors_of(parameters: tuple) -> np.ndarray:
    return draw_errors(ParameterSet(parameters), np.random.default_rng(0))


# --- noise -------------------------------------------------------------------------


def test_without_noise_the_values_are_exact(problem):
    theta = errors(problem)
    rows = simulate(problem, theta, np.random.default_rng(1), count=30, noise=0.0)
    assert rows.sigma is None
    assert len(rows) == 30
    measured = replace(problem, data=rows)
    assert np.abs(measured.errors(theta)).max() < 1e-12
    assert np.abs(measured.errors(0.0 * theta)).max() > 1e-4


@pytest.mark.parametrize("noise", [None, 3e-4])
def test_noise_has_the_stated_size(problem, noise):
    theta = errors(problem)
    rows = simulate(problem, theta, np.random.default_rng(1), count=2000, noise=noise)
    assert rows.sigma is not None
    assert (rows.sigma == (1e-4 if noise is None else noise)).all()
    found = replace(problem, data=rows).errors(theta) / rows.sigma
    # 2000 draws: the deviation of a standard deviation is 1.6 %.
    np.testing.assert_allclose(found.std(axis=0), 1.0, atol=0.07)
    np.testing.assert_allclose(found.mean(axis=0), 0.0, atol=0.1)


def test_the_setup_states_the_noise():
    problem = make("pose", noise={"position": 1e-5, "orientation": 2e-3})
    theta = errors(problem)
    rows = simulate(problem, theta, np.random.default_rng(1), count=3)
    assert rows.sigma is not None
    assert rows.sigma[0].tolist() == [1e-5] * 3 + [2e-3] * 3


def test_orientations_turn_in_the_tool_frame():
    problem = make("pose")
    theta = errors(problem)
    q = problem.error.chain.random_configurations(500, np.random.default_rng(5))
    exact = simulate(problem, theta, np.random.default_rng(1), q=q, noise=0.0)
    rows = simulate(problem, theta, np.random.default_rng(1), q=q, noise=1e-3)
    R_exact = from_quaternion(exact.values[:, 3:])
    turn = so3_log(np.swapaxes(R_exact, 1, 2) @ from_quaternion(rows.values[:, 3:]))
    np.testing.assert_allclose(turn.std(axis=0), 1e-3, rtol=0.15)
    np.testing.assert_allclose(np.linalg.norm(rows.values[:, 3:], axis=1), 1.0)


# --- repeats -----------------------------------------------------------------------


def test_repeats_stay_together(problem):
    theta = errors(problem)
    rows = simulate(problem, theta, np.random.default_rng(1), count=4, repeats=3)
    assert len(rows) == 12
    groups = rows.groups().reshape(4, 3)
    assert (groups == groups[:, :1]).all()
    assert len(set(groups[:, 0])) == 4
    assert len(np.unique(rows.values[:, 0])) == 12


def test_averages_are_better_by_the_root_of_their_number(problem):
    theta = errors(problem)
    rows = simulate(
        problem,
        theta,
        np.random.default_rng(1),
        count=1500,
        noise=1e-3,
        repeats=25,
        average=True,
    )
    assert len(rows) == 1500
    np.testing.assert_allclose(rows.sigma, 2e-4)
    found = replace(problem, data=rows).errors(theta) / 2e-4
    np.testing.assert_allclose(found.std(axis=0), 1.0, atol=0.08)


# --- configurations ----------------------------------------------------------------


def test_configurations_lie_within_the_limits(problem):
    rows = simulate(problem, errors(problem), np.random.default_rng(1), count=200)
    chain = problem.error.chain
    assert (rows.q >= chain.lower).all()
    assert (rows.q <= chain.upper).all()
    assert rows.joints == chain.joints


def test_given_configurations_are_kept(problem):
    theta = errors(problem)
    q = simulate(problem, theta, np.random.default_rng(1), count=7).q
    rows = simulate(problem, theta, np.random.default_rng(2), q=q)
    np.testing.assert_array_equal(rows.q, q)


def test_planes_take_turns_and_are_hit_from_the_front():
    problem = make("plane-distance")
    theta = errors(problem)
    rows = simulate(problem, theta, np.random.default_rng(1), count=100)
    assert set(rows.target) == {"wall", "floor"}
    assert 20 < rows.target.count("wall") < 80
    assert (rows.values > 0.0).all()
    assert (rows.values < 5.01).all()


def test_a_configuration_that_misses_the_plane_is_named():
    problem = make("plane-distance", planes={"floor": PLANES["floor"]})
    theta = errors(problem)
    q = simulate(problem, theta, np.random.default_rng(1), count=3).q
    q[1] = [0.0, -np.pi / 2, 0.0, 0.0, 0.0, 0.0]  # Straight up.
    with pytest.raises(InputError, match="configuration 2 cannot be measured"):
        simulate(problem, theta, np.random.default_rng(1), q=q)


def test_a_plane_out_of_reach():
    planes = {"sky": PlaneSetup((0, 0, 1), -90.0)}
    problem = make("plane-distance", planes=planes)
    with pytest.raises(InputError, match="only 0 of"):
        simulate(problem, errors(problem), np.random.default_rng(1), count=1)


# --- repeatability and mistakes ----------------------------------------------------


def test_the_generator_decides_everything(problem):
    theta = errors(problem)
    rows = [
        simulate(problem, theta, np.random.default_rng(seed), count=5)
        for seed in (1, 1, 2)
    ]
    np.testing.assert_array_equal(rows[0].values, rows[1].values)
    np.testing.assert_array_equal(rows[0].q, rows[1].q)
    assert not np.array_equal(rows[0].q, rows[2].q)


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ({}, "either configurations or their count"),
        ({"count": 3, "q": np.zeros((1, 6))}, "either configurations or their count"),
        ({"count": 0}, "count is too small"),
        ({"count": 3, "repeats": 0}, "repeats is too small"),
        ({"count": 3, "noise": -1e-3}, "noise is out of range"),
        ({"count": 3, "noise": np.nan}, "noise is out of range"),
        ({"count": 3, "noise": np.inf}, "noise is out of range"),
    ],
)
def test_numbers_out_of_range(options, part):
    problem = make("pose")
    with pytest.raises(OptionError, match=part):
        simulate(problem, errors(problem), np.random.default_rng(1), **options)
