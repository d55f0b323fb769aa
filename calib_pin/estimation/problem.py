"""The least-squares problem: a model, measurements, and what is known beside them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import OptionError
from calib_pin.estimation.model import Model, ToolPoses, whitened_jacobian
from calib_pin.estimation.row_blocks import Blocks, Expected, KnownDistances, Priors
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import Linearization
from calib_pin.measurement_models.mixed import absent, assumed_sigma
from calib_pin.observations import Measurements, states_sigmas
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
    """The measurements as a function of all parameters theta, shape (P,)."""

    def errors(self, theta: Floats) -> Floats:
        """Residuals in their units, predicted minus measured, shape (N, d)."""
        ...

    def cost(self, theta: Floats, further: Floats) -> float:
        """Half the sum of squares of the whitened residuals and of further ones."""
        ...

    def linearize(self, theta: Floats) -> tuple[Floats, Floats]:
        """Whitened residual, shape (M,), and Jacobian, (M, P), good for a step."""
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

    def cost(self, theta: Floats, further: Floats) -> float:
        """Half the sum of squares of the whitened residuals and of further ones."""
        r = joined(self.residual(theta), further)
        return 0.5 * float(r @ r)

    def linearize(self, theta: Floats) -> tuple[Floats, Floats]:
        """Whitened residual, shape (N d,), and Jacobian, shape (N d, P)."""
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


def evaluator(
    model: Model, data: Measurements, sigma: Floats, parameters: int
) -> Evaluator:
    """Compiled kernels where a Jacobian would be too large to be handy.

    Args:
        model: The model.
        data: The measurements.
        sigma: Standard deviations of the residual components, shape (N, d).
        parameters: Number of parameters P.
    """
    few = len(data) * model.components * parameters < MANY
    if few or not model.error.geometric or model.measurement.declaration.relative:
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


def joined(rows: Floats, further: Floats) -> Floats:
    """Rows with further ones behind them; without any, no copy."""
    return np.concatenate([rows, further]) if len(further) else rows


@dataclass(frozen=True)
class Problem(Model):
    """Whitened residuals of measurements as a function of the error parameters.

    The residual vector holds the measurements, each component divided by its standard
    deviation, then one row per known distance between points that they name, one per
    direction of an expected size, one per free parameter with a prior.

    Attributes:
        data: The measurements.
        setup: Which parameters are fixed, bounded or have a prior, and the noise
            where the data do not state it.
        held_at: Values of parameters that are held at a bound, by position.
        units: Standard deviation of unit weight of every residual component, shape
            (d,): what the stated or assumed standard deviations are multiplied by;
            empty for ones.
        expected: How large the robot's errors are expected to be; None where the
            measurements alone decide.

    Raises:
        OptionError: If the setup names a parameter that does not exist.
    """

    data: Measurements
    setup: Setup = field(default_factory=Setup)
    held_at: Mapping[int, float] = field(default_factory=dict)
    units: Floats = field(default_factory=lambda: np.zeros(0))
    expected: Expected | None = None

    @cached_property
    def parameters(self) -> ParameterSet:
        """Robot, frames and instrument: base, joints, tool, then the instrument's."""
        instrument = tuple(self.measurement.parameters)
        everything = ParameterSet(self.error.parameters.parameters + instrument)
        try:
            return (
                everything.with_fixed(self.setup.fixed)
                .with_bounds(self.setup.bounds)
                .with_priors(self.setup.prior)
                .without(self.held_at)
            )
        except OptionError as error:
            # The names are first known here; the mistake stands in the setup file.
            raise error.within(self.setup.file) from None

    @cached_property
    def sigma(self) -> Floats:
        """Standard deviation of every residual component, shape (N, d).

        It is what whitens: the given one with the unit weight of its component,
        infinite for measurements that are set aside.
        """
        sigma, weight = self.given_sigma, self.data.weight
        if len(self.units):
            sigma = sigma * self.units
        if (weight == 1.0).all():
            return sigma
        with np.errstate(divide="ignore"):
            return np.asarray(sigma / np.sqrt(weight)[:, None])

    @cached_property
    def given_sigma(self) -> Floats:
        """Standard deviations that are stated or assumed, shape (N, d).

        Infinite for the components that one of mixed measurements does not have.
        """
        if self.data.sigma is not None and states_sigmas(self.data):
            return self.data.sigma
        return _filled(self, self.data.sigma, len(self.data))

    @cached_property
    def values(self) -> int:
        """Number of measured values."""
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
        """Residuals in their units, predicted minus measured, shape (N, d)."""
        return self._evaluator.errors(theta)

    def masked_errors(self, theta: Floats) -> Floats:
        """Residuals as `errors`, with NaN for absent components, shape (N, d).

        Unpredictable values are infinite.
        """
        errors = self.errors(theta)
        errors = np.where(np.isnan(errors), np.inf, errors)
        return np.where(np.isfinite(self.given_sigma), errors, np.nan)

    def residual(self, theta: Floats) -> Floats:
        """Whitened residual, shape (M,): measurements, then `further`."""
        measured = whitened(self.errors(theta), self.data, self.sigma)
        return joined(measured, self.further.residual(theta))

    def cost(self, theta: Floats) -> float:
        """Half the sum of squares of the whitened residual."""
        return self._evaluator.cost(theta, self.further.residual(theta))

    def linearize(self, theta: Floats) -> tuple[Floats, Floats]:
        """Whitened residual and its Jacobian by all parameters.

        Of very many measurements they are those of a square system with the same
        normal equations, in which singular values below 1e-8 of the largest are lost:
        enough for a step, not for a rank.

        Returns:
            Residual, shape (M,), and Jacobian, shape (M, P).
        """
        return self._with_further(theta, *self._evaluator.linearize(theta))

    def factorize(self, theta: Floats) -> tuple[Floats, Floats]:
        """The same as `linearize` to full precision, for decisions about ranks."""
        return self._with_further(theta, *self._evaluator.factorize(theta))

    def linearize_rows(self, theta: Floats) -> tuple[Floats, Floats]:
        """The same with a row for every measured value, however many there are."""
        if not self.many:
            return self.linearize(theta)
        rows = RowByRow(self, self.data, self.sigma)
        return self._with_further(theta, *rows.linearize(theta))

    @property
    def many(self) -> bool:
        """Whether `linearize` returns a square system in place of the rows."""
        return not isinstance(self._evaluator, RowByRow)

    @cached_property
    def _evaluator(self) -> Evaluator:
        return evaluator(self, self.data, self.sigma, len(self.parameters))

    @cached_property
    def _distances(self) -> KnownDistances:
        """Known distances between points that the instrument knows."""
        first = len(self.error.screws)
        known, references = self.setup.distances, self.measurement.references
        return KnownDistances.of(known, references, first)

    @cached_property
    def _priors(self) -> Priors:
        parameters = self.parameters
        return Priors(np.where(parameters.free, parameters.priors, np.inf))

    def _with_further(
        self, theta: Floats, r: Floats, J: Floats
    ) -> tuple[Floats, Floats]:
        """Residual and Jacobian with the further rows behind the measurements."""
        if not len(self.further):
            return r, J
        residual, jacobian = self.further.residual(theta), self.further.jacobian(theta)
        return np.concatenate([r, residual]), np.concatenate([J, jacobian])


def sigma_at(problem: Problem, target: Sequence[str]) -> Floats:
    """Standard deviations of measurements that state none, shape (K, d).

    Args:
        problem: The problem, with the unit weights of its components.
        target: Target of each measurement.
    """
    sigma = _filled(problem, absent(problem.measurement, target), len(target))
    return sigma * problem.units if len(problem.units) else sigma


def _filled(problem: Problem, sigma: Floats | None, count: int) -> Floats:
    """Standard deviations, shape (count, d), with assumed ones in place of NaN."""
    assumed = assumed_sigma(problem.measurement, problem.setup.noise)
    if sigma is None:
        return np.tile(assumed, (count, 1))
    return np.where(np.isnan(sigma), assumed, sigma)


def expecting(problem: Problem, expected: Expected) -> Problem:
    """The problem with errors of the robot that are expected to be so large."""
    result = replace(problem, expected=expected)
    # The measurements are the same, and very many take time to prepare.
    result.__dict__["_evaluator"] = problem._evaluator
    return result


def repeated(data: Measurements) -> NDArray[np.int64]:
    """Label of the measurements of one thing in one configuration, shape (N,)."""
    labels = data.groups()
    for names in (data.target, data.payload):
        number = {name: k for k, name in enumerate(dict.fromkeys(names))}
        if len(number) > 1:
            index = np.array([number[name] for name in names], np.int64)
            labels = labels * len(number) + index
    return labels


def distinct_values(problem: Problem) -> int:
    """Measured values and distances, repetitions of a configuration left out."""
    rows = np.flatnonzero(problem.data.weight > 0.0)
    _, first = np.unique(repeated(problem.data)[rows], return_index=True)
    values = int(np.isfinite(problem.sigma[rows[first]]).sum())
    return values + problem.count - problem.values - problem.priors
