"""Workers on this machine: processes of our own."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor
from concurrent.futures.process import BrokenProcessPool
from contextlib import suppress
from multiprocessing import get_context, parent_process
from multiprocessing.connection import wait
from types import TracebackType
from typing import Any, Self, TypeVar

from calib_pin.workers.distributed import Share, distribute
from calib_pin.workers.remote import Done, alone, keep, run

_Shared = TypeVar("_Shared")
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

PATIENCE = 1.0
"""Time that items are done in this process before others are started, which takes about
as long [s]."""


def cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class LocalProcesses:
    """Processes on this machine; a context that ends them.

    Args:
        count: Number of processes; default one for every core.
        patience: Time that items are done in this process first [s]; zero where an item
            may end its process.
    """

    def __init__(self, count: int | None = None, patience: float = PATIENCE) -> None:
        """Start nothing yet."""
        self.count = cores() if count is None else count
        self._patience = patience
        self._seats = [_Process() for _ in range(self.count)]

    def __enter__(self) -> Self:
        """Start nothing yet."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """End the processes, whatever they are doing."""
        for seat in self._seats:
            seat.end()

    def map(
        self,
        work: Callable[[_Shared, _Item], _Result],
        shared: _Shared,
        items: Iterable[_Item],
        lost: Callable[[_Item], _Result] | None = None,
    ) -> Iterator[_Result]:
        """Results of items, in their order; see `Workers.map`."""
        todo, done = iter(items), 0
        if self._patience > 0.0:
            until = time.monotonic() + self._patience
            for item in todo:
                yield work(shared, item)
                done += 1
                if self.count > 1 and time.monotonic() > until:
                    break
        left = items[done:] if isinstance(items, Sequence) else todo
        yield from distribute(self._seats, work, shared, left, lost)


class _Process:
    """A seat: one process, which ends with this one."""

    died = (BrokenProcessPool,)
    tries = 3

    def __init__(self) -> None:
        self._executor: ProcessPoolExecutor | None = None
        self._pid: Future[int] = Future()
        self._kept = b""

    def submit(self, share: Share, items: Sequence[Any]) -> Future[Done]:
        """Send a batch, and before the first one what all share."""
        if self._executor is None:
            # Not forked: a copy of a process with threads may hang.
            self._executor = ProcessPoolExecutor(
                1, mp_context=get_context("spawn"), initializer=_begin
            )
            self._pid = self._executor.submit(os.getpid)
        try:
            if self._kept != share.digest:
                self._executor.submit(keep, share.digest, share.payload)
                self._kept = share.digest
            return self._executor.submit(run, share.digest, None, items)
        except BrokenProcessPool as error:  # It died with nothing to do.
            future: Future[Done] = Future()
            future.set_exception(error)
            return future

    def renew(self) -> bool:
        """Forget the process; all batches that it had are lost."""
        self.end()
        return True

    def end(self) -> None:
        """End the process, whatever it is doing; the next batch starts another one."""
        if self._executor is None:
            return
        self._executor.shutdown(wait=False, cancel_futures=True)
        self._executor, self._kept = None, b""
        # One that has not yet begun finds nothing to do.
        if self._pid.done() and not self._pid.cancelled() and not self._pid.exception():
            with suppress(ProcessLookupError):
                os.kill(self._pid.result(), signal.SIGTERM)


def _begin() -> None:
    """Begin a worker: one thread, deaf to Ctrl-C, and no longer there than its parent.

    A parent that was killed cannot end it, and the pipes between them stay open.
    """
    alone()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end_with_parent, daemon=True).start()


def _end_with_parent() -> None:
    parent = parent_process()
    if parent is not None:
        wait([parent.sentinel])
        os._exit(1)
