"""Errors that robots of one type have in common: the mean and spread of each.

The errors of robot i are `theta_i = mu + u_i`, `u_i ~ N(0, Lambda)`, with a diagonal
Lambda. Its measurements tell `W_i theta_i = c_i` with independent noise of deviation
one, as many rows as they can tell errors apart. So

    c_i ~ N(W_i mu, V_i),   V_i = W_i Lambda W_i' + 1,

and nothing that a robot hides needs to be inverted: what its frames absorb, or no
configuration shows. Lambda is that of the highest restricted likelihood, mu the
generalized least squares with it (empirical Bayes: Efron and Morris 1973; the rounds
are those of MacKay, Bayesian interpolation, 1992). The prior of the next robot is the
predictive distribution, `N(mu, Lambda + cov(mu))`, wider by what Student's t adds where
a spread is known from few robots.

Beforehand the mean of an error is as large as its scale, and its spread as that of all
errors together: what no robot shows keeps the mean zero and these sizes.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import OptionError, enumerated
from calib_pin.estimation.statistics.distributions import chi_square_quantile, f_tail
from calib_pin.kinematics.spatial import Floats
from calib_pin.setup.population import ParameterPrior, PopulationPrior, RobotType

LEAST = 5
"""Robots that a prior is made from at least: with fewer a spread is a guess."""

STATED = 2.0
"""Robots that the common spread is worth against those that show one of their own."""

STANDS = 1e-3
"""Relative change of a variance that no longer matters: of two hundred robots it is
known to ten percent."""

ROUNDS = 2000
"""Most rounds; a hundred are usual."""

SMALLEST = 1e-6
"""Least variance, in squared scales: a spread of a micrometer."""

OUTSIDE = 0.05
"""Part of the robots that an interval leaves outside where the normal prior is as wide
as Student's t."""


@dataclass(frozen=True)
class RobotEvidence:
    """The equations for the errors of one robot that its measurements amount to.

    Attributes:
        robot: The type of the robot.
        names: Names of its P error parameters.
        units: Their units.
        scales: Their expected sizes, shape (P,).
        rows: W of `W theta = c` with noise of deviation one, theta divided by the
            scales, shape (r, P).
        values: c, shape (r,).
        noise: Standard deviation of a component of every quantity, where it is known.
    """

    robot: RobotType
    names: tuple[str, ...]
    units: tuple[str, ...]
    scales: Floats
    rows: Floats
    values: Floats
    noise: Mapping[str, float]


@dataclass(frozen=True)
class Likelihood:
    """The measurements of all robots at given spreads.

    Attributes:
        mean: Mean errors mu, shape (P,).
        covariance: Covariance of the means, shape (P, P).
        information: `W_i' V_i^-1 W_i` of every robot, shape (R, P, P).
        scores: `W_i' V_i^-1 (c_i - W_i mu)` of every robot, shape (R, P).
    """

    mean: Floats
    covariance: Floats
    information: Floats
    scores: Floats

    @cached_property
    def known(self) -> Floats:
        """Covariance of the scores, about a mean that is their own, (R, P, P)."""
        G = self.information
        return np.asarray(G - G @ self.covariance @ G)

    @cached_property
    def expected(self) -> Floats:
        """Sums of the squared scores that these spreads predict, shape (P,)."""
        G = self.information
        # The diagonal of `known`, without the rest of it.
        mean = np.einsum("ijk,ijk->j", G @ self.covariance, G)
        return np.asarray(np.einsum("ijj->j", G) - mean)

    @property
    def found(self) -> Floats:
        """Sums of the squared scores, shape (P,)."""
        return np.asarray(np.sum(self.scores**2, axis=0))


@dataclass(frozen=True)
class Population:
    """Robots of one type, and what they have in common; all numbers in scales.

    Attributes:
        evidences: What their measurements tell, one for each robot.
        variances: Variance of every error among robots, shape (P,).
        likelihood: Their measurements at these variances.
    """

    evidences: tuple[RobotEvidence, ...]
    variances: Floats
    likelihood: Likelihood

    @property
    def robots(self) -> Floats:
        """Number of robots that each spread is known from, shape (P,)."""
        return self.variances * self.likelihood.expected

    def prior(self) -> PopulationPrior:
        """The prior of the next robot."""
        first, found = self.evidences[0], self.likelihood
        scales, sigma = first.scales, np.sqrt(np.diag(found.covariance))
        widened = self.variances * [_widening(STATED + n) for n in self.robots]
        covariance = (np.diag(widened) + found.covariance) * np.outer(scales, scales)
        columns = [
            *(scales * found.mean, scales * sigma, scales * np.sqrt(self.variances)),
            self.robots,
        ]
        numbers = np.column_stack(columns).tolist()
        return PopulationPrior(
            robot=first.robot,
            robots=len(self.evidences),
            parameters=tuple(
                ParameterPrior(name, unit, *row)
                for name, unit, row in zip(
                    first.names, first.units, numbers, strict=True
                )
            ),
            covariance=tuple(map(tuple, covariance.tolist())),
            noise=_median_noise(self.evidences),
        )


@serial_blas
def population_of(evidences: Sequence[RobotEvidence]) -> Population:
    """Mean and spread of the errors of robots of one type.

    Args:
        evidences: What the measurements of each robot tell.

    Raises:
        OptionError: If they are too few, of several types, or of other parameters.
    """
    _require_alike(evidences)
    rows = _Rows.of(evidences)
    count = len(evidences[0].names)
    # One spread for all, in their scales, then one for each.
    common = rows.spread(np.ones(count), None)
    variances = rows.spread(common, common)
    return Population(tuple(evidences), variances, rows.at(variances))


def _require_alike(evidences: Sequence[RobotEvidence]) -> None:
    if len(evidences) < LEAST:
        raise OptionError(
            "the robots are too few to tell what their type has in common",
            value=len(evidences),
            allowed=f"{LEAST} or more",
        )
    first = evidences[0]
    for number, other in enumerate(evidences[1:], 2):
        difference = first.robot.difference(other.robot)
        lacking = set(first.names) ^ set(other.names)
        if not difference and (lacking or first.names != other.names):
            names = sorted(lacking) or list(other.names)
            difference = f"its parameters are others: {enumerated(names)}"
        if difference:
            raise OptionError(
                f"robot {number} is not of the type of the first one: {difference}",
                value=other.robot.name,
                allowed=first.robot.name,
            )


@dataclass(frozen=True)
class _Rows:
    """The evidence of R robots, rows of zeros added where one has fewer.

    Attributes:
        W: Shape (R, r, P).
        c: Shape (R, r).
    """

    W: Floats
    c: Floats

    @staticmethod
    def of(evidences: Sequence[RobotEvidence]) -> _Rows:
        most = max(len(one.values) for one in evidences)
        W = np.zeros((len(evidences), most, len(evidences[0].names)))
        c = np.zeros((len(evidences), most))
        for k, one in enumerate(evidences):
            W[k, : len(one.rows)] = one.rows
            c[k, : len(one.values)] = one.values
        return _Rows(W, c)

    def at(self, variances: Floats) -> Likelihood:
        """The measurements at variances of the errors, shape (P,)."""
        V = (self.W * variances) @ self.W.transpose(0, 2, 1) + np.eye(self.c.shape[1])
        half = np.linalg.inv(np.linalg.cholesky(V))
        rows, values = half @ self.W, (half @ self.c[:, :, None])[:, :, 0]
        information = rows.transpose(0, 2, 1) @ rows
        along = np.einsum("irp,ir->ip", rows, values)
        # Means are about one beforehand.
        covariance = np.linalg.inv(information.sum(axis=0) + np.eye(len(variances)))
        covariance = 0.5 * (covariance + covariance.T)
        mean = covariance @ along.sum(axis=0)
        return Likelihood(mean, covariance, information, along - information @ mean)

    def spread(self, variances: Floats, common: Floats | None) -> Floats:
        """The variances of the highest restricted likelihood, shape (P,).

        Args:
            variances: Where to begin, shape (P,).
            common: The size that they have together, shape (P,); None where there is
                only that.
        """
        for _ in range(ROUNDS):
            now = self.at(variances)
            found = variances**2 * now.found
            told = variances * now.expected
            if common is None:
                new = np.full_like(variances, (1.0 + found.sum()) / (1.0 + told.sum()))
            else:
                new = (STATED * common + found) / (STATED + told)
            new = np.maximum(new, SMALLEST)
            change = np.abs(np.log(new / variances)).max()
            variances = new
            if change < STANDS:
                break
        return variances


def _median_noise(evidences: Sequence[RobotEvidence]) -> Mapping[str, float]:
    """The noise of every quantity; a few bad measurements of robots do not matter."""
    found: dict[str, list[float]] = {}
    for one in evidences:
        for name, sigma in one.noise.items():
            found.setdefault(name, []).append(sigma)
    return {name: float(np.median(sigmas)) for name, sigmas in found.items()}


def _widening(dof: float) -> float:
    """Variance of the normal distribution that covers as much as Student's t.

    Examples:
        >>> round(_widening(10.0), 3), round(_widening(200.0), 3)
        (1.292, 1.012)
    """
    normal = chi_square_quantile(1.0, OUTSIDE)
    low, high = normal, 100.0 * normal
    while high - low > 1e-9 * low:
        middle = 0.5 * (low + high)
        low, high = (
            (middle, high) if f_tail(middle, 1.0, dof) > OUTSIDE else (low, middle)
        )
    return low / normal
