"""Ways around obstacles: free by a finer look, within limits, always the same."""

from __future__ import annotations

from itertools import pairwise

import numpy as np
import pytest

import calib_pin
from calib_pin.io.collision import load_collisions
from calib_pin.kinematics.chains import Chains
from calib_pin.planning.ways import VIA, Ways
from calib_pin.setup import Obstacle

CHAIN = calib_pin.load_chain("space7")


def scene(seed: int) -> tuple[np.ndarray, list[Obstacle]]:
    """Two configurations, and a sphere at the tip half-way between them."""
    rng = np.random.default_rng(seed)
    while True:
        a, b = 0.6 * CHAIN.random_configurations(2, rng)
        at = CHAIN.poses(0.5 * (a + b)[None])[0, :3, 3]
        around = [Obstacle(sphere=0.1, xyz=tuple(at.tolist()))]
        ends = np.array([a, b])
        if load_collisions(CHAIN, around).free(ends).all():
            return ends, around


def ways_around(obstacles: list[Obstacle]) -> Ways:
    chains = Chains.of(CHAIN)
    collisions = load_collisions(CHAIN, obstacles)
    return Ways(chains, collisions, chains.lower, chains.upper)


def touched(q: np.ndarray, obstacles: list[Obstacle]) -> bool:
    """Whether anything touches, at no clearance, on straight ways cut very finely."""
    bare = load_collisions(CHAIN, obstacles, clearance=0.0)
    assert bare is not None
    parts = np.linspace(0.0, 1.0, 700)[:, None]
    return not all(bare.free(a + parts * (b - a)).all() for a, b in pairwise(q))


@pytest.mark.parametrize("seed", [0, 4])
def test_a_way_around_a_sphere(seed):
    q, obstacles = scene(seed)
    assert touched(q, obstacles)
    ways = ways_around(obstacles)
    assert not ways.is_free(*q)
    found = ways.through(q, np.random.default_rng(0))
    assert found.blocked == ()
    assert 0 < found.vias < 10
    assert not touched(found.q, obstacles)
    np.testing.assert_array_equal(found.q[found.row != VIA], q)
    assert found.row[[0, -1]].tolist() == [0, 1]
    assert ((found.q >= CHAIN.lower) & (found.q <= CHAIN.upper)).all()
    again = ways.through(q, np.random.default_rng(0))
    np.testing.assert_array_equal(again.q, found.q)
    # Not all through the house.
    straight = np.abs(q[1] - q[0]) @ ways.collisions.reach
    assert (
        np.abs(np.diff(found.q, axis=0)) @ ways.collisions.reach
    ).sum() < 4.0 * straight + 8.0


def test_where_there_is_no_way_the_straight_one_is_named():
    """In a cage that is closed, and with an end in the obstacle."""
    q, _ = scene(0)
    wall = [Obstacle(box=(0.02, 6.0, 6.0), xyz=(x, 0.0, 0.0)) for x in (-9.0, 0.0)]
    ways = ways_around(wall)
    assert ways.around(*q, np.random.default_rng(0)) is None
    found = ways.through(q, np.random.default_rng(0))
    assert found.blocked == (1,)
    np.testing.assert_array_equal(found.q, q)
    assert ways.checked(q).blocked == (1,)


def test_free_ways_stay_straight():
    q, _ = scene(1)
    ways = ways_around([])
    found = ways.through(np.array([q[0], q[0] + 0.02, q[0]]), np.random.default_rng(0))
    assert (found.vias, found.blocked) == (0, ())
    assert len(ways.through(q[:0], np.random.default_rng(0)).q) == 0
    assert len(ways.through(q[:1], np.random.default_rng(0)).q) == 1


def test_no_point_of_the_robot_moves_farther_than_the_bound():
    reach = load_collisions(CHAIN).reach
    q = CHAIN.random_configurations(100, np.random.default_rng(0))
    for k in range(len(CHAIN.joints)):
        moved = q.copy()
        moved[:, k] += 1e-4
        way = np.linalg.norm((CHAIN.poses(moved) - CHAIN.poses(q))[:, :3, 3], axis=1)
        assert (way <= 1e-4 * reach[k] * (1.0 + 1e-6)).all()
