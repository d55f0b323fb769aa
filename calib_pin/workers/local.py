"""Workers on this machine: processes of our own."""

from __future__ import annotations

import os
import shutil
import signal
import threading
import time
from collections.abc import Iterator
from concurrent.futures import BrokenExecutor, Future
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from pathlib import Path
from tempfile import NamedTemporaryFile, TemporaryDirectory
from typing import TYPE_CHECKING, Any

from calib_pin.workers.base import Submit, Workers, alone, run

if TYPE_CHECKING:
    from concurrent.futures import ProcessPoolExecutor

PATIENCE = 1.0
"""Time that items are done in this process before others are started, which takes about
as long [s]."""

GLANCE = 0.2
"""Time after which a worker looks again whether it is still needed [s]."""


def cores() -> int:
    """Number of cores that this process may use."""
    if hasattr(os, "sched_getaffinity"):
        return len(os.sched_getaffinity(0))
    return os.cpu_count() or 1


class LocalProcesses(Workers, AbstractContextManager["LocalProcesses"]):
    """Processes on this machine; a context that ends them.

    Args:
        count: Number of processes; default one for every core.
        patience: Time that items are done in this process first [s]; zero where an item
            may end its process.
    """

    died = BrokenExecutor

    def __init__(self, count: int | None = None, patience: float = PATIENCE) -> None:
        """Start nothing yet."""
        self.count = cores() if count is None else count
        self.patience = patience
        self._executor: ProcessPoolExecutor | None = None
        self._folder = TemporaryDirectory(prefix="calib-pin-")

    def __exit__(self, *_: object) -> None:
        """End the processes, whatever they are doing."""
        self._folder.cleanup()
        if self._executor is not None:
            # They go with their folder. Not to wait would leave its end to that of
            # Python, which then may find its pipe closed.
            self._executor.shutdown(wait=True, cancel_futures=True)

    @contextmanager
    def sharing(self, payload: bytes) -> Iterator[Submit]:
        """The way to processes, with a file of what they share."""
        with NamedTemporaryFile(dir=self._folder.name, delete=False) as file:
            file.write(payload)
        try:
            yield partial(self._submit, file.name)
        finally:
            Path(file.name).unlink(missing_ok=True)

    def _submit(self, file: str, item: Any) -> Future[Any]:
        if self._executor is None:
            # Most commands need none, and do not load what starts them.
            from concurrent.futures import ProcessPoolExecutor
            from multiprocessing import get_context

            # Not forked: a copy of a process with threads may hang.
            spawn, ties = get_context("spawn"), (os.getpid(), self._folder.name)
            self._executor = ProcessPoolExecutor(self.count, spawn, _begin, ties)
        try:
            return self._executor.submit(run, file, item)
        except BrokenExecutor:
            self._executor = None
            return self._submit(file, item)


def _begin(parent: int, folder: str) -> None:
    """Begin a worker: one thread, deaf to Ctrl-C, and no longer there than its parent.

    Args:
        parent: Process that gives the work.
        folder: Folder that it removes when it needs no worker any more.
    """
    alone()
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.signal(signal.SIGTERM, signal.SIG_DFL)
    threading.Thread(target=_end, args=(parent, folder), daemon=True).start()


def _end(parent: int, folder: str) -> None:
    while os.getppid() == parent and Path(folder).exists():
        time.sleep(GLANCE)
    shutil.rmtree(folder, ignore_errors=True)  # A parent that was killed leaves it.
    os._exit(1)
