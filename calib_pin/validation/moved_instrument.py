"""Was the instrument moved between the measurements that were fitted and others?

Then both robots seem to err by as much as it moved, the calibrated one and the nominal
one alike, and nothing is checked. Registered on the other measurements they compare.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.fit import FittedModel
from calib_pin.estimation.problem import SAMPLE, Problem, distinct_values
from calib_pin.estimation.solve import least_squares
from calib_pin.kinematics.spatial import Floats
from calib_pin.validation.model_errors import (
    ModelErrors,
    Registered,
    errors_of_registered,
    registered,
)

MOVED = 4.0
"""Errors with the stand of the fit, by those with a stand of their own, of an
instrument that was moved. UR10 Series B by the stand of Series A has 6 500; the second
day of TIAGo, which counts as it is, 1.14, other rows of one stand 1.0 to 1.1."""

ALIKE = 0.5
"""Largest difference of the moves that nominal and calibrated robot see, by the move.

A robot that errs in another corner of its workspace looks displaced as well, with
ratios of 2 to 8 between corners of 0.4 rad, but each robot in its own way.
"""

FEWEST = 5
"""Distinct configurations without which a registration on itself checks nothing."""


def registered_if_moved(
    model: FittedModel, errors: ModelErrors, problem: Problem
) -> tuple[ModelErrors | None, Finding | None]:
    """Errors of validation measurements, registered on themselves if it was moved.

    With S the sum of squared errors as it is and S' registered, of M values and k
    unknowns of the station, it has moved if `S / M > MOVED^2 S' / (M - k)` for the
    calibrated robot and the nominal one sees about the same move. The F test of the
    same hypothesis, `(S - S') / k` against `S' / (M - k)`, then is far beyond chance.

    Args:
        model: The fitted model.
        errors: The errors as they are.
        problem: Problem of these measurements, for their standard deviations.

    Returns:
        The errors, None where the measurements say no more than where the instrument
        stood; and a finding, None where it stood where it did for the fit.
    """
    rows = problem.data
    before = _registered(model.fit.problem, model.fit.before, problem)
    after = _registered(model.problem, model.theta, problem)
    if after is None or before is None:
        return errors, None
    own = errors_of_registered(model, before, after, errors.positions)
    values, unknowns = problem.values, len(after.refitted)
    left = max(values - unknowns, 1)
    as_is, on_itself = (_square(part.after, problem) for part in (errors, own))
    if not as_is * left > MOVED**2 * on_itself * values or not _alike(
        errors, own, problem
    ):
        return errors, None
    numbers = {
        "chi-square as it is": as_is,
        "chi-square registered": on_itself,
        "values": float(values),
        "unknowns": float(unknowns),
    }
    seen = "the instrument had another station for the validation measurements"
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


def _registered(problem: Problem, theta: Floats, of: Problem) -> Registered | None:
    """A fitted problem with a station by other measurements; None where it is known.

    The base and the instrument's references beside it are estimated; tool and robot
    stay.

    Args:
        problem: The fitted problem.
        theta: Parameter values, shape (P,).
        of: Problem of the other measurements.
    """
    there = registered(problem, theta, of.data)
    moved, values = there.problem.rebased(there.theta)
    parameters = moved.parameters
    outer = np.array([p.outer for p in parameters], bool)
    # The base comes first; what stands on the tool stays with the robot.
    outer[:6] |= parameters.nuisance[:6]
    _, J = moved.linearize(values)
    free = np.flatnonzero(outer & parameters.nuisance & parameters.free & J.any(axis=0))
    if len(free) == 0:
        return None
    basis = np.diag(parameters.scales)[:, free]
    plain = replace(moved, setup=replace(moved.setup, distances=()))
    starts = [plain]
    if parameters.free[:6].all() and not moved.data.start.size:
        starts.append(_from_afar(plain, values))
    found = [(least_squares(start, values, basis), start) for start in starts]
    result, start = min(found, key=lambda pair: _finite(pair[0].cost))
    # Known distances count again; they are found, not fitted.
    start = replace(start, setup=moved.setup)
    return Registered(start, result.x, there.new, tuple(free.tolist()))


def _from_afar(problem: Problem, theta: Floats) -> Problem:
    """The problem about a closed-form base, the tool where it is."""
    few = problem.data.sample(SAMPLE)
    F = problem.error.tip_poses(few.q, problem.split(theta)[0], few.payload)
    tool = problem.error.tool
    measurement, base, tool = problem.measurement.register(F, few, None, tool)
    return replace(
        problem,
        error=problem.error.with_frames(base, tool),
        measurement=measurement,
    )


def _alike(errors: ModelErrors, own: ModelErrors, problem: Problem) -> bool:
    """Whether both robots see about the same move, in the median measurement."""
    unit = np.where(np.isfinite(problem.sigma), problem.sigma, np.inf)
    with np.errstate(invalid="ignore"):
        nominal, calibrated = (
            np.nan_to_num((a - b) / unit, posinf=0.0, neginf=0.0)
            for a, b in ((errors.before, own.before), (errors.after, own.after))
        )
    moves = np.linalg.norm(calibrated, axis=1)
    apart = np.linalg.norm(nominal - calibrated, axis=1)
    return bool(np.median(apart) < ALIKE * np.median(moves))


def _square(errors: Floats, problem: Problem) -> float:
    """Sum of squared errors in standard deviations."""
    present = np.isfinite(problem.sigma)
    whitened = errors[present] / problem.sigma[present]
    return float(whitened @ whitened)


def _finite(cost: float) -> float:
    return cost if np.isfinite(cost) else np.inf
