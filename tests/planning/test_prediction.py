"""What a plan promises against what a fit of such rows knows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit, posterior
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.planning.plan import Plan
from calib_pin.setup import FrameSetup, PlaneSetup, Setup
from calib_pin.simulation import exact_problem

FRAMES = {
    "base_frame": FrameSetup((0.5, -0.4, 0.3), (0.3, 0.2, 2.0), estimate=True),
    "tool_frame": FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True),
}
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
COUNT = 40


def planned(name: str) -> tuple[Plan, Fit]:
    """A plan, and the fit of exact rows that the nominal robot gives there.

    At nominal geometry both speak of the same linear problem.
    """
    model, setup, noise = CASES[name]
    setup = replace(
        setup, noise=dict.fromkeys(("position", "orientation", "distance"), noise)
    )
    chain = calib_pin.load_chain("space6")
    found = calib_pin.plan(chain, model, COUNT, setup, method="greedy", candidates=200)
    problem = nominal_problem(chain, model, setup)
    zero = np.zeros(len(problem.parameters))
    exact = exact_problem(problem, zero, found.q, found.target)
    (block,) = exact.blocks
    rows = replace(exact.data.only, sigma=block.table(exact.sigma))
    return found, fit(
        replace(problem, data=Observations.of(rows)), np.random.default_rng(0)
    )


def covariance(fitted: Fit) -> Floats:
    """By the noise that is stated and nothing else: exact rows show no noise."""
    return posterior(fitted.problem, fitted.theta, fitted.directions).covariance


@pytest.mark.parametrize("name", CASES)
def test_covariance_is_that_of_a_fit(name: str) -> None:
    plan, fitted = planned(name)
    predicted = plan.predicted
    assert np.abs(fitted.theta).max() < 1e-9
    assert (predicted.theta == 0.0).all()
    scale = fitted.problem.parameters.scales
    # The fit has directions for nuisances that nothing sees; they have no variance.
    ours = predicted.covariance / np.outer(scale, scale)
    theirs = covariance(fitted) / np.outer(scale, scale)
    robot = ~fitted.problem.parameters.nuisance
    assert predicted.directions.robot.shape[1] == fitted.directions.robot.shape[1]
    size = np.abs(theirs[np.ix_(robot, robot)]).max()
    np.testing.assert_allclose(
        ours[np.ix_(robot, robot)], theirs[np.ix_(robot, robot)], atol=1e-6 * size
    )
    np.testing.assert_allclose(ours, theirs, atol=1e-5 * np.abs(theirs).max())


def test_a_fit_knows_a_little_more_by_the_expected_size_of_errors() -> None:
    """Which only measurements tell: of a variance v it leaves v / (1 + v / size^2)."""
    plan, exact = planned("position")
    zero, rng = np.zeros(len(exact.theta)), np.random.default_rng(3)
    problem = nominal_problem(
        exact.problem.only.error.chain, "position", exact.problem.setup
    )
    rows = calib_pin.simulate(problem, zero, rng, q=plan.q, target=plan.target)
    fitted = fit(replace(problem, data=rows), rng)
    assert all(noise.factor == 1.0 for noise in fitted.noise)
    assert fitted.evidence is not None
    scale = exact.problem.parameters.scales
    V = plan.predicted.directions.robot / scale[:, None]
    before, found = (
        np.linalg.eigvalsh(V.T @ C @ V)
        for C in (plan.predicted.covariance, fitted.covariance)
    )
    (size,) = set(fitted.evidence.expected.sizes[~fitted.problem.parameters.nuisance])
    expected = before / (1.0 + before / size**2)
    assert before.max() > 1.05 * expected.max()
    # The fit is at the robot that it has found, noise away from the nominal one.
    np.testing.assert_allclose(found, expected, rtol=0.01)


@pytest.mark.parametrize("name", CASES)
def test_error_of_the_tip_is_that_of_the_covariance(name: str) -> None:
    """At the default test poses, from the covariance of a fit."""
    plan, fitted = planned(name)
    problem = fitted.problem
    if name == "prior":
        # The default test poses are candidates from all of the workspace.
        assert plan.predicted.position < 1e-3
    rng = np.random.default_rng(5)
    q = problem.only.error.chain.random_configurations(4000, rng)
    zero = np.zeros(len(problem.only.error.screws))
    T, J = problem.only.error.jacobian(q, zero)
    C = covariance(fitted)[: len(zero), : len(zero)]
    at_tip = np.einsum("nai,ij,naj->na", J, C, J)
    position = np.sqrt(at_tip[:, :3].sum(axis=1).mean())
    orientation = np.sqrt(at_tip[:, 3:].sum(axis=1).mean())
    assert T.shape == (4000, 4, 4)
    rows = 0.05 if "distance" not in name else 0.25
    # Test poses of a plan are those that can be measured: few of a ranger.
    assert plan.predicted.position == pytest.approx(position, rel=rows)
    assert plan.predicted.orientation == pytest.approx(orientation, rel=rows)


def test_test_poses_are_those_given() -> None:
    chain = calib_pin.load_chain("space6")
    setup = Setup(tool_frame=FrameSetup((0.05, 0.03, 0.1)))
    problem = nominal_problem(chain, "position", setup)
    q = chain.random_configurations(20, np.random.default_rng(1))
    found = calib_pin.plan(
        chain, "position", COUNT, setup, method="greedy", candidates=200, tests=q
    )
    zero = np.zeros(len(problem.only.error.screws))
    _, J = problem.only.error.jacobian(q, zero)
    C = found.predicted.covariance
    squares = np.einsum("nai,ij,naj->na", J, C, J)
    assert found.predicted.position == pytest.approx(
        np.sqrt(squares[:, :3].sum(axis=1).mean()), rel=1e-6
    )
    assert found.value == pytest.approx(found.predicted.position, rel=1e-9)


def test_accuracy_where_it_is_wanted_is_better_there() -> None:
    chain = calib_pin.load_chain("space6")
    q = 0.3 + 0.1 * np.random.default_rng(2).normal(size=(50, 6))
    everywhere, there = (
        calib_pin.plan(chain, "position", 15, method="exchange", tests=tests)
        for tests in (None, q)
    )
    problem = nominal_problem(chain, "position", Setup())
    _, J = problem.only.error.jacobian(q, np.zeros(len(problem.only.error.screws)))
    errors = [
        np.einsum("nai,ij,naj->", J[:, :3], plan.predicted.covariance, J[:, :3])
        for plan in (everywhere, there)
    ]
    assert errors[1] < 0.8 * errors[0]


def test_directions_that_are_too_weak_stay_at_nominal() -> None:
    """With noise of 50 mm a plan of few rows cannot tell everything."""
    chain = calib_pin.load_chain("space6")
    noise = {"position": 0.05}
    found = calib_pin.plan(
        chain, "position", 12, Setup(noise=noise), method="greedy", candidates=100
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
        chain, "position", 12, method="greedy", candidates=100
    ).predicted
    assert less_noise.directions.weak.shape[1] == 0


def test_parameters_have_the_deviations_of_the_covariance() -> None:
    found, _ = planned("position")
    names = [p.name for p in found.problem.parameters]
    identifiable = [p for p in found.parameters if p.status == "identifiable"]
    assert identifiable
    for parameter in identifiable:
        k = names.index(parameter.name)
        assert parameter.sigma == pytest.approx(
            np.sqrt(found.predicted.covariance[k, k]), rel=1e-9
        )
        assert parameter.value == 0.0
    for group in found.groups:
        C = found.predicted.covariance
        row = np.zeros(len(names))
        for name, coefficient in group.terms:
            row[names.index(name)] = coefficient
        assert group.sigma == pytest.approx(np.sqrt(row @ C @ row), rel=1e-6)
