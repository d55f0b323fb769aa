"""Validation of a fitted model on held-out measurements, with its significance.

Only measurements that the fit has not used count: those that repeat a fitted
configuration are left out, an instrument that was moved or stands at a new station is
registered anew, and rejected measurements count for neither the nominal nor the
calibrated robot. If too few are left there is no check.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.estimation.evidence import Finding, Gain
from calib_pin.estimation.fit import FittedModel, fit_model
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.problem import Problem, distinct_values
from calib_pin.estimation.registration import extended, relocated
from calib_pin.estimation.scopes import BASE
from calib_pin.estimation.solve import least_squares
from calib_pin.estimation.system import FRAME
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations, grouped
from calib_pin.progress import Stages, named, portion
from calib_pin.setup import Setup
from calib_pin.validation.gains import PRESS, gains, press_check
from calib_pin.validation.model_errors import (
    ModelErrors,
    Registered,
    errors_of_registered,
    model_errors,
    registered,
)
from calib_pin.validation.splits import Grouping, folds


@dataclass(frozen=True)
class HeldOut:
    """The check of a fitted model on held-out measurements.

    Attributes:
        measurements: The measurements that the positions of the parts belong to.
        parts: Errors of held-out measurements; empty without a check.
        method: `set`, `file`, `holdout`, `5-fold`, ..., or `none`.
        gains: Paired tests on the parts, then those by the hat matrix (PRESS).
        findings: Defects of the held-out measurements.
        skipped: Reason for each skipped fold of a cross-validation.
    """

    measurements: Observations
    parts: tuple[ModelErrors, ...] = ()
    method: str = "none"
    gains: tuple[Gain, ...] = ()
    findings: tuple[Finding, ...] = ()
    skipped: tuple[str, ...] = ()

    @property
    def counted(self) -> tuple[ModelErrors, ...]:
        """The parts without rejected measurements (weight zero)."""
        return tuple(part.counted(self.measurements.weight) for part in self.parts)


def check(
    chains: Chain | Chains,
    training: Observations,
    setup: Setup,
    model: FittedModel,
    seed: int,
    *,
    validation: Observations | None = None,
    method: str = "set",
    validate: bool = True,
    parts: Sequence[ModelErrors] | None = None,
    progress: Stages | None = None,
) -> HeldOut:
    """Check a model on validation measurements, or by cross-validation without any.

    Args:
        chains: The nominal chains.
        training: The measurements that were fitted.
        setup: Setup of the fit.
        model: The model that was fitted to all of them.
        seed: Seed of the split and of further fits.
        validation: Validation measurements; None for a cross-validation.
        method: How the validation measurements were chosen; see `HeldOut.method`.
        validate: Whether to validate; if not, only the hat matrix is used.
        parts: Errors of a cross-validation with the same folds; None to run it.
        progress: Told the stage and the fraction done.
    """
    fitted = model.fit
    training = model.weighted(training)
    grouping = Grouping.of(training, setup)
    problem = replace(fitted.problem, data=training)
    pressed: tuple[Gain, ...] = ()
    if fitted.dof > 0:  # Without redundancy the hat matrix says nothing.
        press = press_check(fitted, grouping.groups)
        pressed = gains(PRESS, problem, [press], grouping.clusters)
    if not validate:
        return HeldOut(training, gains=pressed)
    if validation is not None:
        found = _checked_on(model, training, validation, method)
        return replace(found, gains=found.gains + pressed)
    masks = folds(grouping, fitted, seed)
    if parts is None:
        parts = tuple(
            cross_validate(chains, training, setup, masks, seed, fitted, progress)
        )
    # A fit that fails without its fold says nothing about the robot.
    kept = tuple(part for part in parts if not part.reason)
    if not _enough(training, kept):
        kept = ()
    name = grouping.validation_name(min(len(kept), len(masks)))
    return HeldOut(
        training,
        kept,
        name,
        gains(name, problem, kept, grouping.clusters) + pressed,
        skipped=tuple(part.reason for part in parts if part.reason),
    )


def cross_validate(
    chains: Chain | Chains,
    measurements: Observations,
    setup: Setup,
    masks: Sequence[NDArray[np.bool_]],
    seed: int,
    whole: Fit,
    progress: Stages | None = None,
) -> Iterator[ModelErrors]:
    """Errors of each part of the measurements by a model fitted to the others.

    Args:
        chains: The nominal chains.
        measurements: The N measurements.
        setup: As for `fit_model`.
        masks: The parts, each of shape (N,).
        seed: As for `fit_model`.
        whole: The fit of all measurements.
        progress: Told the stage and the fraction done of all parts.
    """
    for k, mask in enumerate(masks):
        stage = f"check {k + 1} of {len(masks)}"
        tell = portion(named(progress, stage), k / len(masks), 1.0 / len(masks))
        # Measurements that the fit of all has rejected stay rejected.
        kept = ~mask & (measurements.weight > 0.0)
        some = measurements.rows(kept)
        model = fit_model(chains, some, setup, seed, tell, part_of=(whole, kept))
        reason = ""
        if not model.fit.structure.scaled:
            reason = "the absolute scale is unobservable"
        elif not model.fit.result.status.success:
            reason = "it did not converge"
        shown = whole.problem.layout.quantities
        try:
            if model.problem.layout.quantities != shown:
                raise InputError("all others of an instrument are set aside")
            found = model_errors(model, measurements.rows(mask), np.flatnonzero(mask))
        except InputError as error:
            # All other measurements of a reference may be rejected.
            none = np.zeros((0, whole.problem.layout.width))
            positions = np.zeros(0, np.intp)
            yield ModelErrors(positions, none, none, none, reason=error.reason)
        else:
            yield replace(found, reason=reason)


def _checked_on(
    model: FittedModel, training: Observations, validation: Observations, method: str
) -> HeldOut:
    """The check on validation measurements."""
    findings = []
    new = ~_repeated(training, validation)
    if not new.all():
        some = f"{len(new) - int(new.sum())} of {len(new)}"
        findings.append(
            Finding(
                "repeated-validation",
                "warning",
                f"{some} validation measurements repeat configurations that were "
                "fitted and do not count",
                {"repeated": float(len(new) - new.sum()), "all": float(len(new))},
                "validate with configurations that were not fitted",
            )
        )
    rows = validation.rows(new)
    if rows.configurations < FEWEST:
        return HeldOut(validation, findings=tuple(findings))
    part, moved = registered_if_moved(
        model, model_errors(model, rows, np.flatnonzero(new)), rows
    )
    findings += moved
    if part is None:
        return HeldOut(validation, findings=tuple(findings))
    clusters = Grouping.of(validation, model.problem.setup).clusters
    there, _ = extended(model.problem, model.theta, validation)
    found = gains(method, there, [part], clusters)
    return HeldOut(validation, (part,), method, found, tuple(findings))


def _repeated(training: Observations, validation: Observations) -> NDArray[np.bool_]:
    """Mask of measurements at configurations that were fitted, shape (N,)."""
    fitted = training.q[training.weight > 0.0]
    labels = grouped(np.concatenate([fitted, validation.q]))
    return np.isin(labels[len(fitted) :], labels[: len(fitted)])


def _enough(measurements: Observations, parts: Sequence[ModelErrors]) -> bool:
    """Whether enough distinct configurations are held out to check anything."""
    if not parts:
        return False
    positions = ModelErrors.joined(parts).positions
    held_out = measurements.rows(
        np.sort(positions[measurements.weight[positions] > 0.0])
    )
    return held_out.configurations >= FEWEST


MOVED = 4.0
"""Smallest ratio of RMS errors that shows that the instrument was moved.

The ratio is that of the errors with the station of the fit to those with a station of
their own. UR10 Series B with the station of Series A has 6 500; the second day of
TIAGo, which counts as not moved, 1.14; other measurements from one station 1.0 to 1.1.
"""

ALIKE = 0.5
"""Largest difference of the displacements seen by both robots, relative to them.

Both are the nominal and the calibrated robot. A robot that errs in another corner of
its workspace looks displaced as well, with ratios as in `MOVED` of 2 to 8 between
corners of 0.4 rad, but then the two displacements differ.
"""

FEWEST = 5
"""Fewest distinct configurations for a check."""


def registered_if_moved(
    model: FittedModel, errors: ModelErrors, rows: Observations
) -> tuple[ModelErrors | None, list[Finding]]:
    """Errors of validation measurements, registered anew where an instrument was moved.

    Let S be the sum of squared errors with a station of the fit, S' that with a new
    station, of M values and with k unknowns of the station. The instrument was moved if
    `S / M > MOVED^2 S' / (M - k)` for the calibrated robot and the nominal robot sees
    about the same displacement. The F test of the same hypothesis, `(S - S') / k`
    against `S' / (M - k)`, is then far beyond chance.

    Args:
        model: The fitted model.
        errors: The errors with the stations of the fit.
        rows: The N measurements that they are of.

    Returns:
        The errors, None if the measurements suffice for no more than the registration;
        and a finding for every instrument that was moved.
    """
    fitted = {part.scope.station for part in model.problem.parts.values()}
    there, _ = extended(model.problem, model.theta, rows)
    of_block = [there.parts[key].scope.station for key in rows.keys]
    found, findings, kept = errors, [], np.ones(len(rows), bool)
    for station in dict.fromkeys(filter(fitted.__contains__, of_block)):
        own = np.flatnonzero(np.array(of_block)[rows.block_of] == station)
        moved, finding = _moved(model, errors.at(own), rows.rows(own), station)
        if finding is not None:
            findings.append(finding)
        if moved is None:
            kept[own] = False
        else:
            found = found.replaced(own, moved)
    return found.at(kept) if kept.any() else None, findings


def _moved(
    model: FittedModel, errors: ModelErrors, rows: Observations, station: str
) -> tuple[ModelErrors | None, Finding | None]:
    """The same of the measurements from one station.

    Args:
        model: The fitted model.
        errors: The errors with the station of the fit.
        rows: The measurements that they are of.
        station: Owner and kind of the station's frame.
    """
    before = _registered(model.fit.problem, model.fit.before, rows, station)
    after = _registered(model.problem, model.theta, rows, station)
    if after is None or before is None:
        return errors, None
    problem = after.problem
    own = errors_of_registered(model, before, after, errors.positions)
    values, unknowns = problem.values, len(after.refitted)
    left = max(values - unknowns, 1)
    as_is, on_itself = (_chi_square(part.after, problem) for part in (errors, own))
    moved = as_is * left > MOVED**2 * on_itself * values
    if not moved or not _alike(errors, own, problem):
        return errors, None
    numbers = {
        "chi-square as it is": as_is,
        "chi-square registered": on_itself,
        "values": float(values),
        "unknowns": float(unknowns),
    }
    of = "" if station == BASE else f" of '{station.rpartition('.')[0]}'"
    seen = f"the instrument had another station for the validation measurements{of}"
    rms = [np.sqrt(square / values) for square in (as_is, on_itself)]
    if distinct_values(problem) <= unknowns or rows.configurations < FEWEST:
        return None, Finding(
            "moved-instrument",
            "warning",
            f"{seen}, which are too few for a check from there: "
            f"{distinct_values(problem)} distinct values, {unknowns} unknowns",
            numbers,
            "measure more validation configurations from one station",
        )
    return own, Finding(
        "moved-instrument",
        "warning",
        f"{seen}: with the station of the fit they are off by {rms[0]:.3g} standard "
        f"deviations, with their own by {rms[1]:.3g}; both robots are registered on "
        "them",
        numbers,
    )


def _registered(
    problem: Problem, theta: Floats, rows: Observations, station: str
) -> Registered | None:
    """A fitted problem with a station estimated anew from other measurements.

    The base and the stationary references of the instrument are estimated; tool and
    robot stay. None if nothing of the station is free.
    """
    there = registered(problem, theta, rows)
    moved, values = there.problem.rebased(there.theta)
    parameters = moved.parameters
    outer = np.zeros(len(parameters), bool)
    base = np.zeros(len(parameters), bool)
    for part in moved.parts.values():
        if part.scope.station == station:
            base[part.index[:FRAME]] = True
            # References on the tool stay with the robot.
            outer[part.index] |= [p.outer for p in part.parameters]
    _, J = moved.linearize(values)
    seen = parameters.nuisance & parameters.free & J.any(axis=0)
    free = np.flatnonzero((base | outer) & seen)
    if len(free) == 0:
        return None
    basis = np.diag(parameters.scales)[:, free]
    plain = replace(moved, setup=replace(moved.setup, distances=()))
    starts = [plain]
    if parameters.free[base].all() and not any(b.start.size for b in rows.blocks):
        starts.append(relocated(plain, values, station))
    found = [(least_squares(start, values, basis), start) for start in starts]
    result, start = min(
        found, key=lambda pair: pair[0].cost if np.isfinite(pair[0].cost) else np.inf
    )
    # Known distances count again: they were left out of this fit only.
    start = replace(start, setup=moved.setup)
    return Registered(start, result.x, there.new, tuple(free.tolist()))


def _alike(errors: ModelErrors, own: ModelErrors, problem: Problem) -> bool:
    """Whether both robots see about the same displacement, in the median."""
    unit = problem.layout.table(problem.sigma, len(problem.data))
    with np.errstate(invalid="ignore"):
        nominal, calibrated = (
            np.nan_to_num((a - b) / unit, posinf=0.0, neginf=0.0)
            for a, b in ((errors.before, own.before), (errors.after, own.after))
        )
    moves = np.linalg.norm(calibrated, axis=1)
    apart = np.linalg.norm(nominal - calibrated, axis=1)
    return bool(np.median(apart) < ALIKE * np.median(moves))


def _chi_square(errors: Floats, problem: Problem) -> float:
    """Sum of squared errors in standard deviations, (N, D) a table of them."""
    layout = problem.layout
    present = np.isfinite(problem.sigma)
    whitened = (errors[layout.row, layout.column] / problem.sigma)[present]
    return float(whitened @ whitened)
