"""The irreducible model of partial pose measurements, and its structural ranks.

The robot is `heavy6`. Reference points on its tool are measured, positions only.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cache

import numpy as np
import pinocchio as pin

import calib_pin
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.parameterizations import NOTHING, parameterization
from calib_pin.parameterizations.base import COMPONENTS
from calib_pin.setup import FrameSetup, Payload, PointSetup, Setup, SolverSetup
from calib_pin.validation.result import CalibrationResult

POINTS = {
    "point_1": (0.12, 0.0, -0.05),
    "point_2": (-0.06, 0.10, -0.05),
    "point_3": (-0.06, -0.10, 0.02),
}
"""Reference points in the tool frame [m]."""

HEAVY = "heavy"
"""Name of the payload."""

LOADS = {NOTHING: "without load", HEAVY: "with payload"}
"""Titles of the loads, by their names in the measurements."""

NOMINAL_TOOL = FrameSetup(xyz=(0.0, 0.0, 0.25), estimate=True)
"""Nominal placement of the tool frame in the flange."""


@cache
def robot() -> Chain:
    """The nominal robot."""
    return calib_pin.load_chain("heavy6")


def irreducible(chain: Chain) -> tuple[str, ...]:
    """The irreducible model of case D: names of the placement errors that it keeps.

    After each joint two translations and two rotations across its axis are kept, the
    errors of the next joint's placement without those along and about its axis. Where
    the next axis is perpendicular, one of these rotations is the offset of the next
    joint. Where it is parallel, that offset is a rotation about the axis together with
    the translation across the common normal: it is kept in place of this translation.
    Errors before the first joint belong to the base. Errors after the last joint belong
    to the tool, and so do those along and about its axis.

    Args:
        chain: A chain of revolute joints with axes parallel or perpendicular to
            their neighbors; the last two are not parallel.
    """
    kept: list[str] = []
    for k in range(1, len(chain.joints)):
        link: pin.SE3 = chain.placements[k]
        before, own = link.rotation.T @ chain.axes[k - 1], chain.axes[k]
        dropped = {_along(before)}
        if abs(before @ own) < 0.5:
            dropped.add("r" + _along(before))
        else:
            dropped.add(_along(np.cross(own, link.rotation.T @ link.translation)))
        if k == len(chain.joints) - 1:
            dropped |= {_along(own), "r" + _along(own)}
        kept += [
            f"{chain.joints[k]}.placement.{component}"
            for component in COMPONENTS
            if component not in dropped
        ]
    return tuple(kept)


def _along(direction: Floats) -> str:
    """The coordinate axis that is closest to a direction, shape (3,)."""
    return COMPONENTS[int(np.argmax(np.abs(direction)))]


def others(chain: Chain) -> tuple[str, ...]:
    """Placement errors that the irreducible model leaves out."""
    kept = irreducible(chain)
    screws = parameterization("placement").screws(chain)
    names = (screw.parameter.name for screw in screws)
    return tuple(name for name in names if name not in kept)


def setup_of(
    parameters: Sequence[str] = ("placement",),
    *,
    points: int = len(POINTS),
    known: bool = False,
    full: bool = False,
    load: Payload | None = None,
    solver: str = "gauss-newton",
) -> Setup:
    """The setup of a calibration; the placement of the tracker is always estimated.

    Args:
        parameters: Errors of the robot.
        points: Number of reference points.
        known: Whether they are known in a tool frame that is estimated; otherwise each
            of them is estimated in the flange.
        full: Whether all placement errors are free, not the irreducible ones alone.
        load: The payload.
        solver: Name of the solver.
    """
    names = list(POINTS)[:points]
    return Setup(
        parameters=tuple(parameters),
        base_frame=FrameSetup(estimate=True),
        tool_frame=NOMINAL_TOOL if known else FrameSetup(estimate=False),
        targets={
            name: PointSetup(POINTS[name] if known else None, not known)
            for name in names
        },
        payloads={} if load is None else {HEAVY: load},
        fixed=() if full or "placement" not in parameters else others(robot()),
        solver=SolverSetup(solver),
    )


def calibrated(rows: Measurements, setup: Setup) -> CalibrationResult:
    """A calibration, without validation."""
    return calib_pin.calibrate(robot(), rows, setup, validate=False)


@dataclass(frozen=True)
class Rank:
    """Structural ranks of the geometry with a number of reference points.

    Attributes:
        parameters: Free parameters with all placement errors.
        rank: Their structural rank.
        kept: Free parameters of the irreducible model.
        kept_rank: Their structural rank.
    """

    parameters: int
    rank: int
    kept: int
    kept_rank: int


def ranks() -> dict[tuple[int, bool], Rank]:
    """Ranks by the number of points and by whether they are known in the tool frame."""
    result = {}
    for points in range(1, len(POINTS) + 1):
        for known in (False, True):
            full, kept = (
                calib_pin.identify(robot(), "position", setup).identifiability
                for setup in (
                    _placed(setup_of(points=points, known=known, full=full))
                    for full in (True, False)
                )
            )
            result[points, known] = Rank(
                full.parameters,
                full.structural_rank,
                kept.parameters,
                kept.structural_rank,
            )
    return result


def _placed(setup: Setup) -> Setup:
    """The setup with initial points, which measurements would give otherwise."""
    targets = {
        name: replace(point, xyz=POINTS[name]) for name, point in setup.targets.items()
    }
    return replace(setup, targets=targets)
