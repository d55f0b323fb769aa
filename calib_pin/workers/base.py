"""Workers: many independent items of work, wherever they are done.

The result of an item must depend on nothing but the shared value and the item itself: a
seed belongs to an item, never to a worker. Then results are the same bytes for any
number of workers, and when a worker dies its items are simply done again.

Items go in batches to an executor of `concurrent.futures`. Batches take about a second,
so that sending costs little and a dead worker loses little. They are sent in the order
of their items, and taken in the same.
"""

from __future__ import annotations

import os
import pickle
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, wait
from contextlib import AbstractContextManager
from dataclasses import dataclass, field
from hashlib import sha256
from itertools import islice
from math import inf
from pathlib import Path
from threading import Lock
from typing import Any, NamedTuple, TypeVar

from calib_pin.errors import CalibPinError

SECONDS = 1.0
"""Time that a batch should take."""

LEAST = 1e-4
"""Time that an item is thought to take at least: sending it takes some [s]."""

AHEAD = 8
"""Batches of every worker that are sent, or wait for an earlier result."""

LIBRARIES = ("BLIS", "MKL", "NUMBA", "OMP", "OPENBLAS")
"""Libraries that read a number of threads when they are loaded."""

KEPT = 2
"""Shared values that a worker keeps: a search and what it asks for in between."""

Submit = Callable[[Sequence[Any]], "Future[Done]"]
"""Sends a batch; to new workers where the others have died."""

_Shared = TypeVar("_Shared")
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")


class WorkerLost(CalibPinError):
    """Workers died over the same item twice, or all of them are gone."""


class Workers:
    """Independent items of work, done in this process; the base of other workers.

    Attributes:
        count: Number of items that may be under way at once.
        patience: Time that items are done in this process first [s].
        died: Error of a batch that was lost with its worker.
        acts: The method with which anything may stand in for these.
    """

    count = 1
    acts = "map"
    patience = inf
    died: type[BaseException]

    def sharing(self, digest: bytes, payload: bytes) -> AbstractContextManager[Submit]:
        """The way to workers that have a function and its shared value.

        Args:
            digest: Name of both.
            payload: Both, pickled.
        """
        raise NotImplementedError

    def require_there(self) -> None:
        """Look whether results may still come.

        Raises:
            WorkerLost: If they cannot.
        """

    def map(
        self,
        work: Callable[[_Shared, _Item], _Result],
        shared: _Shared,
        items: Iterable[_Item],
        lost: Callable[[_Item], _Result] | None = None,
    ) -> Iterator[_Result]:
        """Results of items, in their order.

        Args:
            work: A function of a module: it is sent by its name.
            shared: A value that all items need; each worker gets it once.
            items: The items; read little further than the work has come.
            lost: Result of an item over which workers died twice.

        Raises:
            WorkerLost: At the place of such an item, where `lost` is not given.
            Exception: Whatever the work raises, at the place of its item.
        """
        todo, place = iter(items), 0
        if self.patience > 0.0:
            until = time.monotonic() + self.patience
            for item in todo:
                yield work(shared, item)
                place += 1
                if self.count > 1 and time.monotonic() > until:
                    break
            else:
                return
        payload = pickle.dumps((work, shared), pickle.HIGHEST_PROTOCOL)
        with self.sharing(sha256(payload).digest(), payload) as submit:
            yield from _Flow(self, submit, lost, place).results(todo)


SERIAL = Workers()
"""The default of whatever takes workers."""


@dataclass
class _Flow:
    """Items on their way to workers.

    Attributes:
        workers: The workers.
        submit: Sends them a batch.
        lost: Result of an item over which workers died twice.
        place: Number of items whose results were given.
        done: Number of items whose time is known; at first, one that is a batch.
        seconds: Time that these took together.
        sent: Batches whose results were not taken, with their items.
    """

    workers: Workers
    submit: Submit
    lost: Callable[[Any], Any] | None
    place: int
    done: int = 1
    seconds: float = SECONDS
    sent: deque[tuple[Future[Done], Sequence[Any]]] = field(default_factory=deque)

    def results(self, items: Iterator[Any]) -> Iterator[Any]:
        """Results in the order of the items."""
        batches = iter(lambda: list(islice(items, self._size())), [])
        try:
            for batch in batches:
                self.sent.append((self.submit(batch), batch))
                if len(self.sent) == AHEAD * self.workers.count:
                    yield from self._taken(*self.sent.popleft())
            while self.sent:
                yield from self._taken(*self.sent.popleft())
        finally:
            for future, _ in self.sent:
                future.cancel()

    def _size(self) -> int:
        """Items of a batch that takes about a second."""
        return max(int(SECONDS / max(self.seconds / self.done, LEAST)), 1)

    def _taken(
        self, future: Future[Done], items: Sequence[Any], alone: bool = False
    ) -> Iterator[Any]:
        """Results of a batch; of one that was lost, by sending its items again.

        Each goes alone, when nothing else is under way: who dies dies over this item.
        """
        try:
            while not wait([future], timeout=SECONDS).done:
                self.workers.require_there()
            done = future.result()
        except self.workers.died as error:
            if not alone:
                wait([other for other, _ in self.sent])
                for item in items:
                    yield from self._taken(self.submit([item]), [item], alone=True)
            elif self.lost is not None:
                self.place += 1
                yield self.lost(items[0])
            else:
                number = self.place + 1
                raise WorkerLost(f"workers died twice over item {number}") from error
            return
        self.done += len(done.results)
        self.seconds += done.seconds
        for result in done.results:
            self.place += 1
            yield pickle.loads(result)
        if done.failure is not None:
            raise done.failure


class Done(NamedTuple):
    """A batch that was worked on.

    Attributes:
        results: Pickled results of its items, as far as none failed.
        failure: The error of the item behind these, if one failed.
        seconds: Time that it took.
    """

    results: list[bytes]
    failure: Exception | None
    seconds: float


_kept: dict[bytes, tuple[Any, Any]] = {}
_lock = Lock()


def alone() -> None:
    """Give this process one thread: there is a worker for every core."""
    for library in LIBRARIES:
        os.environ[f"{library}_NUM_THREADS"] = "1"
    os.environ["VECLIB_MAXIMUM_THREADS"] = "1"
    if numba := sys.modules.get("numba"):  # It has read them already.
        numba.config.NUMBA_NUM_THREADS = 1


def run(digest: bytes, payload: bytes | str, items: Sequence[Any]) -> Done:
    """Work on a batch.

    Args:
        digest: Name of the function and the value that its items share.
        payload: Both, pickled, or the path of a file of this.
        items: The items.
    """
    with _lock:
        if digest not in _kept:
            alone()
            while len(_kept) >= KEPT:
                del _kept[next(iter(_kept))]
            if isinstance(payload, str):
                payload = Path(payload).read_bytes()
            _kept[digest] = pickle.loads(payload)
        work, shared = _kept[digest]
    start, results, failure = time.perf_counter(), [], None
    for item in items:
        try:
            # Here, so that a result that cannot be sent is an error of its item.
            results.append(pickle.dumps(work(shared, item), pickle.HIGHEST_PROTOCOL))
        except Exception as error:
            failure = _sendable(error)
            break
    return Done(results, failure, time.perf_counter() - start)


def _sendable(error: Exception) -> Exception:
    """The error, or its words where it cannot be sent."""
    try:
        pickle.loads(pickle.dumps(error))
    except Exception:
        return RuntimeError(f"{type(error).__name__}: {error}")
    return error
