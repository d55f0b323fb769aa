"""The state of a robot: how it changes, and what a calibration tells a fleet of it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.setup import Setup
from calib_pin.validation.robot_state import changes, drifts, robot_evidence


@pytest.mark.parametrize("name", ["placement", "dh", "joint-offset", "link-transform"])
def test_an_offset_is_one(name) -> None:
    chain = calib_pin.load_chain("space6")
    problem = nominal_problem(chain, "pose", Setup(parameters=(name,)))
    parameters = problem.parameters
    robot = parameters.free & ~parameters.nuisance
    term, q = problem.only, chain.random_configurations(5, np.random.default_rng(0))
    found = changes(problem, robot)
    offsets = [change for change in found.values() if change.kind == "offset"]
    assert [change.name for change in offsets] == list(chain.joints)
    for k, change in enumerate(offsets):
        theta = change.directions[:, 0] * parameters.scales / 1e3
        moved = q.copy()
        moved[:, k] += change.size / 1e3
        expected = term.error.poses(moved, 0.0 * theta)
        # Errors apply one after the other: the second order is left.
        np.testing.assert_allclose(term.error.poses(q, theta), expected, atol=1e-10)


def test_drifts_and_other_changes() -> None:
    chain = calib_pin.load_chain("space6")
    setup = Setup(parameters=("placement", "transmission"))
    problem = nominal_problem(chain, "pose", setup)
    parameters = problem.parameters
    robot = parameters.free & ~parameters.nuisance
    found, scales = changes(problem, robot), parameters.scales[robot]
    drifting = drifts(problem, robot, found.values())
    sizes = np.diag(drifting["geometry"][robot]) * scales
    units = np.array([p.unit for p in parameters])[robot]
    np.testing.assert_allclose(
        sizes, np.where(np.isin(units, ["m", "rad"]), 1.0, scales / 1e-3)
    )
    assert drifting["joint offsets"].shape == (len(robot), 6)
    placed = found["placement joint_3"].directions
    touched = [parameters.names[k] for k in np.flatnonzero(placed.any(axis=1))]
    assert touched and all(name.startswith("joint_3.") for name in touched)
    assert found["robot"].directions.shape == (len(robot), robot.sum())


def information(evidence):
    """The matrix of the normal equations, and their right side."""
    W = evidence.rows
    return W.T @ W, W.T @ evidence.values


def test_it_is_the_likelihood(fleet) -> None:
    """Frames projected out of the normal equations (their Schur complement)."""
    result = fleet.results[0]
    evidence = robot_evidence(result)
    problem = replace(
        result.model.problem(result.fitted.rows),
        units=np.array([c.factor for c in result.statistics.noise]),
    )
    p = problem.parameters
    r, J = problem.linearize_rows(result.model.theta)
    J = J * p.scales
    N, robot = J.T @ J, p.free & ~p.nuisance
    frames = p.free & p.nuisance
    cross = N[np.ix_(robot, frames)]
    inverse = np.linalg.pinv(N[np.ix_(frames, frames)], hermitian=True)
    A = N[np.ix_(robot, robot)] - cross @ inverse @ cross.T
    gradient = J.T @ r
    b = A @ (result.model.theta / p.scales)[robot]
    b -= gradient[robot] - cross @ inverse @ gradient[frames]
    found = information(evidence)
    # The normal equations have half the digits.
    np.testing.assert_allclose(found[0], A, atol=1e-7 * np.abs(A).max())
    np.testing.assert_allclose(found[1], b, atol=1e-7 * np.abs(b).max())
    assert evidence.names == tuple(np.array(p.names)[robot])
    assert evidence.rows.shape[0] < evidence.rows.shape[1]


def test_a_prior_does_not_count_twice(fleet) -> None:
    """The evidence of a calibration with a prior is that of one without."""
    data, _ = fleet.measured(100, 24)
    chain, noise = fleet.problem.chains[""], {"position": 1e-4}
    prior = fleet.population.prior()
    without, with_it = (
        robot_evidence(
            calib_pin.calibrate(
                chain, data, Setup(noise=noise, prior=some), validate=False
            )
        )
        for some in ({}, prior)
    )
    A, b = information(without)
    other = information(with_it)
    # Linearized elsewhere: errors of a milliradian change derivatives by a thousandth.
    np.testing.assert_allclose(other[0], A, atol=5e-3 * np.abs(A).max())
    np.testing.assert_allclose(other[1], b, atol=5e-3 * np.abs(b).max())


def test_what_tells_nothing(fleet, refused) -> None:
    result = fleet.results[0]
    quiet = replace(result, statistics=replace(result.statistics, noise=()))
    with refused(InputError, reason="noise"):
        robot_evidence(quiet)
    setup = replace(result.model.setup, learned="network")
    with refused(InputError, reason="learned correction"):
        robot_evidence(replace(result, model=replace(result.model, setup=setup)))
