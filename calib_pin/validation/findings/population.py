"""A robot that is not like those its prior was made from."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit, robot_rows
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.row_blocks import Priors
from calib_pin.estimation.statistics.distributions import chi_square_tail
from calib_pin.setup import PopulationPrior
from calib_pin.validation.findings.case import Case

CHANCE = 1e-4
"""Probability by chance below which a robot is unlike the others."""

SPOILED = 2.0
"""Noise with the prior by noise without it from which the prior spoils a fit."""


def population(case: Case) -> Iterator[Finding]:
    """Errors that the prior of a robot's type did not expect.

    A fit without the prior tells `W theta = c`, where `c - W mean` has the covariance
    `W S W' + 1` if the robot is one of those with the covariance S. A fit with the
    prior cannot tell: a robot that is far off looks like noise to it.
    """
    fitted = case.fitted
    if fitted is None or not isinstance(fitted.problem.setup.prior, PopulationPrior):
        return
    prior = fitted.problem.setup.prior
    plain = _without_prior(case, fitted)
    if not plain.noise:
        return  # Without redundancy nobody knows the noise.
    told = robot_rows(plain.problem, plain.theta, plain.noise)
    parameters, robot = plain.problem.parameters, told.robot
    scales, held = parameters.scales[robot], Priors.together(prior, parameters)
    half = np.linalg.inv(held.rows[:, robot] * scales)
    W = told.rows @ half
    V = W @ W.T + np.eye(len(W))
    rest = told.values - told.rows @ (held.mean[robot] / scales)
    square = float(rest @ np.linalg.solve(V, rest))
    if not len(rest) or chi_square_tail(square, len(rest)) > CHANCE:
        return
    # By the most likely errors, in the deviations of the prior.
    off = half @ (W.T @ np.linalg.solve(V, rest)) / np.linalg.norm(half, axis=1)
    k = int(np.argmax(np.abs(off)))
    name = np.array(parameters.names)[robot][k]
    spoiled = any(
        with_it.estimate > SPOILED * alone.estimate
        for with_it, alone in zip(fitted.noise, plain.noise, strict=False)
    )
    yield Finding(
        "unlike-fleet",
        "error" if spoiled else "warning",
        f"this robot is not like the {prior.robots} of its prior: chi-square "
        f"{square:.0f} where {len(rest)} is expected, '{name}' {abs(off[k]):.1f} "
        "standard deviations from their mean",
        {
            "chi2": square,
            "dof": float(len(rest)),
            "parameter": str(name),
            "deviations": float(off[k]),
        },
        "look for damage or another type, and calibrate it without the prior",
    )


def _without_prior(case: Case, fitted: Fit) -> Fit:
    """The fit of the same measurements without the prior."""
    setup = replace(fitted.problem.setup, prior={})
    problem = make_problem(case.chains, fitted.problem.data, setup)
    return fit(problem, np.random.default_rng(0))
