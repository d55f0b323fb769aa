"""Ways in which the errors of a robot change: all a little, or a joint at once."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.system import System
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.base import LENGTH_SCALE, expected_size, owner

ROUNDING = 1e-9
"""Part of a joint's motion that its errors lack where they hold its offset."""


@dataclass(frozen=True)
class Change:
    """A sudden change that parameters may show.

    Attributes:
        joint: The joint, station or tool; empty for the whole robot, or the only one.
        kind: `offset` of the joint, `placement` for all of its errors, `robot`, or the
            frame that moves, `base` or `tool`.
        directions: Its independent effects on all parameters divided by their scales,
            shape (P, k), each of the expected size of an error.
        unit: Unit of an offset, rad or m.
        size: Expected size of an offset in that unit.
    """

    joint: str
    kind: str
    directions: Floats
    unit: str = "m"
    size: float = LENGTH_SCALE


def drifts(system: System, robot: NDArray[np.bool_]) -> Mapping[str, Floats]:
    """How errors drift by independent effects, shapes (P, k) in their scales, by name.

    Of a drift of size one [m, rad] errors without such a unit have the same part of
    their expected sizes as a length.

    Args:
        system: The robot.
        robot: The errors of the robot among its parameters, shape (P,).
    """
    sizes = [
        1.0 / (p.scale if p.unit in ("m", "rad") else LENGTH_SCALE)
        for p in system.given
    ]
    offsets = [column for _, column, _ in _offsets(system, robot)]
    alone = np.array(offsets).reshape(-1, len(robot)).T
    return {"geometry": np.diag(sizes)[:, robot], "joint offsets": alone}


def changes(system: System, robot: NDArray[np.bool_]) -> Mapping[str, Change]:
    """The sudden changes that the errors of a robot may show, by name.

    Args:
        system: The robot.
        robot: The errors of the robot among its parameters, shape (P,).
    """
    found = {}
    for joint, column, unit in _offsets(system, robot):
        size = expected_size(unit)
        change = Change(joint, "offset", size * column[:, None], unit, size)
        found[f"offset {joint}"] = change
    every, owners = np.eye(len(robot)), [p.name.rsplit(".", 2)[0] for p in system.given]
    for joint in system.chains.joints:
        index = [
            k for k, name in enumerate(owners) if robot[k] and name == owner(joint)
        ]
        if len(index) > 1:
            of_joint = Change(joint, "placement", every[:, index])
            found[f"placement {joint}"] = of_joint
    found["robot"] = Change("", "robot", every[:, robot])
    return found


def _offsets(system: System, robot: NDArray[np.bool_]) -> list[tuple[str, Floats, str]]:
    """Joints whose offset the errors hold, with the errors by an offset of one.

    In their scales, shape (P,), and with the unit of the offset.
    """
    found: dict[str, tuple[str, Floats, str]] = {}
    for part in system.parts.values():
        chain = part.error.chain
        behind = [*chain.placements, chain.tip_placement]
        for frame, joint in enumerate(chain.joints, 1):
            index, twists = [], []
            # Errors in the next frame, as those of a DH matrix, move with the joint.
            to_frame = {frame: np.eye(6), frame + 1: behind[frame].toActionMatrix()}
            for screw, k in zip(part.error.screws, part.of_error, strict=True):
                own = screw.parameter.name.rsplit(".", 2)[0] == owner(joint)
                if own and screw.frame in to_frame and screw.basis is None and robot[k]:
                    index.append(k)
                    twist = to_frame[screw.frame] @ screw.twist
                    twists.append(twist * screw.parameter.scale)
            if not twists or joint in found:
                continue
            motion, T = chain.motions[frame - 1], np.array(twists).T
            along = np.linalg.lstsq(T, motion, rcond=1e-9)[0]
            if np.abs(T @ along - motion).max() > ROUNDING:
                continue
            column = np.zeros(len(robot))
            np.add.at(column, index, along)
            unit = "rad" if chain.revolute[frame - 1] else "m"
            found[joint] = joint, column, unit
    return list(found.values())
