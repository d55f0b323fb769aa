"""Base and tool of an acceptance test: stated, calibrated, or fitted, and how surely.

A robot that is not the nominal one leaves errors where its frames are fitted; their
size, by the degrees of freedom of the fit, tells how far the frames can be off.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.measured import assumed_sigma
from calib_pin.estimation.nominal import register
from calib_pin.estimation.problem import Problem, error_table
from calib_pin.estimation.registration import extended, relocated
from calib_pin.estimation.registration import registered as about_references
from calib_pin.estimation.solve import least_squares
from calib_pin.estimation.system import FRAME
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.parameters import matching
from calib_pin.setup import Setup
from calib_pin.validation.acceptance import NOTHING, FrameErrors, ranked
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.model_errors import registered

ROUNDING = 1e-9
"""Least misfit in assumed deviations: simulated measurements may have none."""


@dataclass(frozen=True)
class FrameFit:
    """A robot with base and tool, as far as anything tells them.

    Attributes:
        problem: The problem of the measurements that tell them.
        theta: Parameter values, shape (P,).
        known: Deviations of the parameters by independent ones of size one, (P, r).
        moved: Parameters that were fitted, by their scales, (P, p).
        dof: Degrees of freedom that tell the size of deviations.
    """

    problem: Problem
    theta: Floats
    known: Floats
    moved: Floats
    dof: float = np.inf

    @staticmethod
    def given(problem: Problem, theta: Floats) -> FrameFit:
        """Frames that are as they are."""
        none = np.zeros((len(theta), 0))
        return FrameFit(problem, theta, none, none)

    def at(self, rows: Observations, fitted: str = "") -> tuple[Floats, FrameErrors]:
        """Errors of visits, shape (N, D), predicted minus measured, and of frames.

        Args:
            rows: The visits, one block.
            fitted: What was fitted to them.
        """
        there = registered(self.problem, self.theta, rows)
        errors = error_table(there.problem, there.theta)
        J = derivatives(there.problem, there.theta)
        own = J @ self.known, J @ self.moved
        return errors, FrameErrors(*own, self.dof, fitted)


def stated_frames(chains: Chains, rows: Observations, setup: Setup) -> FrameFit | None:
    """Frames that a setup states, each value for sure or to a prior; None otherwise."""
    problem = _frames_alone(chains, rows, setup)
    parameters = problem.parameters
    if not np.isfinite(parameters.priors[parameters.free]).all():
        return None
    theta = np.zeros(len(parameters))
    found = FrameFit.given(about_references(problem, theta), theta)
    return replace(found, known=np.diag(parameters.priors)[:, parameters.free])


def fitted_frames(chains: Chains, rows: Observations, setup: Setup) -> FrameFit:
    """The nominal robot with frames that are fitted to measurements."""
    problem = _frames_alone(chains, rows, setup)
    problem, found = register(problem, np.zeros(len(problem.parameters)))
    return _fitted(problem, found.x, problem.parameters.free)


def refitted_frames(model: CalibratedModel, rows: Observations) -> FrameFit:
    """A nominal robot with all of its frames fitted to measurements."""
    problem, found = register(model.problem(rows), model.theta)
    parameters = problem.parameters
    return _fitted(problem, found.x, parameters.free & parameters.nuisance)


def fitted_station(model: CalibratedModel, rows: Observations) -> FrameFit:
    """A robot with its tool, whose station is fitted to measurements of one block."""
    problem, theta = extended(model.problem(rows), model.theta, rows)
    part = problem.parts[rows.keys[0]]
    problem = relocated(problem, theta, part.scope.station)
    free = np.isin(np.arange(len(theta)), part.index[:FRAME])
    basis = np.diag(problem.parameters.scales)[:, free]
    return _fitted(problem, least_squares(problem, theta, basis).x, free)


def derivatives(problem: Problem, theta: Floats) -> Floats:
    """Derivatives of the errors of one block by all parameters, shape (N, D, P)."""
    sigma = problem.sigma
    J = problem.linearize_rows(theta)[1][: len(sigma)] * sigma[:, None]
    return np.asarray(J.reshape(len(problem.data), -1, len(theta)))


def _frames_alone(chains: Chains, rows: Observations, setup: Setup) -> Problem:
    """The problem of the nominal robot, whose frames have what the setup knows."""
    bare = replace(setup, parameters=(), learned=None, fixed=(), bounds={}, prior={})
    names = make_problem(chains, rows, bare).parameters.names
    fixed = tuple(glob for glob in setup.fixed if [*matching(glob, names)])
    priors = setup.prior_by_glob.items()
    prior = {glob: size for glob, size in priors if [*matching(glob, names)]}
    return make_problem(chains, rows, replace(bare, fixed=fixed, prior=prior))


def _fitted(problem: Problem, theta: Floats, free: NDArray[np.bool_]) -> FrameFit:
    """What measurements tell of free parameters that were fitted to them.

    Measurements of one configuration have the errors of the robot in common: they count
    as one, their mean.
    """
    part, (label, first) = (
        problem.parts[problem.data.only.key],
        ranked(problem.data.groups()),
    )
    some = replace(problem, data=problem.data.rows(first))
    errors = error_table(problem, theta)
    means = np.zeros((len(first), errors.shape[1]))
    np.add.at(means, label, errors)
    means /= np.bincount(label)[:, None]
    sigma = np.tile(assumed_sigma(part, problem.setup), len(first))
    scales = problem.parameters.scales[free]
    J = derivatives(some, theta).reshape(means.size, -1)[:, free] * scales
    A, e = J / sigma[:, None], means.reshape(-1) / sigma
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    U = U[:, s > NOTHING * s.max(initial=0.0)]
    dof, back = len(e) - U.shape[1], np.diag(problem.parameters.scales)[:, free]
    if dof == 0:
        return FrameFit(problem, theta, back, back, 0)
    e = (e - U @ (U.T @ e)).reshape(means.shape)
    size = np.ones_like(e)
    for quantity in part.measurement.quantities:
        own = e[:, quantity.columns]
        size[:, quantity.columns] = np.sqrt(np.mean(own**2) * e.size / dof)
    size = np.maximum(size.reshape(-1), ROUNDING)
    # What nothing tells is known to a meter and a radian.
    prior = np.diag(np.maximum(scales / problem.parameters.priors[free], 1.0))
    rows = np.concatenate([A / size[:, None], prior])
    _, s, Vt = np.linalg.svd(np.linalg.qr(rows, mode="r"))
    return FrameFit(problem, theta, back @ (Vt.T / s), back, dof)
