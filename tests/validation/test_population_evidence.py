"""What a calibration tells a fleet: its likelihood, and nothing of its priors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import calib_pin
from calib_pin.errors import InputError
from calib_pin.estimation.statistics.population_prior import RobotEvidence
from calib_pin.kinematics.spatial import Floats
from calib_pin.setup import Setup
from calib_pin.validation.robot_state import robot_evidence


def information(evidence: RobotEvidence) -> tuple[Floats, Floats]:
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
