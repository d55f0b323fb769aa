"""Displacements of instrument and tool between two calibrations of one robot.

Of the change of the tool poses in the measurement frame, `T_A(q)` to `T_B(q)`, one
motion of the instrument and one of the tool explain as much as they can; the rest is of
the robot. Parameters do not enter, so that it does not matter which of them hold what a
frame can absorb: with another base, another first joint is the same robot.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass, field

import numpy as np
import pinocchio as pin

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.evidence import PoseErrors
from calib_pin.estimation.statistics.distributions import chi_square_tail
from calib_pin.estimation.system import FRAME, Part
from calib_pin.estimation.tip_accuracy import LEVER
from calib_pin.kinematics.spatial import Floats, invert
from calib_pin.observations import BlockKey
from calib_pin.validation.counterparts import SAME, partners
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.tip_drift import absorbing

SAMPLES = 300
"""Configurations of the workspace."""

SEEN = 1e-6
"""Part of the largest deviation below which nothing is known of a direction."""


UNKNOWN = PoseErrors(math.nan, math.nan)
"""Sizes that nobody knows."""


@dataclass(frozen=True)
class Displacement:
    """How far a frame stands from where it stood.

    Attributes:
        frame: `base`, seen from the measurement frame, or `tool`, seen from the tip; of
            several the name of the station or the tool.
        shift: Distance between both origins [m].
        turn: Angle between both orientations [rad]; None where rows do not tell.
        of_tool: Whether it is that of a tool.
        sigma: Standard deviation of a component of the shift [m] and of the turn [rad],
            by the noise of both calibrations and by a drift of the robot that looks
            like it; NaN where it is not known.
        chance: Probability that these alone displace it as far; NaN where that is not
            known.
        motion: How far that moves the tool points, root mean square over the workspace
            [m].
    """

    frame: str
    shift: float = field(metadata={"key": "position"})
    turn: float | None = field(metadata={"key": "orientation"})
    of_tool: bool = False
    sigma: PoseErrors = UNKNOWN
    chance: float = math.nan
    motion: float = field(default=math.nan, metadata={"key": "tool_point"})


@serial_blas
def displacements(
    first: CalibrationResult,
    second: CalibrationResult,
    told: bool,
    seed: int = 0,
    blurred: float = 1.0,
) -> tuple[Displacement, ...]:
    """How far the frames that two calibrations have stand from where they stood.

    Args:
        first: One calibration.
        second: The other, of the same joints.
        told: Whether the measurements of both tell how the tool is turned.
        seed: Seed of the configurations.
        blurred: Drift of the robot by what noise explains, at least 1: so many times as
            much of it may look like a displacement.
    """
    found: dict[tuple[bool, str], Displacement] = {}
    chains = partners(first.model, second.model)
    for mine, part in first.model.parts.items():
        for theirs, other in second.model.parts.items():
            if chains.get(mine.chain, mine.chain) != theirs.chain:
                continue
            alike = (
                part.scope.station == other.scope.station,
                part.scope.tool == other.scope.tool,
            )
            places = [(k == 1, _name(part, k)) for k in (0, 1) if alike[k]]
            if places and part.error.chain.joints and not set(places) <= set(found):
                pair = _moved((first, mine), (second, theirs), told, seed, blurred)
                for moved in pair:
                    place = moved.of_tool, moved.frame
                    if place in places:
                        found.setdefault(place, moved)
    return tuple(
        moved
        for moved in sorted(found.values(), key=lambda d: (d.of_tool, d.frame))
        if max(moved.shift, moved.turn or 0.0) > SAME
    )


def _moved(
    first: tuple[CalibrationResult, BlockKey],
    second: tuple[CalibrationResult, BlockKey],
    told: bool,
    seed: int,
    blurred: float,
) -> Iterator[Displacement]:
    """The displacements of both frames of a part of each calibration."""
    (mine, key), (theirs, other) = first, second
    part, partner = mine.model.parts[key], theirs.model.parts[other]
    pairs = zip(_free(mine, part), _free(theirs, partner), strict=True)
    base, tool = (any(pair) for pair in pairs)
    rng = np.random.default_rng(seed)
    q = part.error.chain.random_configurations(SAMPLES, rng)
    A, B = mine.model.of(key).poses(q), theirs.model.of(other).poses(q)
    _, L, R = absorbing(A, B, left=base, right=tool)
    here, there = mine.model.of(key), theirs.model.of(other)
    stood, ends = here.error.base.homogeneous, (here.tool, there.tool)
    motions = (
        invert(stood) @ invert(L) @ stood
        if base
        else (here.error.base.inverse() * there.error.base).homogeneous,
        invert(R) if tool else (ends[0].inverse() * ends[1]).homogeneous,
    )
    moved = stood @ motions[0] @ invert(stood) @ A, A @ motions[1]
    C = np.full((12, 12), np.nan)
    if base or tool:
        C = _covariance(mine, key, q) + _covariance(theirs, other, q)
        C *= blurred**2
    for k, (motion, tools) in enumerate(zip(motions, moved, strict=True)):
        twist = pin.log6(pin.SE3(motion)).vector
        known = slice(0, 6 if told or k == 0 else 3)
        own = C[FRAME * k : FRAME * k + FRAME, FRAME * k : FRAME * k + FRAME]
        steps = np.linalg.norm((tools - A)[:, :3, 3], axis=1)
        yield Displacement(
            frame=_name(part, k),
            shift=float(np.linalg.norm(motion[:3, 3])),
            turn=float(np.linalg.norm(twist[3:])) if told or k == 0 else None,
            of_tool=k == 1,
            sigma=PoseErrors(_mean(own[:3, :3]), _mean(own[3:, 3:])),
            chance=_chance(twist[known], own[known, known]),
            motion=float(np.sqrt(np.mean(steps**2))),
        )


def _name(part: Part, k: int) -> str:
    """The name of the base frame of a part, or of its tool frame."""
    scope = part.scope.tool if k else part.scope.station
    return scope.rpartition(".")[0] or ("base", "tool")[k]


def _free(result: CalibrationResult, part: Part) -> tuple[bool, bool]:
    """Whether the base frame, and the tool frame, of a part were estimated."""
    fixed = {p.name for p in result.parameters if p.status == "fixed"}
    count = len(part.error.screws)
    ends = part.parameters[:FRAME], part.parameters[count - FRAME : count]
    base, tool = (any(p.name not in fixed for p in end) for end in ends)
    return base, tool


def _covariance(result: CalibrationResult, key: BlockKey, q: Floats) -> Floats:
    """Covariance of the motions of base and tool that noise looks like, (12, 12).

    NaN where the calibration does not know its own.
    """
    part = result.reference.parts[key]
    own, C = part.of_error, np.asarray(result.covariance)
    if not np.isfinite(C).all():
        return np.full((12, 12), np.nan)
    values = np.array([p.value for p in result.parameters])
    _, J = part.error.jacobian(q, values[own])
    squares, V = np.linalg.eigh(C[np.ix_(own, own)])
    half = V * np.sqrt(np.maximum(squares, 0.0))
    lever = np.repeat([1.0, LEVER], 3)[:, None]
    frames = (J[:, :, np.r_[0:6, -6:0]] * lever).reshape(-1, 12)
    noise = (J @ half * lever).reshape(-1, len(own))
    motions = np.linalg.pinv(frames.T @ frames, rcond=1e-13, hermitian=True) @ (
        frames.T @ noise
    )
    return np.asarray(motions @ motions.T)


def _mean(C: Floats) -> float:
    """Standard deviation of a component, root mean square over all."""
    return float(np.sqrt(np.trace(C) / len(C)))


def _chance(twist: Floats, C: Floats) -> float:
    """Probability that noise of a covariance alone brings as large a twist."""
    if not np.isfinite(C).all():
        return float("nan")
    squares, V = np.linalg.eigh(C)
    seen = squares > SEEN**2 * squares.max(initial=0.0)
    if not seen.any():
        return float(not twist.any())
    square = float(np.sum((V[:, seen].T @ twist) ** 2 / squares[seen]))
    return chi_square_tail(square, int(seen.sum()))
