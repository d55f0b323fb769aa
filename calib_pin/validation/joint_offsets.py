"""Offsets of the joints, as the columns of a measurement file and encoders count."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib_pin.errors import OptionError, nearest
from calib_pin.parameterizations.base import owner
from calib_pin.parameters import matching
from calib_pin.setup import JointMap, Setup
from calib_pin.validation.result import CalibrationResult


@dataclass(frozen=True)
class FoundOffset:
    """How far a joint stands from what its column says.

    Attributes:
        joint: URDF joint.
        column: Its file column.
        unit: Unit of the offset, rad or m.
        value: Where the joint stands minus what the column says.
        sigma: Standard deviation; None where the offset is not known.
        steps: Steps of its encoder per unit; None where they are not stated.
        status: That of the parameter.
        within: Frames or instruments that the offset cannot be told from.
    """

    joint: str
    column: str
    unit: str
    value: float
    sigma: float | None
    steps: float | None
    status: str
    within: tuple[str, ...]


def joint_columns(
    setup: Setup, joints: Sequence[str]
) -> dict[str, tuple[str, JointMap]]:
    """The measured column of each joint, and how it becomes its position."""
    by_joint = {given.joint: (name, given) for name, given in setup.joints.items()}
    return {joint: by_joint.get(joint, (joint, JointMap(joint))) for joint in joints}


def encoder_steps(setup: Setup, joints: Sequence[str]) -> Mapping[str, float]:
    """Steps per turn by joint, of those that have any.

    Raises:
        OptionError: If a name or glob of the setup is no joint.
    """
    found: dict[str, float] = {}
    for pattern, steps in setup.encoder_steps.items():
        positions = matching(pattern, joints)
        if not positions:
            raise OptionError(
                f"there is no joint '{pattern}'{nearest(pattern, joints)}",
                file=setup.file or None,
                column="encoder_steps",
                allowed=", ".join(joints),
            )
        found |= {joints[k]: steps for k in positions}
    return found


def joint_offsets(result: CalibrationResult) -> tuple[FoundOffset, ...]:
    """The offsets of all joints that have one as a parameter."""
    model = result.model
    joints = model.chains.joints
    columns, steps = (
        joint_columns(model.setup, joints),
        encoder_steps(model.setup, joints),
    )
    estimates = {p.name: p for p in result.parameters}
    absorbed = {e.of[0]: e.within for e in result.robot_errors if e.within}
    found = []
    for joint in joints:
        estimate = estimates.get(f"{owner(joint)}.joint-offset.q")
        if estimate is None or estimate.status == "fixed":
            continue
        column, given = columns[joint]
        known = estimate.status == "identifiable" and estimate.sigma is not None
        turns = 2.0 * np.pi if estimate.unit == "rad" else np.inf
        found.append(
            FoundOffset(
                joint=joint,
                column=column,
                unit=estimate.unit,
                value=estimate.value / (given.sign * given.gear),
                sigma=(estimate.sigma or 0.0) / abs(given.gear) if known else None,
                steps=steps[joint] / turns
                if joint in steps and np.isfinite(turns)
                else None,
                status=estimate.status,
                within=absorbed.get(joint, ()),
            )
        )
    return tuple(found)
