"""Base and tool of an acceptance test: stated, calibrated, or fitted, and how surely.

A robot that is not the nominal one leaves errors where its frames are fitted; their
size, by the degrees of freedom of the fit, tells how far the frames can be off.
"""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.nominal import register
from calib_pin.estimation.problem import Problem, error_table
from calib_pin.estimation.registration import extended, registered, relocated
from calib_pin.estimation.solve import least_squares
from calib_pin.estimation.system import FRAME
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.parameters import matching
from calib_pin.setup import Setup
from calib_pin.validation.acceptance import DRAWS, ranked, told
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import CalibrationResult

UNLIKELY = 0.01
"""Probability of a misfit by chance below which no test passes."""


class FrameFit(NamedTuple):
    """A robot with base and tool, as far as anything tells them.

    Attributes:
        problem: The problem of the measurements that tell them.
        theta: Parameter values, shape (P,).
        known: Deviations of the parameters by independent ones of size one, (P, r); of
            a fit that has nothing left a meter and a radian each.
        dof: Degrees of freedom that tell the size of deviations; zero for such a fit.
    """

    problem: Problem
    theta: Floats
    known: Floats
    dof: float = np.inf

    @staticmethod
    def of(model: CalibratedModel, rows: Observations) -> FrameFit:
        """A model's own frames."""
        none = np.zeros((len(model.theta), 0))
        return FrameFit(model.problem(rows), model.theta, none)

    @property
    def unknown(self) -> FrameFit:
        """The same where nothing tells by how much they are off."""
        free = self.known.any(axis=1)
        scales = np.diag(self.problem.parameters.scales)
        return self._replace(known=scales[:, free], dof=np.inf)


def frames_alone(chains: Chains, rows: Observations, setup: Setup) -> FrameFit:
    """The nominal robot with frames as a setup states them, and their priors."""
    bare = replace(setup, parameters=(), learned=None, fixed=(), bounds={}, prior={})
    names = make_problem(chains, rows, bare).parameters.names
    fixed = tuple(glob for glob in setup.fixed if matching(glob, names))
    priors = setup.prior_by_glob.items()
    prior = {glob: sigma for glob, sigma in priors if matching(glob, names)}
    problem = make_problem(chains, rows, replace(bare, fixed=fixed, prior=prior))
    theta, parameters = np.zeros(len(names)), problem.parameters
    known = np.diag(parameters.priors)[:, parameters.free]
    return FrameFit(registered(problem, theta), theta, known)


def fitted_frames(problem: Problem, theta: Floats) -> FrameFit:
    """A robot with all of its frames fitted to the measurements of a problem."""
    problem, found = register(problem, theta)
    parameters = problem.parameters
    return _fitted(problem, found.x, parameters.free & parameters.nuisance)


def fitted_station(model: CalibratedModel, rows: Observations) -> FrameFit:
    """A robot with its tool, whose station is fitted to measurements of one block."""
    problem, theta = extended(model.problem(rows), model.theta, rows)
    part = problem.parts[rows.only.key]
    problem = relocated(problem, theta, part.scope.station)
    free = np.isin(np.arange(len(theta)), part.index[:FRAME])
    basis = np.diag(problem.parameters.scales)[:, free]
    return _fitted(problem, least_squares(problem, theta, basis).x, free)


def derivatives(problem: Problem, theta: Floats) -> Floats:
    """Derivatives of the errors of one block by all parameters, shape (N, D, P)."""
    sigma = problem.sigma
    J = problem.linearize_rows(theta)[1][: len(sigma)] * sigma[:, None]
    return np.asarray(J.reshape(len(problem.data), -1, len(theta)))


def _fitted(problem: Problem, theta: Floats, free: NDArray[np.bool_]) -> FrameFit:
    """Free parameters that were fitted to measurements, and how surely.

    Those of one configuration have the errors of the robot in common, and count as one.
    """
    r, J = problem.linearize_rows(theta)
    count, scales = len(problem.sigma), problem.parameters.scales[free]
    A = J[:count, free] * scales
    share = problem.data.configurations / len(problem.data)
    dof = round(share * count) - int(np.linalg.matrix_rank(A, 1e-6 * len(A) ** 0.5))
    back = np.diag(problem.parameters.scales)[:, free]
    if dof <= 0:
        return FrameFit(problem, theta, back, 0)
    square = max(float(r[:count] @ r[:count]) * share / dof, 1e-12)
    # What nothing tells is known to a meter and a radian.
    prior = np.maximum(scales / problem.parameters.priors[free], 1.0)
    C = np.linalg.inv(A.T @ A * (share / square) + np.diag(prior**2))
    return FrameFit(problem, theta, back @ np.linalg.cholesky(C), dof)


def misfit(calibration: CalibrationResult, fit: FrameFit) -> tuple[str, bool]:
    """The misfit of a fitted station beside that to expect, in words.

    And whether chance does not explain it.

    Args:
        calibration: The calibration, which knows its covariance and its noise.
        fit: Its station by measurements of one block.
    """
    problem, C = fit.problem, np.asarray(calibration.covariance)
    noise = [n for n in calibration.statistics.noise if n.quantity == "position"]
    if not np.isfinite(C).all() or not noise:
        return "which misfit to expect the calibration does not say", False
    _, first = ranked(problem.data.groups())
    d = error_table(problem, fit.theta)[first, :3].reshape(-1)
    J = derivatives(problem, fit.theta)[first, :3].reshape(len(d), -1)
    # Another station has parameters beside those of the calibration, in their order.
    own = np.isin(problem.parameters.names, calibration.covariance.rows)
    S = J[:, own] @ C @ J[:, own].T
    S += noise[0].estimate ** 2 * np.eye(len(d))
    Q = np.linalg.qr(J[:, problem.parts[problem.data.only.key].index[:FRAME]])[0]
    left = np.eye(len(d)) - Q @ Q.T
    squares = np.maximum(np.linalg.eigvalsh(left @ S @ left), 0.0)
    draws = np.random.default_rng(0).standard_normal((DRAWS, len(d))) ** 2 @ squares
    found = float(np.sum((left @ d) ** 2))
    sizes = [told((square / len(first)) ** 0.5) for square in (found, squares.sum())]
    said = f"the misfit of the station is {sizes[0]} where {sizes[1]} is expected"
    return said, float(np.mean(draws >= found)) < UNLIKELY
