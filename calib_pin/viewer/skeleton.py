"""Where all links of a robot are, and not only those of a chain."""

from __future__ import annotations

from collections.abc import Mapping
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.chain import Robot
from calib_pin.kinematics.spatial import Floats, invert


class Skeleton:
    """Forward kinematics of a whole robot in one of its links.

    A joint that mimics another follows it, as commanded; one with several degrees of
    freedom, such as that of a floating base, stays at its neutral position.

    Args:
        robot: The robot; its model is not changed.
        base: Link in whose frame the others are.

    Attributes:
        links: Names of all L links.
        joints: Names of the K joints with a position of their own.
        revolute: True for those that turn, shape (K,).
        lower: Lower position limits, shape (K,) [rad, m].
        upper: Upper position limits, shape (K,) [rad, m]; half a turn or 1 m to either
            side where there is none.
    """

    def __init__(self, robot: Robot, base: str) -> None:
        """Find out which joints there are."""
        model = robot.model
        self._model = model
        self._data = model.createData()
        self.links = robot.links
        self._base = robot.links.index(base)
        self._frames = [model.getFrameId(k, pin.FrameType.BODY) for k in self.links]
        mimics = _mimics(robot)
        single = [j for j in range(1, model.njoints) if model.nvs[j] == 1]
        own = [joint for joint in single if model.names[joint] not in mimics]
        self.joints: tuple[str, ...] = tuple(str(model.names[j]) for j in own)
        # Joint, the one of `joints` whose position it takes, factor, and offset.
        self._driven = [(joint, k, 1.0, 0.0) for k, joint in enumerate(own)]
        for joint in set(single) - set(own):
            leader, factor, offset = mimics[model.names[joint]]
            if leader in self.joints:
                place = self.joints.index(leader)
                self._driven.append((joint, place, factor, offset))
        kinds = [model.joints[j].shortname() for j in own]
        self.revolute = np.array(["JointModelP" not in kind for kind in kinds], bool)
        start = [model.idx_qs[j] for j in own]
        lower, upper = model.lowerPositionLimit[start], model.upperPositionLimit[start]
        continuous = np.array([model.nqs[j] == 2 for j in own], bool)
        limited = ~continuous & (upper > lower) & (np.abs(upper - lower) < 1e6)
        half = np.where(self.revolute, np.pi, 1.0)
        self.lower: Floats = np.where(limited, lower, -half)
        self.upper: Floats = np.where(limited, upper, half)

    @property
    def neutral(self) -> Floats:
        """Zero, or the limit next to it, of every joint, shape (K,) [rad, m]."""
        return np.asarray(np.clip(0.0, self.lower, self.upper))

    def placements(self, q: Floats) -> Floats:
        """Poses of all links in the base link at q (K,) [rad, m], shape (L, 4, 4)."""
        model, data = self._model, self._data
        full = pin.neutral(model)
        for joint, place, factor, offset in self._driven:
            position, start = factor * q[place] + offset, model.idx_qs[joint]
            if model.nqs[joint] == 2:  # A continuous joint has cosine and sine.
                full[start : start + 2] = np.cos(position), np.sin(position)
            else:
                full[start] = position
        pin.framesForwardKinematics(model, data, full)
        T = np.array([data.oMf[frame].homogeneous for frame in self._frames])
        return np.asarray(invert(T[self._base]) @ T)


def _mimics(robot: Robot) -> Mapping[str, tuple[str, float, float]]:
    """Joints that follow others: of which one, factor and offset, by name."""
    result = {}
    for joint in ElementTree.fromstring(robot.source).iterfind("joint"):
        mimic = joint.find("mimic")
        if mimic is not None:
            factor, offset = mimic.get("multiplier", "1"), mimic.get("offset", "0")
            leader = mimic.get("joint", "")
            result[joint.get("name", "")] = leader, float(factor), float(offset)
    return result
