"""Offsets of the joints, as the columns of a measurement file and encoders count."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.parameterizations.base import owner
from calib_pin.parameters import by_joint
from calib_pin.setup import Setup
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
        status: That of the parameter, or of one less known that it is coupled to.
        within: Frames or instruments that the offset cannot be told from.
        reverses: A sentence where the joint turns back as its column goes on.
    """

    joint: str
    column: str
    unit: str
    value: float
    sigma: float | None
    steps: float | None
    status: str
    within: tuple[str, ...]
    reverses: str = ""


def encoder_steps(setup: Setup, joints: Sequence[str]) -> Mapping[str, float]:
    """Steps per turn by joint, of those that have any.

    Raises:
        OptionError: If a name or glob of the setup is no joint.
    """
    stated = setup.encoder_steps.items()
    return by_joint(stated, joints, "encoder_steps", setup.file or None)


def told_reversed(columns: JointColumns) -> dict[str, str]:
    """A sentence by joint that turns back as its column goes on."""
    factors = {j: given.sign * given.gear for j, (_, given) in columns.maps.items()}
    return {
        joint: f"{joint} is reversed: q = -{f'{-factor:g} '.removeprefix('1 ')}"
        "(reading + offset)"
        for joint, factor in factors.items()
        if factor < 0.0
    }


def joint_offsets(result: CalibrationResult) -> tuple[FoundOffset, ...]:
    """The offsets of the columns of all joints that have one as a parameter."""
    model = result.model
    columns = JointColumns.of(model.chains, model.setup.joints)
    joints = model.chains.joints
    steps = encoder_steps(model.setup, joints)
    # Where columns are coupled, the offset of one is made up of those of several.
    weights = columns.values(np.eye(len(joints)) + columns.offsets).T
    estimates = {p.name: p for p in result.parameters if p.status != "fixed"}
    absorbed = {e.of[0]: e.within for e in result.robot_errors if e.within}
    place, found = result.covariance.rows.index, []
    reverses = told_reversed(columns)
    for row, joint, column in zip(weights, columns.joints, columns.names, strict=True):
        name = "{}.joint-offset.q"
        parts = {
            name.format(owner(other)): weight
            for other, weight in zip(joints, row, strict=True)
            if weight and name.format(owner(other)) in estimates
        }
        estimate = joint and estimates.get(name.format(owner(joint)))
        if not estimate:
            continue
        involved, w = [estimates[part] for part in parts], np.array([*parts.values()])
        sigma, status = None, "identifiable"
        if unknown := [one.status for one in involved if one.status != status]:
            status = unknown[0]
        else:
            index = [place(part) for part in parts]
            C = np.asarray(result.covariance)[np.ix_(index, index)]
            sigma = float(np.sqrt(w @ C @ w))
        stepped = estimate.unit == "rad" and joint in steps
        found.append(
            FoundOffset(
                joint=joint,
                column=column,
                unit=estimate.unit,
                value=float(w @ [one.value for one in involved]),
                sigma=sigma,
                steps=steps[joint] / (2.0 * np.pi) if stepped else None,
                status=status,
                within=absorbed.get(joint, ()),
                reverses=reverses.get(joint, ""),
            )
        )
    return tuple(found)
