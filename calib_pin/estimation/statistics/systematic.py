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
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.errors import OptionError
from calib_pin.estimation.directions import Directions, half_covariance
from calib_pin.estimation.problem import Problem, known_values, representative
from calib_pin.estimation.statistics.restricted_likelihood import (
    EXACT,
    Groups,
    Variances,
    estimate_variances,
    with_effects,
)
from calib_pin.estimation.statistics.variance_components import current_units, grouped
from calib_pin.estimation.system import Part, assembled
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.parameterizations import (
    NOTHING,
    PARAMETERIZATIONS,
    Screw,
    frame_screws,
    parameterization,
    required_keys,
)
from calib_pin.parameterizations.base import owner
from calib_pin.parameterizations.compliance import Compliance
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.parameterizations.transmission import AMPLITUDE_SCALES, Transmission
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
        gear: Standard deviation of an amplitude of a gear [rad]; 0 for none.
        compliance: That of a compliance, as the deflection under the usual torque of
            a joint [rad]; 0 for none.
        noise: Variance of each quantity beside them, relative to that in the units of
            the problem, shape (K,).
    """

    errors: Mapping[str, ErrorModel]
    names: tuple[str, ...]
    sizes: Floats
    gear: float
    compliance: float
    noise: Floats

    @property
    def kinds(self) -> NDArray[np.str_]:
        """Parameterization of each effect, shape (S,)."""
        return np.array([name.rsplit(".", 2)[1] for name in self.names])

    def rows(self, problem: Problem, theta: Floats) -> Floats:
        """Whitened residuals that each effect of its size adds, shape (M, S).

        Args:
            problem: A problem with the rows.
            theta: Parameter values at which frames and instrument stand, shape (P,).
        """
        moved, _ = problem.rebased(theta)
        plain = replace(moved.setup, fixed=(), bounds={}, prior={}, parameters=())
        plain = replace(plain, distances=(), angles=())
        parts, given = assembled(
            [replace(part, error=self._about(part)) for part in moved.parts.values()]
        )
        there = replace(
            moved, parts=parts, given=given, setup=plain, held_at={}, expected=None
        )
        _, J = there.linearize_rows(np.zeros(len(given)))
        columns = [given.index(name) for name in self.names]
        return np.asarray(J[:, columns] * self.sizes)

    def twists(self, part: Part, q: Floats) -> Floats:
        """Body twists of the tool of a part by each effect of its size, (N, 6, S).

        Args:
            part: The part about its solution, see `System.rebased`.
            q: Positions of its joints, shape (N, n) [rad, m].
        """
        there = self._about(part)
        _, J = there.jacobian(q, np.zeros(len(there.screws)))
        result = np.zeros((len(q), 6, len(self.names)))
        position = {name: k for k, name in enumerate(self.names)}
        for column, name in enumerate(there.parameters.names):
            if name in position:
                result[:, :, position[name]] += J[:, :, column]
        return result * self.sizes

    def _about(self, part: Part) -> ErrorModel:
        """The effects of the chain of a part about its frames."""
        error = self.errors[part.key.chain]
        return error.with_frames(part.error.base, part.error.tool)


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
    fun, jac = sample.linearize_rows(theta)
    measured = fun[: len(sample.layout.row)]
    if float(measured @ measured) <= EXACT * sample.values:
        return None
    half = half_covariance(jac, directions.basis, problem.parameters)
    X = np.zeros((len(fun), len(effects.names)))
    X[: len(measured)] = effects.rows(sample, theta)
    if not np.isfinite(X).all():
        return None  # The nominal robot is far away, behind the camera, say.
    groups = grouped(sample, np.column_stack([jac @ half, X, fun]))
    return _significant(sample, effects, groups)


def sampled(problem: Problem, count: int = ROWS) -> Observations:
    """Measurements that effects are estimated from; of many stations those of some."""
    data = problem.data
    if problem.own_of_stations:
        kept = set(representative(problem))
        data = Observations(tuple(b for b in data.blocks if b.key in kept))
    return data.sample(count)


def candidates(problem: Problem) -> Systematic | None:
    """All effects that are not estimated already, in their expected sizes."""
    setup, chains = problem.setup, problem.chains
    payloads = {"", NOTHING, *setup.payloads}
    effects = {
        name: member.effects.components
        for name, member in PARAMETERIZATIONS.items()
        if member.effects is not None
    }
    kinds = [kind for kind in effects if kind not in setup.parameters]
    if not payloads.issuperset(problem.data.payload.distinct):
        # Nothing is known of what was carried.
        kinds = [kind for kind in kinds if "payloads" not in required_keys([kind])]
    errors: dict[str, ErrorModel] = {}
    found: dict[str, float] = {}
    for name in chains.names:
        screws = _effects(chains[name], kinds, effects, setup)
        errors[name] = _with_screws(chains[name], screws)
        if len(setup.payloads) > 1:
            carried = problem.only.error.payload or next(iter(setup.payloads))
            errors[name] = errors[name].carrying(carried)
        for screw in screws:
            found[screw.parameter.name] = screw.parameter.scale
    if not found:
        return None
    return Systematic(
        errors=errors,
        names=tuple(found),
        sizes=np.array(list(found.values())),
        gear=AMPLITUDE_SCALES["rad"],
        compliance=Compliance.effects.size,
        noise=np.ones(0),
    )


def _effects(
    chain: Chain,
    kinds: Sequence[str],
    effects: Mapping[str, Sequence[str]],
    setup: Setup,
) -> list[Screw]:
    """The screws of the effects of some kinds on the joints of a chain that turn."""
    revolute = {
        owner(joint)
        for joint, turns in zip(chain.joints, chain.revolute, strict=True)
        if turns
    }
    screws: list[Screw] = []
    for kind in kinds:
        try:
            screws += parameterization(kind, setup).screws(chain)
        except OptionError:
            # Nothing loads the joints.
            continue
    names = [screw.parameter.name.rsplit(".", 2) for screw in screws]
    screws = [
        screw
        for screw, (joint, kind, component) in zip(screws, names, strict=True)
        if joint in revolute and component in effects[kind]
    ]
    return sorted(screws, key=lambda screw: screw.frame)


def _with_screws(chain: Chain, screws: Sequence[Screw]) -> ErrorModel:
    """A chain with some screws between its frames, which are known."""
    identity = pin.SE3.Identity()
    first, last = (
        frame_screws(name, place, free=False)
        for name, place in (("base", 0), ("tool", len(chain.joints) + 2))
    )
    return ErrorModel(chain, (*first, *screws, *last), identity, identity)


def _significant(
    problem: Problem, effects: Systematic, groups: Groups
) -> Systematic | None:
    """The effects that raise the likelihood enough, with their estimated sizes.

    The groups are residual rows by quantity, in the columns of what was moved, of all
    effects in their expected sizes and of the residual.
    """
    kind_of = effects.kinds
    current = current_units(problem) ** 2

    def estimated(kinds: tuple[str, ...]) -> Variances:
        return estimate_variances(
            with_effects(groups, kind_of, kinds),
            np.concatenate([current, np.ones(len(kinds))]),
        )

    chosen: tuple[str, ...] = ()
    best = estimated(chosen)
    effective = [kind for kind in PARAMETERIZATIONS if kind in kind_of]
    for _ in effective:
        left = [kind for kind in effective if kind not in chosen]
        tried = {(*chosen, kind): estimated((*chosen, kind)) for kind in left}
        kinds = max(tried, key=lambda key: tried[key].likelihood, default=())
        if not kinds or tried[kinds].likelihood - best.likelihood < 0.5 * SIGNIFICANT:
            break
        chosen, best = kinds, tried[kinds]
    if not chosen:
        return None
    count = len(groups.counts)
    noise, squares = best.values[:count], best.values[count:]
    kept = np.isin(kind_of, chosen)
    of_effect = squares[[chosen.index(kind) for kind in kind_of[kept]]]
    found, predicted = _shares(groups, noise, of_effect, kept, current)
    squares = squares * min(1.0, MOST * found / predicted)
    factors = dict(zip(chosen, np.sqrt(squares), strict=True))
    sizes = effects.sizes * [factors.get(kind, 0.0) for kind in kind_of]
    return replace(
        effects,
        names=tuple(np.array(effects.names)[kept].tolist()),
        sizes=sizes[kept],
        gear=effects.gear * float(factors.get(Transmission.name, 0.0)),
        compliance=effects.compliance * float(factors.get(Compliance.name, 0.0)),
        noise=noise / current,
    )


def _shares(
    groups: Groups,
    noise: Floats,
    squares: Floats,
    kept: NDArray[np.bool_],
    current: Floats,
) -> tuple[float, float]:
    """Squares that noise leaves to effects, and those that effects should leave.

    By variances of the quantities, shape (K,), and of the effects that are kept, (s,);
    the fit was made in units of the current variances, (K,).
    """
    first = groups.known.shape[0] - 1 - len(kept)
    products = groups.products / current[:, None, None]
    total = groups.known + products.sum(axis=0)
    M = np.linalg.inv(total[:first, :first])
    # Residuals of the fit, and of what each effect adds.
    left = np.diag(total) - np.einsum("ij,ik,kj->j", total[:first], M, total[:first])
    hats = np.einsum("ij,kji->k", M, products[:, :first, :first])
    known = float(noise / current @ (groups.counts - hats))
    predicted = float(squares @ left[first:-1][kept])
    return max(float(left[-1]) - known, 0.0), predicted
