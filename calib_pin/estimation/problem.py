"""The least-squares problem: a system, measurements, and what is known beside them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import NamedTuple, Protocol

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OptionError
from calib_pin.estimation.layout import Layout
from calib_pin.estimation.model import Model, ToolPoses, whitened_jacobian
from calib_pin.estimation.row_blocks import Blocks, Expected, KnownDistances, Priors
from calib_pin.estimation.system import Part, System
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import Linearization
from calib_pin.observations import BlockKey, Measurements, Observations
from calib_pin.parameters import ParameterSet
from calib_pin.setup import Setup

SAMPLE = 10_000
"""Measurements that a closed-form start is made from; more do not help it."""

EXACT = 1e-6
"""Scatter, in standard deviations, below which measurements differ by rounding alone.
"""


MANY = 1_000_000
"""Entries of a Jacobian from which measurements go through the compiled kernels, in
chunks.

Below, Pinocchio takes less time than loading the kernels.
"""


class Evaluator(Protocol):
    """The measurements of one block as a function of its parameters, shape (p,)."""

    def errors(self, theta: Floats) -> Floats:
        """Residuals in their units, predicted minus measured, shape (N, d)."""
        ...

    def square(self, theta: Floats) -> float:
        """Sum of squares of the whitened residuals."""
        ...

    def linearize(self, theta: Floats) -> tuple[Floats, Floats]:
        """Whitened residual, shape (M,), and Jacobian, (M, p), good for a step."""
        ...

    def factorize(self, theta: Floats) -> tuple[Floats, Floats]:
        """The same to full precision, for decisions about ranks."""
        ...


class RowByRow:
    """Measurements of a model by Pinocchio, a residual row for each value.

    Args:
        model: The model.
        data: The measurements.
        sigma: Standard deviations of the residual components, shape (N, d).
    """

    def __init__(self, model: Model, data: Measurements, sigma: Floats) -> None:
        """Prepare nothing: what does not change is computed where it is needed."""
        self._model, self._data, self._sigma = model, data, sigma

    @cached_property
    def _tool(self) -> ToolPoses:
        return ToolPoses(self._model.error, self._data)

    def errors(self, theta: Floats) -> Floats:
        """Residuals in their units, shape (N, d)."""
        of_robot, instrument = self._model.split(theta)
        T = self._tool(of_robot)
        return self._model.measurement.residual(T, instrument, self._data)

    def residual(self, theta: Floats) -> Floats:
        """Whitened residual, shape (N d,)."""
        return whitened(self.errors(theta), self._data, self._sigma)

    def square(self, theta: Floats) -> float:
        """Sum of squares of the whitened residuals."""
        r = self.residual(theta)
        return float(r @ r)

    def linearize(self, theta: Floats) -> tuple[Floats, Floats]:
        """Whitened residual, shape (N d,), and Jacobian, shape (N d, p)."""
        of_robot, instrument = self._model.split(theta)
        tool = self._tool.linearize(of_robot)
        linear = self._model.measurement.linearize(tool.T, instrument, self._data)
        known = Linearization(
            linear.residual,
            kept(linear.J_pose, self._data),
            kept(linear.J_instrument, self._data),
        )
        J = whitened_jacobian(tool, known, self._sigma).reshape(-1, len(theta))
        return whitened(linear.residual, self._data, self._sigma), J

    factorize = linearize


def evaluator(model: Model, data: Measurements, sigma: Floats, many: bool) -> Evaluator:
    """Compiled kernels where measurements are many and kernels can evaluate them.

    Args:
        model: The model of the block.
        data: Its measurements.
        sigma: Standard deviations of the residual components, shape (N, d).
        many: Whether a Jacobian of all measurements would be too large to be handy.
    """
    if not many or not model.error.geometric or data.start.size:
        return RowByRow(model, data, sigma)
    from calib_pin.estimation.many_rows import ManyRows

    return ManyRows(model, data, sigma)


def whitened(errors: Floats, data: Measurements, sigma: Floats) -> Floats:
    """Residuals in standard deviations, (N, d) -> (N d,)."""
    return np.asarray((kept(errors, data) / sigma).reshape(-1))


def kept(values: Floats, data: Measurements) -> Floats:
    """Values with zeros for measurements that are set aside, shape (N, ...).

    They may be so wrong that they cannot be predicted, and nothing times infinity is
    not nothing.
    """
    if data.weight.all():
        return values
    aside = (data.weight == 0.0).reshape(-1, *[1] * (values.ndim - 1))
    return np.where(aside, 0.0, values)


class Block(NamedTuple):
    """A block of measurements before its part.

    Attributes:
        part: The part.
        data: The measurements, with the joints of the part's chain.
        rows: Where they stand among all measurements.
        values: Where their residual components stand among all.
    """

    part: Part
    data: Measurements
    rows: slice
    values: slice

    def table(self, flat: Floats) -> Floats:
        """Components of all measurements as a table of these, (M,) -> (N, d)."""
        return np.asarray(flat[self.values].reshape(len(self.data), -1))


@dataclass(frozen=True)
class Problem(System):
    """Whitened residuals of measurements as a function of the error parameters.

    The residual vector holds the measurements, block by block, each component divided
    by its standard deviation, then one row per known distance between points that they
    name, one per direction of an expected size, one per free parameter with a prior.

    Attributes:
        data: The measurements; a block of which there is a part for each key.
        setup: Which parameters are fixed, bounded or have a prior, and the noise
            where the data do not state it.
        held_at: Values of parameters that are held at a bound, by position.
        units: Standard deviation of unit weight of every quantity of every instrument,
            shape (K,): what the stated or assumed standard deviations are multiplied
            by; empty for ones.
        expected: How large the robot's errors are expected to be; None where the
            measurements alone decide.

    Raises:
        OptionError: If the setup names a parameter that does not exist.
    """

    data: Observations
    setup: Setup = field(default_factory=Setup)
    held_at: Mapping[int, float] = field(default_factory=dict)
    units: Floats = field(default_factory=lambda: np.zeros(0))
    expected: Expected | None = None

    @cached_property
    def parameters(self) -> ParameterSet:
        """Stations, robot, tools and instruments as the setup has them."""
        try:
            return (
                self.given.with_fixed(self.setup.fixed)
                .with_bounds(self.setup.bounds)
                .with_priors(self.setup.prior)
                .without(self.held_at)
            )
        except OptionError as error:
            # The names are first known here; the mistake stands in the setup file.
            raise error.within(self.setup.file) from None

    @cached_property
    def layout(self) -> Layout:
        """Measurement and quantity of each residual component."""
        quantities = {
            key: part.measurement.quantities for key, part in self.parts.items()
        }
        return Layout.of(self.data, quantities)

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Every block of measurements with its part."""
        result, start = [], 0
        for data, rows in zip(self.data.blocks, self.data.slices, strict=True):
            part = self.parts[data.key]
            own = part.of_chain(data)
            assert isinstance(own, Measurements)
            stop = start + len(data) * part.components
            result.append(Block(part, own, rows, slice(start, stop)))
            start = stop
        return tuple(result)

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
    def given_sigma(self) -> Floats:
        """Standard deviations that are stated or assumed, shape (M,)."""
        return np.concatenate(
            [
                (
                    np.tile(assumed_sigma(part, self.setup), (len(data), 1))
                    if data.sigma is None
                    else data.sigma
                ).reshape(-1)
                for part, data, _, _ in self.blocks
            ]
        )

    @cached_property
    def values(self) -> int:
        """Number of measured values that count."""
        return int(np.isfinite(self.sigma).sum())

    @property
    def count(self) -> int:
        """Number of values that are known: measured ones, known distances, priors."""
        return self.values + len(self._distances) + len(self._priors)

    @cached_property
    def further(self) -> Blocks:
        """The residual rows behind those of the measurements."""
        known = self._distances, self.expected, self._priors
        return Blocks([block for block in known if block is not None and len(block)])

    @property
    def priors(self) -> int:
        """Number of priors on single parameters, the last residual rows."""
        return len(self._priors)

    def errors(self, theta: Floats) -> Floats:
        """Residuals in their units, predicted minus measured, shape (M,)."""
        return self._measured(theta, lambda one, own: one.errors(own).reshape(-1))

    def residual(self, theta: Floats) -> Floats:
        """Whitened residual: measurements, then `further`."""
        r = self.errors(theta)
        aside = np.isinf(self.sigma)
        if aside.any():  # They may be so wrong that they cannot be predicted.
            r[aside] = 0.0
        return np.concatenate([r / self.sigma, self.further.residual(theta)])

    def cost(self, theta: Floats) -> float:
        """Half the sum of squares of the whitened residual."""
        r = self.further.residual(theta)
        squares = sum(
            one.square(theta[block.part.index])
            for block, one in zip(self.blocks, self._evaluators, strict=True)
        )
        return 0.5 * (squares + float(r @ r))

    def linearize(self, theta: Floats) -> tuple[Floats, Floats]:
        """Whitened residual and its Jacobian by all parameters.

        Of very many measurements they are those of a smaller system with the same
        normal equations, in which singular values below 1e-8 of the largest are lost:
        enough for a step, not for a rank.

        Returns:
            Residual, shape (M,), and Jacobian, shape (M, P).
        """
        return self._joined(theta, lambda one, own: one.linearize(own))

    def factorize(self, theta: Floats) -> tuple[Floats, Floats]:
        """The same as `linearize` to full precision, for decisions about ranks."""
        return self._joined(theta, lambda one, own: one.factorize(own))

    def linearize_rows(self, theta: Floats) -> tuple[Floats, Floats]:
        """The same with a row for every measured value, however many there are."""
        if not self.many:
            return self.linearize(theta)
        rows = [
            RowByRow(block.part, block.data, block.table(self.sigma))
            for block in self.blocks
        ]
        return self._joined(theta, lambda one, own: one.linearize(own), rows)

    @property
    def many(self) -> bool:
        """Whether `linearize` returns a smaller system in place of the rows."""
        return not all(isinstance(one, RowByRow) for one in self._evaluators)

    @cached_property
    def _evaluators(self) -> tuple[Evaluator, ...]:
        entries = len(self.layout.row) * len(self.parameters)
        return tuple(
            evaluator(block.part, block.data, block.table(self.sigma), entries >= MANY)
            for block in self.blocks
        )

    @cached_property
    def _distances(self) -> KnownDistances:
        """Known distances between points that the instruments know."""
        return KnownDistances.of(
            self.setup.distances, self.references, self.given.names
        )

    @cached_property
    def _priors(self) -> Priors:
        parameters = self.parameters
        return Priors(np.where(parameters.free, parameters.priors, np.inf))

    def _measured(
        self, theta: Floats, evaluate: Callable[[Evaluator, Floats], Floats]
    ) -> Floats:
        """What the evaluators of all blocks say, one behind the other."""
        parts = [
            evaluate(one, theta[block.part.index])
            for block, one in zip(self.blocks, self._evaluators, strict=True)
        ]
        return parts[0] if len(parts) == 1 else np.concatenate(parts)

    def _joined(
        self,
        theta: Floats,
        evaluate: Callable[[Evaluator, Floats], tuple[Floats, Floats]],
        evaluators: Sequence[Evaluator] = (),
    ) -> tuple[Floats, Floats]:
        """Residual and Jacobian of all blocks, and the further rows behind them."""
        r, J = [], []
        pairs = zip(self.blocks, evaluators or self._evaluators, strict=True)
        for block, one in pairs:
            own, columns = evaluate(one, theta[block.part.index])
            r.append(own)
            J.append(self.spread(block.part, columns))
        if len(self.further):
            r.append(self.further.residual(theta))
            J.append(self.further.jacobian(theta))
        if len(r) == 1:
            return r[0], J[0]
        return np.concatenate(r), np.concatenate(J)


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


def assumed_sigma(part: Part, setup: Setup) -> Floats:
    """Standard deviations of the components of measurements that state none, (d,)."""
    return np.concatenate(
        [
            np.full(
                quantity.columns.stop - quantity.columns.start,
                setup.noise.get(quantity.name, quantity.sigma),
            )
            for quantity in part.measurement.quantities
        ]
    )


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


def expecting(problem: Problem, expected: Expected) -> Problem:
    """The problem with errors of the robot that are expected to be so large."""
    result = replace(problem, expected=expected)
    # The measurements are the same, and very many take time to prepare.
    for name in ("layout", "blocks", "given_sigma", "sigma", "_evaluators"):
        result.__dict__[name] = getattr(problem, name)
    return result


def repeated(data: Observations) -> NDArray[np.int64]:
    """Label of the measurements of one thing in one configuration, shape (N,)."""
    labels = data.groups()
    for codes in (data.things(), data.payload.codes):
        count = int(codes.max(initial=0)) + 1
        if count > 1:
            labels = labels * count + codes
    return labels


def distinct_values(problem: Problem) -> int:
    """Measured values and distances, repetitions of a configuration left out."""
    rows = np.flatnonzero(problem.data.weight > 0.0)
    _, first = np.unique(repeated(problem.data)[rows], return_index=True)
    counted = np.zeros(len(problem.data), bool)
    counted[rows[first]] = True
    used = counted[problem.layout.row] & np.isfinite(problem.sigma)
    return int(used.sum()) + problem.count - problem.values - problem.priors
