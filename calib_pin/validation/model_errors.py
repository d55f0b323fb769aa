"""Errors of measurements by the nominal robot and by a fitted model."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError
from calib_pin.estimation.fit import FittedModel
from calib_pin.estimation.problem import Problem, distinct_values
from calib_pin.estimation.registration import extended
from calib_pin.estimation.row_blocks import KnownDistances
from calib_pin.estimation.solve import least_squares
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.validation.predicted import predicted_variance
from calib_pin.validation.result import FoundDistance


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
    known = {reference.name for reference in model.problem.measurement.references}
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
        tuple(f.name for f in problem.measurement.references if f.name not in known),
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
        for distances in [KnownDistances.of(stated, at.problem.measurement.references)]
    )
    assert first.stated == second.stated
    return tuple(
        FoundDistance(d.between, d.value, d.sigma, float(n), float(f), known is None)
        for d, n, f in zip(first.stated, nominal, found, strict=True)
    )


@dataclass(frozen=True)
class Registered:
    """A fitted problem registered on other measurements.

    Attributes:
        problem: The problem of these measurements.
        theta: Its parameter values, shape (P,).
        new: Positions of the parameters of reference objects that only these
            measurements name.
        refitted: Positions of further parameters that were estimated anew from them.
    """

    problem: Problem
    theta: Floats
    new: tuple[int, ...] = ()
    refitted: tuple[int, ...] = ()


def registered(
    problem: Problem, theta: Floats, measurements: Measurements
) -> Registered:
    """A fitted problem on other measurements, with what only these name registered.

    A socket, say, that only these measurements name is estimated from them. Nothing
    else is fitted, and known distances between new reference objects do not count:
    they are there to be found.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).
        measurements: The other measurements.

    Raises:
        InputError: If a new reference object uses up all that its measurements say.
    """
    known = set(problem.parameters.names)
    problem, theta = extended(problem, theta, measurements)
    names = problem.parameters.names
    new = tuple(k for k, name in enumerate(names) if name not in known)
    if not new:
        return Registered(problem, theta)
    plain = replace(problem, setup=replace(problem.setup, distances=()))
    _require_redundancy(plain, theta, new)
    basis = np.diag(problem.parameters.scales)[:, list(new)]
    return Registered(problem, least_squares(plain, theta, basis).x, new)


def _require_redundancy(problem: Problem, theta: Floats, new: Sequence[int]) -> None:
    """Refuse measurements that a new reference object uses up.

    Raises:
        InputError: If there are such; their errors would all be zero.
    """
    count, size = len(problem.data), problem.components
    _, J = problem.linearize_rows(theta)
    J = J[: count * size].reshape(count, size, -1)
    owners: dict[str, list[int]] = {}
    for k in new:
        owners.setdefault(problem.parameters.names[k].rsplit(".", 2)[0], []).append(k)
    for name, columns in owners.items():
        rows = np.flatnonzero(J[:, :, columns].any(axis=(1, 2)))
        A = J[rows][:, :, columns].reshape(-1, len(columns))
        values = distinct_values(replace(problem, data=problem.data.rows(rows)))
        if values <= np.linalg.matrix_rank(A):
            data = problem.data
            error = partial(data.error, int(rows[0])) if len(rows) else InputError
            raise error(
                f"the measurements of '{name}', which was not fitted, say no more than "
                "where it is; measure it in more configurations",
                column="target",
            )
