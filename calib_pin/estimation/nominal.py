"""The nominal robot: its frames fitted, its structure, and whether its scale is known.

A robot whose lengths are all longer by one factor moves like the nominal one, only
larger. What it leaves at angles or in the sockets of a ball is the same.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.configurations import observable_configurations
from calib_pin.estimation.directions import nuisance_basis
from calib_pin.estimation.identifiability import Structure, structure
from calib_pin.estimation.problem import (
    Problem,
    representative,
    sigma_at,
    station_kinds,
)
from calib_pin.estimation.registration import registered
from calib_pin.estimation.solve import Solution, least_squares
from calib_pin.estimation.terms import ToolPoses
from calib_pin.kinematics.spatial import Floats, adjoint, invert
from calib_pin.observations import BlockKey, Measurements
from calib_pin.parameterizations.linearization import PoseLinearization

EXPLAINED = 1e-6
"""Part of a change of scale that rounding leaves where parameters express it."""

LEAST = 50
"""Least number of configurations that show a structure."""

FEWEST = 12
"""Least number of these of each block, twice what two frames need."""

MOST = 5000
"""Most parameters that are analyzed, in gigabytes and minutes already."""

UNKNOWN = 0.01
"""Standard deviation of the scale from which it counts as unobservable.

The tip of an arm of a meter is then off by a centimeter.
"""


@serial_blas
def register(problem: Problem, theta: Floats) -> tuple[Problem, Solution]:
    """Fit only base, tool and instrument; the robot keeps its values.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,); those of the robot count.

    Returns:
        The problem about its registered references and the least-squares result.
    """
    parameters = problem.parameters
    problem = registered(problem, theta)
    start = np.where(parameters.nuisance, 0.0, theta)
    return problem, least_squares(problem, start, nuisance_basis(parameters))


@serial_blas
def analyze_structure(
    problem: Problem, theta: Floats, rng: np.random.Generator
) -> tuple[Structure, Floats]:
    """Structure at zero robot errors over random configurations.

    Args:
        problem: The problem about its registered references.
        theta: Parameter values with the robot at nominal, shape (P,).
        rng: Random generator.

    Returns:
        The structure of the data alone, and the whitened Jacobian with the rows of the
        priors, shape (M, P).

    Raises:
        OptionError: If there are too many parameters, or planes that are not parallel
            have a known distance.
    """
    theta = problem.further.distances.with_parallels(theta)
    keys = representative(problem)
    blocks, at = len(keys), []
    parameters = len(problem.parameters) - len(_omitted(problem, keys))
    if parameters > MOST:
        raise OptionError(
            "the chain and its references have too many parameters",
            file=problem.setup.file or None,
            value=parameters,
            allowed=f"at most {MOST}; a shorter chain (--base, --tip)",
        )
    for key in keys:
        # Each quantity alone may have to show its structure.
        quantities = problem.terms[key].measurement.quantities
        least = min(q.columns.stop - q.columns.start for q in quantities)
        enough = -(-3 * parameters // (blocks * least))
        count = max(-(-LEAST // blocks), FEWEST, enough)
        at.append(observable_configurations(problem, key, theta, count, rng))
    return structure_at(problem, theta, at)


@serial_blas
def structure_at(
    problem: Problem, theta: Floats, at: Sequence[Measurements]
) -> tuple[Structure, Floats]:
    """Structure at zero robot errors of given configurations.

    Args:
        problem: The problem about its registered references.
        theta: Parameter values with the robot at nominal, shape (P,).
        at: Configurations of blocks.

    Returns:
        The structure, and the whitened Jacobian with the rows of the priors, (M, P).

    Raises:
        InputError: If the measured values have no derivative.
    """
    J = jacobian_at(problem, theta, at)
    count = sum(len(some.q) for some in at)
    alike = _omitted(problem, [some.key for some in at])
    shown = problem.parameters.without(alike)
    if not np.isfinite(J).all():
        raise InputError(
            "the measured values have no derivative, as a distance of zero has none; "
            "check the base and tip links"
        )
    found = structure(J[: len(J) - len(problem.further.priors)], shown, count)
    scaled = scale_deviation(problem, theta, at, J) < UNKNOWN
    return replace(found, scaled=scaled, alike=alike), J


def jacobian_at(problem: Problem, theta: Floats, at: Sequence[Measurements]) -> Floats:
    """Whitened Jacobian of noise-free measurements and of all further rows, (M, P).

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).
        at: Configurations of blocks.
    """
    rows = []
    for some in at:
        sigma = sigma_at(problem, some.key, len(some.q))
        rows.append(problem.jacobian(theta, some, sigma).reshape(-1, len(theta)))
    return np.concatenate([*rows, problem.further.jacobian(theta)])


def scale_deviation(
    problem: Problem, theta: Floats, at: Sequence[Measurements], J: Floats
) -> float:
    """Standard deviation of the logarithm of a robot's size.

    Of all changes of the parameters that move every tool as if every length grew by one
    factor, up to fixed displacements of bases and tools, the one is taken that the
    residual rows (with known distances and priors) notice least. A robot whose lengths
    are not all estimated cannot grow; its scale is known.

    Args:
        problem: The problem.
        theta: Parameter values with the robot at nominal, shape (P,).
        at: Configurations that its instruments can measure.
        J: The whitened Jacobian there, with all further rows, shape (M, P).

    Returns:
        The deviation; zero where the robot cannot grow, infinite where no row changes.
    """
    free = problem.parameters.free.copy()
    free[list(_omitted(problem, [some.key for some in at]))] = False
    scales = problem.parameters.scales
    twists, grown = [], []
    named = [problem.terms[some.key].frames for some in at]
    ends = dict.fromkeys([*(s.station for s in named), *(s.tool for s in named)])
    first_of = {name: 6 * k for k, name in enumerate(ends)}
    frames = 6 * len(ends)
    for some in at:
        term = problem.terms[some.key]
        of_robot = term.values(theta)[0]
        poses = ToolPoses(term.error, term.of_chain(some)).linearize(of_robot).poses
        count = len(poses.T)
        by_error = poses.derivative(np.tile(np.eye(6), (count, 1, 1)))
        by_own = np.zeros((6 * count, len(term.index)))
        by_own[:, : len(of_robot)] = by_error.reshape(6 * count, -1)
        displaced = np.zeros((6 * count, frames))
        first, last = first_of[term.frames.station], first_of[term.frames.tool]
        displaced[:, first : first + 6] = adjoint(invert(poses.to_base)).reshape(-1, 6)
        on_tool = term.frames.offset.toActionMatrixInverse()
        displaced[:, last : last + 6] = np.tile(on_tool, (count, 1))
        by_all = problem.spread(term, by_own) * scales
        twists.append(np.column_stack([by_all[:, free], displaced]))
        grown.append(_grown(poses, poses.to_base).reshape(-1))
    moved, b = np.concatenate(twists), np.concatenate(grown)
    rows = np.column_stack([(J * scales)[:, free], np.zeros((len(J), frames))])
    _, s, Vt = np.linalg.svd(np.linalg.qr(moved, mode="r"))
    rank = int((s > 1e-11 * s[0]).sum())
    # Minimum-norm growth, and all that changes without moving the tool.
    z = Vt[:rank].T @ ((Vt[:rank] @ (moved.T @ b)) / s[:rank] ** 2)
    if np.linalg.norm(moved @ z - b) > EXPLAINED * np.linalg.norm(b):
        return 0.0
    still = rows @ Vt[rank:].T
    noticed = rows @ z
    noticed = noticed - still @ np.linalg.lstsq(still, noticed, rcond=1e-11)[0]
    size = float(np.linalg.norm(noticed))
    # What rounding leaves of large terms is nothing noticed.
    least = EXPLAINED * float(np.linalg.norm(rows * z))
    return 1.0 / size if size > least else np.inf


def _omitted(problem: Problem, keys: Sequence[BlockKey]) -> dict[int, int]:
    """Parameters of stations that none of some blocks is measured from.

    With each the same parameter of a station of its kind that is.
    """
    used = {problem.terms[key].frames.station for key in keys}
    own = problem.own_of_stations
    found: dict[int, int] = {}
    for alike in station_kinds(problem).values() if own else ():
        shown = [station for station in alike if station in used]
        for station in alike:
            if station not in used:
                pairs = zip(own[station], own[shown[-1]], strict=True)
                found |= {int(omitted): int(other) for omitted, other in pairs}
    return found


def growth(problem: Problem, theta: Floats) -> Floats:
    """Derivative of the whitened residuals by the logarithm of the robot's size.

    All lengths from the bases to the tips grow by one factor; bases and tools stay.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).

    Returns:
        The derivative, component by component as in `Problem.sigma`, shape (M,).
    """
    changes = []
    for term, data, _, _ in problem.blocks:
        of_robot, instrument = term.values(theta)
        tool = ToolPoses(term.error, data).linearize(of_robot)
        T, poses, start = tool.T, tool.poses, tool.start
        grown = _grown(poses, poses.to_base @ invert(poses.to_tip))
        if start is not None:
            # The twist of T_0^-1 T is that of T without that of T_0, transformed there.
            begins = _grown(start, start.to_base @ invert(start.to_tip))
            grown -= (adjoint(invert(T)) @ begins[:, :, None])[:, :, 0]
        J_pose = term.measurement.linearize(T, instrument, data).J_pose
        changes.append((J_pose @ grown[:, :, None]).reshape(-1))
    return np.asarray(np.concatenate(changes) / problem.sigma)


def _grown(poses: PoseLinearization, to_point: Floats) -> Floats:
    """Body twists of the tool as a point on it, (N, 4, 4), leaves the base, (N, 6)."""
    twists = np.zeros((len(to_point), 6))
    R, p = poses.to_base[:, :3, :3], to_point[:, :3, 3]
    twists[:, :3] = np.einsum("nji,nj->ni", R, p)
    return twists
