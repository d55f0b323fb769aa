"""Distances that are known count as measurements of what they lie between."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.problem import distinct_values, known_values
from calib_pin.estimation.row_blocks import KnownDistances, Priors
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.references import (
    Anchor,
    Plane,
    Point,
    ReferenceObject,
    Sphere,
)
from calib_pin.setup import DistanceSetup, FrameSetup, PointSetup, Setup

REFERENCES: tuple[ReferenceObject, ...] = (
    Point("probe", "target", np.array([0.0, 0.0, 0.1])),
    Plane("table", np.array([0.0, 0.0, 1.0])),
    Point("left", "socket", np.array([1.0, 0.0, 0.0])),
    Sphere("ball", np.array([1.0, 3.0, 4.0]), 0.1),
    Anchor("wire", np.array([1.0, 0.0, -2.0])),
    Point("right", "socket", np.array([3.0, 0.0, 0.0])),
)
DISTANCES = (
    DistanceSetup(("left", "ball"), 4.9, 0.1),
    DistanceSetup(("wire", "right"), 2.0, 1e-3),
    DistanceSetup(("left", "nowhere"), 1.0, 1e-3),
    DistanceSetup(("table", "left"), 1.0, 1e-3),
)


def distances_of(
    stated: Sequence[DistanceSetup], references: Sequence[ReferenceObject]
) -> tuple[KnownDistances, Floats]:
    """Known distances between objects by their names, and zero for their parameters."""
    names = [p.name for reference in references for p in reference.parameters]
    named = {(reference.section, reference.name): reference for reference in references}
    return KnownDistances.of(stated, named, names), np.zeros(len(names))


def known() -> tuple[KnownDistances, Floats]:
    return distances_of(DISTANCES, REFERENCES)


def test_those_whose_ends_are_known() -> None:
    """A plane has no place, and what is not there has none either."""
    found, zero = known()
    assert found.stated == DISTANCES[:2] and len(found) == 2
    np.testing.assert_allclose(found.lengths(zero), [5.0, np.sqrt(8.0)])
    # Probe 3, table 3, left 3, ball 4, wire 4, right 3.
    assert found.columns.tolist() == [
        [[6, 7, 8], [9, 10, 11]],
        [[13, 14, 15], [17, 18, 19]],
    ]
    residual = found.residual(zero)
    np.testing.assert_allclose(residual, [1.0, (np.sqrt(8.0) - 2.0) / 1e-3])


def test_many_members_at_once() -> None:
    found, zero = known()
    instrument = 0.1 * np.random.default_rng(1).normal(size=(2, 3, len(zero)))
    together = found.residual(instrument)
    assert together.shape == (2, 3, 2)
    for place in np.ndindex(2, 3):
        np.testing.assert_array_equal(
            together[place], found.residual(instrument[place])
        )


def test_none() -> None:
    found, zero = distances_of((), REFERENCES)
    assert len(found) == 0
    assert found.residual(zero).shape == found.lengths(zero).shape == (0,)
    assert found.jacobian(zero).shape == (0, len(zero))


def test_jacobian_agrees_with_central_differences() -> None:
    found, zero = known()
    instrument = 0.1 * np.random.default_rng(0).normal(size=len(zero))
    J, step = found.jacobian(instrument), 1e-6
    for k in range(len(instrument)):
        shift = step * np.eye(len(instrument))[k]
        change = found.residual(instrument + shift) - found.residual(instrument - shift)
        np.testing.assert_allclose(J[:, k], change / (2.0 * step), rtol=1e-6, atol=1e-5)


def test_a_socket_goes_before_a_point_of_the_tool() -> None:
    references = (
        Point("a", "target", np.zeros(3)),
        Point("a", "socket", np.array([1.0, 0.0, 0.0])),
        Point("b", "target", np.array([0.0, 2.0, 0.0])),
        Point("b", "socket", np.array([1.0, 0.5, 0.0])),
        Point("c", "target", np.array([0.0, 0.0, 7.0])),
    )
    for order in (references, references[::-1]):
        found, zero = distances_of((DistanceSetup(("a", "b"), 1.0),), order)
        assert found.lengths(zero) == pytest.approx([0.5])
    # Two points of the tool, where no place has their names.
    found, zero = distances_of((DistanceSetup(("a", "c"), 1.0),), references[::4])
    assert found.lengths(zero) == pytest.approx([7.0])


# In a problem.

ARM = calib_pin.load_chain("space6")
SOCKETS = {"s/0": PointSetup((0.6, 0.3, 0.4)), "s/1": PointSetup((0.5, -0.2, 0.6))}
TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True)


def test_rows_of_a_problem() -> None:
    distances = (DistanceSetup(("s/0", "s/1"), 0.5, 1e-5),)
    prior = {"joint_1.placement.x": 1e-3}
    setup = Setup(sockets=SOCKETS, tool_frame=TOOL, distances=distances, prior=prior)
    problem = nominal_problem(ARM, "fixed-point", setup)
    plain = replace(problem, setup=replace(setup, distances=()))
    theta = 1e-3 * np.random.default_rng(0).normal(size=len(problem.parameters))
    # Behind the rows, before the priors.
    r, J = problem.linearize(theta)
    assert problem.count == plain.count + 1 == len(r)
    assert distinct_values(problem) == distinct_values(plain) + 1
    np.testing.assert_allclose(r, problem.residual(theta), rtol=1e-12, atol=1e-9)
    bare = plain.linearize(theta)
    np.testing.assert_array_equal(np.delete(r, -2), bare[0])
    np.testing.assert_array_equal(np.delete(J, -2, axis=0), bare[1])
    between = np.subtract(SOCKETS["s/1"].xyz, SOCKETS["s/0"].xyz)
    between = between + theta[-3:] - theta[-6:-3]
    assert r[-2] == pytest.approx((np.linalg.norm(between) - 0.5) / 1e-5)
    assert np.flatnonzero(J[-2]).tolist() == list(range(len(theta) - 6, len(theta)))


@pytest.mark.parametrize(("sigma", "left"), [(1e-6, 1e-6), (1.0, 1e-3)])
def test_a_distance_weighs_by_its_sigma(sigma: float, left: float) -> None:
    """Rows with known lengths find another distance; the smaller sigma wins."""
    setup = Setup(sockets=SOCKETS, tool_frame=TOOL, parameters=("joint-offset",))
    problem = nominal_problem(ARM, "fixed-point", setup)
    zero, rng = np.zeros(len(problem.parameters)), np.random.default_rng(0)
    rows = calib_pin.simulate(problem, zero, rng, count=40, noise=1e-4)
    apart = float(np.linalg.norm([0.1, 0.5, -0.2]))
    wrong = (DistanceSetup(("s/0", "s/1"), apart + 1e-3, sigma),)
    told = replace(setup, distances=wrong)
    fitted = fit(make_problem(ARM, rows, told), rng)
    moved, _ = fitted.problem.rebased(fitted.theta)
    places = moved.only.measurement.sites
    found = float(np.linalg.norm(places[0].xyz - places[1].xyz))
    assert abs(found - apart - 1e-3) <= 1.1 * left
    assert (abs(found - apart) < 2e-4) == (sigma == 1.0)


def test_between_points_of_the_tool() -> None:
    """A gauge on the flange sets the scale of nothing, but its points are tied."""
    points = {"a": PointSetup((0.05, 0.08, 0.12)), "b": PointSetup((-0.06, 0.03, 0.1))}
    gauge = (DistanceSetup(("a", "b"), 0.12, 1e-6),)
    setup = Setup(targets=points, base_frame=FrameSetup((1, 2, 3), estimate=True))
    plain, tied = (
        calib_pin.identify(ARM, "position", replace(setup, distances=d))
        for d in ((), gauge)
    )
    assert plain.identifiability.rank == tied.identifiability.rank == 30
    problem = nominal_problem(ARM, "position", replace(setup, distances=gauge))
    assert problem.count == nominal_problem(ARM, "position", setup).count + 1


def test_a_prior_of_several_parameters(fleet) -> None:
    """Rows of deviation one by the covariance, and their derivative."""
    prior = fleet.population.prior()
    parameters = fleet.problem.parameters
    block = Priors.together(prior, parameters)
    index = [parameters.index(name) for name in prior.names]
    W, covariance = block.rows[:, index], np.array(prior.covariance)
    np.testing.assert_allclose(W @ covariance @ W.T, np.eye(len(W)), atol=1e-9)
    mean = np.zeros(len(parameters))
    mean[index] = [p.mean for p in prior.parameters]
    assert not block.residual(mean).any() and len(block) == len(index)
    theta = mean + np.random.default_rng(0).normal(size=len(mean)) * parameters.scales
    steps = 1e-6 * np.eye(len(theta))
    found = (block.residual(theta + steps) - block.residual(theta - steps)).T / 2e-6
    J = block.jacobian(theta)
    np.testing.assert_allclose(found, J, atol=1e-8 * np.abs(J).max())


def test_a_prior_of_some_fixed_parameters(fleet) -> None:
    """Those that are free keep their marginal distribution."""
    prior = fleet.population.prior()
    parameters = fleet.problem.parameters.with_fixed(["*.placement.z"])
    block = Priors.together(prior, parameters)
    free = [k for k, name in enumerate(prior.names) if not name.endswith(".z")]
    index = [parameters.index(prior.names[k]) for k in free]
    assert len(block) == len(free)
    W = block.rows[:, index]
    covariance = np.array(prior.covariance)[np.ix_(free, free)]
    np.testing.assert_allclose(W @ covariance @ W.T, np.eye(len(W)), atol=1e-9)
    assert not np.delete(block.rows, index, axis=1).any()


def test_the_prior_of_a_problem(fleet) -> None:
    """Its rows are the last ones; values that priors hold count as known."""
    prior = fleet.population.prior()
    data, theta = fleet.measured(400, 10)
    chain = fleet.problem.chains[""]
    plain = make_problem(chain, data, Setup())
    problem = make_problem(chain, data, Setup(prior=prior))
    block = Priors.together(prior, problem.parameters)
    r, J = problem.linearize(theta)
    np.testing.assert_allclose(r[-len(block) :], block.residual(theta), rtol=1e-12)
    np.testing.assert_array_equal(J[-len(block) :], block.rows)
    assert problem.count == plain.count + len(block)
    assert known_values(problem) == distinct_values(plain) + len(block)
    assert problem.setup.noise == prior.noise
