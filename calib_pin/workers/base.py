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
from functools import lru_cache
from itertools import islice
from math import inf
from pathlib import Path
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

    def sharing(self, payload: bytes) -> AbstractContextManager[Submit]:
        """The way to workers that have a function and its shared value, pickled."""
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
        with self.sharing(payload) as submit:
            yield from self._sent(submit, todo, lost, place)

    def _sent(
        self,
        submit: Submit,
        items: Iterator[Any],
        lost: Callable[[Any], Any] | None,
        place: int,
    ) -> Iterator[Any]:
        """Results of items behind a place, by batches of about a second."""
        sent = deque[tuple[Future[Done], list[Any]]]()
        known, seconds = 1, SECONDS  # At first, an item is a batch.
        try:
            while True:
                size = max(int(SECONDS / max(seconds / known, LEAST)), 1)
                room = len(sent) < AHEAD * self.count
                if room and (batch := list(islice(items, size))):
                    sent.append((submit(batch), batch))
                    continue
                if not sent:
                    return
                future, batch = sent.popleft()
                parts: Iterable[Done | None] = [self._taken(future)]
                if parts == [None]:
                    # Each goes alone, when nothing else is under way: who dies dies
                    # over this item.
                    wait([other for other, _ in sent])
                    parts = (self._taken(submit([item])) for item in batch)
                for item, done in zip(batch, parts, strict=False):
                    if done is None:
                        if lost is None:
                            number = place + 1
                            raise WorkerLost(f"workers died twice over item {number}")
                        place += 1
                        yield lost(item)
                        continue
                    known, seconds = known + len(done.results), seconds + done.seconds
                    for result in done.results:
                        place += 1
                        yield pickle.loads(result)
                    if done.failure is not None:
                        raise done.failure
        finally:
            for future, _ in sent:
                future.cancel()

    def _taken(self, future: Future[Done]) -> Done | None:
        """Results of a batch; None if it was lost with its worker."""
        while not wait([future], timeout=SECONDS).done:
            self.require_there()
        try:
            return future.result()
        except self.died:
            return None


SERIAL = Workers()
"""The default of whatever takes workers."""


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


def alone() -> None:
    """Give this process one thread: there is a worker for every core."""
    for library in LIBRARIES:
        os.environ[f"{library}_NUM_THREADS"] = "1"
    os.environ["VECLIB_MAXIMUM_THREADS"] = "1"
    if numba := sys.modules.get("numba"):  # It has read them already.
        numba.config.NUMBA_NUM_THREADS = 1


@lru_cache(KEPT)
def _loaded(payload: bytes | str) -> tuple[Callable[[Any, Any], Any], Any]:
    """A function and the value that its items share."""
    alone()
    if isinstance(payload, str):
        payload = Path(payload).read_bytes()
    return pickle.loads(payload)  # type: ignore[no-any-return]


def run(payload: bytes | str, items: Sequence[Any]) -> Done:
    """Work on a batch.

    Args:
        payload: A function and the value that its items share, pickled, or the path of
            a file of this, which no other value has.
        items: The items.
    """
    work, shared = _loaded(payload)
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
