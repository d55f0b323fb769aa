"""One fit: fixed, bounded and prior parameters, and which directions may move."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.row_blocks import expected_places
from calib_pin.setup import FrameSetup, Setup
from calib_pin.solvers import Status

Simulated = Callable[..., tuple[Problem, np.ndarray]]

KNOWN = FrameSetup(estimate=False)
SETUP = Setup(base_frame=KNOWN, tool_frame=KNOWN, parameters=("joint-offset",))
OFF_AXIS = FrameSetup((0.1, 0.0, 0.05), estimate=False)
OFFSETS = [0.004, -0.003, 0.002, 0.005, -0.001, 0.003]


def offsets_problem(setup: Setup, noise: float = 0.0) -> tuple[Problem, np.ndarray]:
    """`space6` with joint offsets, measured by position."""
    rng = np.random.default_rng(1)
    chain = calib_pin.load_chain("space6")
    free = nominal_problem(chain, "position", replace(SETUP, tool_frame=OFF_AXIS))
    names = [n for n in free.parameters.names if n.endswith(".q")]
    truth = free.parameters.vector(dict(zip(names, OFFSETS, strict=True)))
    rows = calib_pin.simulate(free, truth, rng, count=30, noise=noise)
    problem = nominal_problem(chain, "position", replace(setup, tool_frame=OFF_AXIS))
    return replace(problem, data=rows), truth


def run(problem: Problem) -> Fit:
    return fit(problem, np.random.default_rng(0))


@pytest.mark.parametrize("bounds", [{}, {"*": 0.5}])
def test_offsets_without_noise(bounds: dict[str, float]) -> None:
    """A wide bound changes nothing."""
    problem, truth = offsets_problem(replace(SETUP, bounds=bounds))
    found = run(problem)
    assert found.result.status is Status.CONVERGED
    assert found.rank == 6
    assert np.abs(found.theta - truth).max() < 1e-11


def test_fixed_parameters_stay() -> None:
    problem, _ = offsets_problem(replace(SETUP, fixed=("joint_2.*",)))
    found = run(problem)
    assert found.theta[problem.parameters.index("joint_2.joint-offset.q")] == 0.0
    assert found.rank == 5


def test_bounds_hold_and_the_others_make_up_for_it() -> None:
    problem, truth = offsets_problem(replace(SETUP, bounds={"joint_4.*": 0.002}))
    found = run(problem)
    k = problem.parameters.index("joint_4.joint-offset.q")
    assert found.result.status is Status.CONVERGED
    assert found.theta[k] == 0.002
    assert found.problem.held_at == {k: 0.002}
    # Optimal under the bound: the gradient of the posterior vanishes for all others.
    _, held, _ = found.held
    assert len(held.fun) == len(found.result.fun) + found.directions.robot.shape[1]
    gradient = held.jac.T @ held.fun
    by_rows = found.result.jac.T @ found.result.fun
    others = problem.parameters.free & (np.arange(len(truth)) != k)
    # It was weighed by sigma0, of which the unit weight is the better estimate.
    pull = np.abs(by_rows[others]).max()
    assert np.abs(gradient[others]).max() < 1e-3 * pull < 1e-4 * np.abs(gradient[k])


def test_a_prior_is_a_measurement_of_zero() -> None:
    sigma = 1e-5
    problem, _ = offsets_problem(replace(SETUP, prior={"*": sigma}), noise=1e-4)
    found = run(problem)
    J, r = found.result.jac[:, problem.parameters.free], found.result.fun
    # The normal equations hold with the prior's rows among them.
    assert np.abs(J.T @ r).max() < 1e-6 * np.linalg.norm(J) * np.linalg.norm(r)
    assert len(found.result.fun) == 30 * 3 + 6
    assert np.abs(found.theta).max() < max(OFFSETS)


def test_a_prior_makes_every_direction_known() -> None:
    setup = Setup(base_frame=KNOWN, tool_frame=KNOWN, prior={"*.placement.*": 1e-3})
    problem, _ = offsets_problem(setup, noise=1e-4)
    found = run(problem)
    assert found.structure.rank < 36
    assert found.directions.weak.shape[1] == 0
    assert found.rank == 36


def test_noise_free_rows_admit_every_structural_direction(
    simulated: Simulated,
) -> None:
    problem, _ = simulated("pose", count=30, size=1.0, robot="pa10")
    found = run(problem)
    assert found.rank == found.structure.rank == 34
    assert found.directions.weak.shape[1] == 0
    assert found.result.cost < 1e-13


def test_noisy_rows_leave_weak_directions_to_the_prior(simulated: Simulated) -> None:
    """By least squares they would move by ten expected sizes and more."""
    problem, _ = simulated("position", count=14, size=1.0, robot="pa10", noise=2e-3)
    found = run(problem)
    weak = found.directions.weak
    assert weak.shape[1] > 0
    assert found.evidence is not None and found.evidence.matters
    (size,) = set(found.evidence.sizes[~problem.parameters.nuisance])
    # Of independent errors, about the places where these are expected.
    places = expected_places(found.problem, problem.parameters)
    errors = np.linalg.solve(places, found.theta / problem.parameters.scales)
    own = np.linalg.solve(places, weak)
    # The rows tell them to ten sizes at best, so that they keep a hundredth of what
    # these say.
    assert np.abs(np.linalg.qr(own)[0].T @ errors).max() < 0.1 * size
    # What they may be off by is what they were expected to be, and no more.
    C = found.covariance / np.outer(*[problem.parameters.scales] * 2)
    deviations = np.sqrt(np.diag(weak.T @ C @ weak))
    expected = size * np.sqrt(np.diag(np.linalg.inv(own.T @ own)))
    np.testing.assert_allclose(deviations, expected, rtol=0.05)


def test_large_errors_converge(simulated: Simulated) -> None:
    """Errors of 50 mm and 3 degrees, no first guess."""
    problem, _ = simulated("pose", size=17.0, seed=5)
    found = run(problem)
    assert found.result.status is Status.CONVERGED
    assert found.result.cost < 1e-12


def test_the_truth_lies_within_its_standard_errors() -> None:
    """And it is determined by as much as the noise allows."""
    problem, truth = offsets_problem(SETUP, noise=1e-4)
    found = run(problem)
    deviations = np.sqrt(np.diag(found.covariance))[problem.parameters.free]
    z = (found.theta - truth)[problem.parameters.free] / deviations
    assert np.abs(z).max() < 4.0 and 0.2 < np.sqrt(np.mean(z**2)) < 2.5
    assert (deviations < 3e-4).all()


def test_every_value_stays_within_its_bounds() -> None:
    limit = 2e-4
    problem, truth = placement_problem(Setup(bounds={"*.placement.*": limit}))
    found = run(problem)
    robot = ~problem.parameters.nuisance
    assert np.abs(truth[robot]).max() > limit
    assert np.abs(found.theta[robot]).max() <= limit
    assert found.problem.held_at
    # No parameter is called known because a bound stopped it.
    held = list(found.problem.held_at)
    assert not found.problem.parameters.free[held].any()


def test_a_tight_bound_costs_what_fixing_costs() -> None:
    """Others of its group take over what a bounded parameter must not."""
    name, costs = "joint_4.placement.rz", []
    for setup in (Setup(fixed=(name,)), Setup(bounds={name: 1e-7})):
        problem, _ = placement_problem(setup)
        costs.append(run(problem).result.cost)
    assert costs[1] == pytest.approx(costs[0], rel=1e-3)


def placement_problem(setup: Setup) -> tuple[Problem, np.ndarray]:
    """`space6` with placement errors, measured by position with 0.1 mm noise."""
    rng = np.random.default_rng(1)
    chain = calib_pin.load_chain("space6")
    tool = FrameSetup((0.1, 0.05, 0.05))
    free = nominal_problem(chain, "position", Setup(tool_frame=tool))
    truth = calib_pin.draw_errors(free.parameters, rng)
    rows = calib_pin.simulate(free, truth, rng, count=40, noise=1e-4)
    return replace(nominal_problem(chain, "position", setup), data=rows), truth
