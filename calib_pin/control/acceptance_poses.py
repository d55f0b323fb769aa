"""Poses of an acceptance test in the terms of ISO 9283: five in a cube.

A cube with edges parallel to the base frame, as large as the workspace allows. In one
of its diagonal planes P1 is the center, and P2 to P5 lie on the diagonals of the plane,
a tenth of their length from their ends. One orientation is kept at all of them.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import pairwise, product

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.control.joints import Joints, Kinematics
from calib_pin.control.reaching import Task, reach, search
from calib_pin.errors import OptionError
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats, adjoint, invert
from calib_pin.observations import Booleans
from calib_pin.setup import Region

EDGES = (1.0, 0.63, 0.4, 0.25)
"""Edges of cubes that are tried, the largest first [m]."""

INSET = 0.1
"""Part of a diagonal between its end and the pose on it."""

ORDER = (5, 4, 3, 2, 1)
"""Poses of a cycle in their order."""

SAMPLES = 4000
"""Configurations whose places show where the workspace is."""

BESIDE = 0.1
"""Distance of cubes from the axis on which the robot stands [m]."""

CENTERS = 16
"""Cubes of an edge that are looked at closely."""

TURNS = 12
"""Orientations of random configurations that are tried after the usual ones."""

Free = Callable[[Floats], Booleans]
"""Joint positions of a chain, (N, n), to whether nothing touches there, (N,)."""

Moves = Callable[[Floats, Floats], bool]
"""Whether the straight move between two configurations, (n,) each, is free."""


@dataclass(frozen=True)
class AcceptancePoses:
    """The five poses of an acceptance test.

    Attributes:
        center: Center of the cube in the base link, shape (3,) [m].
        edge: Its edge [m].
        T: Poses P1 to P5 of the tool in the base link, shape (5, 4, 4).
        q: Configurations there, shape (5, n) [rad, m].
        oriented: Whether all have the same orientation; a robot of fewer than six
            joints only goes to positions.
    """

    center: Floats
    edge: float
    T: Floats
    q: Floats
    oriented: bool

    def cycles(self, count: int) -> tuple[Floats, list[int], list[int]]:
        """All visits: configurations, shape (5 count, n), their poses and cycles."""
        poses = list(ORDER) * count
        each = [k for k in range(1, count + 1) for _ in ORDER]
        return self.q[[pose - 1 for pose in poses]], poses, each


@serial_blas
def acceptance_poses(
    chain: Chain,
    tool: Floats,
    *,
    limits: tuple[Floats, Floats] | None = None,
    region: Region | None = None,
    free: Free | None = None,
    moves: Moves | None = None,
) -> AcceptancePoses:
    """The poses in the largest cube of which all of a grid can be reached.

    Args:
        chain: The nominal chain.
        tool: The measured point in the tip, shape (4, 4).
        limits: Narrower joint limits, each of shape (n,) [rad, m]; those of mimic
            joints and of what they follow are left as they are.
        region: Where the cube may be, in the base link.
        free: Where nothing touches.
        moves: On which moves nothing touches.

    Raises:
        OptionError: If there is none of the smallest edge.

    Examples:
        >>> import calib_pin
        >>> poses = acceptance_poses(calib_pin.load_chain("space6"), np.eye(4))
        >>> poses.edge in EDGES, poses.q.shape
        (True, (5, 6))
    """
    joints = Joints.of(chain)
    if limits is not None and not chain.mimics:
        joints = replace(
            joints,
            lower=np.maximum(joints.lower, limits[0]),
            upper=np.minimum(joints.upper, limits[1]),
        )

    def evaluate(q: Floats) -> tuple[Floats, Floats]:
        T, J = chain.jacobian(q)
        return T @ tool, adjoint(invert(tool)) @ J

    q = joints.positions(joints.samples(SAMPLES))
    T = chain.poses(q) @ tool
    if free is not None:
        T = T[free(q)]
    oriented = len(joints.lower) >= 6
    middle = chain.poses(joints.positions(joints.home[None]))[0] @ tool
    every = T[:: max(1, len(T) // TURNS), :3, :3]
    # One orientation is as good as another where only positions are reached.
    wanted = [_orientations(middle), every] if oriented else [middle[None, :3, :3]]
    for edge in EDGES:
        centers = _cubes(evaluate, T[:, :3, 3], joints, edge, region)
        for turns, center in product(wanted, centers):
            options = _pose_sets(evaluate, center, edge, turns, joints, oriented, free)
            for T_5, q_5 in options:
                tour = q_5[[pose - 1 for pose in (1, *ORDER)]]
                if moves is None or all(moves(a, b) for a, b in pairwise(tour)):
                    return AcceptancePoses(center, edge, T_5, q_5, oriented)
    raise OptionError(
        f"no cube of {1e3 * EDGES[-1]:.0f} mm was found of which the robot reaches "
        "all, with one orientation at the five poses and without a collision",
        allowed="a robot, limits or a region with more room",
    )


def _orientations(middle: Floats) -> Floats:
    """Orientations that are preferred, in their order, shape (K, 3, 3).

    The tool down, by any of eight headings, and as it is in the middle of the limits.
    """
    headings = np.arange(8) * np.pi / 4.0
    c, s, zero = np.cos(headings), np.sin(headings), np.zeros(8)
    down = np.array([[c, s, zero], [s, -c, zero], [zero, zero, zero - 1.0]])
    return np.concatenate([np.moveaxis(down, 2, 0), middle[None, :3, :3]])


def _cubes(
    evaluate: Kinematics,
    points: Floats,
    joints: Joints,
    edge: float,
    region: Region | None,
) -> Floats:
    """Centers of cubes that can be reached everywhere, the most used first, (K, 3).

    The robot does not stand in them, and those above its base come first.
    """
    corners = np.array([*product((-1, 1), repeat=3)])
    # People read these numbers.
    centers, counts = np.round(points[:: max(1, len(points) // 800)], 2), []
    for center in centers:
        away = (points - center) / (0.5 * edge)
        inside = away[(np.abs(away) <= 1.0).all(axis=1)]
        octant = (inside > 0.0) @ np.array([4, 2, 1])
        beside = (np.abs(center[:2]) > 0.5 * edge + BESIDE).any()
        within = beside and (
            region is None or region.contains(center + 0.5 * edge * corners).all()
        )
        above = len(points) if center[2] >= 0.5 * edge else 0
        least = int(np.bincount(octant, minlength=8).min())
        counts.append(above + least if within and least else 0)
    grid = np.array([*product((-1.0, 0.0, 1.0), repeat=3)])
    order = np.argsort(-np.array(counts), kind="stable")[:CENTERS]
    order = order[np.array(counts)[order] > 0]
    chosen = centers[order]
    targets = np.tile(np.eye(4), (len(chosen), len(grid), 1, 1))
    targets[:, :, :3, 3] = chosen[:, None] + 0.5 * edge * grid
    every = targets.reshape(-1, 4, 4)
    reached = search(Task.of(evaluate, every, joints, orientation=False)).reached
    return chosen[reached.reshape(len(chosen), len(grid)).all(axis=1)]


def _pose_sets(
    evaluate: Kinematics,
    center: Floats,
    edge: float,
    turns: Floats,
    joints: Joints,
    oriented: bool,
    free: Free | None,
) -> Iterator[tuple[Floats, Floats]]:
    """Poses in the planes of a cube, (5, 4, 4), and their configurations, (5, n)."""
    first = np.tile(np.eye(4), (len(turns), 1, 1))
    first[:, :3, :3], first[:, :3, 3] = turns, center
    middle = search(Task.of(evaluate, first, joints, orientation=oriented))
    for T_1, q_1, reached in zip(first, middle.q, middle.reached, strict=True):
        if not reached:
            continue
        for plane in _planes():
            T = np.tile(T_1, (5, 1, 1))
            T[1:, :3, 3] += (0.5 - INSET) * edge * plane
            # Near the center, so that an elbow stays where it is.
            near = np.tile(q_1, (5, 1))
            solutions = reach(Task.of(evaluate, T, joints, near, oriented))
            if solutions.reached.all() and (free is None or free(solutions.q).all()):
                yield T, solutions.q


def _planes() -> Iterator[Floats]:
    """Ends of the diagonals of four planes, in edges times two, each (4, 3)."""
    for axis in (0, 1):
        for slope in (-1.0, 1.0):
            ends = np.array([[1, 1, slope], [-1, 1, -slope]], float)
            ends = np.concatenate([ends, [[-1, -1, -slope], [1, -1, slope]]])
            yield ends if axis == 0 else ends[:, [1, 0, 2]]
