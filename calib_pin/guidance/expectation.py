"""What is expected of the next row, by the fit of those before it."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np

from calib_pin.errors import CalibPinError
from calib_pin.estimation.fit import FittedModel, fit_model
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.nominal import register
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.statistics.distributions import f_tail
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Observations, states_sigmas
from calib_pin.setup import JointPrior, Setup
from calib_pin.validation.assessment import registration_reason
from calib_pin.validation.model_errors import (
    mahalanobis,
    predicted_variance,
    registered,
)

LEVEL = 1e-3
"""Probability by chance below which a row is told not to be as expected."""

WIDE = 1.5
"""Expected sizes of an error within which a robot is looked for before its measurements
tell more than frames."""

KNOWN = 1e6
"""Degrees of freedom of a noise that is stated."""


@dataclass(frozen=True)
class Deviation:
    """A row beside its prediction.

    Attributes:
        size: How far it is from there, of the first quantity it has [its unit].
        sigma: Standard deviation of that [its unit].
        unit: The unit, m, rad or px.
        chance: Probability of as much by chance.
    """

    size: float
    sigma: float
    unit: str
    chance: float

    @property
    def wrong(self) -> bool:
        """Whether it is not chance."""
        return self.chance < LEVEL


@dataclass(frozen=True)
class Expectation:
    """A fit of all rows so far, as one of the next row sees it.

    Attributes:
        model: The fit.
        reason: Why it predicts nothing yet; empty where it does.
        early: Whether the noise is assumed, and the errors of the robot, too.
    """

    model: FittedModel | None
    reason: str = ""
    early: bool = False

    @staticmethod
    def of(
        chains: Chains,
        rows: Observations,
        setup: Setup,
        seed: int,
        registered_before: bool = False,
    ) -> Expectation:
        """The ordinary fit, or with wide priors as long as nothing tells the noise."""
        try:
            problem = make_problem(chains, rows, setup)
            if not registered_before:
                found, result = register(problem, np.zeros(len(problem.parameters)))
                if reason := registration_reason(found, result):
                    return Expectation(None, reason)
            model = fit_model(chains, rows, setup, seed)
            if model.fit.noise:
                return Expectation(model)
            stated = replace(setup, prior=wide(problem), learned=None)
            return Expectation(fit_model(chains, rows, stated, seed), early=True)
        except (CalibPinError, np.linalg.LinAlgError) as error:
            return Expectation(None, getattr(error, "reason", str(error)))

    @cached_property
    def freedom(self) -> float:
        """Degrees of freedom of the noise."""
        assert self.model is not None
        if self.early or states_sigmas(self.model.fit.problem.data):
            return KNOWN
        noise = self.model.fit.noise
        return sum(part.redundancy * part.values for part in noise)

    def deviation(self, row: Observations) -> Deviation | None:
        """How far measurements are from there; None where nothing tells."""
        if self.model is None or self.freedom < 1.0:
            return None
        if not np.isfinite(self.model.fit.posterior.by_noise).all():
            return None
        try:
            there = registered(self.model.problem, self.model.theta, row)
        except CalibPinError:
            return None
        if there.new:
            return None  # Its own place is all it tells.
        fit, problem = self.model.fit, there.problem
        values = int(np.isfinite(problem.sigma).sum())
        # Errors that are larger than assumed show in the fit.
        inflation = max(float(np.nan_to_num(fit.sigma0)), 1.0) if self.early else 1.0
        square = mahalanobis(fit, problem, there.theta) / inflation**2
        chance = f_tail(square / values, values, self.freedom)
        first = problem.layout.component == problem.layout.component[0]
        error = problem.errors(there.theta)[first]
        variance = predicted_variance(fit, problem, there.theta)[first]
        count = len(row)
        size, sigma = (float(np.sqrt(v.sum() / count)) for v in (error**2, variance))
        sigma *= inflation
        unit = problem.layout.quantities[0].unit
        return Deviation(size, sigma, unit, chance)


def wide(problem: Problem) -> JointPrior | dict[str, float]:
    """Priors of all errors of the robot, those that the setup states first."""
    stated = problem.setup.prior
    if isinstance(stated, JointPrior):
        return stated
    alone = [
        p for p in problem.parameters if np.isinf(p.prior) and p.free and not p.nuisance
    ]
    return {**stated, **{p.name: WIDE * p.scale for p in alone}}
