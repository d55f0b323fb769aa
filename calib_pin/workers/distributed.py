"""Batches of items on seats, each of which works on one after the other.

A seat is a place behind an executor of `concurrent.futures`: a process of our own, or a
thread of a cluster. Batches take about a second, so that sending costs little and a
dead worker loses little.
"""

from __future__ import annotations

import pickle
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from hashlib import sha256
from itertools import islice
from queue import SimpleQueue
from typing import Any, Protocol, TypeVar

from calib_pin.workers.base import WorkerLost
from calib_pin.workers.remote import Done

_Shared = TypeVar("_Shared")
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

SECONDS = 1.0
"""Time that a batch should take."""

LARGEST = 10_000
"""Items of a batch, at most."""

QUEUED = 2
"""Batches of a seat: one is worked on while the next one is sent."""

AHEAD = 8
"""Batches of results for every seat that may wait for an earlier result."""

ENDGAME = 3
"""Parts for every seat, at least, into which the rest of the items is cut, so that none
works on while all others have nothing to do."""


@dataclass(frozen=True)
class Share:
    """A function and a value that all its items need, pickled once."""

    payload: bytes
    digest: bytes

    @staticmethod
    def of(work: Callable[..., Any], shared: object) -> Share:
        """Pickle both."""
        payload = pickle.dumps((work, shared), protocol=pickle.HIGHEST_PROTOCOL)
        return Share(payload, sha256(payload).digest())


class Seat(Protocol):
    """A place where one batch after the other is worked on."""

    @property
    def died(self) -> tuple[type[BaseException], ...]:
        """Errors of a batch whose worker died."""
        ...

    @property
    def tries(self) -> int:
        """Times that a batch may end so before it is given up."""
        ...

    def submit(self, share: Share, items: Sequence[Any]) -> Future[Done]:
        """Send a batch."""
        ...

    def renew(self) -> bool:
        """Put a new worker in the place of one that died.

        Returns:
            Whether the other batches of this seat have died with it.
        """
        ...


@dataclass
class _Batch:
    """Items on their way.

    Attributes:
        start: Place of the first one among all.
        items: The items.
        deaths: Times that a worker died over them.
        sent: Number of batches that were sent before.
    """

    start: int
    items: Sequence[Any]
    deaths: int = 0
    sent: int = 0

    def __len__(self) -> int:
        return len(self.items)

    def split(self) -> list[_Batch]:
        """Batches of single items, to tell over which of them workers die."""
        return [
            _Batch(self.start + k, [item], self.deaths)
            for k, item in enumerate(self.items)
        ]


class Dispatch:
    """Items on their way over some seats; iterates over results in order.

    What it does for a batch takes the same time however many seats there are.

    Args:
        seats: The seats.
        share: The function and the shared value.
        items: The items.
        total: Number of items, where it is known.
        lost: Result of an item over which workers died again and again.
    """

    def __init__(
        self,
        seats: Sequence[Seat],
        share: Share,
        items: Iterator[Any],
        total: int | None = None,
        lost: Callable[[Any], Any] | None = None,
    ) -> None:
        """Send nothing yet."""
        self._seats, self._share, self._items = seats, share, items
        self._total, self._lost = total, lost
        # Every seat once, then every seat a second time: all begin before any queues.
        self._vacant = deque([*range(len(seats))] * QUEUED)
        self._read = self._sent = self._done = 0
        self._seconds = 0.0
        self._again: deque[_Batch] = deque()
        self._under_way: dict[Future[Done], tuple[int, _Batch]] = {}
        self._back: SimpleQueue[Future[Done]] = SimpleQueue()
        self._ready: dict[int, Any] = {}

    def __iter__(self) -> Iterator[Any]:
        """Results in the order of the items."""
        place = 0
        try:
            while True:
                self._fill()
                if place in self._ready:
                    found = self._ready.pop(place)
                    if isinstance(found, _Failed):
                        raise found.error
                    yield found
                    place += 1
                elif self._under_way:
                    self._take(self._back.get())
                else:
                    return
        finally:
            for future in self._under_way:
                future.cancel()

    def _fill(self) -> None:
        """Give every seat its batches.

        Results that wait for an earlier one take memory, so no seat runs far ahead.
        """
        while self._vacant:
            far = len(self._ready) > AHEAD * len(self._seats) * self._size()
            batch = None if far and not self._again else self._next()
            if batch is None:
                return
            number = self._vacant.popleft()
            batch.sent, self._sent = self._sent, self._sent + 1
            future = self._seats[number].submit(self._share, batch.items)
            self._under_way[future] = number, batch
            future.add_done_callback(self._back.put)

    def _next(self) -> _Batch | None:
        if self._again:
            return self._again.popleft()
        items = list(islice(self._items, self._size()))
        batch = _Batch(self._read, items)
        self._read += len(items)
        return batch if items else None

    def _size(self) -> int:
        """Items of a batch that takes about a second."""
        if not self._done:
            return 1
        size = SECONDS * self._done / max(self._seconds, 1e-6)
        if self._total is not None:
            rest = self._total - self._read
            size = min(size, rest / (ENDGAME * len(self._seats)))
        return int(min(max(size, 1), LARGEST))

    def _take(self, future: Future[Done]) -> None:
        """Take the results of a batch, or send it again."""
        if future not in self._under_way:
            return  # It was lost with another one of its seat.
        number, batch = self._under_way.pop(future)
        self._vacant.append(number)
        seat = self._seats[number]
        try:
            done = future.result()
        except seat.died:
            self._bury(number, batch)
            return
        self._done += max(len(done.results), 1)
        self._seconds += done.seconds
        for k, result in enumerate(done.results):
            self._ready[batch.start + k] = result
        if done.failure is not None:
            place = batch.start + len(done.results)
            self._ready[place] = _Failed(done.failure)

    def _bury(self, number: int, batch: _Batch) -> None:
        """Send what a dead worker had again; the batch it worked on counts a death."""
        seat, dead = self._seats[number], [batch]
        if seat.renew():
            others = [f for f, (k, _) in self._under_way.items() if k == number]
            dead += [self._under_way.pop(future)[1] for future in others]
            self._vacant.extend([number] * len(others))
        # A worker dies over the first of its batches; the others only waited.
        first, *waiting = sorted(dead, key=lambda one: one.sent)
        first.deaths += 1
        self._again.extendleft(reversed(waiting))
        if first.deaths < seat.tries:
            self._again.extendleft(reversed(first.split()))
            return
        error = WorkerLost(f"workers died over item {first.start + 1}, again and again")
        for k, item in enumerate(first.items):
            given_up = _Failed(error) if self._lost is None else self._lost(item)
            self._ready[first.start + k] = given_up


@dataclass(frozen=True)
class _Failed:
    """An error in the place of a result."""

    error: Exception


def distribute(
    seats: Sequence[Seat],
    work: Callable[[_Shared, _Item], _Result],
    shared: _Shared,
    items: Iterable[_Item],
    lost: Callable[[_Item], _Result] | None,
) -> Iterator[_Result]:
    """Results of items over seats, see `Workers.map`."""
    total = len(items) if isinstance(items, Sequence) else None
    share = Share.of(work, shared)
    return iter(Dispatch(seats, share, iter(items), total, lost))
