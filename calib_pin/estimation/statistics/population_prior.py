"""Knowledge of a robot beforehand, and how far its measurements are from it.

Robots of one type have a mean and a spread of each error in common: the errors of robot
i are `theta_i = mu + u_i`, `u_i ~ N(0, Lambda)`, with a diagonal Lambda. Its
measurements tell `W_i theta_i = c_i` with independent noise of deviation one, as many
rows as they can tell errors apart. So

    c_i ~ N(W_i mu, V_i),   V_i = W_i Lambda W_i' + 1,

and nothing that a robot hides needs to be inverted: what its frames absorb, or no
configuration shows. Lambda is that of the highest restricted likelihood, mu the
generalized least squares with it (empirical Bayes: Efron and Morris 1973). The prior of
the next robot is the predictive distribution, `N(mu, Lambda + cov(mu))`, wider by what
Student's t adds where a spread is known from few robots.

Beforehand the mean of an error is as large as its scale, and its spread as that of all
errors together: what no robot shows keeps the mean zero and these sizes.

Innovations `v ~ N(0, V)` are new measurements minus their prediction, with

    V = V_0 + sum_g s_g^2 E_g E_g',

V_0 by what was uncertain before, and causes g that act by independent effects of one
size s_g: the drift of a robot, the noise of the measurements, a joint that was hit, a
measurement that is wrong. A size that was expected beforehand counts like as many
effects as it is worth; the sizes are the most likely ones.

A sparse cause is accepted by its evidence: the likelihood with it, averaged over all
sizes that it may have, by that without. Were there no such cause, a ratio of k would
come about in at most one of k cases (Markov's inequality, as `E[L_1/L_0] = 1`).
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.statistics.distributions import (
    chi_square_quantile,
    student_quantile,
)
from calib_pin.estimation.statistics.variance_components import (
    KNOWN,
    REJECTED,
    STATED,
    Components,
    ErrorBlock,
    estimate_variances,
)
from calib_pin.kinematics.spatial import Floats
from calib_pin.setup.population import ParameterPrior, PopulationPrior, RobotType

LEAST = 5
"""Robots that a prior is made from at least: with fewer a spread is a guess."""


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


@serial_blas
def prior_of_type(evidences: Sequence[RobotEvidence]) -> PopulationPrior:
    """The prior of the next robot of a type.

    Args:
        evidences: What the measurements of each robot tell, `LEAST` or more of one type
            and of the same parameters.
    """
    first, scales = evidences[0], evidences[0].scales
    count = len(first.names)
    # The means are about one beforehand.
    blocks = [ErrorBlock(np.eye(count, count + 1), np.full(count, KNOWN))]
    for e in evidences:
        rows, number = np.column_stack([-e.rows, e.values]), len(e.values)
        labels = np.append(np.full(number, KNOWN), np.arange(count))
        blocks.append(ErrorBlock(rows, labels, np.hstack([np.eye(number), e.rows])))
    each = np.ones(count)
    # One spread for all, in their scales, then one for each.
    individual = Components(blocks, each / count, each / count)
    together = individual.relabeled(np.zeros(count, int))
    common = estimate_variances(together, np.ones(1)).values * each
    components = Components(blocks, STATED * each, STATED * common)
    model = estimate_variances(components, common)
    robots = np.maximum(model.redundancies - STATED, 0.0)
    widened = model.values * [_widening(STATED + number) for number in robots]
    covariance = np.diag(widened) + model.covariance
    parameters = map(
        ParameterPrior,
        first.names,
        first.units,
        (scales * model.unknowns).tolist(),
        (scales * np.sqrt(np.diag(model.covariance))).tolist(),
        (scales * np.sqrt(model.values)).tolist(),
        robots.tolist(),
    )
    return PopulationPrior(
        robot=first.robot,
        robots=len(evidences),
        parameters=tuple(parameters),
        covariance=tuple(map(tuple, (covariance * np.outer(scales, scales)).tolist())),
        noise=_median_noise(evidences),
    )


def _median_noise(evidences: Sequence[RobotEvidence]) -> Mapping[str, float]:
    """The noise of every quantity; a few bad measurements of robots do not matter."""
    names = dict.fromkeys(name for e in evidences for name in e.noise)
    known = {n: [e.noise[n] for e in evidences if n in e.noise] for n in names}
    return {name: float(np.median(sigmas)) for name, sigmas in known.items()}


def _widening(dof: float) -> float:
    """Variance of the normal distribution that covers as much as Student's t.

    Examples:
        >>> round(_widening(10.0), 3), round(_widening(200.0), 3)
        (1.292, 1.012)
    """
    normal = chi_square_quantile(1.0, REJECTED)
    return student_quantile(dof, 0.5 * REJECTED) ** 2 / normal


PROMISING = 6
"""Causes that are looked at closely, of all that might be accepted."""


@dataclass(frozen=True)
class Cause:
    """A cause of innovations.

    Attributes:
        name: Its name.
        effects: E, the innovations by its effects of size one, shape (r, k).
        size: Their expected size s; that of a sparse cause is found.
        worth: Number of effects that the expected size is worth against those that
            show; infinite where the size is known.
        most: Largest size.
        sizes: The sizes that a cause may have which is there or, far more likely, not:
            equally likely, ascending.
        chance: How likely that is beside others, before any evidence.
    """

    name: str
    effects: Floats
    size: float = 1.0
    worth: float = np.inf
    most: float = np.inf
    sizes: Sequence[float] | Floats = ()
    chance: float = 1.0


@dataclass(frozen=True)
class Explanation:
    """Innovations and the causes that explain them.

    Attributes:
        values: The innovations v, shape (r,).
        known: Their covariance V_0 by what was uncertain before, shape (r, r).
        causes: The causes; their sizes count.
    """

    values: Floats
    known: Floats
    causes: tuple[Cause, ...]

    @property
    def covariance(self) -> Floats:
        """Covariance V of the innovations, shape (r, r)."""
        result = self.known.copy()
        for cause in self.causes:
            result += cause.size**2 * cause.effects @ cause.effects.T
        return result

    @property
    def square(self) -> float:
        """Chi-square of the innovations, of as many degrees of freedom as they are."""
        return float(self.values @ np.linalg.solve(self.covariance, self.values))

    @property
    def likelihood(self) -> float:
        """Logarithm of their density, but for a constant."""
        return float(_likelihoods(self.values, self.covariance[None])[0])

    def effects(self, cause: Cause) -> tuple[Floats, Floats]:
        """The likeliest effects of a cause, (k,), and their covariance, (k, k)."""
        E, square = cause.effects, cause.size**2
        by = square * np.linalg.solve(self.covariance, E).T
        return by @ self.values, square * np.eye(E.shape[1]) - square * by @ E

    def fitted(self) -> tuple[Explanation, tuple[float, ...]]:
        """The likeliest sizes, and the number of effects that tell each of them."""
        acting = [cause for cause in self.causes if np.isfinite(cause.worth)]
        names = [cause.name for cause in acting]
        variances, vectors = np.linalg.eigh(self.without(names).covariance)
        half = vectors * np.sqrt(np.maximum(variances, 0.0))
        factors = [half, *(cause.effects for cause in acting)]
        number = [factor.shape[1] for factor in factors]
        labels = np.repeat([KNOWN, *range(len(acting))], number)
        block = ErrorBlock(self.values[:, None], labels, np.hstack(factors))
        numbers = [(cause.worth, cause.size, cause.most) for cause in acting]
        worth, size, most = np.reshape(numbers, (-1, 3)).T
        components = Components([block], worth, worth * size**2)
        model = estimate_variances(components, size**2, upper=most**2)
        sizes = dict(zip(names, np.sqrt(model.values).tolist(), strict=True))
        counts = dict(zip(names, (model.redundancies - worth).tolist(), strict=True))
        causes = [replace(c, size=sizes.get(c.name, c.size)) for c in self.causes]
        result = replace(self, causes=tuple(causes))
        return result, tuple(counts.get(cause.name, 0.0) for cause in causes)

    def misfit(self, effects: Floats) -> float:
        """Chi-square of the innovations with effects of any size, shape (r, k)."""
        by = np.linalg.solve(self.covariance, np.column_stack([self.values, effects]))
        square, along = float(self.values @ by[:, 0]), effects.T @ by[:, 0]
        return square - float(along @ np.linalg.pinv(effects.T @ by[:, 1:]) @ along)

    def without(self, names: Collection[str]) -> Explanation:
        """The same without some causes."""
        causes = tuple(cause for cause in self.causes if cause.name not in names)
        return replace(self, causes=causes)

    def evidence(self, cause: Cause) -> tuple[float, Cause]:
        """Logarithm of the mean likelihood with a sparse cause, and it as is likeliest.

        That counts how likely it is beside others.
        """
        EE = cause.effects @ cause.effects.T
        V = self.covariance + np.square(cause.sizes)[:, None, None] * EE
        log_L = _likelihoods(self.values, V)
        best = float(log_L.max())
        mean = best + float(np.log(cause.chance * np.mean(np.exp(log_L - best))))
        return mean, replace(cause, size=float(cause.sizes[int(np.argmax(log_L))]))

    def expected(self, other: Explanation) -> float:
        """Logarithm of how likely the sizes are beforehand by those of another one."""
        pairs = zip(self.causes, other.causes, strict=False)
        acting = [(c, new) for c, new in pairs if np.isfinite(c.worth)]
        squares = [(c.worth, (new.size / c.size) ** 2) for c, new in acting]
        terms = [worth * float(np.log(r) + 1.0 / r - 1.0) for worth, r in squares]
        return -0.5 * sum(terms)


def explained(
    first: Explanation, causes: Sequence[Cause], sure: float, most: int
) -> tuple[Explanation, tuple[Cause, ...], float]:
    """Innovations with the sparse causes that the evidence is sure of, one by one.

    One that those accepted after it have made needless is dropped again.

    Args:
        first: The innovations with the causes that always act, of expected sizes.
        causes: The sparse causes.
        sure: Ratio of the evidence for a cause, times its chance, from which it is
            accepted.
        most: Most sparse causes.

    Returns:
        The innovations with all causes of their likeliest sizes; the sparse ones among
        these, in the order in which they were accepted; and the logarithm of the
        evidence by that without them.
    """
    accepted, evidence = list[Cause](), 0.0
    remaining = {cause.name: cause for cause in causes}
    while remaining and len(accepted) < most:
        gain, cause = _best(first, accepted, [*remaining.values()])
        if gain < np.log(sure):
            break
        accepted.append(cause)
        evidence += gain
        del remaining[cause.name]
    for cause in accepted[:-1]:
        others = [other for other in accepted if other is not cause]
        gain, _ = _best(first, others, [cause])
        if gain < np.log(sure):
            accepted, evidence = others, evidence - gain
    result, _ = replace(first, causes=(*first.causes, *accepted)).fitted()
    return result, tuple(accepted), evidence


def _best(
    first: Explanation, accepted: Sequence[Cause], causes: Sequence[Cause]
) -> tuple[float, Cause]:
    """The cause with the most evidence, by that without it, and its size.

    What always acts may have grown for want of the cause, and is fitted beside it.
    """
    now, _ = replace(first, causes=(*first.causes, *accepted)).fitted()
    promising = sorted(map(now.evidence, causes), key=lambda pair: -pair[0])
    result = []
    for _, cause in promising[:PROMISING]:
        beside = replace(first, causes=(*first.causes, *accepted, cause))
        other, _ = beside.fitted()
        evidence, cause = other.without({cause.name}).evidence(cause)
        result.append((evidence + first.expected(other), cause))
    gain, best = max(result, key=lambda pair: pair[0])
    return gain - now.likelihood - first.expected(now), best


def _likelihoods(v: Floats, V: Floats) -> Floats:
    """Logarithms of normal densities, shapes (r,) and (K, r, r) -> (K,)."""
    half = np.linalg.cholesky(V)
    logarithm = np.log(np.diagonal(half, axis1=1, axis2=2)).sum(axis=1)
    rest = np.linalg.solve(half, np.broadcast_to(v[:, None], (len(V), len(v), 1)))
    return np.asarray(-logarithm - 0.5 * np.sum(rest[:, :, 0] ** 2, axis=1))
