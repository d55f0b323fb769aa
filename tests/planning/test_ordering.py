"""The order of a plan against all orders there are."""

from __future__ import annotations

from itertools import pairwise, permutations

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.ordering import shortest_order


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


def nearest_neighbor(q: Floats, first: int, start: Floats | None = None) -> float:
    """Travel of the path that always goes on to the nearest place."""
    order, left = [first], [k for k in range(len(q)) if k != first]
    while left:
        here = q[order[-1]]
        nearest = min(left, key=lambda k: np.abs(q[k] - here).max())
        order.append(nearest)
        left.remove(nearest)
    return length(q, tuple(order), start)


@pytest.mark.parametrize("with_start", [False, True])
@pytest.mark.parametrize("count", [1, 2, 3, 5, 7])
def test_against_every_order(count: int, with_start: bool) -> None:
    hits, cases, excess = 0, 15, []
    for seed in range(cases):
        rng = np.random.default_rng(seed)
        q = rng.uniform(-2.0, 2.0, (count, 3))
        start = rng.uniform(-2.0, 2.0, 3) if with_start else None
        order, blocked = shortest_order(q, start)
        assert sorted(order.tolist()) == list(range(count))
        assert blocked == ()
        best = float(all_lengths(q, start).min())
        travel = length(q, tuple(order), start)
        assert travel >= best - 1e-12
        excess.append(travel / best - 1.0 if best else 0.0)
        hits += travel <= best + 1e-9
    # 2-opt is a local search.
    assert hits >= (1.0 if count < 4 else 0.7) * cases
    assert max(excess) < 0.25


@pytest.mark.parametrize("with_start", [False, True])
@pytest.mark.parametrize("count", [10, 40])
def test_never_longer_than_nearest_neighbors(count: int, with_start: bool) -> None:
    shorter = 0
    for seed in range(8):
        rng = np.random.default_rng(seed)
        q = rng.uniform(-2.0, 2.0, (count, 6))
        start = rng.uniform(-2.0, 2.0, 6) if with_start else None
        order, _ = shortest_order(q, start)
        travel = length(q, tuple(order), start)
        firsts = range(count)
        if start is not None:
            firsts = [int(np.abs(q - start).max(axis=1).argmin())]
        simple = min(nearest_neighbor(q, first, start) for first in firsts)
        assert travel <= simple + 1e-9
        shorter += travel < simple - 1e-9
    assert shorter >= 6


def test_the_start_stands_before_the_first() -> None:
    q = np.array([[3.0], [1.0], [2.0]])
    assert shortest_order(q, np.array([0.0]))[0].tolist() == [1, 2, 0]
    assert shortest_order(q, np.array([4.0]))[0].tolist() == [0, 2, 1]


def crosses(a: Floats, b: Floats) -> bool:
    """A wall at 0 in the first joint with a door where the second is above 1."""
    if (a[0] > 0.0) == (b[0] > 0.0):
        return False
    part = a[0] / (a[0] - b[0])
    return bool(a[1] + part * (b[1] - a[1]) < 1.0)


def blocked_moves(q: Floats, order: tuple[int, ...], start: Floats | None) -> int:
    places = [q[k] for k in order]
    if start is not None:
        places = [start, *places]
    return sum(crosses(a, b) for a, b in pairwise(places))


@pytest.mark.parametrize("with_start", [False, True])
def test_blocked_moves_are_avoided_where_that_is_possible(with_start: bool) -> None:
    avoided, possible, without = 0, 0, 0
    for seed in range(25):
        rng = np.random.default_rng(seed)
        q = rng.uniform(-2.0, 2.0, (6, 2))
        start = rng.uniform(-2.0, 2.0, 2) if with_start else None
        order, blocked = shortest_order(q, start, crosses)
        assert sorted(order.tolist()) == list(range(6))
        # They are those of the order that comes out.
        way = q[order] if start is None else np.concatenate([start[None], q[order]])
        places = range(1 if start is None else 0, 6)
        shift = 0 if start is None else 1
        expected = [k for k in places if crosses(way[k + shift - 1], way[k + shift])]
        assert list(blocked) == expected
        best = min(blocked_moves(q, p, start) for p in permutations(range(6)))
        assert len(blocked) >= best
        possible += best == 0
        avoided += len(blocked) == best
        careless, _ = shortest_order(q, start)
        without += blocked_moves(q, tuple(careless), start) == best
    assert possible >= 5
    assert avoided >= 23
    assert without < avoided


def test_the_count_is_true_where_most_is_blocked() -> None:
    """Many places and hardly a free move: the search ends before all is known."""
    for seed in range(3):
        rng = np.random.default_rng(seed)
        q = rng.uniform(-2.0, 2.0, (40, 2))
        free = rng.random((40, 40)) < 0.1
        free |= free.T
        index = {tuple(place): k for k, place in enumerate(q)}
        asked = 0

        def blocked(a: Floats, b: Floats) -> bool:
            nonlocal asked
            asked += 1
            return not free[index[tuple(a)], index[tuple(b)]]  # noqa: B023

        order, places = shortest_order(q, None, blocked)
        assert len(places) == sum(not free[a, b] for a, b in pairwise(order))
        # Asking is expensive, so not every pair is asked for twice.
        assert asked <= 40 * 39 / 2


def test_a_move_is_asked_for_once_only() -> None:
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (12, 2))
    asked: list[tuple[float, ...]] = []

    def blocked(a: Floats, b: Floats) -> bool:
        asked.append(tuple(sorted([*a, *b])))
        return crosses(a, b)

    shortest_order(q, None, blocked)
    assert len(asked) == len(set(asked)) < 12 * 11 / 2


def test_the_same_places_give_the_same_order() -> None:
    q = np.random.default_rng(0).normal(size=(30, 6))
    assert shortest_order(q)[0].tolist() == shortest_order(q)[0].tolist()


def test_places_that_coincide() -> None:
    q = np.zeros((5, 3))
    order, _ = shortest_order(q)
    assert sorted(order.tolist()) == [0, 1, 2, 3, 4]


def test_many_places() -> None:
    q = np.random.default_rng(0).uniform(-3.0, 3.0, (250, 6))
    order, _ = shortest_order(q)
    assert sorted(order.tolist()) == list(range(250))
