"""The least-squares problem: error model, measurement model and data put together."""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.chain import Chain
from calib_pin.error_model import ErrorModel
from calib_pin.errors import InputError, OptionError
from calib_pin.measurement_models import MeasurementModel, measurement_model
from calib_pin.measurements import Measurements
from calib_pin.parameters import ParameterSet
from calib_pin.setup import FrameSetup, Setup
from calib_pin.spatial import Floats

if TYPE_CHECKING:
    from calib_pin.many_rows import ManyRows

__all__ = [
    "Problem",
    "assumed_sigma",
    "frame_pose",
    "make_problem",
    "nominal_problem",
    "observable_configurations",
]

DRAWS = 200
"""Random configurations tried for each one that is wanted."""

SAMPLE = 10_000
"""Rows that a closed-form start is made from; more do not help it."""

MANY = 1_000_000
"""Entries of a Jacobian from which rows go through the compiled kernels, in chunks.

Below, Pinocchio takes less time than loading the kernels.
"""


@dataclass(frozen=True)
class Problem:
    """Whitened residuals of data as a function of the error parameters.

    The residual vector holds the rows of the data, each component divided by its
    standard deviation, then one row per free parameter with a prior.

    Attributes:
        error: The error model about its reference frames.
        measurement: The measurement model about its reference values.
        data: The rows.
        setup: Which parameters are fixed, bounded or have a prior, and the noise
            where the data do not state it.
        held_at: Values of parameters that are held at a bound, by position.

    Raises:
        OptionError: If the setup names a parameter that does not exist.
    """

    error: ErrorModel
    measurement: MeasurementModel
    data: Measurements
    setup: Setup = field(default_factory=Setup)
    held_at: Mapping[int, float] = field(default_factory=dict)

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
        """Standard deviation of every residual component, shape (N, d)."""
        if self.data.sigma is not None:
            return self.data.sigma
        return np.tile(
            assumed_sigma(self.measurement, self.setup.noise), (len(self.data), 1)
        )

    @property
    def components(self) -> int:
        """Residual components of a row."""
        return int(self.measurement.quantities[-1].columns.stop)

    @property
    def count(self) -> int:
        """Components of the whitened residual: those of the rows and the priors."""
        return len(self.data) * self.components + int(self._prior.sum())

    @property
    def distinct_values(self) -> int:
        """Measured values, repetitions of a configuration left out."""
        return self.data.configurations * self.components

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

    def errors(self, theta: Floats) -> Floats:
        """Residuals in their units, predicted minus measured, shape (N, d)."""
        of_robot, own = self.split(theta)
        if self._many is not None:
            return self._many.errors(of_robot, own)
        T = self.error.poses(self.data.q, of_robot, self._factors)
        return self.measurement.residual(T, own, self.data)

    def residual(self, theta: Floats) -> Floats:
        """Whitened residual, shape (M,): components of the rows, then the priors."""
        rows = (self.errors(theta) / self.sigma).reshape(-1)
        return np.concatenate([rows, self.prior_rows(theta)])

    def prior_rows(self, theta: Floats) -> Floats:
        """Parameters in standard deviations of their priors, (..., P) -> (..., p)."""
        return np.asarray((theta / self.parameters.priors)[..., self._prior])

    def cost(self, theta: Floats) -> float:
        """Half the sum of squares of the whitened residual."""
        if self._many is None:
            r = self.residual(theta)
            return 0.5 * float(r @ r)
        prior = self.prior_rows(theta)
        return self._many.cost(*self.split(theta)) + 0.5 * float(prior @ prior)

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
        return self._with_priors(theta, *self._many.normal(*self.split(theta)))

    def linearize_rows(self, theta: Floats) -> tuple[Floats, Floats]:
        """The same as `linearize` row by row, however many there are."""
        of_robot, own = self.split(theta)
        poses = self.error.linearize(self.data.q, of_robot, self._factors)
        linear = self.measurement.linearize(poses.T, own, self.data)
        weight = 1.0 / self.sigma[:, :, None]
        blocks = [poses.derivative(linear.by_twist * weight)]
        if len(own):
            blocks.append(linear.by_own * weight)
        J = _joined(blocks, axis=2).reshape(-1, len(theta))
        r = (linear.residual / self.sigma).reshape(-1)
        return self._with_priors(theta, r, J)

    def factorize(self, theta: Floats) -> tuple[Floats, Floats]:
        """The same as `linearize` to full precision, for decisions about ranks."""
        if self._many is None:
            return self.linearize(theta)
        return self._with_priors(theta, *self._many.triangular(*self.split(theta)))

    @property
    def many(self) -> bool:
        """Whether `linearize` returns a square system in place of the rows."""
        return self._many is not None

    @cached_property
    def _factors(self) -> Floats:
        """Those of the joint corrections, which depend on commands alone, (N, C)."""
        return self.error.factors(self.data.q)

    @cached_property
    def _many(self) -> ManyRows | None:
        """The compiled kernels where a Jacobian would be too large to be handy."""
        size = len(self.data) * self.components * len(self.parameters)
        if size < MANY or not self.error.geometric:
            return None
        from calib_pin.many_rows import ManyRows

        return ManyRows(self.error, self.measurement, self.data, self.sigma)

    def _with_priors(
        self, theta: Floats, r: Floats, J: Floats
    ) -> tuple[Floats, Floats]:
        """Residual and Jacobian with the rows of the priors behind them."""
        if not self._prior.any():
            return r, J
        prior = np.diag(1.0 / self.parameters.priors)[self._prior]
        return np.concatenate([r, prior @ theta]), np.concatenate([J, prior])

    def register(self, theta: Floats) -> Problem:
        """The same problem about closed-form frames and instrument references.

        What the setup gives for a frame stands, as known or as a first guess; so does
        the identity for a frame that is partly fixed, bounded or has a prior.

        Args:
            theta: Parameter values, shape (P,); those of the robot count.
        """
        count = len(self.error.screws)
        few = self.data.sample(SAMPLE)
        # A frame of the chain has six parameters at either end.
        start = (
            self._given(self.setup.base_frame, slice(0, 6)),
            self._given(self.setup.tool_frame, slice(count - 6, count)),
        )
        own = slice(count, None)
        if self.measurement.missing and self._constrained(own):
            raise OptionError(
                f"fixed, bounds or prior on a part of an unknown instrument: "
                f"{self.measurement.missing}",
                file=self.setup.file or None,
            )
        F = self.error.tip_poses(few.q, self.split(theta)[0])
        measurement, base, tool = self.measurement.register(F, few, *start)
        return replace(
            self, error=self.error.with_frames(base, tool), measurement=measurement
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
        """Whether some parameters of an estimated frame or plane are tied down."""
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
            measurement=self.measurement.about(own),
        )
        return moved, np.where(self.parameters.nuisance, 0.0, theta)

    def about(self, theta: Floats, q: Floats, target: Sequence[str]) -> Problem:
        """The problem with noise-free data of the model at other rows.

        Args:
            theta: Parameter values, shape (P,).
            q: Joint positions, shape (K, n) [rad, m].
            target: Target of each row.
        """
        of_robot, own = self.split(theta)
        T = self.error.poses(q, of_robot)
        data = Measurements(
            joints=self.error.chain.joints,
            q=q,
            model=self.measurement.name,
            values=self.measurement.predict(T, own, target),
            target=tuple(target),
        )
        return replace(self, data=data)

    def split(self, theta: Floats) -> tuple[Floats, Floats]:
        """Values of the error model and of the measurement model, (..., P) each."""
        count = len(self.error.screws)
        return theta[..., :count], theta[..., count:]


def make_problem(chain: Chain, data: Measurements, setup: Setup) -> Problem:
    """Error model, measurement model and data of a setup put together.

    A measuring frame of its own exists for positions and poses. A ranger measures
    against a plane given in the base, which is known unless the setup frees it.

    Raises:
        OptionError: If a name in the setup does not exist.
    """
    model = measurement_model(data.model, setup, data.target)
    base, tool = setup.base_frame.estimate, setup.tool_frame.estimate
    try:
        error = ErrorModel.create(
            chain,
            setup.parameters,
            setup=setup,
            estimate_base=model.measuring_frame if base is None else base,
            estimate_tool=True if tool is None else tool,
        )
    except OptionError as mistake:
        raise mistake.within(setup.file) from None
    return Problem(error, model, data, setup)


def nominal_problem(chain: Chain, model: str, setup: Setup) -> Problem:
    """A problem without rows, about the frames and instrument that the setup gives.

    Raises:
        OptionError: If the instrument needs a reference that the setup lacks.
    """
    data = Measurements(
        joints=chain.joints,
        q=np.zeros((len(setup.planes) or 1, len(chain.joints))),
        model=model,
        values=np.zeros((len(setup.planes) or 1, 1)),
        target=tuple(setup.planes) or ("",),
    )
    problem = make_problem(chain, data, setup)
    missing = problem.measurement.missing
    if missing:
        raise OptionError(f"a {model} study without measurements: {missing}")
    frames = frame_pose(setup.base_frame), frame_pose(setup.tool_frame)
    return replace(problem, error=problem.error.with_frames(*frames))


def _joined(blocks: list[Floats], axis: int) -> Floats:
    """Blocks side by side; a single one without a copy."""
    return blocks[0] if len(blocks) == 1 else np.concatenate(blocks, axis=axis)


def frame_pose(frame: FrameSetup) -> pin.SE3:
    """The pose that a setup states, the identity for what it leaves out."""
    rotation = pin.rpy.rpyToMatrix(*(frame.rpy or (0.0, 0.0, 0.0)))
    return pin.SE3(rotation, np.array(frame.xyz or (0.0, 0.0, 0.0)))


def assumed_sigma(measurement: MeasurementModel, noise: Mapping[str, float]) -> Floats:
    """Standard deviation of the residual components where rows state none, (d,)."""
    return np.concatenate(
        [
            np.full(
                quantity.columns.stop - quantity.columns.start,
                noise.get(quantity.name, quantity.sigma),
            )
            for quantity in measurement.quantities
        ]
    )


def observable_configurations(
    problem: Problem, theta: Floats, count: int, rng: np.random.Generator
) -> tuple[Floats, tuple[str, ...]]:
    """Random configurations within the limits at which the instrument can measure.

    Args:
        problem: Chain, frames, instrument; its data only name the targets.
        theta: Parameter values, shape (P,).
        count: Number K of configurations.
        rng: Random generator.

    Returns:
        Joint positions, shape (K, n), and the target of each, in turn.

    Raises:
        InputError: If fewer than one configuration in two hundred can be measured.
    """
    names = tuple(dict.fromkeys(problem.data.target)) or ("",)
    target = tuple(names[i % len(names)] for i in range(count))
    of_robot, own = problem.split(theta)
    q_found, target_found = np.empty((0, len(problem.error.chain.joints))), []
    for _ in range(DRAWS):
        q = problem.error.chain.random_configurations(count, rng)
        T = problem.error.poses(q, of_robot)
        seen = problem.measurement.observable(T, own, target)
        q_found = np.concatenate([q_found, q[seen]])
        target_found += [target[i] for i in np.flatnonzero(seen)]
        if len(q_found) >= count:
            return q_found[:count], tuple(target_found[:count])
    raise InputError(
        f"only {len(q_found)} of {DRAWS * count} random configurations within the "
        f"joint limits can be measured ({problem.measurement.name})"
    )
