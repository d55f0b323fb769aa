"""Exchange methods on subsets whose costs a test can count and enumerate."""

from __future__ import annotations

from itertools import combinations

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import Status, exchange, greedy


class Volume:
    """Rows chosen so that their information has a large determinant."""

    def __init__(self, rows: Floats, chosen: list[int]) -> None:
        self.rows, self.chosen = rows, list(chosen)
        self.sizes: list[int] = []

    @property
    def cost(self) -> float:
        return self.of(self.chosen)

    @property
    def left(self) -> int:
        return len(self.rows) - len(self.chosen)

    def of(self, chosen: list[int]) -> float:
        assert len(set(chosen)) == len(chosen), "a candidate is chosen twice"
        U = self.rows[chosen]
        sign, logarithm = np.linalg.slogdet(U.T @ U + 1e-9 * np.eye(U.shape[1]))
        return -float(logarithm) if sign > 0 else np.inf

    def best_to_add(self) -> tuple[int, float]:
        left = [k for k in range(len(self.rows)) if k not in self.chosen]
        costs = [self.of([*self.chosen, k]) for k in left]
        k = int(np.argmin(costs))
        return left[k], costs[k]

    def best_to_remove(self) -> tuple[int, float]:
        costs = [self.of([m for m in self.chosen if m != k]) for k in self.chosen]
        k = int(np.argmin(costs))
        return self.chosen[k], costs[k]

    def add(self, candidate: int) -> None:
        assert candidate not in self.chosen
        self.chosen.append(candidate)
        self.sizes.append(len(self.chosen))

    def remove(self, candidate: int) -> None:
        self.chosen.remove(candidate)
        self.sizes.append(len(self.chosen))

    def reset(self, chosen: list[int]) -> None:
        self.chosen = list(chosen)


def rows_of(seed: int, count: int = 12, size: int = 4) -> Floats:
    return np.random.default_rng(seed).normal(size=(count, size))


def test_greedy_adds_the_best_of_all_each_time() -> None:
    rows = rows_of(0)
    result = greedy(Volume(rows, []), 6)
    assert (result.status, result.nit, len(result.chosen)) == (Status.CONVERGED, 6, 6)
    for k in range(6):
        volume = Volume(rows, list(result.chosen[:k]))
        assert volume.best_to_add()[0] == result.chosen[k]
    assert result.cost == Volume(rows, []).of(list(result.chosen))


def test_sizes_stay_when_there_are_few_candidates() -> None:
    """An excursion cannot add more than there are, nor the same one again."""
    for count in range(5, 9):
        volume = Volume(rows_of(3, count=8), list(range(count)))
        first = volume.cost
        result = exchange(volume)
        assert len(set(result.chosen)) == count
        assert max(volume.sizes, default=0) <= 8
        assert result.cost <= first
        best = min(volume.of(list(some)) for some in combinations(range(8), count))
        assert result.cost == pytest.approx(best, abs=1e-9)


@pytest.mark.parametrize("after", [1, 3, 7])
def test_exchange_stops_with_the_best_so_far(after: int) -> None:
    seen: list[tuple[int, float]] = []

    def callback(steps: int, cost: float) -> bool:
        seen.append((steps, cost))
        return len(seen) == after

    volume = Volume(rows_of(5, count=30, size=6), list(range(8)))
    first = volume.cost
    result = exchange(volume, callback)
    assert (len(seen), result.status) == (after, Status.STOPPED)
    assert len(set(result.chosen)) == 8
    assert result.cost == seen[-1][1] == volume.of(list(result.chosen)) <= first
    assert result.nit == seen[-1][0]
    # The best of all that was told.
    assert result.cost == min(cost for _, cost in seen)
    assert [cost for _, cost in seen] == sorted((c for _, c in seen), reverse=True)


def test_exchange_against_every_subset() -> None:
    """DETMAX is a local search: it is at the optimum nearly always, never far off."""
    hits = greedy_hits = 0
    for seed in range(8):
        rows = rows_of(seed, count=10)
        volume = Volume(rows, [])
        start = greedy(volume, 5)
        result = exchange(volume)
        least = min(volume.of(list(some)) for some in combinations(range(10), 5))
        assert result.status is Status.CONVERGED
        assert result.cost == volume.of(list(result.chosen))
        assert least - 1e-9 <= result.cost <= start.cost + 1e-9
        # What is returned is also where the subset stands.
        assert volume.chosen == list(result.chosen)
        hits += result.cost < least + 1e-6
        greedy_hits += start.cost < least + 1e-6
    assert greedy_hits < hits >= 7


def test_the_limits_of_both() -> None:
    volume = Volume(rows_of(0), [3, 4])
    done = greedy(volume, 2, lambda *_: True)
    assert (done.chosen, done.nit, done.status) == ((3, 4), 0, Status.CONVERGED)
    stopped = greedy(volume, 6, lambda steps, _: steps == 3)
    assert (len(stopped.chosen), stopped.status) == (5, Status.STOPPED)
    assert exchange(Volume(np.array([[0.5], [3.0], [2.0]]), [0])).chosen == (1,)
