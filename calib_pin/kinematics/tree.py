"""Pinocchio's model of a whole robot: its links, its branches, its configurations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.spatial import Floats

LINK = "\0"
"""Marks the names of links in a reduced model; no XML can contain it."""


def reduced(full: pin.Model, locked: Sequence[int]) -> pin.Model:
    """The model with some joints locked at zero.

    Pinocchio looks for a locked joint's frame by its name alone and fails where a
    link bears the same name, so links are renamed first.
    """
    model = full.copy()
    for frame in model.frames:
        if frame.type == pin.FrameType.BODY:
            frame.name = LINK + frame.name
    return pin.buildReducedModel(model, locked, pin.neutral(model))


def link_frame(model: pin.Model, link: str) -> int:
    """Frame of a link; a joint may bear the same name."""
    return int(model.getFrameId(link, pin.FrameType.BODY))


def support(model: pin.Model, link: str) -> list[int]:
    """Moving joints from the root of the tree to a link."""
    joint = model.frames[link_frame(model, link)].parentJoint
    return [j for j in model.supports[joint] if j != 0]


def turns(model: pin.Model, joint: str) -> bool:
    """Whether a joint of one degree of freedom is revolute or continuous."""
    # The types of prismatic joints, along an axis and unaligned, begin with a P.
    kind = model.joints[model.getJointId(joint)].shortname()
    return not kind.startswith("JointModelP")


class Configurations:
    """Pinocchio's configuration vectors; joints of no concern stand at zero.

    Args:
        model: The model.
        joints: Numbers of the n joints that move.

    Attributes:
        index: First entry of each joint in a configuration vector, shape (n,).
        continuous: True for joints with two entries, cosine and sine, shape (n,).
    """

    def __init__(self, model: pin.Model, joints: Sequence[int]) -> None:
        """Look up the entries once."""
        self.index = np.array([model.idx_qs[joint] for joint in joints], np.intp)
        self.continuous = np.array([model.nqs[joint] == 2 for joint in joints], bool)
        self._neutral = pin.neutral(model)

    def __call__(self, q: Floats) -> Floats:
        """Configuration vectors of joint positions, shape (N, n) -> (N, nq)."""
        result = np.tile(self._neutral, (len(q), 1))
        result[:, self.index] = np.where(self.continuous, np.cos(q), q)
        result[:, self.index[self.continuous] + 1] = np.sin(q[:, self.continuous])
        return result
