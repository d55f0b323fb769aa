"""A robot as its URDF describes it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

import pinocchio as pin

from calib_pin.errors import RobotError, nearest
from calib_pin.kinematics.joint_space import Mimic


@dataclass(frozen=True)
class Robot:
    """A URDF as it was read.

    Attributes:
        name: Name in the `<robot>` element.
        file: Path or bundled name the robot was read from, for messages.
        source: The bytes of the URDF.
        model: Pinocchio model of the whole tree.
        root: Name of the root link.
        links: Names of all links, in the order of the file.
        leaves: Names of the links without children.
        fixed_parents: For each link that hangs on a fixed joint, that joint's name.
        refused: Joints that a chain cannot contain, each with the reason.
        mimics: The other mimic joints, each with the driven joint that it follows.
        remarks: Sentences about the robot being other than its file.
    """

    name: str
    file: str
    source: bytes
    model: pin.Model
    root: str
    links: tuple[str, ...]
    leaves: tuple[str, ...]
    fixed_parents: Mapping[str, str] = field(default_factory=dict)
    refused: Mapping[str, str] = field(default_factory=dict)
    mimics: Mapping[str, Mimic] = field(default_factory=dict)
    remarks: tuple[str, ...] = ()

    def link(self, name: str, role: str) -> str:
        """The name of a link, for a role that messages tell.

        Raises:
            RobotError: If there is no such link.
        """
        if name not in self.links:
            raise RobotError(
                f"the robot has no link '{name}' for the {role}"
                f"{nearest(name, self.links)}",
                file=self.file,
                allowed=", ".join(self.links) if len(self.links) <= 12 else None,
            )
        return name

    def carried(self, joint: str) -> str:
        """The link that a joint moves."""
        number, body = self.model.getJointId(joint), pin.FrameType.BODY
        frames = [f for f in self.model.frames if f.parentJoint == number]
        return next(str(frame.name) for frame in frames if frame.type == body)

    def only_tip(self, base: str) -> str:
        """The only leaf beside a base link.

        Raises:
            RobotError: If there are several, or none.
        """
        leaves = [leaf for leaf in self.leaves if leaf != base]
        if len(leaves) != 1:
            raise RobotError(
                f"the robot has {len(leaves)} possible tips, name one with --tip",
                file=self.file,
                allowed=", ".join(leaves) or None,
            )
        return leaves[0]
