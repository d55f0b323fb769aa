"""Where all links of a robot are, and the link in which everything is drawn."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pinocchio as pin

from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.joint_space import JointSpace
from calib_pin.kinematics.robot import Robot
from calib_pin.kinematics.shapes import Shape, box
from calib_pin.kinematics.spatial import Floats, invert
from calib_pin.kinematics.threads import PerThread, workspace
from calib_pin.kinematics.tree import Configurations, link_frame


class Skeleton:
    """Forward kinematics of a whole robot in one of its links.

    A joint that mimics another follows it, as commanded; one with several degrees of
    freedom, such as that of a floating base, stays at its neutral position.

    Args:
        robot: The robot; its model is not changed.
        base: Link in whose frame the others are.

    Attributes:
        base: That link.
        links: Names of all L links.
        joints: Names of the K joints with a position of their own.
        revolute: True for those that turn, shape (K,).
        lower: Lower position limits, shape (K,) [rad, m], see `JointSpace`.
        upper: Upper position limits, shape (K,) [rad, m].
    """

    def __init__(self, robot: Robot, base: str) -> None:
        """Find out which joints there are."""
        model = robot.model
        self._workspace = PerThread(workspace, model)
        self.base, self.links = base, robot.links
        self._base = robot.links.index(base)
        self._frames = [model.getFrameId(k, pin.FrameType.BODY) for k in self.links]
        single = np.array(model.names)[np.array(model.nvs) == 1].tolist()
        still = {*robot.mimics, *robot.refused}
        self.joints: tuple[str, ...] = tuple(k for k in single if k not in still)
        joints, count = [*self.joints, *robot.mimics], len(self.joints)
        space = self._space = JointSpace(model, joints, robot.mimics)
        ids = [model.getJointId(name) for name in space.joints]
        self._configurations = Configurations(model, ids)
        self.revolute = space.revolute[:count]
        self.lower, self.upper = space.lower[:count], space.upper[:count]

    @property
    def neutral(self) -> Floats:
        """Zero, or the limit next to it, of every joint, shape (K,) [rad, m]."""
        return np.asarray(np.clip(0.0, self.lower, self.upper))

    def positions(self, joints: Sequence[str], q: Floats) -> Floats:
        """Positions (n,) of joints, also of those that follow others, at q (K,)."""
        places = [self._space.joints.index(joint) for joint in joints]
        return np.asarray(self._with_followers(q)[0, places])

    def placements(self, q: Floats) -> Floats:
        """Poses of all links in the base link at q (K,) [rad, m], shape (L, 4, 4)."""
        model, data = self._workspace.value
        (full,) = self._configurations(self._with_followers(q))
        pin.framesForwardKinematics(model, data, full)
        T = np.array([data.oMf[frame].homogeneous for frame in self._frames])
        return np.asarray(invert(T[self._base]) @ T)

    def _with_followers(self, q: Floats) -> Floats:
        """Positions of all joints, those that follow others last, shape (1, n)."""
        followers = np.zeros(len(self._space.joints) - len(q))
        return self._space.follow(np.append(q, followers)[None])


LEGS = 0.15
"""How far below what stands still a robot must reach to count as standing there [m]."""


def corners(skeleton: Skeleton, shapes: Sequence[Shape], q: Floats) -> Floats:
    """Corners (S, 3) [m] of boxes around shapes in the base link at q (K,) [rad, m]."""
    T = dict(zip(skeleton.links, skeleton.placements(q), strict=True))
    return np.concatenate([_corners(shape, T[shape.link]) for shape in shapes])


def floor_height(skeleton: Skeleton, shapes: Sequence[Shape]) -> float:
    """Height of the ground under a robot in its base link [m].

    It lies under the links that stand still, or under the feet of a robot that reaches
    well below these.
    """
    neutral = skeleton.neutral
    # No joint stands at the same angle in both, nor a whole turn away.
    other = skeleton.lower + 0.37 * (skeleton.upper - skeleton.lower)
    ends = skeleton.placements(neutral), skeleton.placements(other)
    moves = np.abs(ends[0] - ends[1]).max(axis=(1, 2))
    fixed = {skeleton.links[k] for k in np.flatnonzero(moves < 1e-9)}
    lowest = float(corners(skeleton, shapes, neutral)[:, 2].min())
    standing = [shape for shape in shapes if shape.link in fixed]
    if not standing:
        return lowest
    under = float(corners(skeleton, standing, neutral)[:, 2].min())
    return under if lowest > under - LEGS else lowest


def _corners(shape: Shape, T: Floats) -> Floats:
    vertices = shape.surface.vertices
    least, most = vertices.min(axis=0), vertices.max(axis=0)
    around = box(most - least).vertices + 0.5 * (least + most)
    pose = T @ shape.placement
    return np.asarray(around @ pose[:3, :3].T + pose[:3, 3])


def chain_links(chains: Chains) -> frozenset[str]:
    """The links that the joints of measured chains move, and the links they start at.

    Links that are fixed to these belong to them.
    """
    model = chains.robot.model
    measured = [chains[name] for name in chains.names if chains[name].joints]
    joints = {model.getJointId(joint) for chain in measured for joint in chain.joints}
    joints |= {model.frames[link_frame(model, c.base)].parentJoint for c in measured}
    return frozenset(
        link
        for link in chains.robot.links
        if model.frames[link_frame(model, link)].parentJoint in joints
    )


def drawn_link(chains: Chains) -> str:
    """The link in which everything is drawn: the base of the chains, or the root."""
    bases = {chains[name].base for name in chains.names if chains[name].joints}
    return bases.pop() if len(bases) == 1 else chains.robot.root


def base_poses(chains: Chains, name: str, link: str, q: Floats) -> Floats:
    """Poses (N, 4, 4) of the base of a chain in a link, as the nominal robot has them.

    Args:
        chains: The chains.
        name: Name of the chain.
        link: The link.
        q: Positions of the joints of all chains, shape (N, n) [rad, m].
    """
    result = np.tile(np.eye(4), (len(q), 1, 1))
    if chains[name].base == link:
        return result
    model = chains.robot.model
    data = model.createData()
    base, other = (link_frame(model, k) for k in (chains[name].base, link))
    joints = [model.getJointId(joint) for joint in chains.joints]
    for k, configuration in enumerate(Configurations(model, joints)(q)):
        pin.framesForwardKinematics(model, data, configuration)
        result[k] = data.oMf[other].actInv(data.oMf[base]).homogeneous
    return result
