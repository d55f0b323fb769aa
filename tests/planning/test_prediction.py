"""What a plan promises against what a fit of such rows knows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from benchmarks.exact import exact_problem
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.planning.plan import Plan
from calib_pin.setup import FrameSetup, PlaneSetup, Setup

FRAMES = {
    "base_frame": FrameSetup((0.5, -0.4, 0.3), (0.3, 0.2, 2.0), estimate=True),
    "tool_frame": FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True),
}
CHAIN = calib_pin.load_chain("space6")
CASES = {
    "position": ("position", Setup(**FRAMES), 1e-4),
    "pose": ("pose", Setup(**FRAMES), 1e-4),
    "position with known frames": (
        "position",
        Setup(
            base_frame=FrameSetup(estimate=False), tool_frame=FrameSetup(estimate=False)
        ),
        1e-4,
    ),
    "plane-distance": (
        "plane-distance",
        Setup(
            parameters=("dh",),
            base_frame=FrameSetup(estimate=False),
            tool_frame=FrameSetup(estimate=False),
            planes={
                "wall": PlaneSetup((0.0, 1.0, 4.6), -0.69),
                "side": PlaneSetup((1.0, 0.3, 0.2), -2.0),
            },
        ),
        1e-4,
    ),
    "prior": ("position", Setup(prior={"*.placement.*": 2e-3}, **FRAMES), 1e-4),
}
COUNT = 30


@pytest.fixture(scope="module", params=CASES)
def planned(request: pytest.FixtureRequest) -> tuple[Plan, Fit, Floats]:
    """A plan, the fit of exact rows that the nominal robot gives there, its covariance.

    At nominal geometry both speak of the same linear problem. Exact rows show no noise,
    so the covariance is by the noise that is stated and nothing else.
    """
    model, setup, noise = CASES[request.param]
    stated = dict.fromkeys(("position", "orientation", "distance"), noise)
    setup = replace(setup, noise=stated)
    plan = calib_pin.plan(CHAIN, model, COUNT, setup, method="greedy", candidates=150)
    problem = nominal_problem(CHAIN, model, setup)
    zero = np.zeros(len(problem.parameters))
    exact = exact_problem(problem, zero, plan.q, plan.target)
    (block,) = exact.blocks
    rows = replace(exact.data.only, sigma=block.table(exact.sigma))
    rng = np.random.default_rng(0)
    fitted = fit(replace(problem, data=Observations.of(rows)), rng)
    C = replace(fitted, evidence=None, noise=(), unit=1.0).covariance
    return plan, fitted, C


def tip_errors(problem: Problem, C: Floats, q: Floats) -> tuple[Floats, Floats]:
    """Mean-square position and orientation of the tip at each configuration."""
    zero = np.zeros(len(problem.only.error.screws))
    _, J = problem.only.error.jacobian(q, zero)
    C = C[: len(zero), : len(zero)]
    squares = np.einsum("nai,ij,naj->na", J, C, J)
    return squares[:, :3].sum(axis=1), squares[:, 3:].sum(axis=1)


def test_covariance_is_that_of_a_fit(planned: tuple[Plan, Fit, Floats]) -> None:
    plan, fitted, C = planned
    predicted = plan.predicted
    assert np.abs(fitted.theta).max() < 1e-9
    assert (predicted.theta == 0.0).all()
    scale = fitted.problem.parameters.scales
    # The fit has directions for nuisances that nothing sees; they have no variance.
    ours = predicted.covariance / np.outer(scale, scale)
    theirs = C / np.outer(scale, scale)
    robot = ~fitted.problem.parameters.nuisance
    assert predicted.directions.robot.shape[1] == fitted.directions.robot.shape[1]
    size = np.abs(theirs[np.ix_(robot, robot)]).max()
    np.testing.assert_allclose(
        ours[np.ix_(robot, robot)], theirs[np.ix_(robot, robot)], atol=1e-6 * size
    )
    np.testing.assert_allclose(ours, theirs, atol=1e-5 * np.abs(theirs).max())
    # The error of the tip at the default test poses follows from it. Those are poses
    # that can be measured: few of a ranger.
    q = CHAIN.random_configurations(3000, np.random.default_rng(5))
    position, orientation = (
        np.sqrt(e.mean()) for e in tip_errors(fitted.problem, C, q)
    )
    within = 0.25 if plan.problem.only.key.model == "plane-distance" else 0.06
    assert predicted.position == pytest.approx(position, rel=within)
    assert predicted.orientation == pytest.approx(orientation, rel=within)
    # So do the deviations of parameters and of their groups.
    C, names = predicted.covariance, [p.name for p in plan.problem.parameters]
    told = [p for p in plan.parameters if p.status == "identifiable"]
    for parameter in told:
        k = names.index(parameter.name)
        assert parameter.value == 0.0
        assert parameter.sigma == pytest.approx(np.sqrt(C[k, k]), rel=1e-6)
    for group in plan.groups:
        row = np.zeros(len(names))
        for name, coefficient in group.terms:
            row[names.index(name)] = coefficient
        assert group.sigma == pytest.approx(np.sqrt(row @ C @ row), rel=1e-5)
    assert told or plan.groups


def test_accuracy_where_it_is_wanted_is_better_there() -> None:
    q = 0.3 + 0.1 * np.random.default_rng(2).normal(size=(50, 6))
    everywhere, there = (
        calib_pin.plan(
            CHAIN, "position", 15, method="exchange", candidates=300, tests=tests
        )
        for tests in (None, q)
    )
    errors = [
        tip_errors(plan.problem, plan.predicted.covariance, q)[0].mean()
        for plan in (everywhere, there)
    ]
    assert errors[1] < 0.8 * errors[0]
    # Test poses are those given.
    assert there.predicted.position == pytest.approx(np.sqrt(errors[1]), rel=1e-6)
    assert there.value == pytest.approx(there.predicted.position, rel=1e-9)


def test_directions_that_are_too_weak_stay_at_nominal() -> None:
    """With noise of 50 mm a plan of few rows cannot tell everything."""
    noise = {"position": 0.05}
    found = calib_pin.plan(
        CHAIN, "position", 12, Setup(noise=noise), method="greedy", candidates=100
    )
    predicted = found.predicted
    weak = predicted.directions.weak
    assert 0 < weak.shape[1] < found.predicted.rank
    assert predicted.directions.count + weak.shape[1] == found.predicted.rank
    scale = found.problem.parameters.scales
    scaled = predicted.covariance / np.outer(scale, scale)
    # Nothing moves along them, and what moves is known to less than ten scales.
    assert np.abs(weak.T @ scaled).max() < 1e-8 * np.abs(scaled).max()
    robot = predicted.directions.robot
    deviations = np.sqrt(np.diag(robot.T @ scaled @ robot))
    assert (deviations < 10.0).all()
    np.testing.assert_allclose(
        np.column_stack([robot, weak]).T @ np.column_stack([robot, weak]),
        np.eye(robot.shape[1] + weak.shape[1]),
        atol=1e-8,
    )
    # The criterion counts them all, so that the plan may become good enough.
    assert found.value > predicted.position
    less_noise = calib_pin.plan(
        CHAIN, "position", 12, method="greedy", candidates=100
    ).predicted
    assert less_noise.directions.weak.shape[1] == 0
