"""Workers: many independent items of work, wherever they are done.

The result of an item must depend on nothing but the shared value and the item itself: a
seed belongs to an item, never to a worker. Then results are the same bytes for any
number of workers, and when a worker dies its items are simply done again.

Items go one by one to an executor of `concurrent.futures`, in their order, and are
taken in the same.
"""

from __future__ import annotations

import os
import pickle
import sys
import time
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, wait
from contextlib import AbstractContextManager
from functools import lru_cache
from itertools import islice
from math import inf
from pathlib import Path
from typing import Any, TypeVar

from calib_pin.errors import CalibPinError
from calib_pin.workers.threads import limit_blas

GLANCE = 1.0
"""Time after which whoever waits looks whether results may still come [s]."""

AHEAD = 8
"""Items of every worker that are sent, or wait for an earlier result."""

KEPT = 2
"""Shared values that a worker keeps: a search and what it asks for in between."""

Submit = Callable[[Any], "Future[Any]"]
"""Sends an item; to new workers where the others have died."""

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
        died: Error of an item that was lost with its worker.
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
        todo = enumerate(items, start=1)
        if self.patience > 0.0:
            until = time.monotonic() + self.patience
            for _, item in todo:
                yield work(shared, item)
                if self.count > 1 and time.monotonic() > until:
                    break
            else:
                return
        payload = pickle.dumps((work, shared), pickle.HIGHEST_PROTOCOL)
        with self.sharing(payload) as submit:
            yield from self._sent(submit, todo, lost)

    def _sent(
        self,
        submit: Submit,
        items: Iterator[tuple[int, Any]],
        lost: Callable[[Any], Any] | None,
    ) -> Iterator[Any]:
        """Results of numbered items that are sent to workers."""
        sent = deque[tuple[Future[Any], int, Any]]()
        try:
            while True:
                ahead = islice(items, AHEAD * self.count - len(sent))
                sent.extend((submit(item), number, item) for number, item in ahead)
                if not sent:
                    return
                future, number, item = sent.popleft()
                try:
                    result = self._collect(future)
                except self.died:
                    # It goes again when nothing else is under way: who dies dies over
                    # this item.
                    wait([other for other, _, _ in sent])
                    try:
                        result = self._collect(submit(item))
                    except self.died:
                        if lost is None:
                            reason = f"workers died twice over item {number}"
                            raise WorkerLost(reason) from None
                        result = lost(item)
                yield result
        finally:
            for future, _, _ in sent:
                future.cancel()

    def _collect(self, future: Future[Any]) -> Any:
        """The result of an item, as soon as it is there."""
        while not wait([future], timeout=GLANCE).done:
            self.require_there()
        return future.result()


SERIAL = Workers()
"""The default of whatever takes workers."""


def alone() -> None:
    """Give this process one thread: there is a worker for every core."""
    limit_blas()
    os.environ["NUMBA_NUM_THREADS"] = "1"
    if numba := sys.modules.get("numba"):  # It has read them already.
        numba.config.NUMBA_NUM_THREADS = 1


@lru_cache(KEPT)
def _loaded(payload: bytes | str) -> tuple[Callable[[Any, Any], Any], Any]:
    """A function and the value that its items share."""
    alone()
    if isinstance(payload, str):
        payload = Path(payload).read_bytes()
    return pickle.loads(payload)  # type: ignore[no-any-return]


def run(payload: bytes | str, item: Any) -> Any:
    """Work on an item.

    Args:
        payload: A function and the value that its items share, pickled, or the path of
            a file of this, which no other value has.
        item: The item.
    """
    work, shared = _loaded(payload)
    return work(shared, item)
