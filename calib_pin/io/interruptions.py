"""Moments that nothing interrupts: signals that wait, folders that are locked."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from calib_pin.errors import OutputError

PATIENCE = 30.0
"""How long a folder may stay locked [s]; runs hold it while they write, not longer."""


@contextmanager
def signals_deferred() -> Iterator[None]:
    """Let Ctrl-C and SIGTERM wait for the end of the block.

    Python handles signals in the main thread alone; elsewhere nothing has to wait.

    Example:
        >>> seen = []
        >>> before = signal.signal(signal.SIGTERM, lambda *_: seen.append("signal"))
        >>> with signals_deferred():
        ...     signal.raise_signal(signal.SIGTERM)
        ...     seen.append("all of it")
        >>> _ = signal.signal(signal.SIGTERM, before)
        >>> seen
        ['all of it', 'signal']
    """
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    caught: list[int] = []
    handlers = {
        number: signal.signal(number, lambda found, _: caught.append(found))
        for number in (signal.SIGINT, signal.SIGTERM)
    }
    try:
        yield
    finally:
        for number, handler in handlers.items():
            # None stands for a handler that was not set from Python.
            signal.signal(number, signal.SIG_DFL if handler is None else handler)
        for found in caught:
            signal.raise_signal(found)


@contextmanager
def locked(folder: Path, *, shared: bool = False) -> Iterator[bool]:
    """Keep the other runs out of a folder.

    The lock is one of the system on the folder itself: no file stands for it, and it
    ends with the process whatever happens to that.

    Args:
        folder: The folder.
        shared: Keep out only those that write.

    Yields:
        Whether there is such a lock; some file systems, and Windows, know none.

    Raises:
        OutputError: If another program does not let go of the folder.
    """
    try:
        import fcntl

        descriptor = os.open(folder, os.O_RDONLY)
    except (ImportError, OSError, ValueError):
        yield False
        return
    kind = (fcntl.LOCK_SH if shared else fcntl.LOCK_EX) | fcntl.LOCK_NB
    deadline = time.monotonic() + PATIENCE
    try:
        while True:
            try:
                fcntl.flock(descriptor, kind)
                held = True
                break
            except BlockingIOError as error:
                if time.monotonic() > deadline:
                    reason = "another program has kept it locked"
                    raise OutputError(f"{folder}: {reason}") from error
                time.sleep(0.01)
            except OSError:
                held = False
                break
        yield held
    finally:
        os.close(descriptor)
