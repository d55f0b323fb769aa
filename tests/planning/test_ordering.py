"""The order of a plan against all orders there are."""

from __future__ import annotations

from itertools import pairwise, permutations

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.travel import shortest_order


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
        order, blocked = shortest_order(q, start, crosses)
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

    def blocked(a: Floats, b: Floats) -> bool:
        nonlocal asked
        asked += 1
        return not free[index[tuple(a)], index[tuple(b)]]

    order, places = shortest_order(q, None, blocked)
    assert len(places) == sum(not free[a, b] for a, b in pairwise(order))
    # Asking is expensive, so not every pair is asked for twice.
    assert asked <= 40 * 39 / 2
