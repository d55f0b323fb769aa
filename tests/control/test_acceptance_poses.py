"""Poses of an acceptance test: their geometry, by themselves, and in the workspace."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import calib_pin
from calib_pin.control.acceptance_poses import (
    EDGES,
    ORDER,
    AcceptancePoses,
    acceptance_poses,
)
from calib_pin.control.joints import Joints
from calib_pin.control.reaching import Task, search
from calib_pin.errors import OptionError
from calib_pin.io.collision import load_collisions
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import adjoint, from_quaternion, invert
from calib_pin.setup import Region

TOOL = np.eye(4)
TOOL[:3, :3] = from_quaternion(np.array([[0.5, -0.5, 0.5, 0.5]]))[0]
TOOL[:3, 3] = 0.02, -0.03, 0.1


def check(found: AcceptancePoses, chain: Chain, tool: np.ndarray) -> None:
    P = found.T[:, :3, 3]
    assert found.edge in EDGES
    np.testing.assert_array_equal(P[0], found.center)
    # The ends of the diagonals of a diagonal plane are corners of the cube.
    ends = (P[1:] - found.center) / 0.8
    np.testing.assert_allclose(np.abs(ends), 0.5 * found.edge, atol=1e-12)
    length = np.sqrt(3.0) * found.edge
    np.testing.assert_allclose(
        np.linalg.norm(ends - (P[1:] - found.center), axis=1), 0.1 * length
    )
    np.testing.assert_allclose(P[1] + P[3], P[2] + P[4], atol=1e-12)
    normal = np.cross(P[1] - P[3], P[2] - P[4])
    normal = np.sort(np.abs(normal / np.linalg.norm(normal)))
    np.testing.assert_allclose(normal, [0.0, 0.5**0.5, 0.5**0.5], atol=1e-12)
    T = chain.poses(found.q) @ tool
    np.testing.assert_allclose(T[:, :3, 3], P, atol=2e-9)
    if found.oriented:
        np.testing.assert_allclose(T, found.T, atol=2e-9)
        np.testing.assert_array_equal(found.T[1:, :3, :3], found.T[:4, :3, :3])
    assert ((found.q >= chain.lower) & (found.q <= chain.upper)).all()
    inside = np.random.default_rng(0).uniform(-0.5, 0.5, (40, 3)) * found.edge
    targets = np.tile(np.eye(4), (40, 1, 1))
    targets[:, :3, 3] = found.center + inside

    def evaluate(q):
        T, J = chain.jacobian(q)
        return T @ tool, adjoint(invert(tool)) @ J

    task = Task.of(evaluate, targets, Joints.of(chain), orientation=False)
    reached = search(task).reached
    assert reached.mean() > 0.97


@pytest.mark.slow
def test_five_poses_in_a_cube():
    chain = calib_pin.load_chain("space6")
    region = Region(box=((-3.0, 0.2, 1.0), (3.0, 3.0, 2.2)))
    lower, upper = chain.lower.copy(), chain.upper.copy()
    lower[0], upper[0] = -2.0, 2.0
    # Without limits the poses need it on the other side.
    lower[4] = 0.0
    found = acceptance_poses(chain, TOOL, limits=(lower, upper), region=region)
    assert found.oriented
    assert ((found.q >= lower) & (found.q <= upper)).all()
    check(found, chain, TOOL)
    half = 0.5 * found.edge
    corners = found.center + half * np.array([[1, 1, 1], [-1, -1, -1]])
    assert region.contains(corners).all()
    small = Region(box=((0.1, 0.2, 1.0), (0.3, 0.5, 1.3)))
    with pytest.raises(OptionError, match="250 mm"):
        acceptance_poses(chain, np.eye(4), region=small)


def test_nothing_touches_at_the_poses_and_between_them():
    chain = calib_pin.load_chain("space7")
    collisions = load_collisions(chain)
    found = acceptance_poses(
        chain,
        TOOL,
        free=collisions.free,
        moves=lambda a, b: bool(collisions.free(np.linspace(a, b, 60)).all()),
    )
    check(found, chain, TOOL)
    cycle = [found.q[pose - 1] for pose in (1, *ORDER)]
    part = np.linspace(0.0, 1.0, 150)[:, None]
    for a, b in pairwise(cycle):
        assert collisions.free(a + part * (b - a)).all()


def test_visits():
    q = np.arange(5.0)[:, None]
    poses = AcceptancePoses(np.zeros(3), 0.4, np.tile(np.eye(4), (5, 1, 1)), q, True)
    visits, names, cycles = poses.cycles(2)
    assert visits[:, 0].tolist() == [4, 3, 2, 1, 0, 4, 3, 2, 1, 0]
    assert names == [5, 4, 3, 2, 1, 5, 4, 3, 2, 1]
    assert cycles == [1] * 5 + [2] * 5
