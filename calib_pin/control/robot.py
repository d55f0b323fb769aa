"""Joint commands of a calibrated robot."""

from __future__ import annotations

from dataclasses import replace
from typing import Literal, TypeAlias

import numpy as np

from calib_pin.control.joints import Joints, Kinematics, Solutions
from calib_pin.control.reaching import search
from calib_pin.kinematics.spatial import Floats, adjoint, interpolate, invert
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.validation.calibrated_model import CalibratedModel

Frame: TypeAlias = Literal["measuring", "base"]
Point: TypeAlias = Literal["tool", "tip"]


def kinematics(
    model: CalibratedModel,
    *,
    frame: Frame = "measuring",
    point: Point = "tool",
    nominal: bool = False,
) -> Kinematics:
    """Kinematics of a calibrated robot, with all its corrections.

    Args:
        model: The calibrated robot.
        frame: Frame of the poses: `measuring`, or `base`, the base link.
        point: The placed point: `tool`, or `tip`, the tip link.
        nominal: Whether the robot is taken without its errors; the frames stay.

    Returns:
        Kinematics for `reach` and `search`. Derivatives of the corrections of joint
        positions by these are neglected.
    """
    error, theta = model.error, model.theta
    if nominal:
        error, theta = replace(error, learned=None), np.zeros_like(theta)

    def evaluate(q: Floats) -> tuple[Floats, Floats]:
        T, J = error.kinematics(q, theta)
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


def commands(
    model: CalibratedModel,
    targets: Floats,
    start: Floats | None = None,
    *,
    frame: Frame = "measuring",
    point: Point = "tool",
    orientation: bool = True,
) -> Solutions:
    """Joint positions at which a calibrated robot is where it shall be.

    Without a start the nominal robot is solved first, and the solution is the one close
    to that.

    Args:
        model: The calibrated robot.
        targets: Poses to reach, shape (N, 4, 4).
        start: Joint positions that solutions shall be close to, shape (N, n) [rad, m].
        frame: Frame of the targets, see `kinematics`.
        point: The point that shall reach them.
        orientation: Whether orientations count; else only positions do.

    Example:
        >>> import calib_pin
        >>> chain = calib_pin.load_chain("space6")
        >>> setup = calib_pin.read_setup(calib_pin.robot_file("space6", "setup.yaml"))
        >>> rows = calib_pin.read_measurements(
        ...     calib_pin.robot_file("space6", "measurements.csv"), chain
        ... )
        >>> model = calib_pin.calibrate(chain, rows, setup).model
        >>> found = commands(model, model.poses(rows.q), rows.q)
        >>> bool(found.reached.all())
        True
    """
    return search(
        kinematics(model, frame=frame, point=point),
        targets,
        Joints.of(model.chain),
        start,
        nominal=kinematics(model, frame=frame, point=point, nominal=True),
        orientation=orientation,
    )
