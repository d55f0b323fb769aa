"""A calibrated robot as kinematics: of which frame, which point, and which load."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Literal, TypeAlias

import numpy as np

from calib_pin.control.joints import Kinematics
from calib_pin.errors import OptionError, require_known
from calib_pin.kinematics.spatial import Floats, adjoint, interpolate, invert
from calib_pin.observations import UNSTATED, Conditions, Signs
from calib_pin.parameterizations import NOTHING
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.validation.calibrated_model import CalibratedChain

Frame: TypeAlias = Literal["measuring", "base"]
Point: TypeAlias = Literal["tool", "tip"]


def kinematics(
    model: CalibratedChain,
    *,
    frame: Frame = "measuring",
    point: Point = "tool",
    nominal: bool = False,
    side: Signs | None = None,
) -> Kinematics:
    """Kinematics of a calibrated robot, with all its corrections.

    Args:
        model: The calibrated chain.
        frame: Frame of the poses: `measuring`, or `base`, the base link.
        point: The placed point: `tool`, or `tip`, the tip link.
        nominal: Whether the robot is taken without its errors; the frames stay.
        side: Sign of the last motion of each joint, shape (n,); None where it is not
            known, and joints stand in the middle of their lost motion.

    Returns:
        Kinematics for `reach` and `search`. Derivatives of the corrections of joint
        positions by these are neglected.
    """
    error, theta = model.error, model.theta
    if nominal:
        error, theta = replace(error, learned=None), np.zeros_like(theta)

    def evaluate(q: Floats) -> tuple[Floats, Floats]:
        held = UNSTATED
        if side is not None:
            held = Conditions(direction=np.tile(side, (len(q), 1)))
        T, J = error.kinematics(q, theta, held)
        base, tool = _ends(error, q)
        if frame == "base":
            T = invert(base) @ T
        if point == "tip":
            # Through the tool, which also carries the learned motion.
            T, J = T @ invert(tool), adjoint(tool) @ J
        return T, J

    return evaluate


def _ends(error: ErrorModel, q: Floats) -> tuple[Floats, Floats]:
    """Base and tool frame, each (4, 4), or (N, 4, 4) where the correction fades."""
    base, tool = error.base.homogeneous, error.tool.homogeneous
    if error.learned is None:
        return base, tool
    products = error.corrections(error.learned.shift)
    shifted = base @ products[0].homogeneous, tool @ products[-1].homogeneous
    weight = error.learned.weight(q)
    if (weight == 1.0).all():
        return shifted
    return interpolate(base, shifted[0], weight), interpolate(tool, shifted[1], weight)


def with_payload(
    model: CalibratedChain, payload: str | None, file: str | Path | None = None
) -> CalibratedChain:
    """The calibrated robot with a payload that its setup knows.

    Args:
        model: The calibrated chain.
        payload: Name of the payload, `none` for nothing; may be left out where the
            calibration needs none or knows only one.
        file: File of the calibration, for messages.

    Raises:
        OptionError: If there is no payload of that name, or it is missing.
    """
    known = [*model.setup.payloads, NOTHING]
    if payload is not None:
        require_known("payload", payload, known)
        return replace(model, error=model.error.carrying(payload))
    if not model.geometric and len(model.setup.payloads) > 1:
        raise OptionError(
            "the calibration knows several payloads; say with --payload which one is "
            "carried",
            file=file,
            allowed=", ".join(known),
        )
    return model


def ends_estimated(model: CalibratedChain, *, base: bool, tip: bool) -> bool:
    """Whether the base or the tool frame was estimated along with the robot.

    Args:
        model: The calibrated chain.
        base: Whether the base frame matters.
        tip: Whether the tool frame matters.
    """
    free = model.error.parameters.free
    return bool((base and free[:6].any()) or (tip and free[-6:].any()))


def has_sides(model: CalibratedChain) -> bool:
    """Whether it matters from which side joints come: there is lost motion."""
    n = len(model.chain.joints)
    one, none = np.ones((1, n), np.int8), np.zeros((1, n))
    basis = model.error.basis(none, Conditions(direction=one))
    moved = (basis - model.error.basis(none)) * model.theta[
        model.error.joint_corrections
    ]
    return bool(moved.any())
