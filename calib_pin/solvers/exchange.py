"""Exchange methods that choose a subset of candidates.

`greedy` adds the best candidate until there are enough. `exchange` is DETMAX (Mitchell
1974, doi 10.1080/00401706.1974.10489175): from a subset of the wanted size it makes
excursions that add some candidates and then remove as many members, or the reverse,
each step the best one. If an excursion finds nothing better, the next one is longer by
one exchange; the search ends when the longest fails in both directions.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from calib_pin.solvers.status import Status

LONGEST = 6
"""Exchanges of the longest excursion, as in Mitchell (1974)."""

GAIN = 1e-9
"""Gain in the cost below which two subsets count as equally good."""

Callback = Callable[[int, float], bool | None]
"""Called with the number of steps and the best cost; True stops the search."""


class Subset(Protocol):
    """A mutable subset of candidates that keeps its cost up to date.

    Attributes:
        chosen: Indices of the members, in the order in which they were added.
    """

    chosen: list[int]

    @property
    def cost(self) -> float:
        """Cost of the subset."""
        ...

    @property
    def left(self) -> int:
        """Number of candidates that are not members."""
        ...

    def best_to_add(self) -> tuple[int, float]:
        """The candidate whose addition gives the least cost, and that cost."""
        ...

    def best_to_remove(self) -> tuple[int, float]:
        """The member whose removal gives the least cost, and that cost."""
        ...

    def add(self, candidate: int) -> None:
        """Add a candidate."""
        ...

    def remove(self, candidate: int) -> None:
        """Remove a member."""
        ...

    def reset(self, chosen: list[int]) -> None:
        """Replace all members."""
        ...


@dataclass(frozen=True)
class SelectionResult:
    """Outcome of a selection.

    Attributes:
        chosen: Indices of the members, in the order in which they were added, if any.
        cost: Their cost.
        nit: Number of additions and removals, or of generations.
        status: How the search ended.
    """

    chosen: tuple[int, ...]
    cost: float
    nit: int
    status: Status


def greedy(
    subset: Subset, count: int, callback: Callback | None = None
) -> SelectionResult:
    """Add the best candidate until there are `count` members; changes the subset.

    Args:
        subset: The subset to begin with.
        count: Number of members to reach.
        callback: Called after every addition.
    """
    steps, status = 0, Status.CONVERGED
    while len(subset.chosen) < count:
        subset.add(subset.best_to_add()[0])
        steps += 1
        if callback is not None and callback(steps, subset.cost):
            status = Status.STOPPED
            break
    return SelectionResult(tuple(subset.chosen), subset.cost, steps, status)


def exchange(subset: Subset, callback: Callback | None = None) -> SelectionResult:
    """Exchange members for candidates until nothing improves; changes the subset.

    Args:
        subset: The subset to begin with; its size stays.
        callback: Called after every excursion.
    """
    best, best_cost = list(subset.chosen), subset.cost
    steps, length = 0, 1
    while length <= LONGEST:
        improved = False
        for first_add in (True, False):
            if length > (subset.left if first_add else len(best)):
                continue
            _excursion(subset, length, first_add)
            steps += 2 * length
            if subset.cost < best_cost - GAIN:
                best, best_cost, improved = list(subset.chosen), subset.cost, True
            else:
                subset.reset(best)
            if callback is not None and callback(steps, best_cost):
                return SelectionResult(tuple(best), best_cost, steps, Status.STOPPED)
        # After a gain, short excursions may succeed again.
        length = 1 if improved else length + 1
    return SelectionResult(tuple(best), best_cost, steps, Status.CONVERGED)


def _excursion(subset: Subset, length: int, first_add: bool) -> None:
    """Add and then remove `length` candidates, or remove and then add them."""
    for add in (first_add, not first_add):
        for _ in range(length):
            if add:
                subset.add(subset.best_to_add()[0])
            else:
                subset.remove(subset.best_to_remove()[0])
