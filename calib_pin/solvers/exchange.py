"""Exchange methods that choose some of many candidates.

`greedy` adds the best candidate until there are enough. `exchange` is DETMAX (Mitchell
1974, doi 10.1080/00401706.1974.10489175): from a subset of the wanted size it makes
excursions that add some candidates and then remove as many members, or the other way
round, each step the best one. An excursion of one exchange that finds nothing better is
followed by a longer one; when the longest fails in both directions, nothing improves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

from calib_pin.errors import OptionError
from calib_pin.solvers.status import Status

LONGEST = 6
"""Exchanges of the longest excursion, as Mitchell has it."""

GAIN = 1e-9
"""Gain in the cost below which two subsets count as equally good."""

Callback = Callable[[int, float], bool | None]
"""Told the number of steps and the best cost; True stops the search."""


class Subset(Protocol):
    """A subset of candidates whose cost follows every change.

    Attributes:
        chosen: The members, in the order in which they came.
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
        """The candidate whose addition costs least, and the cost after it."""
        ...

    def best_to_remove(self) -> tuple[int, float]:
        """The member whose removal costs least, and the cost after it."""
        ...

    def add(self, candidate: int) -> None:
        """Add a candidate."""
        ...

    def remove(self, candidate: int) -> None:
        """Remove a member."""
        ...

    def reset(self, chosen: list[int]) -> None:
        """Become another subset."""
        ...


@dataclass(frozen=True)
class ExchangeResult:
    """Outcome of an exchange method.

    Attributes:
        chosen: The members, in the order in which they came.
        cost: Their cost.
        nit: Number of candidates that were added or removed on the way.
        status: How the search ended.
    """

    chosen: tuple[int, ...]
    cost: float
    nit: int
    status: Status


def greedy(
    subset: Subset, count: int, callback: Callback | None = None
) -> ExchangeResult:
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
    return ExchangeResult(tuple(subset.chosen), subset.cost, steps, status)


def exchange(
    subset: Subset,
    callback: Callback | None = None,
    *,
    longest: int = LONGEST,
    max_steps: int = 100_000,
) -> ExchangeResult:
    """Exchange members for candidates until nothing improves; changes the subset.

    Args:
        subset: The subset to begin with; its size stays.
        callback: Called after every excursion.
        longest: Exchanges of the longest excursion.
        max_steps: Limit on the additions and removals.

    Raises:
        OptionError: If the longest excursion has no exchange.
    """
    if longest < 1:
        raise OptionError(
            "excursions are too short", value=longest, allowed="1 or more"
        )
    best, least = list(subset.chosen), subset.cost
    steps, length = 0, 1
    status = Status.CONVERGED
    while length <= longest:
        improved = False
        for first_add in (True, False):
            if length > (subset.left if first_add else len(best)):
                continue
            _excursion(subset, length, first_add)
            steps += 2 * length
            if subset.cost < least - GAIN:
                best, least, improved = list(subset.chosen), subset.cost, True
            else:
                subset.reset(best)
            if callback is not None and callback(steps, least):
                return ExchangeResult(tuple(best), least, steps, Status.STOPPED)
        # A gain may make short excursions worth while again.
        length = 1 if improved else length + 1
        if steps >= max_steps:
            status = Status.ITERATIONS
            break
    return ExchangeResult(tuple(best), least, steps, status)


def _excursion(subset: Subset, length: int, first_add: bool) -> None:
    for add in (first_add, not first_add):
        for _ in range(length):
            if add:
                subset.add(subset.best_to_add()[0])
            else:
                subset.remove(subset.best_to_remove()[0])
