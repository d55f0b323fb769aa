"""Parameterization, the base of all: error parameters as screws along a chain.

The base frame and the tool frame are six screws at each end of the chain.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Sequence
from dataclasses import dataclass
from typing import ClassVar, Protocol, Self

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.joint_space import Mimic
from calib_pin.kinematics.spatial import Floats
from calib_pin.kinematics.tree import turns
from calib_pin.observations.conditions import UNSTATED, Conditions
from calib_pin.parameters import Parameter
from calib_pin.setup import FrameSetup, Setup

LENGTH_SCALE = 1e-3
"""Expected size of a length error of a robot [m]."""

ANGLE_SCALE = 3e-3
"""Expected size of an angle error of a robot [rad].

Over a link of a third of a meter it moves what follows as far as a length error does.
The marginal likelihood of the TALOS and TIAGo training rows peaks at this ratio too.
"""

PIXEL_SCALE = 1.0
"""Expected size of an error in an image [px]: a millimeter seen from a meter."""

COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")
"""Names of the six unit twists, in the order (linear, angular)."""


class BasisFunctions(Protocol):
    """Basis functions of the commanded joint positions and of the conditions."""

    def __call__(self, q: Floats, conditions: Conditions = UNSTATED) -> Floats:
        """The values of all functions.

        Args:
            q: Joint positions, shape (N, n) [rad, m].
            conditions: What holds at each configuration; by default nothing is
                stated, and the only payload that there is is carried.

        Returns:
            Values, shape (N, m).

        Raises:
            InputError: If there are several payloads, or none of that name.
        """
        ...


@dataclass(frozen=True)
class BasisFunction:
    """One of several basis functions, which are evaluated together.

    Attributes:
        functions: The functions.
        column: Column of this function among them.
    """

    functions: BasisFunctions
    column: int


@dataclass(frozen=True)
class Screw:
    """One error parameter as a unit screw in one frame of the chain.

    Attributes:
        parameter: The parameter whose value is the amount of the screw.
        frame: Frame index: 0 for the base, 1..n for the joints from base to tip, n + 1
            for the tip, n + 2 for the tool. At a joint the screw follows the nominal
            placement, in the joint frame; screws of one frame apply in the order they
            are listed.
        twist: Unit twist (linear, angular), shape (6,), per unit of the parameter.
        basis: The basis function phi_p that multiplies the amount; None for an error
            of the geometry. A joint's own motion is corrected where the twist is just
            that, `dq_j = sum_p theta_p phi_p(q)`. Other twists S_p bend their place
            behind its geometry and before that motion, `Exp(sum_p S_p theta_p phi_p)`.
    """

    parameter: Parameter
    frame: int
    twist: Floats
    basis: BasisFunction | None = None


@dataclass(frozen=True)
class Drive:
    """The drive that moves a joint of a chain: its own, or that of its leader.

    A correction dq of the drive moves the joint by `factor dq`. Parameters of joints'
    motions belong to the drive; a parameter of several joints stands in several screws.

    Attributes:
        joint: Joint that has the drive: this one, or the leader of a mimic joint.
        unit: Unit of that joint's position, rad or m.
        frame: Frame index of the joint that is moved.
        motion: Unit twist of its motion in its own frame, shape (6,).
        factor: Its factor, not zero.
        offset: Its position where the drive is at zero [rad, m].
    """

    joint: str
    unit: str
    frame: int
    motion: Floats
    factor: float = 1.0
    offset: float = 0.0


def drives(chain: Chain) -> list[Drive]:
    """The drives of all joints of a chain but those that stand still."""
    model, result = chain.robot.model, []
    for frame, (joint, motion) in enumerate(
        zip(chain.joints, chain.motions, strict=True), start=1
    ):
        mimic = chain.mimics.get(joint, Mimic(joint))
        if mimic.factor:
            unit = "rad" if turns(model, mimic.leader) else "m"
            given = mimic.leader, unit, frame, motion, mimic.factor, mimic.offset
            result.append(Drive(*given))
    return result


@dataclass(frozen=True)
class Effects:
    """Components of a parameterization that act as random effects unless estimated.

    Attributes:
        components: Names of the components.
        size: Expected size of one, in the unit of a revolute joint's correction [rad].
    """

    components: tuple[str, ...]
    size: float


class Parameterization(ABC):
    """Error parameters of a robot: of its geometry, or of its joints' motions.

    A member is one file with one subclass, and one line in `PARAMETERIZATIONS` or, in
    another package, one entry point of the group `calib_pin.parameterizations`.

    Attributes:
        name: Name as users write it.
        kind: The middle word of parameter names, `<owner>.<kind>.<component>`; default
            the name.
        geometric: Whether a URDF can hold all of it.
        requires: Keys of a setup file without which the parameters mean nothing.
        effects: Components that act as random effects unless they are estimated.
        conditions: What the measurements must state, `direction`, `temperature` or
            `time`, for the parameters to mean anything.
        turn: Expected turn of an origin by its parameters, where they are all that
            turn it [rad].
    """

    name: ClassVar[str]
    kind: ClassVar[str]
    geometric: ClassVar[bool] = True
    requires: ClassVar[tuple[str, ...]] = ()
    effects: ClassVar[Effects | None] = None
    conditions: ClassVar[tuple[str, ...]] = ()
    turn: ClassVar[float] = ANGLE_SCALE

    def __init_subclass__(cls) -> None:
        """Name the parameters after the parameterization unless stated."""
        super().__init_subclass__()
        if "name" in vars(cls) and "kind" not in vars(cls):
            cls.kind = cls.name

    @classmethod
    def of_setup(cls, setup: Setup) -> Self:
        """The parameterization with the statements of a setup about the robot."""
        return cls()

    def parameter(
        self, joint: str, component: str, unit: str, scale: float | None = None
    ) -> Parameter:
        """A parameter of a joint, by default with the expected size of its unit."""
        scale = expected_size(unit) if scale is None else scale
        return Parameter(f"{owner(joint)}.{self.kind}.{component}", unit, scale)

    @abstractmethod
    def screws(self, chain: Chain) -> Sequence[Screw]:
        """The screws of a chain, frame by frame in the order they apply."""


def owner(joint: str) -> str:
    """Name of a joint as it stands in parameter names.

    The words `base` and `tool` belong to the two frames.

    Examples:
        >>> owner("elbow"), owner("tool")
        ('elbow', 'joint:tool')
    """
    return f"joint:{joint}" if joint in ("base", "tool") else joint


def expected_size(unit: str) -> float:
    """Expected size of an error of a robot in a unit, `m`, `px` or an angle."""
    if unit == "px":
        return PIXEL_SCALE
    return LENGTH_SCALE if unit == "m" else ANGLE_SCALE


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
