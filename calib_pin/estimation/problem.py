"""The least-squares problem: terms, measurements, and what is known beside them.

The normal equations of many stations are block-arrow: each frame, tool or instrument
that only one station has meets the robot, and no other station. With the columns A of
these and B of all others, the best change of the former follows from that of the
latter, `a = -A^+ (r + B b)`, and what is left for b is `r + B b` with the range of A
projected out (the Schur complement, by orthogonal projection). So the cost grows with
the measurements and not with the square of the stations.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields, replace
from functools import cached_property
from itertools import zip_longest
from typing import TYPE_CHECKING, TypeAlias

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import in_file
from calib_pin.estimation.identifiability import RANK
from calib_pin.estimation.row_blocks import Further, KnownDistances, Priors
from calib_pin.estimation.terms import Block, RowByRow, Term, Terms, compilable
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.declaration import Quantity
from calib_pin.observations import BlockKey, Indices, Measurements, Observations
from calib_pin.observations.labels import firsts, numbered
from calib_pin.parameterizations import needed_conditions
from calib_pin.parameters import ParameterSet
from calib_pin.setup import JointPrior, Setup

if TYPE_CHECKING:
    from calib_pin.estimation.many_rows import ManyRows


@dataclass(frozen=True)
class Component:
    """One quantity of one instrument at one station, whose noise is one unknown.

    Attributes:
        name: Name in reports: that of the quantity, with the model and the station
            behind it where others have the same.
        quantity: The quantity.
        model: Name of the measurement model.
        station: Name of the station.
    """

    name: str
    quantity: Quantity
    model: str
    station: str

    @property
    def key(self) -> tuple[str, str, str]:
        """Model, quantity and station, which tell it from others."""
        return self.model, self.quantity.name, self.station


@dataclass(frozen=True)
class Layout:
    """The M residual components of N measurements.

    Attributes:
        row: Measurement of each, shape (M,).
        component: Position of its quantity among `components`, shape (M,).
        column: Column of the table that is shown, shape (M,).
        components: The K quantities of all instruments.
        quantities: The quantities of all models, with their columns of the table.
        of_keys: Position among `components` of each residual component of the
            measurements of a block, shape (d,).
    """

    row: NDArray[np.int32]
    component: NDArray[np.int32]
    column: NDArray[np.int32]
    components: tuple[Component, ...]
    quantities: tuple[Quantity, ...]
    of_keys: Mapping[BlockKey, NDArray[np.int64]]

    @staticmethod
    def of(
        data: Observations, measured: Mapping[BlockKey, Sequence[Quantity]]
    ) -> Layout:
        """The layout of measurements.

        Args:
            data: The measurements.
            measured: The quantities of each block, also of those without measurements.
        """
        shown, first = side_by_side({key.model: q for key, q in measured.items()})
        components = _components(measured)
        position = {c.key: k for k, c in enumerate(components)}
        of_keys = {
            key: np.repeat(
                [position[key.model, q.name, key.station] for q in quantities],
                [q.columns.stop - q.columns.start for q in quantities],
            )
            for key, quantities in measured.items()
        }
        parts = []
        for block, rows in zip(data.blocks, data.slices, strict=True):
            codes = of_keys[block.key].astype(np.int32)
            place = first[block.model] + np.arange(len(codes), dtype=np.int32)
            row = np.arange(rows.start, rows.stop, dtype=np.int32).repeat(len(codes))
            parts.append((row, *(np.tile(part, len(block)) for part in (codes, place))))
        row, component, column = map(np.concatenate, zip(*parts, strict=True))
        return Layout(row, component, column, components, shown, of_keys)

    @cached_property
    def of_components(self) -> Sequence[NDArray[np.intp]]:
        """Where the residual components of each stand, ascending."""
        order = np.argsort(self.component, kind="stable")
        ends = np.cumsum(np.bincount(self.component, minlength=len(self.components)))
        return np.split(order, ends[:-1])

    @property
    def width(self) -> int:
        """Columns of the table that is shown."""
        return int(self.quantities[-1].columns.stop)

    def table(self, flat: Floats, count: int) -> Floats:
        """Components side by side, NaN for other models, (M,) -> (count, D)."""
        result = np.full((count, self.width), np.nan)
        result[self.row, self.column] = flat
        return result


def side_by_side(
    models: Mapping[str, Sequence[Quantity]],
) -> tuple[tuple[Quantity, ...], Mapping[str, int]]:
    """Columns of a table that is shown, which has those of all models.

    Args:
        models: The quantities of each model.

    Returns:
        The quantities of all with these columns, and the first column of each model.
    """
    names = Counter(q.name for quantities in models.values() for q in quantities)
    shown: list[Quantity] = []
    first: dict[str, int] = {}
    for model, quantities in models.items():
        first[model] = at = shown[-1].columns.stop if shown else 0
        for q in quantities:
            of_model = names[q.name] > 1 and model != q.name
            name = f"{q.name} ({model})" if of_model else q.name
            columns = slice(at + q.columns.start, at + q.columns.stop)
            shown.append(replace(q, name=name, columns=columns))
    return tuple(shown), first


def fitted_components(layout: Layout, known: Layout) -> NDArray[np.intp]:
    """Position of every component of a layout among those of a fit, shape (K,).

    At a station that was not fitted an instrument measures as it does at the first one.

    Args:
        layout: The layout; each of its instruments was fitted somewhere.
        known: The layout of the fit.
    """
    position: dict[tuple[str, ...], int] = {}
    for k, c in enumerate(known.components):
        position[c.key] = k
        position.setdefault(c.key[:2], k)
    index = [position.get(c.key, position[c.key[:2]]) for c in layout.components]
    return np.array(index, np.intp)


def _components(
    measured: Mapping[BlockKey, Sequence[Quantity]],
) -> tuple[Component, ...]:
    """The quantities of all instruments, each once."""
    distinct = {
        (q.name, key.model, key.station): q
        for key, quantities in measured.items()
        for q in quantities
    }
    stations = Counter((name, model) for name, model, _ in distinct)
    models = Counter(name for name, _ in stations)
    result = []
    for (name, model, station), quantity in distinct.items():
        suffix = [model] if models[name] > 1 and model != name else []
        if station and stations[name, model] > 1:
            suffix.append(station)
        full = f"{name} ({', '.join(suffix)})" if suffix else name
        result.append(Component(full, quantity, model, station))
    return tuple(result)


SAMPLE = 10_000
"""Measurements that a closed-form start is made from; more do not help it."""

EXACT = 1e-6
"""Scatter, in standard deviations, below which measurements differ by rounding alone;
part of a change of scale that rounding leaves where parameters express it."""

WORTHWHILE = 60
"""Parameters of single stations from which they are eliminated: as many as a robot has.

With fewer, all together cost less, and every rank is that of all."""

ALIKE = 2
"""Stations of a kind that show what very many do; others only add frames."""

MANY = 1_000_000
"""Entries of a Jacobian from which measurements go through the compiled kernels, in
chunks.

Below, Pinocchio takes less time than loading the kernels.
"""


@dataclass(eq=False)
class Shared:
    """Known to all problems of the same measurements, as soon as one of them asks.

    Attributes:
        data: The measurements; their weights may differ.
        setup: What the user states.
        terms: The terms; their references may differ.
        evaluators: The last evaluators.
    """

    data: Observations
    setup: Setup
    terms: Mapping[BlockKey, Term]
    evaluators: Sequence[Evaluator] = ()

    def holds(self, problem: Problem) -> bool:
        """Whether a problem differs in weights, references and priors alone."""
        ours, theirs = self.data.blocks, problem.data.blocks
        same = problem.setup is self.setup and list(problem.terms) == list(self.terms)
        if not same or len(ours) != len(theirs):
            return False
        names = [item.name for item in fields(Measurements) if item.name != "weight"]
        pairs = zip(ours, theirs, strict=True)
        return all(getattr(a, n) is getattr(b, n) for a, b in pairs for n in names)

    @cached_property
    def layout(self) -> Layout:
        """Measurement and quantity of each residual component."""
        terms = self.terms.items()
        return Layout.of(self.data, {k: t.measurement.quantities for k, t in terms})

    @cached_property
    def given_sigma(self) -> Floats:
        """Standard deviations that are stated or assumed, shape (M,)."""
        parts = [
            np.tile(assumed_sigma(self.terms[block.key], self.setup), len(block))
            if block.sigma is None
            else block.sigma.reshape(-1)
            for block in self.data.blocks
        ]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    @cached_property
    def repeated(self) -> Indices:
        """Label of what is measured in one configuration, see `repeated`, (N,)."""
        data = self.data
        labels, sides = data.groups(), np.zeros(len(data), np.int64)
        directions = data.conditions.direction
        if directions.size and "direction" in needed_conditions(self.setup.parameters):
            sides = np.unique(directions, axis=0, return_inverse=True)[1].reshape(-1)
        for codes in (data.things, data.payload.codes, sides):
            count = int(codes.max(initial=0)) + 1
            if count > 1:
                labels = numbered(labels * count + codes)[1]
        return labels


@dataclass(frozen=True)
class Problem(Terms):
    """Whitened residuals of measurements as a function of the error parameters.

    The residual vector holds the measurements, block by block, each component divided
    by its standard deviation, then one row per known distance of what they name, one
    per direction of an expected size, one per free parameter with a prior.

    Attributes:
        data: The measurements; there is a term for the key of each block.
        setup: What the user states.
        units: Standard deviation of unit weight of every quantity of every instrument,
            shape (K,): what the stated or assumed standard deviations are multiplied
            by; empty for ones.
        _known: Does not change with weights, units and priors; passed on.
        held_at: Values of parameters that are held at a bound, by position.
        expected: How large the robot's errors are expected to be; None where the
            measurements alone decide.

    Raises:
        OptionError: If the setup names a parameter that does not exist.
    """

    data: Observations
    setup: Setup = field(default_factory=Setup)
    units: Floats = field(default_factory=lambda: np.zeros(0))
    _known: Shared = field(default=None, repr=False, compare=False)  # type: ignore
    held_at: Mapping[int, float] = field(default_factory=dict)
    expected: Priors | None = None

    def __post_init__(self) -> None:
        """Share what the problem knows that this one was made from, if it can."""
        if self._known is None or not self._known.holds(self):
            known = Shared(self.data, self.setup, self.terms)
            object.__setattr__(self, "_known", known)

    @property
    def layout(self) -> Layout:
        """Measurement and quantity of each residual component."""
        return self._known.layout

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Every block of measurements with its term."""
        result, start = [], 0
        for data, rows in zip(self.data.blocks, self.data.slices, strict=True):
            term = self.terms[data.key]
            stop = start + len(data) * term.components
            result.append(Block(term, term.on_chain(data), rows, slice(start, stop)))
            start = stop
        return tuple(result)

    @property
    def given_sigma(self) -> Floats:
        """Standard deviations that are stated or assumed, shape (M,)."""
        return self._known.given_sigma

    @cached_property
    def sigma(self) -> Floats:
        """Standard deviation of every residual component, shape (M,).

        It is what whitens: the given one with the unit weight of its quantity, infinite
        for measurements that are set aside.
        """
        sigma, weight = self.given_sigma, self.data.weight
        if len(self.units):
            sigma = sigma * self.units[self.layout.component]
        if (weight == 1.0).all():
            return sigma
        with np.errstate(divide="ignore"):
            return np.asarray(sigma / np.sqrt(weight)[self.layout.row])

    @cached_property
    def parameters(self) -> ParameterSet:
        """Stations, robot, tools and instruments as the setup has them."""
        setup, priors = self.setup, self.setup.prior
        if isinstance(priors, JointPrior):
            names = [p.name for p in self.given if not p.nuisance]
            priors = dict(priors.deviations(names))
        with in_file(setup.file):
            parameters = self.given.with_fixed(setup.fixed).with_bounds(setup.bounds)
            return parameters.with_priors(priors).without(self.held_at)

    @cached_property
    def further(self) -> Further:
        """The residual rows behind those of the measurements."""
        distances, names = self.setup.distances, self.given.names
        known = KnownDistances.of(distances, self.references, names)
        prior, parameters = self.setup.prior, self.parameters
        alone = np.where(parameters.free, parameters.priors, np.inf)
        priors = Priors.alone(alone)
        if isinstance(prior, JointPrior):
            # What robots have says nothing of how an instrument drifts.
            single = Priors.alone(np.where(parameters.nuisance, alone, np.inf))
            together = Priors.together(prior, parameters)
            priors = Priors(np.vstack([together.rows, single.rows]), together.mean)
        return Further(known, self.expected, priors)

    def errors(self, theta: Floats) -> Floats:
        """Residuals in their units, predicted minus measured, shape (M,)."""
        parts = [rows.errors(theta).reshape(-1) for rows in self._evaluators]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def residual(self, theta: Floats) -> Floats:
        """Whitened residual: measurements, then `further`."""
        r = self.errors(theta)
        # They may be so wrong that nothing predicts them.
        r[np.isinf(self.sigma)] = 0.0
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
        parts = [r for r, _ in self.factorize(theta)]
        return 0.5 * sum(float(r @ r) for r in (*parts, self.further.residual(theta)))

    def factorize(self, theta: Floats) -> list[tuple[Floats, Floats]]:
        """Whitened residual, shape (M,), and Jacobian, shape (M, p), of every block.

        They are by the block's own parameters; of very many measurements those of a
        smaller system with the same normal equations, to full precision.
        """
        return [rows.factorize(theta) for rows in self._evaluators]

    def linearize(self, theta: Floats) -> tuple[Floats, Floats]:
        """Whitened residual and its Jacobian by all parameters.

        Of very many measurements they are as in `factorize`. Of very many stations the
        parameters of each alone are eliminated: their columns are zero, see `stations`.

        Returns:
            Residual, shape (M,), and Jacobian, shape (M, P).
        """
        pairs = zip(self.blocks, self.factorize(theta), strict=True)
        parts = [(r, self.spread(block.term, J)) for block, (r, J) in pairs]
        if not self.station_parameters:
            return self._full(theta, parts)
        alone = np.concatenate([*self.station_parameters.values()])
        shared = np.setdiff1d(np.arange(len(theta)), alone)
        rows: dict[str, list[tuple[Floats, Floats]]] = {}
        for (term, *_), part in zip(self.blocks, parts, strict=True):
            rows.setdefault(term.frames.station, []).append(part)
        self._eliminated.clear()
        stations, remainders = self._eliminated.setdefault(theta.tobytes(), {}), []
        for name, members in rows.items():
            r, J = map(np.concatenate, zip(*members, strict=True))
            local = self.station_parameters[name]
            stations[name], rest = eliminate(local, shared, r, J)
            remainders.append(rest)
        R = np.asarray(np.linalg.qr(np.concatenate(remainders), mode="r"))
        jac = np.zeros((len(R), len(theta)))
        jac[:, shared] = R[:, :-1]
        return self._full(theta, [(R[:, -1], jac)])

    def linearize_rows(self, theta: Floats) -> tuple[Floats, Floats]:
        """The same with a row for every measured value, however many there are."""
        if not self.many:
            return self.linearize(theta)
        parts = []
        for block in self.blocks:
            rows = RowByRow(block.term, block.data, block.table(self.sigma))
            r, J = rows.factorize(theta)
            parts.append((r, self.spread(block.term, J)))
        return self._full(theta, parts)

    def stations(self, theta: Floats) -> Mapping[str, Station]:
        """The parameters that were eliminated, where these were last linearized.

        Args:
            theta: Parameter values, shape (P,).
        """
        if self.station_parameters and theta.tobytes() not in self._eliminated:
            self.linearize(theta)
        return self._eliminated.get(theta.tobytes(), {})

    @cached_property
    def station_parameters(self) -> Mapping[str, NDArray[np.intp]]:
        """Parameters that only one station has and nothing else knows, by station.

        They are eliminated; empty where they are few.
        """
        if not self._large:
            return {}
        parameters = self.parameters
        loose = parameters.free & parameters.nuisance
        loose &= ~np.isfinite([*parameters.bounds, parameters.priors]).any(axis=0)
        columns = self.further.distances.columns
        loose[columns[columns >= 0]] = False
        indices: dict[str, list[NDArray[np.intp]]] = {}
        for term in self.terms.values():
            indices.setdefault(term.frames.station, []).append(term.index)
        index = {n: np.unique(np.concatenate(parts)) for n, parts in indices.items()}
        counts = np.bincount(np.concatenate([*index.values()]), minlength=len(loose))
        alone = loose & (counts == 1)
        if len(index) == 1 or alone.sum() < WORTHWHILE:
            return {}
        return {name: k[alone[k]] for name, k in index.items()}

    @property
    def many(self) -> bool:
        """Whether `linearize` returns a smaller system in place of the rows."""
        return evaluator(self) == "kernel" or bool(self.station_parameters)

    @cached_property
    def _evaluators(self) -> Sequence[Evaluator]:
        """Residuals and derivatives of every block.

        Compiled kernels take measurements that are many and that they can evaluate; of
        the last evaluators, whose references or weights may have been others, they use
        again what these have prepared.
        """
        result = list[Evaluator]()
        for block, last in zip_longest(self.blocks, self._known.evaluators):
            error, relative = block.term.error, block.data.start.size > 0
            if self._large and compilable(error) and not relative:
                from calib_pin.estimation.many_rows import ManyRows

                result.append(ManyRows(block, self.sigma, last))
            else:
                sigma = block.table(self.sigma)
                result.append(RowByRow(block.term, block.data, sigma))
        self._known.evaluators = result
        return result

    @cached_property
    def _large(self) -> bool:
        return len(self.layout.row) * len(self.given) >= MANY

    @cached_property
    def _eliminated(self) -> dict[bytes, dict[str, Station]]:
        """The last elimination, by the parameter values at which it was made."""
        return {}

    @cached_property
    def _distinct(self) -> int:
        """See `distinct_values`."""
        rows = np.flatnonzero(self.data.weight > 0.0)
        counted = np.zeros(len(self.data), bool)
        counted[rows[firsts(repeated(self)[rows])]] = True
        used = counted[self.layout.row] & np.isfinite(self.sigma)
        return int(used.sum()) + len(self.further.distances)

    def _full(
        self, theta: Floats, parts: list[tuple[Floats, Floats]]
    ) -> tuple[Floats, Floats]:
        """Residual and Jacobian by all parameters, part after part, and `further`."""
        if len(self.further):
            further = self.further.residual(theta), self.further.jacobian(theta)
            parts = [*parts, further]
        if len(parts) == 1:  # Nothing is copied.
            return parts[0]
        r, J = map(np.concatenate, zip(*parts, strict=True))
        return r, J


def current_units(problem: Problem) -> Floats:
    """Standard deviation of unit weight of every quantity, shape (K,)."""
    units, count = problem.units, len(problem.layout.components)
    return units if len(units) else np.ones(count)


def measured_count(problem: Problem) -> int:
    """Number of measured values that count."""
    return int(np.isfinite(problem.sigma).sum())


def known_count(problem: Problem) -> int:
    """Number of values that are known: measured ones, known distances, priors."""
    further = problem.further
    return measured_count(problem) + len(further.distances) + len(further.priors)


def evaluator(problem: Problem) -> str:
    """Name of the way in which measurements are evaluated."""
    plain = all(isinstance(rows, RowByRow) for rows in problem._evaluators)
    return "pinocchio" if plain else "kernel"


def tool_points(problem: Problem, theta: Floats) -> list[Floats]:
    """Tool points of every block in its measurement frame, shape (N, 3)."""
    return [rows.points(theta) for rows in problem._evaluators]


def absorbed(problem: Problem) -> int:
    """Number of parameters that are eliminated."""
    return sum(map(len, problem.station_parameters.values()))


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


def assumed_sigma(term: Term, setup: Setup) -> Floats:
    """Standard deviations of the components of measurements that state none, (d,)."""
    quantities = term.measurement.quantities
    widths = [q.columns.stop - q.columns.start for q in quantities]
    return np.repeat([setup.noise.get(q.name, q.sigma) for q in quantities], widths)


def station_kinds(problem: Problem) -> Mapping[frozenset[BlockKey], Sequence[str]]:
    """Stations by the blocks that are measured from them, but for their names."""
    blocks: dict[str, list[BlockKey]] = {}
    for key, term in problem.terms.items():
        blocks.setdefault(term.frames.station, []).append(key._replace(station=""))
    result: dict[frozenset[BlockKey], list[str]] = {}
    for station, keys in blocks.items():
        result.setdefault(frozenset(keys), []).append(station)
    return result


def representative(problem: Problem) -> list[BlockKey]:
    """Blocks that show the structure; of very many stations some of each kind."""
    keys = list(problem.terms)
    if not problem.station_parameters:
        return keys
    kinds = station_kinds(problem).values()
    shown = {station for names in kinds for station in names[:ALIKE]}
    return [key for key in keys if problem.terms[key].frames.station in shown]


def repeated(problem: Problem) -> Indices:
    """Label of the measurements of one thing in one configuration, from 0, shape (N,).

    Where lost motion is estimated, one configuration reached from two sides is two.
    """
    return problem._known.repeated


def distinct_values(problem: Problem) -> int:
    """Measured values and distances, repetitions of a configuration left out."""
    return problem._distinct


def known_values(problem: Problem) -> int:
    """Distinct values and priors: as many directions as that can be determined."""
    return distinct_values(problem) + len(problem.further.priors)


Evaluator: TypeAlias = "RowByRow | ManyRows"
"""The measurements of a block as a function of all parameters, shape (P,).

Derivatives are by the block's own parameters, shape (p,). Of `ManyRows`, `factorize`
returns fewer rows than there are values.
"""


@dataclass(frozen=True)
class Station:
    """The parameters of one station alone, about a linearization.

    Attributes:
        local: Their positions, shape (k,).
        shared: Positions of the parameters that no station has alone, shape (m,).
        root: Factor of their covariance by its own measurements, `A^+ = root U^T`, with
            U orthonormal, shape (k, rank).
        response: Their change with the others', `-A^+ B`, shape (k, m).
        settled: Their best change by themselves, `-A^+ r`, shape (k,).
    """

    local: NDArray[np.intp]
    shared: NDArray[np.intp]
    root: Floats
    response: Floats
    settled: Floats


def eliminate(
    local: NDArray[np.intp], shared: NDArray[np.intp], r: Floats, J: Floats
) -> tuple[Station, Floats]:
    """Eliminate the parameters of a station from the rows of its measurements.

    Args:
        local: Positions of its parameters, shape (k,).
        shared: Positions of those that no station has alone, shape (m,).
        r: Whitened residual of its measurements, shape (M,).
        J: Jacobian by all parameters, shape (M, P).

    Returns:
        The station, and rows that are left for the shared ones, residual last.
    """
    U, s, Vt = np.linalg.svd(J[:, local], full_matrices=False)
    kept = s > RANK * s.max(initial=0.0)
    U, root = U[:, kept], Vt[kept].T / s[kept]
    rows = np.column_stack([J[:, shared], r])
    along = U.T @ rows
    change = -root @ along
    station = Station(local, shared, root, change[:, :-1], change[:, -1])
    return station, rows - U @ along


def completed(stations: Mapping[str, Station], step: Floats) -> Floats:
    """A step of the shared parameters with that of the eliminated ones, shape (P,)."""
    result = with_response(stations, step)
    for station in stations.values():
        result[station.local] += station.settled
    return result


def with_response(stations: Mapping[str, Station], factor: Floats) -> Floats:
    """Changes of all parameters, where only the shared ones were given, (P, k)."""
    result = factor.copy()
    for station in stations.values():
        result[station.local] = station.response @ factor[station.shared]
    return result
