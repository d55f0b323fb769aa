"""Errors of measurements by the nominal robot and by a fitted model."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.fit import FittedModel
from calib_pin.estimation.row_blocks import KnownDistances
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.validation.predicted import predicted_variance
from calib_pin.validation.result import FoundDistance
from calib_pin.validation.validation_registration import Registered, registered


@dataclass(frozen=True)
class ModelErrors:
    """Errors of measurements in the units of the residual.

    Attributes:
        positions: Positions of the measurements among all, shape (N,).
        before: Errors of the nominal robot, base, tool and instrument registered, shape
            (N, d); NaN for what a measurement of mixed ones does not have.
        after: Errors of the fitted model, shape (N, d).
        variance: The variance of these that the fit predicts, shape (N, d): noise, and
            what it leaves uncertain; NaN for measurements that were fitted.
        distances: Known distances between reference objects that these measurements
            name.
        registered: Names of the objects that were not fitted, and are estimated from
            the measurements themselves.
        reason: Why the fit that they check says little of the robot, so that they do
            not count; empty where they do.
    """

    positions: NDArray[np.intp]
    before: Floats
    after: Floats
    variance: Floats
    distances: tuple[FoundDistance, ...] = ()
    registered: tuple[str, ...] = ()
    reason: str = ""

    @staticmethod
    def empty(components: int, reason: str) -> ModelErrors:
        """Those of no measurements, and why."""
        none = np.zeros((0, components))
        return ModelErrors(np.zeros(0, np.intp), none, none, none, reason=reason)

    @staticmethod
    def joined(parts: Sequence[ModelErrors]) -> ModelErrors:
        """Those of all parts, one after the other."""
        positions, before, after, variance = (
            np.concatenate([getattr(part, name) for part in parts])
            for name in ("positions", "before", "after", "variance")
        )
        return ModelErrors(
            positions,
            before,
            after,
            variance,
            tuple(distance for part in parts for distance in part.distances),
            tuple(dict.fromkeys(name for part in parts for name in part.registered)),
        )

    def at(self, kept: NDArray[np.generic]) -> ModelErrors:
        """Those of some of the measurements, a mask or positions within them."""
        return replace(
            self,
            positions=self.positions[kept],
            before=self.before[kept],
            after=self.after[kept],
            variance=self.variance[kept],
        )

    def counted(self, weight: Floats) -> ModelErrors:
        """Those that are not set aside; all of them where no other is left.

        Args:
            weight: Weight of all measurements that the positions belong to, shape
                (N',).
        """
        kept = weight[self.positions] > 0.0
        return self if kept.all() or not kept.any() else self.at(kept)


@serial_blas
def model_errors(
    model: FittedModel, measurements: Measurements, positions: NDArray[np.intp]
) -> ModelErrors:
    """Errors of measurements, with reference objects that only these name registered.

    Args:
        model: The fitted model.
        measurements: The N measurements.
        positions: Their positions among all, shape (N,).

    Raises:
        InputError: If a new reference object uses up all that its measurements say.
    """
    before = registered(model.fit.problem, model.fit.before, measurements)
    after = registered(model.problem, model.theta, measurements)
    return errors_of_registered(model, before, after, positions)


@serial_blas
def fitted_errors(model: FittedModel, training: Measurements) -> ModelErrors:
    """Errors of the measurements that were fitted, and the known distances among them.

    Args:
        model: The fitted model.
        training: The measurements, those that the fit has set aside included.
    """
    before = registered(model.fit.problem, model.fit.before, training)
    after = registered(model.problem, model.theta, training)
    return ModelErrors(
        np.arange(len(training)),
        before.problem.masked_errors(before.theta),
        after.problem.masked_errors(after.theta),
        np.full(after.problem.sigma.shape, np.nan),
        _found_distances(before, after, None),
    )


def errors_of_registered(
    model: FittedModel,
    before: Registered,
    after: Registered,
    positions: NDArray[np.intp],
) -> ModelErrors:
    """Errors of measurements that both robots are registered on.

    Args:
        model: The fitted model.
        before: The nominal robot.
        after: The fitted model.
        positions: Positions of the measurements among all, shape (N,).
    """
    problem, theta = after.problem, after.theta
    known = {feature.name for feature in model.problem.measurement.features}
    there = replace(model.fit.problem, data=problem.data), model.fit.theta
    estimated = (*after.refitted, *after.new)
    if estimated:
        there = problem, theta
    return ModelErrors(
        positions,
        before.problem.masked_errors(before.theta),
        problem.masked_errors(theta),
        predicted_variance(model.fit, *there, estimated),
        _found_distances(before, after, known),
        tuple(f.name for f in problem.measurement.features if f.name not in known),
    )


def _found_distances(
    before: Registered, after: Registered, known: Collection[str] | None
) -> tuple[FoundDistance, ...]:
    """Known distances beside those that the nominal and the fitted robot find.

    Args:
        before: The nominal robot.
        after: The fitted model.
        known: Names of what was fitted, where this is about what was not.
    """
    stated = [
        distance
        for distance in after.problem.setup.distances
        if known is None or not set(known).intersection(distance.between)
    ]
    (first, nominal), (second, found) = (
        (distances, distances.lengths(at.problem.split(at.theta)[1]))
        for at in (before, after)
        for distances in [KnownDistances.of(stated, at.problem.measurement.features)]
    )
    assert first.stated == second.stated
    return tuple(
        FoundDistance(d.between, d.value, d.sigma, float(n), float(f), known is None)
        for d, n, f in zip(first.stated, nominal, found, strict=True)
    )
