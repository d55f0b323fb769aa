"""The fit of all rows so far: the prediction of the next one, the verdict, causes."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

import calib_pin.validation.model_errors as model_errors
from calib_pin.errors import CalibPinError
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.nominal import register
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.row_blocks import Priors
from calib_pin.estimation.statistics.distributions import f_tail
from calib_pin.guidance.events import State
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations, states_sigmas
from calib_pin.setup import JointPrior, Setup
from calib_pin.validation.assessment import robot_errors
from calib_pin.validation.findings import find
from calib_pin.validation.findings.case import FOREIGN, Case, Others
from calib_pin.validation.held_out import check
from calib_pin.validation.judgement import examine, judge

LEVEL = 1e-3
"""Probability by chance below which a row is told not to be as expected."""

WIDE = 1.5
"""Expected sizes of an error within which a robot is looked for before its measurements
tell the noise."""

KNOWN = 1e6
"""Degrees of freedom of a noise that is stated."""


class Deviation(NamedTuple):
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
class Fitted:
    """A fit of the rows so far.

    Attributes:
        chains: The nominal chains.
        rows: The rows.
        setup: The setup.
        seed: Seed of whatever is random.
        model: The fit; None where there is none yet.
        reason: Why not.
        early: Whether the noise is assumed, and the size of the robot's errors, too.
    """

    chains: Chains
    rows: Observations
    setup: Setup
    seed: int
    model: Fit | None = None
    reason: str = "nothing to compare it with yet"
    early: bool = False

    def fit(self, known: bool, robust: bool) -> Fitted:
        """The ordinary fit, or with wide priors as long as nothing tells the noise.

        Args:
            known: Whether fewer rows than these determined the frames.
            robust: Whether the rows may have outliers that nobody has set aside.
        """
        if not robust and self.setup.loss == "auto":
            squared = replace(self.setup, loss="squared")
            return replace(self, setup=squared).fit(known, True)
        try:
            problem = make_problem(self.chains, self.rows, self.setup)
            if not known:
                nominal, result = register(problem, np.zeros(len(problem.parameters)))
                if reason := model_errors.registration_reason(nominal, result):
                    return replace(self, reason=reason)
            model = fit_model(self.chains, self.rows, self.setup, self.seed)
            if early := not model.noise:
                prior, sizes = self.setup.prior, _wide_priors(problem)
                if not isinstance(prior, JointPrior):
                    named = zip(problem.parameters.names, sizes.tolist(), strict=True)
                    prior = {**prior, **{n: size for n, size in named if size < np.inf}}
                setup = replace(self.setup, prior=prior, learned=None)
                model = fit_model(self.chains, self.rows, setup, self.seed)
            return replace(self, model=model, early=early)
        except (CalibPinError, np.linalg.LinAlgError) as error:
            return replace(self, reason=getattr(error, "reason", str(error)))

    @property
    def informed(self) -> Problem:
        """The problem of the fit with wide priors on all errors of the robot."""
        assert self.model is not None
        problem = self.model.problem
        return replace(problem, expected=Priors.alone(_wide_priors(problem)))

    def deviation(self, row: Observations) -> Deviation | None:
        """How far measurements are from their prediction; None where nothing tells."""
        if self.model is None or not np.isfinite(self.model.covariance).all():
            return None
        fit, freedom, inflation = self.model, KNOWN, 1.0
        if self.early:
            # Errors that are larger than assumed show in the fit.
            inflation = max(float(np.nan_to_num(fit.sigma0)), 1.0)
        elif not states_sigmas(fit.problem.data):
            freedom = sum(part.redundancy * part.values for part in fit.noise)
        try:
            row_fit = model_errors.registered(*fit.solved, row)
        except CalibPinError:
            return None
        if row_fit.new or freedom < 1.0:
            return None  # Its own place is all it tells.
        problem, theta = row_fit.problem, row_fit.theta
        values = len(problem.sigma)
        square = model_errors.mahalanobis(fit, row_fit) / inflation**2
        first = problem.layout.component == problem.layout.component[0]
        error = problem.errors(theta)[first]
        variance = inflation**2 * model_errors.predicted_variance(fit, row_fit)[first]
        size, sigma = np.sqrt([np.sum(error**2), variance.sum()]) / len(row) ** 0.5
        unit = problem.layout.quantities[0].unit
        chance = f_tail(square / values, values, freedom)
        return Deviation(float(size), float(sigma), unit, chance)

    @property
    def doubtful(self) -> bool:
        """Whether the rows are so far from the robot that they may be read wrong."""
        return self._case is None or self._case.doubtful

    @property
    def lost(self) -> bool:
        """Whether no robot explains them, so that none of them stands out."""
        return self._case is None or not self._case.remaining <= FOREIGN

    @cached_property
    def _case(self) -> Case | None:
        return Case.of(self.model) if self.model else None

    def causes(self, all_rows: Observations, others: Others) -> tuple[Finding, ...]:
        """Why no robot explains the rows, those among them that were set aside."""
        try:
            return find(Case.of_robot(self.chains, all_rows, self.setup, others)).causes
        except CalibPinError:
            return ()

    def assess(
        self, known: State, ahead: tuple[float, ...], seek: bool
    ) -> tuple[State, Iterable[Finding]]:
        """The verdict and the expected accuracy, and what is wrong with the rows.

        Args:
            known: Number of rows and limit.
            ahead: Error of the tool point after 0, 1, ... further rows [m].
            seek: Whether to seek faults of all rows; they have been sought otherwise.
        """
        model, case = self.model, self._case
        assert model is not None and case is not None
        if self.early:
            return known, find(case, seek=False).others
        try:
            errors = model_errors.fitted_errors(model, self.rows)
            held_out = check(model, self.rows, self.seed, parts=())
            examined = examine(model, self.seed, seek=seek)
            judgement = judge(model, errors, held_out, *examined)
        except CalibPinError as error:
            return replace(known, reason=str(error)), ()
        state, (_, accuracy) = dict[str, Any](), judgement.worst
        state["verdict"], state["reason"] = judgement.verdict
        if accuracy is not None:
            near = (a.measured for a in judgement.accuracies.values() if a.measured)
            now, state["bound"] = accuracy.calibrated.position, accuracy.bound.position
            state["near"] = max(error.calibrated.position for error in near)
            state["workspace"] = now
            state["ahead"] = tuple(now * size / ahead[0] for size in ahead)
        known_errors = robot_errors(model.problem, model.structure, model)
        weak = [error for error in known_errors if error.status == "weak"]
        state["unknown"] = tuple(f"{e.kind} of {' + '.join(e.of)}" for e in weak)
        return replace(known, **state), judgement.findings


def _wide_priors(problem: Problem) -> Floats:
    """Wide priors on the errors of the robot that have none of their own, (P,)."""
    parameters = problem.parameters
    alone = parameters.free & ~parameters.nuisance & np.isinf(parameters.priors)
    return np.where(alone, WIDE * parameters.scales, np.inf)
