"""Effects of gears and compliance that the model does not have.

Real residuals are not noise: an eccentric gear or a joint that gives under load moves
the tool in the same way whenever the joint stands there again, and a fit bends its
parameters to absorb what it can. Such errors are random effects: amplitudes

    dq_j = sum_k a_jk sin(k q_j) + b_jk cos(k q_j) + c_j tau_j(q),

k = 1, 2, of every joint that turns, all a and b of one unknown size gamma [rad], all
c_j of one size kappa in their expected sizes. They are not estimated but their sizes
are, beside the noise of every quantity, by restricted maximum likelihood; either is
kept where the likelihood ratio says that there is something.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.errors import OptionError
from calib_pin.estimation.directions import Directions, half_covariance
from calib_pin.estimation.problem import (
    Problem,
    known_values,
    measured_count,
    representative,
)
from calib_pin.estimation.statistics.restricted_likelihood import EXACT, Variances
from calib_pin.estimation.statistics.variance_components import Groups, grouped
from calib_pin.estimation.terms import Term, assembled
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.parameterizations import (
    NOTHING,
    PARAMETERIZATIONS,
    parameterization,
    required_keys,
)
from calib_pin.parameterizations.base import owner
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.setup import Setup

SIGNIFICANT = 5.41
"""Twice the gain in log-likelihood that an effect must bring: chance brings as much
once in a hundred (half of it has none at all, Self and Liang 1987)."""

SPARE = 10
"""Values of distinct configurations that must be left over beside what was fitted."""

MOST = 1.5
"""Largest squares that effects may leave in residuals, in those that are found there.

Gears and compliance are only a part of what disturbs a real robot, and likelihood makes
them as large as the rest of it needs. Without a limit, errors on held-out measurements
are predicted three to five times too large on a UR10 and a UR5; with it within 10 %.
"""

ROWS = 2000
"""Measurements that sizes are estimated from; more tell no more of a few dozen
amplitudes."""


@dataclass(frozen=True)
class Systematic:
    """Random effects of joints, of their estimated sizes.

    Attributes:
        errors: The chains with the effects as parameters, by name.
        names: Names of the effects, S of them.
        sizes: Standard deviation of each, shape (S,) [its unit].
        noise: Variance of each quantity beside them, relative to that in the units of
            the problem, shape (K,).
    """

    errors: Mapping[str, ErrorModel]
    names: tuple[str, ...]
    sizes: Floats
    noise: Floats

    @property
    def kinds(self) -> list[str]:
        """Parameterization of each effect."""
        return [name.rsplit(".", 2)[1] for name in self.names]

    def rows(self, problem: Problem, theta: Floats) -> Floats:
        """Whitened residuals that each effect of its size adds, shape (M, S).

        Args:
            problem: A problem with the rows.
            theta: Parameter values at which frames and instrument stand, shape (P,).
        """
        moved = [term.rebased(theta) for term in problem.terms.values()]
        about = [replace(term, error=self._about(term)) for term in moved]
        terms, given = assembled(about)
        plain, data = Setup(noise=problem.setup.noise), problem.data
        there = Problem(problem.chains, terms, given, data, plain, problem.units)
        _, J = there.linearize_rows(np.zeros(len(given)))
        columns = [given.index(name) for name in self.names]
        return np.asarray(J[:, columns] * self.sizes)

    def twists(self, term: Term, q: Floats) -> Floats:
        """Body twists of the tool of a term by each effect of its size, (N, 6, S).

        Args:
            term: The term about its solution, see `Terms.rebased`.
            q: Positions of its joints, shape (N, n) [rad, m].
        """
        there, result = self._about(term), np.zeros((len(q), 6, len(self.names)))
        _, J = there.jacobian(q, np.zeros(len(there.screws)))
        for k, name in enumerate(there.parameters.names):
            if name in self.names:
                own = self.names.index(name)
                result[:, :, own] = J[:, :, k] * self.sizes[own]
        return result

    def _about(self, term: Term) -> ErrorModel:
        """The effects of the chain of a term about its frames."""
        error = self.errors[term.key.chain]
        return error.with_frames(term.error.base, term.error.tool)


def with_effects(
    sample: Problem,
    theta: Floats,
    basis: Floats,
    effects: Floats,
    kind_of: Sequence[str],
) -> Groups | None:
    """The rows of a problem with random effects; None where they are exact.

    Args:
        sample: The problem, see `sampled`.
        theta: Its solution, shape (P,).
        basis: The directions that were moved, shape (P, k).
        effects: Whitened residuals by all effects in their expected sizes, (M, S).
        kind_of: Kind of each.
    """
    fun, jac = sample.linearize_rows(theta)
    measured = fun[: len(effects)]
    if float(measured @ measured) <= EXACT * measured_count(sample):
        return None
    X = np.zeros((len(fun), len(kind_of)))
    X[: len(effects)] = effects
    half = half_covariance(jac, basis, sample.parameters)
    return grouped(sample, np.column_stack([jac @ half, X, fun]), kind_of)


def systematic(
    problem: Problem, theta: Floats, directions: Directions
) -> Systematic | None:
    """Estimate the sizes of what gears and compliance leave in the residuals.

    Args:
        problem: The problem in the units of its solution.
        theta: The solution, shape (P,).
        directions: The directions that were moved.

    Returns:
        The effects, or None where nothing shows, all of them are estimated, or the
        nominal robot is where nothing can be measured.
    """
    effects = candidates(problem)
    spare = known_values(problem) - directions.count
    if effects is None or spare < SPARE:
        return None
    sample = replace(problem, data=sampled(problem))
    X = effects.rows(sample, theta)
    if not np.isfinite(X).all():
        return None  # The nominal robot is far away, behind the camera, say.
    groups = with_effects(sample, theta, directions.basis, X, effects.kinds)
    if groups is None:
        return None
    chosen, found = groups.selected(PARAMETERIZATIONS, SIGNIFICANT)
    if not chosen:
        return None
    noise = found.values[: len(groups.counts)] / groups.current
    variances = np.array([chosen.get(kind, 0.0) for kind in effects.kinds])
    variances *= min(1.0, MOST * _share(groups, noise, variances))
    kept = np.isin(effects.kinds, [*chosen])
    names = tuple(np.array(effects.names)[kept].tolist())
    sizes = (effects.sizes * np.sqrt(variances))[kept]
    return replace(effects, names=names, sizes=sizes, noise=noise)


def _share(groups: Groups, noise: Floats, variances: Floats) -> float:
    """Squares that noise leaves to effects, by those that these should leave.

    Args:
        groups: The rows with all effects.
        noise: Variances of the quantities by those of the fit, shape (K,).
        variances: Variances of the effects, shape (S,).
    """
    fitted = Variances.at(groups.components(), groups.current)
    ((e, U, _),) = fitted.whitened
    sizes = np.sqrt(np.append(groups.current, 1.0))
    X = np.vstack([*(groups.rows / sizes[:, None, None])])[:, -1 - len(variances) : -1]
    predicted = variances @ (np.sum(X**2, axis=0) - np.sum((U.T @ X) ** 2, axis=0))
    found = float(e @ e - noise @ fitted.redundancies)
    return max(found, 0.0) / float(predicted)


def sampled(problem: Problem, count: int = ROWS) -> Observations:
    """Measurements that effects are estimated from; of many stations those of some."""
    data = problem.data
    if problem.own_of_stations:
        kept = set(representative(problem))
        data = Observations(tuple(b for b in data.blocks if b.key in kept))
    return data.sample(count)


def candidates(problem: Problem, whole: Sequence[str] = ()) -> Systematic | None:
    """All effects that are not estimated already, in their expected sizes.

    Args:
        problem: The problem.
        whole: Further parameterizations, all of whose parameters are tried.
    """
    setup, chains = problem.setup, problem.chains
    kinds = dict.fromkeys(whole, ("",)) | {
        name: member.effects.components
        for name, member in PARAMETERIZATIONS.items()
        if member.effects is not None and name not in setup.parameters
    }

    def suits(kind: str, chain: Chain) -> bool:
        """Whether a chain can have errors of a kind: something may have to load it."""
        try:
            return bool(parameterization(kind, setup).screws(chain))
        except OptionError:
            return False

    if not {"", NOTHING, *setup.payloads}.issuperset(problem.data.payload.distinct):
        # Nothing is known of what was carried.
        kinds = {k: c for k, c in kinds.items() if "payloads" not in required_keys([k])}
    errors: dict[str, ErrorModel] = {}
    sizes: dict[str, float] = {}
    for name, chain in ((name, chains[name]) for name in chains.names):
        loaded = [kind for kind in kinds if suits(kind, chain)]
        errors[name] = ErrorModel.create(
            chain, loaded, setup=setup, estimate_base=False, estimate_tool=False
        )
        if len(setup.payloads) > 1:
            carried = problem.only.error.payload or next(iter(setup.payloads))
            errors[name] = errors[name].carrying(carried)
        turns = dict(zip(map(owner, chain.joints), chain.revolute, strict=True))
        for parameter in errors[name].parameters:
            joint, kind, component = parameter.name.rsplit(".", 2)
            # A mimic joint has the errors of its leader, which may be of no chain.
            told = component in kinds.get(kind, ()) and turns.get(joint)
            if told or kind in whole:
                sizes[parameter.name] = parameter.scale
    if not sizes:
        return None
    return Systematic(errors, tuple(sizes), np.array([*sizes.values()]), np.ones(0))
