"""The side of a worker: shared values that it keeps, and batches of items."""

from __future__ import annotations

import os
import pickle
import sys
import time
from collections.abc import Sequence
from threading import Lock
from typing import Any, NamedTuple

THREADS = (
    "BLIS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "NUMBA_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""Variables that libraries read when they are loaded."""

KEPT = 2
"""Shared values that a worker keeps: a search and what it asks for in between."""


class Done(NamedTuple):
    """A batch that was worked on.

    Attributes:
        results: Results of its items, as far as none failed.
        failure: The error of the item behind these, if one failed.
        seconds: Time that it took.
    """

    results: list[Any]
    failure: Exception | None
    seconds: float


_kept: dict[bytes, tuple[Any, Any]] = {}
_lock = Lock()


def alone() -> None:
    """Give this process one thread: there is a worker for every core."""
    for name in THREADS:
        os.environ[name] = "1"
    if "numba" in sys.modules:  # It has read them already.
        from numba import config

        config.NUMBA_NUM_THREADS = 1  # type: ignore[attr-defined]


def keep(digest: bytes, payload: bytes) -> None:
    """Keep a function and the value that its items share.

    Args:
        digest: Name of both.
        payload: Both, pickled by the process that gives the work.
    """
    with _lock:
        if digest not in _kept:
            alone()
            while len(_kept) >= KEPT:
                del _kept[next(iter(_kept))]
            _kept[digest] = pickle.loads(payload)


def run(digest: bytes, payload: bytes | None, items: Sequence[Any]) -> Done:
    """Work on a batch.

    Args:
        digest: Name of the function and the shared value, see `keep`.
        payload: Both; None where they have been kept.
        items: The items.
    """
    if payload is not None:
        keep(digest, payload)
    work, shared = _kept[digest]
    start, results, failure = time.perf_counter(), [], None
    for item in items:
        try:
            results.append(work(shared, item))
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
