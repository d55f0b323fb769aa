"""The least-squares problem: a system, measurements, and what is known beside them."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TypeVar

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import stated_in
from calib_pin.estimation.elimination import (
    Station,
    eliminate,
    reduced,
    station_parameters,
)
from calib_pin.estimation.evaluators import Evaluator, RowByRow, prepared
from calib_pin.estimation.measured import Measured, assumed_sigma
from calib_pin.estimation.row_blocks import Blocks, Expected, KnownDistances, Priors
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey
from calib_pin.parameterizations import needed_conditions
from calib_pin.parameters import ParameterSet
from calib_pin.setup import JointPrior

_Found = TypeVar("_Found")

SAMPLE = 10_000
"""Measurements that a closed-form start is made from; more do not help it."""

EXACT = 1e-6
"""Scatter, in standard deviations, below which measurements differ by rounding alone.
"""


ALIKE = 2
"""Stations of a kind that show what very many do; others only add frames."""

MANY = 1_000_000
"""Entries of a Jacobian from which measurements go through the compiled kernels, in
chunks.

Below, Pinocchio takes less time than loading the kernels.
"""


@dataclass(frozen=True)
class Problem(Measured):
    """Whitened residuals of measurements as a function of the error parameters.

    The residual vector holds the measurements, block by block, each component divided
    by its standard deviation, then one row per known distance or angle of what they
    name, one per direction of an expected size, one per free parameter with a prior.

    Attributes:
        held_at: Values of parameters that are held at a bound, by position.
        expected: How large the robot's errors are expected to be; None where the
            measurements alone decide.

    Raises:
        OptionError: If the setup names a parameter that does not exist.
    """

    held_at: Mapping[int, float] = field(default_factory=dict)
    expected: Expected | None = None

    @cached_property
    def parameters(self) -> ParameterSet:
        """Stations, robot, tools and instruments as the setup has them."""
        with stated_in(self.setup.file):
            return (
                self.given.with_fixed(self.setup.fixed)
                .with_bounds(self.setup.bounds)
                .with_priors(self._deviations)
                .without(self.held_at)
            )

    @property
    def count(self) -> int:
        """Number of values that are known: measured ones, known distances, priors."""
        return self.values + len(self.known_distances) + len(self._priors)

    @cached_property
    def further(self) -> Blocks:
        """The residual rows behind those of the measurements."""
        known = self.known_distances, self.expected, self._priors
        return Blocks([block for block in known if block is not None and len(block)])

    def errors(self, theta: Floats) -> Floats:
        """Residuals in their units, predicted minus measured, shape (M,)."""
        parts = self._by_block(lambda one: one.errors(theta))
        parts = [part.reshape(-1) for part in parts]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def points(self, theta: Floats) -> list[Floats]:
        """Tool points of every block in its measurement frame, shape (N, 3)."""
        return self._by_block(lambda one: one.points(theta))

    def residual(self, theta: Floats) -> Floats:
        """Whitened residual: measurements, then `further`."""
        r = self.errors(theta)
        aside = np.isinf(self.sigma)
        if aside.any():  # They may be so wrong that they cannot be predicted.
            r[aside] = 0.0
        r /= self.sigma
        further = self.further.residual(theta)
        return np.concatenate([r, further]) if len(further) else r

    def cost(self, theta: Floats) -> float:
        """Half the sum of squares of the whitened residual.

        Very many measurements are linearized, for a step that lowers it leads there.
        """
        if not self.many:
            r = self.residual(theta)
            return 0.5 * float(r @ r)
        found = [r for r, _ in self._by_block(lambda one: one.factorize(theta))]
        return 0.5 * sum(float(r @ r) for r in (*found, self.further.residual(theta)))

    def products(self, theta: Floats) -> list[Floats]:
        """Products of the columns of Jacobian and residual of every block.

        They are by the block's own parameters, shape (p + 1, p + 1).
        """
        found = self._by_block(lambda one: one.factorize(theta))
        columns = [np.column_stack([J, r]) for r, J in found]
        return [np.asarray(A.T @ A) for A in columns]

    def linearize(self, theta: Floats) -> tuple[Floats, Floats]:
        """Whitened residual and its Jacobian by all parameters.

        Of very many measurements they are those of a smaller system with the same
        normal equations, to full precision. Of very many stations the parameters of
        each alone are eliminated: their columns are zero, see `completed`.

        Returns:
            Residual, shape (M,), and Jacobian, shape (M, P).
        """
        found = self._by_block(lambda one: one.factorize(theta))
        if not self.own_of_stations:
            return self._with_further(theta, *self._stacked(found))
        left, stations = [], []
        for name, blocks in self._by_station.items():
            rows = [(self.blocks[k].part.index, *found[k]) for k in blocks]
            station, rest = eliminate(self.own_of_stations[name], rows)
            stations.append(station)
            left.append(rest)
        self._eliminated.clear()
        self._eliminated[theta.tobytes()] = stations
        return self._with_further(theta, *reduced(left, len(theta)))

    def linearize_rows(self, theta: Floats) -> tuple[Floats, Floats]:
        """The same with a row for every measured value, however many there are."""
        if not self.many:
            return self.linearize(theta)
        rows = [
            RowByRow(block, self.sigma).factorize(theta)[0] for block in self.blocks
        ]
        return self._with_further(theta, *self._stacked(rows))

    def completed(self, theta: Floats, step: Floats) -> Floats:
        """A step with that of the parameters that were eliminated.

        Args:
            theta: Parameter values, shape (P,).
            step: Step of the other parameters from there, shape (P,).
        """
        result = step.copy()
        for station in self.stations(theta):
            result[station.own] = (
                station.settled + station.response @ step[station.shared]
            )
        return result

    def stations(self, theta: Floats) -> Sequence[Station]:
        """The parameters that were eliminated, where these were last linearized.

        Args:
            theta: Parameter values, shape (P,).
        """
        if not self.own_of_stations:
            return ()
        known: dict[bytes, Sequence[Station]] = self._eliminated
        if theta.tobytes() not in known:
            self.linearize(theta)
        return known[theta.tobytes()]

    @cached_property
    def own_of_stations(self) -> Mapping[str, NDArray[np.intp]]:
        """Parameters that are eliminated, by the station that alone has them."""
        if not self._large:
            return {}
        indices: dict[str, list[NDArray[np.intp]]] = {}
        for part in self.parts.values():
            indices.setdefault(part.scope.station, []).append(part.index)
        parameters = self.parameters
        tied = np.isfinite([*parameters.bounds, parameters.priors]).any(axis=0)
        tied |= ~parameters.free | ~parameters.nuisance
        tied[self.known_distances.columns[self.known_distances.columns >= 0]] = True
        return station_parameters(indices, ~tied)

    @property
    def absorbed(self) -> int:
        """Number of parameters that are eliminated."""
        return sum(map(len, self.own_of_stations.values()))

    @property
    def many(self) -> bool:
        """Whether `linearize` returns a smaller system in place of the rows."""
        reduces = any(one.reduces for one in self.evaluators)
        return reduces or bool(self.own_of_stations)

    @property
    def evaluator(self) -> str:
        """Name of the way in which measurements are evaluated."""
        kernels = not all(isinstance(one, RowByRow) for one in self.evaluators)
        return "kernel" if kernels else "pinocchio"

    @cached_property
    def evaluators(self) -> Mapping[Evaluator, Sequence[int]]:
        """Residuals and derivatives of blocks, with the positions of these."""
        return prepared(self._prepared, self.sigma, self._large)

    @cached_property
    def _large(self) -> bool:
        return len(self.layout.row) * len(self.given) >= MANY

    @cached_property
    def _eliminated(self) -> dict[bytes, Sequence[Station]]:
        """The last elimination, by the parameter values at which it was made."""
        return {}

    @cached_property
    def known_distances(self) -> KnownDistances:
        """Known distances and angles between what the instruments know."""
        return KnownDistances.of(self.setup.known, self.references, self.given.names)

    @cached_property
    def _priors(self) -> Priors:
        prior, parameters = self.setup.prior, self.parameters
        if isinstance(prior, JointPrior):
            together = Priors.together(prior, parameters)
            # What robots have says nothing of how an instrument drifts.
            own = np.where(parameters.nuisance, parameters.priors, np.inf)
            alone = Priors.alone(np.where(parameters.free, own, np.inf))
            return Priors(np.vstack([together.rows, alone.rows]), together.mean)
        return Priors.alone(np.where(parameters.free, parameters.priors, np.inf))

    @property
    def _deviations(self) -> Mapping[str, float]:
        """Standard deviations of priors by name or glob."""
        prior = self.setup.prior
        if isinstance(prior, JointPrior):
            return dict(
                prior.deviations([p.name for p in self.given if not p.nuisance])
            )
        return prior

    @cached_property
    def _by_station(self) -> Mapping[str, Sequence[int]]:
        """Positions of the blocks of every station."""
        found: dict[str, list[int]] = {}
        for k, block in enumerate(self.blocks):
            found.setdefault(block.part.scope.station, []).append(k)
        return found

    def _by_block(
        self, evaluate: Callable[[Evaluator], Iterable[_Found]]
    ) -> list[_Found]:
        """Values by the evaluators, block after block."""
        found = {
            k: value
            for one, positions in self.evaluators.items()
            for k, value in zip(positions, evaluate(one), strict=True)
        }
        return [found[k] for k in range(len(found))]

    def _stacked(self, found: Sequence[tuple[Floats, Floats]]) -> tuple[Floats, Floats]:
        """Residual and Jacobian by all parameters, block after block."""
        pairs = zip(self.blocks, found, strict=True)
        parts = [(r, self.spread(block.part, J)) for block, (r, J) in pairs]
        if len(parts) == 1:
            return parts[0]
        r, J = zip(*parts, strict=True)
        return np.concatenate(r), np.concatenate(J)

    def _with_further(
        self, theta: Floats, r: Floats, J: Floats
    ) -> tuple[Floats, Floats]:
        """Residual and Jacobian with the further rows behind the measurements."""
        if not len(self.further):
            return r, J
        residual, jacobian = self.further.residual(theta), self.further.jacobian(theta)
        return np.concatenate([r, residual]), np.concatenate([J, jacobian])


def reweighted(problem: Problem, weight: Floats) -> Problem:
    """The problem with other weights of its measurements, shape (N,)."""
    return replace(problem, data=problem.data.weighted(weight))


def error_table(problem: Problem, theta: Floats) -> Floats:
    """Residuals as they are shown, NaN for absent components, shape (N, D).

    Values that cannot be predicted are infinite.

    Args:
        problem: The problem; its layout says which columns there are.
        theta: Parameter values, shape (P,).
    """
    errors = problem.errors(theta)
    errors = np.where(np.isnan(errors), np.inf, errors)
    return problem.layout.table(errors, len(problem.data))


def sigma_at(problem: Problem, key: BlockKey, count: int) -> Floats:
    """Standard deviations of measurements of a block that state none, shape (count, d).

    Args:
        problem: The problem, with the unit weights of its quantities.
        key: The block.
        count: Number of measurements.
    """
    part = problem.parts[key]
    sigma = assumed_sigma(part, problem.setup)
    if len(problem.units):
        sigma = sigma * problem.units[problem.layout.of_keys[key]]
    return np.tile(sigma, (count, 1))


def station_kinds(problem: Problem) -> Mapping[frozenset[BlockKey], Sequence[str]]:
    """Stations by the blocks that are measured from them, but for their names."""
    blocks: dict[str, list[BlockKey]] = {}
    for key, part in problem.parts.items():
        blocks.setdefault(part.scope.station, []).append(key._replace(station=""))
    found: dict[frozenset[BlockKey], list[str]] = {}
    for station, keys in blocks.items():
        found.setdefault(frozenset(keys), []).append(station)
    return found


def representative(problem: Problem) -> list[BlockKey]:
    """Blocks that show the structure; of very many stations some of each kind."""
    keys = list(problem.parts)
    if not problem.own_of_stations:
        return keys
    shown = {
        station
        for alike in station_kinds(problem).values()
        for station in alike[:ALIKE]
    }
    return [key for key in keys if problem.parts[key].scope.station in shown]


def repeated(problem: Problem) -> NDArray[np.int64]:
    """Label of the measurements of one thing in one configuration, shape (N,).

    Where lost motion is estimated, one configuration reached from two sides is two.
    """
    data = problem.data
    labels, sides = data.groups(), np.zeros(len(data), np.int64)
    held = data.conditions.direction
    if held.size and "direction" in needed_conditions(problem.setup.parameters):
        sides = np.unique(held, axis=0, return_inverse=True)[1].reshape(-1)
    for codes in (data.things(), data.payload.codes, sides):
        count = int(codes.max(initial=0)) + 1
        if count > 1:
            labels = labels * count + codes
    return labels


def distinct_values(problem: Problem) -> int:
    """Measured values and distances, repetitions of a configuration left out."""
    rows = np.flatnonzero(problem.data.weight > 0.0)
    _, first = np.unique(repeated(problem)[rows], return_index=True)
    counted = np.zeros(len(problem.data), bool)
    counted[rows[first]] = True
    used = counted[problem.layout.row] & np.isfinite(problem.sigma)
    return int(used.sum()) + problem.count - problem.values - problem.further.priors


def known_values(problem: Problem) -> int:
    """Distinct values and priors: as many directions as that can be determined."""
    return distinct_values(problem) + problem.further.priors
