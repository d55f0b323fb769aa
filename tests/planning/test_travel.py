"""Whole turns of planned configurations: away where nothing depends on them."""

from __future__ import annotations

from itertools import pairwise, permutations

import numpy as np
import pytest

import calib_pin
from calib_pin.io.collision import load_collisions
from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.plan import shortest_order
from calib_pin.setup import Obstacle, Setup

CHAIN = calib_pin.load_chain("example:ur5_robot", tip="tool0")
QUICK = {"method": "greedy", "candidates": 150}


def test_what_a_gear_depends_on_keeps_its_turns():
    setup = Setup(parameters=("joint-offset", "transmission"))
    found = calib_pin.plan(CHAIN, "pose", 14, setup, **QUICK)
    assert np.abs(found.q).max() > 1.3 * np.pi


def test_turns_change_nothing_of_what_is_planned(monkeypatch):
    turned = calib_pin.plan(CHAIN, "position", 10, **QUICK)
    monkeypatch.setattr("calib_pin.planning.plan._duplicates", lambda *about: False)
    as_found = calib_pin.plan(CHAIN, "position", 10, **QUICK)
    assert turned.value == pytest.approx(as_found.value, rel=1e-4)
    assert np.abs(turned.q).max() <= np.pi + 1e-6
    travels = [
        np.abs(np.diff(p.q, axis=0)).max(axis=1).sum() for p in (turned, as_found)
    ]
    assert travels[0] < 0.8 * travels[1]


def length(q: Floats, order: tuple[int, ...], start: Floats | None = None) -> float:
    """Travel in the largest joint movement of each move, by its definition."""
    places = [q[k] for k in order]
    if start is not None:
        places = [start, *places]
    return sum(float(np.abs(b - a).max()) for a, b in pairwise(places))


def all_lengths(q: Floats, start: Floats | None = None) -> Floats:
    places = q if start is None else np.concatenate([q, start[None]])
    way = np.abs(places[:, None] - places[None]).max(axis=2)
    orders = np.array(list(permutations(range(len(q)))))
    if start is not None:
        orders = np.column_stack([np.full(len(orders), len(q)), orders])
    return way[orders[:, :-1], orders[:, 1:]].sum(axis=1)


@pytest.mark.parametrize("with_start", [False, True])
@pytest.mark.parametrize("count", [1, 2, 3, 6])
def test_against_every_order(count: int, with_start: bool) -> None:
    excess = []
    for seed in range(8):
        rng = np.random.default_rng(seed)
        q = rng.uniform(-2.0, 2.0, (count, 3))
        start = rng.uniform(-2.0, 2.0, 3) if with_start else None
        order, blocked = shortest_order(q, start)
        assert sorted(order.tolist()) == list(range(count)) and blocked == ()
        best = float(all_lengths(q, start).min())
        travel = length(q, tuple(order), start)
        assert travel >= best - 1e-12
        excess.append(travel / best - 1.0 if best else 0.0)
    # 2-opt is a local search.
    assert np.mean(np.array(excess) < 1e-9) >= (1.0 if count < 4 else 0.6)
    assert max(excess) < 0.25


def test_many_places_and_those_that_coincide() -> None:
    rng = np.random.default_rng(0)
    q = rng.uniform(-3.0, 3.0, (60, 6))
    order, _ = shortest_order(q)
    assert sorted(order.tolist()) == list(range(60))
    assert shortest_order(q)[0].tolist() == order.tolist()
    chance = min(length(q, tuple(rng.permutation(60))) for _ in range(20))
    assert length(q, tuple(order)) < 0.8 * chance
    assert sorted(shortest_order(np.zeros((5, 3)))[0].tolist()) == [0, 1, 2, 3, 4]


def crosses(a: Floats, b: Floats) -> bool:
    """A wall at 0 in the first joint with a door where the second is above 1."""
    if (a[0] > 0.0) == (b[0] > 0.0):
        return False
    part = a[0] / (a[0] - b[0])
    return bool(a[1] + part * (b[1] - a[1]) < 1.0)


@pytest.mark.parametrize("with_start", [False, True])
def test_blocked_moves_are_avoided_where_that_is_possible(with_start: bool) -> None:
    avoided = possible = 0
    for seed in range(10):
        rng = np.random.default_rng(seed)
        q = rng.uniform(-2.0, 2.0, (6, 2))
        start = rng.uniform(-2.0, 2.0, 2) if with_start else None
        order, blocked = shortest_order(q, start, lambda a, b: not crosses(a, b))
        # They are those of the order that comes out.
        first = int(with_start)
        way = q[order] if start is None else np.concatenate([start[None], q[order]])
        hits = [k for k, move in enumerate(pairwise(way), 1 - first) if crosses(*move)]
        assert list(blocked) == hits
        fewest = min(
            sum(crosses(a, b) for a, b in pairwise([*way[:first], *q[list(p)]]))
            for p in permutations(range(6))
        )
        possible += fewest == 0
        avoided += len(blocked) == fewest
    assert possible >= 2 and avoided >= 9


def test_the_count_is_true_where_most_is_blocked() -> None:
    """Many places and hardly a free move: the search ends before all is known."""
    rng = np.random.default_rng(0)
    q = rng.uniform(-2.0, 2.0, (40, 2))
    free = rng.random((40, 40)) < 0.1
    free |= free.T
    index = {tuple(place): k for k, place in enumerate(q)}
    asked = 0

    def is_free(a: Floats, b: Floats) -> bool:
        nonlocal asked
        asked += 1
        return bool(free[index[tuple(a)], index[tuple(b)]])

    order, places = shortest_order(q, None, is_free)
    assert len(places) == sum(not free[a, b] for a, b in pairwise(order))
    # Asking is expensive, so not every pair is asked for twice.
    assert asked <= 40 * 39 / 2


PLANAR = calib_pin.load_chain("space7")


def scene(seed: int) -> tuple[np.ndarray, list[Obstacle]]:
    """Two configurations, and a sphere at the tip half-way between them."""
    rng = np.random.default_rng(seed)
    while True:
        a, b = 0.6 * PLANAR.random_configurations(2, rng)
        at = PLANAR.poses(0.5 * (a + b)[None])[0, :3, 3]
        around = [Obstacle(sphere=0.1, xyz=tuple(at.tolist()))]
        ends = np.array([a, b])
        if load_collisions(PLANAR, around).free(ends).all():
            return ends, around


def touched(q: np.ndarray, obstacles: list[Obstacle]) -> bool:
    """Whether anything touches, at no clearance, on straight ways cut very finely."""
    bare = load_collisions(PLANAR, obstacles, clearance=0.0)
    assert bare is not None
    parts = np.linspace(0.0, 1.0, 700)[:, None]
    return not all(bare.free(a + parts * (b - a)).all() for a, b in pairwise(q))


@pytest.mark.parametrize("seed", range(3))
def test_a_move_through_a_sphere_is_seen(seed):
    q, obstacles = scene(seed)
    assert touched(q, obstacles)
    assert not load_collisions(PLANAR, obstacles).move_is_free(*q)


def test_free_moves_are_free():
    q, _ = scene(1)
    free = load_collisions(PLANAR)
    assert free.move_is_free(q[0], q[0] + 0.02) and free.move_is_free(q[0], q[0])


def test_no_point_of_the_robot_moves_farther_than_the_bound():
    reach = load_collisions(PLANAR).reach
    q = PLANAR.random_configurations(100, np.random.default_rng(0))
    for k in range(len(PLANAR.joints)):
        moved = q.copy()
        moved[:, k] += 1e-4
        way = np.linalg.norm((PLANAR.poses(moved) - PLANAR.poses(q))[:, :3, 3], axis=1)
        assert (way <= 1e-4 * reach[k] * (1.0 + 1e-6)).all()
