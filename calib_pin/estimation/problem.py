"""The least-squares problem: error model, measurement model and data put together."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.errors import OptionError
from calib_pin.estimation.known_distances import KnownDistances
from calib_pin.kinematics.spatial import Floats, adjoint, invert
from calib_pin.measurement_models import MeasurementModel
from calib_pin.measurement_models.features import slices
from calib_pin.measurement_models.rows import absent, assumed_sigma, relative_rows
from calib_pin.observations import Measurements, trusted
from calib_pin.parameterizations import frame_pose
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.parameters import ParameterSet
from calib_pin.setup import FrameSetup, Setup

if TYPE_CHECKING:
    from calib_pin.estimation.many_rows import ManyRows

__all__ = ["Expected", "Problem"]

SAMPLE = 10_000
"""Rows that a closed-form start is made from; more do not help it."""

EXACT = 1e-6
"""Scatter, in standard deviations, below which rows differ by rounding alone."""

MANY = 1_000_000
"""Entries of a Jacobian from which rows go through the compiled kernels, in chunks.

Below, Pinocchio takes less time than loading the kernels.
"""


@dataclass(frozen=True)
class Expected:
    """A normal prior about zero on directions of the robot's errors.

    Attributes:
        directions: Orthonormal, of the parameters divided by their scale, shape (P, k).
        size: Standard deviation along each of them, in scales.
    """

    directions: Floats
    size: float

    @property
    def count(self) -> int:
        """Number of directions k."""
        return int(self.directions.shape[1])

    def rows(self, scaled: Floats) -> Floats:
        """Whitened residuals of scaled parameter values, (..., P) -> (..., k)."""
        return np.asarray(scaled @ self.directions / self.size)


@dataclass(frozen=True)
class Problem:
    """Whitened residuals of data as a function of the error parameters.

    The residual vector holds the rows of the data, each component divided by its
    standard deviation, then one row per known distance between points that these rows
    name, one per direction of an expected size, one per free parameter with a prior.

    Attributes:
        error: The error model about its reference frames.
        measurement: The measurement model about its reference values.
        data: The rows.
        setup: Which parameters are fixed, bounded or have a prior, and the noise
            where the data do not state it.
        held_at: Values of parameters that are held at a bound, by position.
        units: Standard deviation of unit weight of every residual component, shape
            (d,): what the stated or assumed standard deviations of the rows are
            multiplied by; empty for ones.
        expected: How large the robot's errors are expected to be; None where the rows
            alone decide.

    Raises:
        OptionError: If the setup names a parameter that does not exist.
    """

    error: ErrorModel
    measurement: MeasurementModel
    data: Measurements
    setup: Setup = field(default_factory=Setup)
    held_at: Mapping[int, float] = field(default_factory=dict)
    units: Floats = field(default_factory=lambda: np.zeros(0))
    expected: Expected | None = None

    @cached_property
    def parameters(self) -> ParameterSet:
        """Robot, frames and instrument: base, joints, tool, then the model's own."""
        own = tuple(self.measurement.parameters)
        everything = ParameterSet(self.error.parameters.parameters + own)
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

        It is what whitens: that of the rows with the unit weight of its component,
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
        """Standard deviations that rows state, or that are assumed, shape (N, d).

        Infinite for what a row of mixed measurements does not have.
        """
        assumed = assumed_sigma(self.measurement, self.setup.noise)
        if self.data.sigma is None:
            return np.tile(assumed, (len(self.data), 1))
        if self.data.stated:
            return self.data.sigma
        return np.where(np.isnan(self.data.sigma), assumed, self.data.sigma)

    @property
    def components(self) -> int:
        """Residual components of a row."""
        return int(self.measurement.quantities[-1].columns.stop)

    @cached_property
    def values(self) -> int:
        """Measured values: what a row of mixed measurements lacks does not count."""
        return int(np.isfinite(self.sigma).sum())

    @property
    def count(self) -> int:
        """Values that are known: rows, known distances and priors."""
        return self.values + len(self._distances) + self.priors

    @property
    def priors(self) -> int:
        """Number of rows of priors, the last ones."""
        return int(self._prior.sum())

    @property
    def distinct_values(self) -> int:
        """Measured values and distances, repetitions of a configuration left out."""
        rows = np.flatnonzero(self.data.weight > 0.0)
        _, first = np.unique(self.repeated()[rows], return_index=True)
        values = int(np.isfinite(self.sigma[rows[first]]).sum())
        return values + len(self._distances)

    def repeated(self) -> NDArray[np.int64]:
        """Label of the rows that show one thing in one configuration, shape (N,)."""
        labels = self.data.groups()
        for names in (self.data.target, self.data.payload):
            number = {name: k for k, name in enumerate(dict.fromkeys(names))}
            if len(number) > 1:
                index = np.array([number[name] for name in names], np.int64)
                labels = labels * len(number) + index
        return labels

    @cached_property
    def _prior(self) -> NDArray[np.bool_]:
        return np.isfinite(self.parameters.priors) & self.parameters.free

    @property
    def held(self) -> Floats:
        """Values of the parameters that are not free, shape (P,)."""
        result = np.zeros(len(self.parameters))
        for position, value in self.held_at.items():
            result[position] = value
        return result

    def holding(self, values: Mapping[int, float]) -> Problem:
        """The problem with further parameters held at values."""
        return replace(self, held_at={**self.held_at, **values})

    def releasing(self, positions: Collection[int]) -> Problem:
        """The problem with parameters that were held let go."""
        kept = {k: v for k, v in self.held_at.items() if k not in positions}
        return replace(self, held_at=kept)

    def expecting(self, expected: Expected) -> Problem:
        """The problem with errors of the robot that are expected to be so large."""
        result = replace(self, expected=expected)
        # The rows are the same, and very many take time to prepare.
        result.__dict__["_many"] = self._many
        return result

    def errors(self, theta: Floats) -> Floats:
        """Residuals in their units, predicted minus measured, shape (N, d)."""
        of_robot, own = self.split(theta)
        if self._many is not None:
            return self._many.errors(of_robot, own)
        return self.measurement.residual(self.poses(theta), own, self.data)

    def shown(self, theta: Floats) -> Floats:
        """Residuals as `errors`, with NaN for what a row does not have, shape (N, d).

        What cannot be predicted is infinite.
        """
        errors = self.errors(theta)
        errors = np.where(np.isnan(errors), np.inf, errors)
        return np.where(np.isfinite(self.given_sigma), errors, np.nan)

    def poses(self, theta: Floats) -> Floats:
        """Tool poses of the rows in the measuring frame, shape (N, 4, 4).

        Those of relative measurements in the tool at the row's start.
        """
        of_robot, _ = self.split(theta)
        T, begun = self.error.poses(self.data.q, of_robot, self._factors), self._begun
        if begun.any():
            start = self.data.start[begun]
            T_0 = self.error.poses(start, of_robot, self._start_factors)
            T[begun] = invert(T_0) @ T[begun]
        return T

    def residual(self, theta: Floats) -> Floats:
        """Whitened residual, shape (M,): rows, known distances, then the priors."""
        rows = (self._kept(self.errors(theta)) / self.sigma).reshape(-1)
        return _joined([rows, *self._further(theta)], axis=0)

    def further_rows(self, theta: Floats) -> Floats:
        """Whitened rows that are no rows of the data, (..., P) -> (..., p)."""
        empty = np.empty((*theta.shape[:-1], 0))
        return _joined(self._further(theta) or [empty], axis=-1)

    def _further(self, theta: Floats) -> list[Floats]:
        """Those rows in blocks: distances, expected sizes and priors, if there are."""
        blocks = []
        if len(self._distances):
            blocks.append(self._distances.residual(self.split(theta)[1]))
        if self.expected is not None:
            blocks.append(self.expected.rows(theta / self.parameters.scales))
        if self.priors:
            blocks.append(self.prior_rows(theta))
        return blocks

    def prior_rows(self, theta: Floats) -> Floats:
        """Parameters in standard deviations of their priors, (..., P) -> (..., p)."""
        return np.asarray((theta / self.parameters.priors)[..., self._prior])

    def cost(self, theta: Floats) -> float:
        """Half the sum of squares of the whitened residual."""
        if self._many is None:
            r = self.residual(theta)
            return 0.5 * float(r @ r)
        further = self.further_rows(theta)
        return self._many.cost(*self.split(theta)) + 0.5 * float(further @ further)

    def linearize(self, theta: Floats) -> tuple[Floats, Floats]:
        """Whitened residual and its Jacobian by all parameters.

        Of very many rows they are those of a square system with the same normal
        equations, in which singular values below 1e-8 of the largest are lost: enough
        for a step, not for a rank.

        Returns:
            Residual, shape (M,), and Jacobian, shape (M, P).
        """
        if self._many is None:
            return self.linearize_rows(theta)
        return self._with_further(theta, *self._many.normal(*self.split(theta)))

    def linearize_rows(self, theta: Floats) -> tuple[Floats, Floats]:
        """The same as `linearize` row by row, however many there are."""
        of_robot, own = self.split(theta)
        poses = self.error.linearize(self.data.q, of_robot, self._factors)
        T, weight, begun = poses.T, 1.0 / self.sigma[:, :, None], self._begun
        if begun.any():
            start = self.error.linearize(
                self.data.start[begun], of_robot, self._start_factors
            )
            T = T.copy()
            T[begun] = invert(start.T) @ T[begun]
        linear = self.measurement.linearize(T, own, self.data)
        J_pose = self._kept(linear.J_pose) * weight
        blocks = [poses.derivative(J_pose)]
        if begun.any():
            # The twist of T_0^-1 T is that of T without that of T_0, carried there.
            carried = J_pose[begun] @ adjoint(invert(T[begun]))
            blocks[0][begun] -= start.derivative(carried)
        if len(own):
            blocks.append(self._kept(linear.J_instrument) * weight)
        J = _joined(blocks, axis=2).reshape(-1, len(theta))
        r = (self._kept(linear.residual) / self.sigma).reshape(-1)
        return self._with_further(theta, r, J)

    def _kept(self, values: Floats) -> Floats:
        """Values with zeros for rows that are set aside, shape (N, ...).

        They may be so wrong that they cannot be predicted, and nothing times infinity
        is not nothing.
        """
        if self.data.weight.all():
            return values
        aside = (self.data.weight == 0.0).reshape(-1, *[1] * (values.ndim - 1))
        return np.where(aside, 0.0, values)

    def factorize(self, theta: Floats) -> tuple[Floats, Floats]:
        """The same as `linearize` to full precision, for decisions about ranks."""
        if self._many is None:
            return self.linearize(theta)
        return self._with_further(theta, *self._many.triangular(*self.split(theta)))

    @property
    def many(self) -> bool:
        """Whether `linearize` returns a square system in place of the rows."""
        return self._many is not None

    @cached_property
    def _factors(self) -> Floats:
        """Those of the joint corrections, which depend on commands alone, (N, C)."""
        return self.error.basis(self.data.q, self.data.payload)

    @cached_property
    def _start_factors(self) -> Floats:
        """The same where relative measurements start."""
        rows = np.flatnonzero(self._begun)
        loads = [self.data.payload[k] for k in rows]
        return self.error.basis(self.data.start[rows], loads)

    @cached_property
    def _begun(self) -> NDArray[np.bool_]:
        """The rows that are measured relative to a start, shape (N,)."""
        if not self.data.start.size:
            return np.zeros(len(self.data), bool)
        return np.asarray(np.isfinite(self.data.start[:, 0]))

    @cached_property
    def _distances(self) -> KnownDistances:
        """Known distances between points that the instrument knows."""
        return KnownDistances.of(self.setup.distances, self.measurement.features)

    @cached_property
    def _many(self) -> ManyRows | None:
        """The compiled kernels where a Jacobian would be too large to be handy."""
        size = len(self.data) * self.components * len(self.parameters)
        if size < MANY or not self.error.geometric or self.measurement.relative:
            return None
        from calib_pin.estimation.many_rows import ManyRows

        return ManyRows(self.error, self.measurement, self.data, self.sigma)

    def _with_further(
        self, theta: Floats, r: Floats, J: Floats
    ) -> tuple[Floats, Floats]:
        """Residual and Jacobian with known distances and priors behind the rows."""
        further = self._further(theta)
        if not further:
            return r, J
        own = self.split(theta)[1]
        J_instrument = self._distances.jacobian(own)
        blocks = [np.zeros((len(J_instrument), len(theta)))]
        blocks[0][:, len(theta) - len(own) :] = J_instrument
        if self.expected is not None:
            blocks.append(self.expected.rows(np.diag(1.0 / self.parameters.scales)).T)
        blocks.append(np.diag(1.0 / self.parameters.priors)[self._prior])
        return np.concatenate([r, *further]), np.concatenate([J, *blocks])

    def register(self, theta: Floats) -> Problem:
        """The same problem about closed-form frames and instrument references.

        What the setup gives for a frame stands, as known or as a first guess; so does
        the identity for a frame that is partly fixed, bounded or has a prior.

        Args:
            theta: Parameter values, shape (P,); those of the robot count.
        """
        count = len(self.error.screws)
        few = trusted(self.data).sample(SAMPLE)
        # A frame of the chain has six parameters at either end.
        start = (
            self._given(self.setup.base_frame, slice(0, 6)),
            self._given(self.setup.tool_frame, slice(count - 6, count)),
        )
        self._require_loose(count)
        of_robot = self.split(theta)[0]
        F = self.error.tip_poses(few.q, of_robot, few.payload)
        if few.start.size:
            begun = np.isfinite(few.start[:, 0])
            loads = [few.payload[k] for k in np.flatnonzero(begun)]
            F_0 = self.error.tip_poses(few.start[begun], of_robot, loads)
            F[begun] = invert(F_0) @ F[begun]
        measurement, base, tool = self.measurement.register(F, few, *start)
        return replace(
            self, error=self.error.with_frames(base, tool), measurement=measurement
        )

    def _require_loose(self, start: int) -> None:
        """Refuse fixed, bounds or prior on what has no reference to be about.

        Args:
            start: Position of the first of the instrument's own parameters.
        """
        features = self.measurement.features
        for feature, part in zip(features, slices(features), strict=True):
            if feature.placed:
                continue
            own = slice(start + part.start, start + part.stop)
            lower, upper = (bound[own] for bound in self.parameters.bounds)
            priors = self.parameters.priors[own]
            free = np.array([p.free for p in feature.parameters], bool)
            held = free & ~self.parameters.free[own]
            if held.any() or np.isfinite([lower, upper, priors]).any():
                raise OptionError(
                    "fixed, bounds or prior on a part of an unknown instrument: give "
                    f"its '{feature.section}' in a setup file (--setup)",
                    file=self.setup.file or None,
                )

    def _given(self, frame: FrameSetup, part: slice) -> pin.SE3 | None:
        """The pose that a frame starts from, None for a closed-form estimate.

        What is fixed, bounded or has a prior is so about the pose of the setup file,
        not about an estimate.
        """
        stated = frame.xyz is not None or frame.rpy is not None
        free = self.parameters.free[part].any()
        if stated or not free or self._constrained(part):
            return frame_pose(frame)
        return None

    def _constrained(self, part: slice) -> bool:
        """Whether some parameters of an estimated frame are tied down."""
        parameters = self.parameters
        lower, upper = parameters.bounds
        tied = np.isfinite([lower[part], upper[part], parameters.priors[part]]).any()
        free = parameters.free[part]
        return bool(free.any() and (tied or not free.all()))

    def at(self, theta: Floats) -> tuple[Problem, Floats]:
        """The same problem about other values of frames and instrument.

        Args:
            theta: Parameter values, shape (P,).

        Returns:
            The problem with these in its references, and values about them, shape
            (P,): zero for frames and instrument, those of the robot as they are.
        """
        of_robot, own = self.split(theta)
        error, products = self.error, self.error.corrections(of_robot)
        frames = error.base * products[0], error.tool * products[-1]
        moved = replace(
            self,
            error=error.with_frames(*frames),
            measurement=self.measurement.rebased(own),
        )
        return moved, np.where(self.parameters.nuisance, 0.0, theta)

    def extended(self, theta: Floats, rows: Measurements) -> tuple[Problem, Floats]:
        """The problem of other rows, with a place for what only these name.

        Args:
            theta: Parameter values, shape (P,).
            rows: The other rows.

        Returns:
            The problem about its instrument, and its parameter values: those of the
            instrument are zero.
        """
        of_robot, own = self.split(theta)
        known = self.measurement.rebased(own)
        there = replace(self, data=rows, measurement=known)
        T = there.poses(np.concatenate([of_robot, 0.0 * own]))
        measurement = known.extended(T, rows)
        own = np.zeros(len(measurement.parameters))
        return replace(there, measurement=measurement), np.concatenate([of_robot, own])

    def about(
        self,
        theta: Floats,
        q: Floats,
        target: Sequence[str],
        start: Floats | None = None,
        payload: Sequence[str] = (),
    ) -> Problem:
        """The problem with noise-free data of the model at other rows.

        Args:
            theta: Parameter values, shape (P,).
            q: Joint positions, shape (K, n) [rad, m].
            target: Target of each row.
            start: Where relative measurements start, shape (K, n); default the row
                before each.
            payload: What each row carries; default `loads`.
        """
        there = self.looking(q, target, start, payload)
        own = self.split(theta)[1]
        values = self.measurement.predict(there.poses(theta), own, target)
        return replace(there, data=replace(there.data, values=values))

    def looking(
        self,
        q: Floats,
        target: Sequence[str],
        start: Floats | None = None,
        payload: Sequence[str] = (),
    ) -> Problem:
        """The problem with rows whose measured values are zero; see `about`."""
        if self.measurement.relative and start is None:
            start = np.roll(q, 1, axis=0)
            start[~relative_rows(self.measurement, target)] = np.nan
        data = Measurements(
            joints=self.error.chain.joints,
            q=q,
            model=self.measurement.name,
            values=np.zeros((len(q), self.measurement.width)),
            sigma=absent(self.measurement, target),
            target=tuple(target),
            payload=tuple(payload) or self.loads(len(q)),
            start=np.zeros((0, 0)) if start is None else start,
        )
        return replace(self, data=data)

    def loads(self, count: int) -> tuple[str, ...]:
        """What the robot carries in rows that do not say: all payloads in turn.

        Each stays for as many rows as there are targets, so that all meet.
        """
        names = tuple(dict.fromkeys(self.data.payload)) or ("",)
        targets = len(set(self.data.target)) or 1
        return tuple(names[k // targets % len(names)] for k in range(count))

    def split(self, theta: Floats) -> tuple[Floats, Floats]:
        """Values of the error model and of the measurement model, (..., P) each."""
        count = len(self.error.screws)
        return theta[..., :count], theta[..., count:]


def _joined(blocks: list[Floats], axis: int) -> Floats:
    """Blocks side by side; a single one without a copy."""
    return blocks[0] if len(blocks) == 1 else np.concatenate(blocks, axis=axis)
