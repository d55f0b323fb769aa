"""Errors of measurements by the nominal robot and by a fitted model."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError
from calib_pin.estimation.fitted import Fit, Posterior
from calib_pin.estimation.identifiability import column_space
from calib_pin.estimation.nominal import extended, register, relocated
from calib_pin.estimation.problem import (
    SAMPLE,
    Problem,
    distinct_values,
    error_table,
    fitted_components,
)
from calib_pin.estimation.row_blocks import KnownDistances
from calib_pin.estimation.solve import least_squares
from calib_pin.estimation.terms import FRAME
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.declaration import Quantity
from calib_pin.observations import Indices, Observations
from calib_pin.solvers import LeastSquaresResult
from calib_pin.validation.result import Accuracy, DistanceCheck, QuantityErrors

ARRAYS = ("positions", "before", "after", "variance")
"""Those that have a row for each measurement."""


@dataclass(frozen=True)
class ModelErrors:
    """Errors of measurements in the units of the residual.

    Attributes:
        positions: Positions of the measurements among all, shape (N,).
        before: Errors of the nominal robot, base, tool and instrument registered, shape
            (N, D) with the quantities of all models side by side; NaN for what a
            measurement does not have.
        after: Errors of the fitted model, shape (N, D).
        variance: The variance of these that the fit predicts, shape (N, D): noise, and
            what it leaves uncertain; NaN for measurements that were fitted.
        distances: Known distances between reference objects that these measurements
            name.
        registered: Names of the stations and objects that were not fitted, and are
            estimated from the measurements themselves.
        reason: Why the fit that they check says little of the robot, so that they do
            not count; empty where they do.
    """

    positions: NDArray[np.intp]
    before: Floats
    after: Floats
    variance: Floats
    distances: tuple[DistanceCheck, ...] = ()
    registered: tuple[str, ...] = ()
    reason: str = ""

    @staticmethod
    def joined(parts: Sequence[ModelErrors]) -> ModelErrors:
        """Those of all parts, one after the other."""
        arrays = ([getattr(part, name) for part in parts] for name in ARRAYS)
        distances = tuple(dict.fromkeys(d for part in parts for d in part.distances))
        names = dict.fromkeys(name for part in parts for name in part.registered)
        positions, before, after, variance = map(np.concatenate, arrays)
        return ModelErrors(positions, before, after, variance, distances, tuple(names))

    def at(self, index: NDArray[np.generic]) -> ModelErrors:
        """Those of some of the measurements, a mask or positions within them."""
        return replace(self, **{name: getattr(self, name)[index] for name in ARRAYS})

    def accuracy(self, quantity: Quantity) -> tuple[Accuracy | None, Accuracy | None]:
        """Accuracy of a quantity before and after; None where none has it."""
        sizes = (quantity.errors(errors) for errors in (self.before, self.after))
        before, after = (Accuracy.of(size) if len(size) else None for size in sizes)
        return before, after

    def counted(self, weight: Floats) -> ModelErrors:
        """Those that are not set aside; all of them where no other is left.

        Args:
            weight: Weight of all measurements that the positions belong to, shape
                (N',).
        """
        mask = weight[self.positions] > 0.0
        return self.at(mask) if mask.any() else self


def quantity_errors(
    quantities: Iterable[Quantity], fitted: ModelErrors, *held_out: ModelErrors
) -> tuple[QuantityErrors, ...]:
    """Accuracy before and after, of fitted and of parts of held-out measurements.

    Of the quantities that fitted measurements have.
    """
    # Of mixed measurements, those held out may all be of another model.
    joined = [ModelErrors.joined(held_out)] if held_out else []
    parts, errors = (fitted, *joined), list[QuantityErrors]()
    for quantity in quantities:
        (before, after), *held = (part.accuracy(quantity) for part in parts)
        if before is not None and after is not None:
            stages = before, after, *(held[0] if held else (None, None))
            errors.append(QuantityErrors(quantity.name, quantity.unit, *stages))
    return tuple(errors)


@serial_blas
def model_errors(
    fitted: Fit, measurements: Observations, positions: NDArray[np.intp]
) -> ModelErrors:
    """Errors of measurements, with what only these name registered on them.

    Args:
        fitted: The fit.
        measurements: The N measurements.
        positions: Their positions among all, shape (N,).

    Raises:
        InputError: If a new station or reference object uses up all that its
            measurements say, or they are of something that was not fitted.
    """
    return errors_of_registered(fitted, *both(fitted, measurements), positions)


@serial_blas
def fitted_errors(fitted: Fit, training: Observations) -> ModelErrors:
    """Errors of the measurements that were fitted, and the known distances among them.

    Args:
        fitted: The fit.
        training: The measurements, those that the fit has set aside included.
    """
    positions = np.arange(len(training))
    return errors_of_registered(fitted, *both(fitted, training), positions, own=True)


def errors_of_registered(
    fitted: Fit,
    before: Registered,
    after: Registered,
    positions: NDArray[np.intp],
    deviations: Posterior | None = None,
    own: bool = False,
) -> ModelErrors:
    """Errors of measurements that both robots are registered on.

    Args:
        fitted: The fit.
        before: The nominal robot.
        after: The fitted model.
        positions: Positions of the measurements among all, shape (N,).
        deviations: Those of the fit that predicts; default of the model's own.
        own: Whether they were fitted, so that it predicts nothing of them.
    """
    problem = after.problem
    old, new = (error_table(at.problem, at.theta) for at in (before, after))
    spread, distances = np.full(new.shape, np.nan), problem.setup.distances
    known = {name for _, name in fitted.problem.references}
    if not own:
        distances = tuple(d for d in distances if known.isdisjoint(d.between))
        variance = predicted_variance(fitted, after, deviations)
        spread = problem.layout.table(variance, len(problem.data))
    nominal, calibrated = (
        KnownDistances.of(distances, at.problem.references, at.problem.given.names)
        for at in (before, after)
    )
    lengths = nominal.lengths(before.theta), calibrated.lengths(after.theta)
    checks = tuple(
        DistanceCheck(d.between, d.value, d.sigma, float(n), float(f), own)
        for d, n, f in zip(calibrated.stated, *lengths, strict=True)
    )
    return ModelErrors(positions, old, new, spread, checks, after.located)


def located_names(problem: Problem) -> tuple[str, ...]:
    """Names of the stations and reference objects that can be estimated."""
    free = dict(zip(problem.given.names, problem.parameters.free, strict=True))
    terms = problem.terms.values()
    estimated = [t for t in terms if any(free[p.name] for p in t.parameters[:FRAME])]
    words = (" ".join(reversed(t.frames.station.rsplit(".", 1))) for t in estimated)
    objects = problem.references.items()
    return (*dict.fromkeys(words), *(name for (_, name), o in objects if o.parameters))


@dataclass(frozen=True)
class Registered:
    """A fitted problem registered on other measurements.

    Attributes:
        problem: The problem of these measurements.
        theta: Its parameter values, shape (P,).
        new: Positions of the free parameters of stations and reference objects that
            only these measurements name.
        refitted: Positions of further parameters that were estimated anew from them.
        registered: Whether base, tool and instrument were fitted to them.
        reason: Why that must not be trusted; empty where it may.
        located: Names of stations and references, such as sockets, that were not there
            before and stand where the measurements put them.
        used_up: Number of values that base, tool and instrument have used up.
    """

    problem: Problem
    theta: Floats
    new: tuple[int, ...] = ()
    refitted: tuple[int, ...] = ()
    registered: bool = False
    reason: str = ""
    located: tuple[str, ...] = ()
    used_up: int = 0


def registered(
    problem: Problem, theta: Floats, measurements: Observations, anew: bool = False
) -> Registered:
    """A fitted problem on other measurements, with what only these name registered.

    A socket, say, that only these measurements name is estimated from them, and so is
    the base frame of a station. Nothing else is fitted, and known distances between new
    reference objects do not count: they are there to be found.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).
        measurements: The other measurements.
        anew: Whether base, tool and instrument are fitted to these as well.

    Raises:
        InputError: If a new station or reference object uses up all that its
            measurements say, or they are of something that was not fitted.
    """
    known, located = set(problem.parameters.names), located_names(problem)
    problem, theta = extended(problem, theta, measurements)
    if anew:
        return registered_anew(problem, theta, located)
    names, free = enumerate(problem.parameters.names), problem.parameters.free
    new = [k for k, name in names if name not in known and free[k]]
    if new:
        plain = replace(problem, setup=replace(problem.setup, distances=()))
        _require_redundancy(plain, theta, new)
        basis = np.diag(problem.parameters.scales)[:, new]
        theta = least_squares(plain, theta, basis).x
    there = tuple(name for name in located_names(problem) if name not in located)
    return Registered(problem, theta, tuple(new), located=there)


def registered_anew(
    problem: Problem, theta: Floats, located: Collection[str]
) -> Registered:
    """A problem with base, tool and instrument fitted to its measurements.

    Args:
        problem: The problem; where it is nominal, nothing of these has a place yet.
        theta: Parameter values, shape (P,).
        located: Names of what has been located before.
    """
    problem, result = register(problem, theta)
    reason, used_up = registration_reason(problem, result), _used_up(problem, result)
    there = tuple(name for name in located_names(problem) if name not in located)
    return Registered(problem, result.x, (), (), True, reason, there, used_up)


def _used_up(problem: Problem, result: LeastSquaresResult) -> int:
    """Number of values that a registration has used up."""
    parameters = problem.parameters
    A = (result.jac * parameters.scales)[:, parameters.free & parameters.nuisance]
    return int(np.linalg.matrix_rank(A)) if A.size and np.isfinite(A).all() else 0


def relocated_station(
    problem: Problem, theta: Floats, station: str, free: Indices, loose: bool = True
) -> tuple[Problem, Floats]:
    """A problem about the place of a station that its measurements tell, and theta.

    Known distances count again later: they are left out of this fit only.

    Args:
        problem: The problem of measurements from there, about its solution.
        theta: Parameter values, shape (P,).
        station: Owner and kind of the station's frame.
        free: Positions of the parameters that are estimated anew.
        loose: Whether the station may be anywhere, so that its closed form is a start.
    """
    basis = np.diag(problem.parameters.scales)[:, free]
    plain = replace(problem, setup=replace(problem.setup, distances=()))
    starts = [plain, relocated(plain, theta, station)] if loose else [plain]
    fits = [(least_squares(start, theta, basis), start) for start in starts]
    best, start = min(fits, key=lambda pair: np.nan_to_num(pair[0].cost, nan=np.inf))
    return replace(start, setup=problem.setup), best.x


def registration_reason(problem: Problem, result: LeastSquaresResult) -> str:
    """The reason why a registration must not be trusted; empty where it may be.

    Args:
        problem: The problem whose nuisances were fitted.
        result: Outcome of the fit.
    """
    values, rank = distinct_values(problem), _used_up(problem, result)
    if rank and values <= rank:
        text = f"{values} measured values are used up by the {rank} unknowns of base, "
        return f"{text}tool and instrument; measure more configurations"
    return "" if result.status.success else result.status.advice


def both(fitted: Fit, measurements: Observations) -> tuple[Registered, Registered]:
    """The nominal robot and the fitted model, `registered` on other measurements."""
    before = registered(fitted.problem, fitted.before, measurements)
    return before, registered(*fitted.solved, measurements)


def _require_redundancy(problem: Problem, theta: Floats, new: Sequence[int]) -> None:
    """Refuse measurements that a new station or reference object uses up.

    Raises:
        InputError: If there are such; their errors would all be zero.
    """
    row, names = problem.layout.row, problem.parameters.names
    J = problem.linearize_rows(theta)[1][: len(row)]
    for owner in dict.fromkeys(names[k].rpartition(".")[0] for k in new):
        A = J[:, [k for k in new if names[k].rpartition(".")[0] == owner]]
        rows = np.unique(row[A.any(axis=1)])
        seen = replace(problem, data=problem.data.rows(rows))
        if distinct_values(seen) > np.linalg.matrix_rank(A):
            continue
        name, _, kind = owner.rpartition(".")
        reason = f"the measurements of '{name}', which was not fitted, say no more "
        reason += "than where it is; measure it in more configurations"
        column = "station" if kind == "station" else "target"
        if len(rows):
            raise problem.data.error(int(rows[0]), reason, column=column)
        raise InputError(reason, column=column)  # Of what is set aside.


@serial_blas
def predicted_variance(
    fitted: Fit, there: Registered, deviations: Posterior | None = None
) -> Floats:
    """Variance of the errors of measurements that were not fitted, in their units.

    The noise of these and what the fit leaves uncertain, `sigma^2 + J C J^T`, with what
    gears and compliance do beyond what the fit has absorbed of them. What was estimated
    from these measurements themselves, K, takes its part of both away: the variance of
    `(I - K K^+)(e + J d)`.

    Args:
        fitted: The fit that predicts.
        there: Its problem of the N measurements.
        deviations: Those of its parameters; default of a fit of all.

    Returns:
        Variances of the residual components, shape (M,); infinite for measurements that
        are set aside, NaN where the fit knows no covariance.
    """
    sigma, deviations = there.problem.sigma, deviations or fitted.posterior
    if not np.isfinite(deviations.by_noise).all():
        return np.full(sigma.shape, np.nan)
    parts = _predicted_parts(fitted, there, deviations)
    whitened = [noise + np.sum(uncertain**2, axis=1) for noise, uncertain in parts]
    return np.asarray(np.concatenate(whitened) * sigma**2)


@serial_blas
def mahalanobis(fitted: Fit, there: Registered) -> float:
    """Chi-square of the errors of measurements together, by their whole covariance.

    Args:
        fitted: The fit that predicts.
        there: Its problem of a few measurements that were not fitted.
    """
    parts = [*_predicted_parts(fitted, there, fitted.posterior)]
    noise, uncertain = (np.concatenate(part) for part in zip(*parts, strict=True))
    errors = there.problem.residual(there.theta)[: len(noise)]
    C = np.diag(noise) + uncertain @ uncertain.T
    return float(errors @ np.linalg.lstsq(C, errors, rcond=None)[0])


def _predicted_parts(
    fitted: Fit, there: Registered, deviations: Posterior
) -> Iterator[tuple[Floats, Floats]]:
    """Variances by noise and deviations by the fit, whitened, of some rows at a time.

    Shapes (M',) and (M', k); arguments as for `predicted_variance`.
    """
    problem, theta, new = there.problem, there.theta, [*there.refitted, *there.new]
    names, scales = problem.parameters.names, problem.parameters.scales
    of_fit = fitted.problem.parameters.names
    # What is new there has no covariance: it was estimated from these.
    shared = [k for k, name in enumerate(names) if name in of_fit]
    moved = np.column_stack([deviations.by_noise, deviations.by_effects])
    factor = np.zeros((len(theta), moved.shape[1]))
    factor[shared] = moved[[of_fit.index(names[k]) for k in shared]]
    factor[new] = 0.0
    noises = deviations.noise[fitted_components(problem.layout, fitted.problem.layout)]
    positions = np.arange(len(problem.data))
    # An estimate couples all of them.
    step = max(len(positions), 1) if new else SAMPLE
    for start in range(0, len(positions), step):
        part = replace(problem, data=problem.data.rows(positions[start : start + step]))
        component = part.layout.component
        J = part.linearize_rows(theta)[1][: len(component)]
        uncertain, noise = J @ factor, fitted.unit**2 * noises[component]
        if deviations.systematic is not None:
            # The fit has absorbed a part of what gears and compliance do there.
            absorbed = deviations.systematic.rows(part, theta)
            uncertain[:, -absorbed.shape[1] :] -= absorbed
        if new:
            K = column_space(J[:, new] * scales[new])
            uncertain = uncertain - K @ (K.T @ uncertain)
            noise = noise * (1.0 - np.sum(K**2, axis=1))
        yield noise, uncertain
