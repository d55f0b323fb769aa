"""The base frame and the tool frame: six screws at each end of the chain."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from calib_pin.parameterizations.base import COMPONENTS, Screw
from calib_pin.parameters import Parameter
from calib_pin.setup import FrameSetup


def frame_screws(name: str, frame: int, *, free: bool) -> Sequence[Screw]:
    """Screws `<name>.frame.x..rz` that follow the reference pose of a frame.

    Their scale is 1 m and 1 rad: an unknown tracker stand is not a robot error.

    Args:
        name: `base` or `tool`.
        frame: Frame index in the chain.
        free: Whether the frame is estimated.
    """
    return [
        Screw(
            Parameter(
                f"{name}.frame.{component}",
                "m" if k < 3 else "rad",
                1.0,
                nuisance=True,
                free=free,
            ),
            frame,
            np.eye(6)[k],
        )
        for k, component in enumerate(COMPONENTS)
    ]


def frame_pose(frame: FrameSetup) -> pin.SE3:
    """The pose that a setup states, zero for the parts that it leaves out."""
    rotation = pin.rpy.rpyToMatrix(*(frame.rpy or (0.0, 0.0, 0.0)))
    return pin.SE3(rotation, np.array(frame.xyz or (0.0, 0.0, 0.0)))


def frame_setup(pose: pin.SE3, *, known: bool) -> FrameSetup:
    """The setup of a frame that is known, or estimated from a first guess."""
    x, y, z = map(float, pose.translation)
    roll, pitch, yaw = map(float, pin.rpy.matrixToRpy(pose.rotation))
    return FrameSetup((x, y, z), (roll, pitch, yaw), estimate=not known)
