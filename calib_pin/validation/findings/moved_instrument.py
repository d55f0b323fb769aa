"""Instruments that were moved between the fitted and the validation measurements."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.problem import Problem, distinct_values, measured_count
from calib_pin.estimation.statistics.distributions import chi_square_tail
from calib_pin.estimation.terms import BASE, FRAME
from calib_pin.validation.findings.case import CHANCE, MEASUREMENTS, by_chance
from calib_pin.validation.findings.sentences import finding
from calib_pin.validation.model_errors import (
    ModelErrors,
    Registered,
    errors_of_registered,
    mahalanobis,
    relocated_station,
)
from calib_pin.validation.splits import FEWEST_HELD_OUT

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

SUSPICIOUS = 1.5
"""Ratio from which a smaller move is told, without registering anything anew, and
errors from a station of their own, in standard deviations, up to which nothing but a
move is wrong.

The nominal robot, with errors that are larger than the move, cannot confirm it.
"""

STATION = (
    "give them a station of their own (a column 'station', or --station-per-file), or "
    "check that the instrument stood still"
)


def registered_if_moved(
    fitted: Fit,
    before: Registered,
    after: Registered,
    positions: NDArray[np.intp],
) -> tuple[list[ModelErrors], list[Finding]]:
    """Errors of validation measurements, registered anew where an instrument was moved.

    Let S be the sum of squared errors with a station of the fit, S' that with a new
    station, of M values and with k unknowns of the station. The instrument was moved if
    `S / M > MOVED^2 S' / (M - k)` for the calibrated robot and the nominal robot sees
    about the same displacement. The F test of the same hypothesis, `(S - S') / k`
    against `S' / (M - k)`, is then far beyond chance.

    Args:
        fitted: The fit.
        before: The nominal robot, with the stations of the fit.
        after: The fitted model, with the same measurements.
        positions: Positions of these among all, shape (N,).

    Returns:
        The errors station by station, without those that suffice for no more than the
        registration; and a finding for every instrument that was moved.
    """
    data, parts, findings = after.problem.data, list[ModelErrors](), list[Finding]()
    named = [after.problem.terms[key].frames.station for key in data.keys]
    of_row = np.array(named)[data.block_of]
    for station in dict.fromkeys(named):
        rows = np.flatnonzero(of_row == station)
        nominal, calibrated = (
            replace(robot, problem=replace(robot.problem, data=data.rows(rows)))
            for robot in (before, after)
        )
        part: ModelErrors | None
        part = errors_of_registered(fitted, nominal, calibrated, positions[rows])
        part, moved = _if_moved(fitted, part, nominal, calibrated, station)
        parts += [part] if part is not None else []
        findings += moved
    return parts, findings


def _if_moved(
    fitted: Fit,
    errors: ModelErrors,
    before: Registered,
    after: Registered,
    station: str,
) -> tuple[ModelErrors | None, list[Finding]]:
    """Errors of the measurements from one station, and a finding, if it was moved.

    Args:
        fitted: The fit.
        errors: The errors with the station of the fit.
        before: The nominal robot with these measurements.
        after: The fitted model with these measurements.
        station: Owner and kind of the station's frame.
    """
    here = _at_new_station(after, station)
    if here is None:
        return errors, []
    values, unknowns = measured_count(here.problem), len(here.refitted)
    dof, S, S_new = max(values - unknowns, 1), _chi_square(after), _chi_square(here)
    ratio = np.sqrt(S * dof / max(S_new * values, 1e-300))
    nominal = _at_new_station(before, station) if ratio > SUSPICIOUS else None
    if nominal is None:
        return errors, []
    there = errors_of_registered(fitted, nominal, here, errors.positions)
    off, left = (float(np.sqrt(square / values)) for square in (S, S_new))
    result: ModelErrors | None = there
    end = "has moved, and both robots are registered on them"
    few = here.problem.data.configurations < FEWEST_HELD_OUT
    if ratio <= MOVED or not _same_move(errors, there, here.problem):
        # Where the fit does not know the robot as well, it is that far off.
        sample = replace(after.problem, data=after.problem.data.sample(MEASUREMENTS))
        square = mahalanobis(fitted, Registered(sample, after.theta))
        by_fit = chi_square_tail(square, measured_count(sample))
        chance = max(by_fit, by_chance(S, S_new, unknowns, dof))
        if left > SUSPICIOUS or chance > CHANCE:
            return errors, []
        result, end = errors, "may have moved before them"
    elif few or distinct_values(here.problem) <= unknowns:
        result, end = None, "has moved, and they are too few for a check from there"
    owner = "" if station == BASE else f" from '{station.rpartition('.')[0]}'"
    text = f"the validation measurements{owner} are off by {off:.3g} standard "
    text += f"deviations, from another station by {left:.3g}: the instrument {end}"
    numbers = {"chi-square as it is": S, "chi-square registered": S_new}
    numbers |= {"values": values, "unknowns": unknowns}
    return result, [finding("moved-instrument", text, numbers, STATION)]


def _at_new_station(robot: Registered, station: str) -> Registered | None:
    """A problem with a station estimated anew from its measurements.

    The base and the stationary references of the instrument are estimated; tool and
    robot stay. None if nothing of the station is free.

    Args:
        robot: The problem of measurements from there.
        station: Owner and kind of the station's frame.
    """
    problem, theta = robot.problem.rebased(robot.theta)
    parameters, data = problem.parameters, problem.data
    base, outer = np.zeros((2, len(parameters)), bool)
    for term in (problem.terms[key] for key in data.keys):
        base[term.index[:FRAME]] = True
        # References on the tool stay with the robot.
        outer[term.index] |= [p.outer for p in term.parameters]
    _, J = problem.linearize(theta)
    observable = parameters.nuisance & parameters.free & J.any(axis=0)
    free = np.flatnonzero((base | outer) & observable)
    if len(free) == 0:
        return None
    relative = any(block.start.size for block in data.blocks)
    loose = bool(parameters.free[base].all()) and not relative
    here, theta = relocated_station(problem, theta, station, free, loose)
    return Registered(here, theta, robot.new, tuple(free.tolist()))


def _same_move(errors: ModelErrors, anew: ModelErrors, problem: Problem) -> bool:
    """Whether both robots see about the same displacement, in the median."""
    unit = problem.layout.table(problem.sigma, len(problem.data))
    pairs = (errors.before, anew.before), (errors.after, anew.after)
    with np.errstate(invalid="ignore"):
        moves = [
            np.nan_to_num((a - b) / unit, posinf=0.0, neginf=0.0) for a, b in pairs
        ]
    sizes = np.linalg.norm([moves[0] - moves[1], moves[1]], axis=2)
    apart, moved = np.median(sizes, axis=1)
    return bool(apart < ALIKE * moved)


def _chi_square(robot: Registered) -> float:
    """Sum of squared errors in standard deviations; infinite where one is lost."""
    r = robot.problem.residual(robot.theta)[: len(robot.problem.sigma)]
    return float(np.nan_to_num(r @ r, nan=np.inf, posinf=np.inf))
