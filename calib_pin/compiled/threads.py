"""Threads: several for pieces of arrays, one for BLAS.

The kernels release the interpreter, so that plain threads run them side by side. What
a piece computes must not depend on where it is cut; then results do not depend on the
number of threads either.

BLAS knows no such rule: its number of threads changes the last bits of a product. For
matrices as small as ours its threads also take many times longer than one does.
"""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from contextlib import ContextDecorator
from inspect import isgeneratorfunction
from itertools import pairwise
from threading import Lock, get_ident
from types import TracebackType
from typing import Any, TypeVar

_Function = TypeVar("_Function", bound=Callable[..., Any])
_Piece = TypeVar("_Piece")
_Result = TypeVar("_Result")


_ALL = 0
"""Stands for all Python threads; the identity of one is never zero."""


class _SerialBlas(ContextDecorator):
    """Context and decorator in which BLAS has one thread.

    It may be entered within itself and from several Python threads. Most libraries
    have one number of threads for the process: the last Python thread to leave restores
    what the first one found. Others have one for each Python thread.
    """

    def __init__(self) -> None:
        self._lock = Lock()
        self._depths: dict[int, int] = {}
        self._counts: dict[tuple[str, int], tuple[Any, int]] = {}
        self._libraries: list[Any] = []
        self._modules = 0

    def __call__(self, function: _Function) -> _Function:
        """Decorate a function.

        Raises:
            TypeError: If it is a generator, whose caller would run within the limit.
        """
        if isgeneratorfunction(function):
            raise TypeError(f"'{function.__name__}' is a generator")
        return super().__call__(function)

    def __enter__(self) -> None:
        """Limit all libraries, also those loaded since the level around this one."""
        with self._lock:
            thread, modules = get_ident(), len(sys.modules)
            # Scipy brings a BLAS of its own, and comes late. To look for libraries
            # takes up to a millisecond: only when modules have been imported.
            grown = modules != self._modules
            if grown:
                self._libraries, self._modules = _blas_libraries(), modules
            if grown or thread not in self._depths:
                for library in self._libraries:
                    self._limit(library, thread)
            self._depths[thread] = self._depths.get(thread, 0) + 1

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Restore what was found, unless someone is still inside."""
        with self._lock:
            thread = get_ident()
            self._depths[thread] -= 1
            if self._depths[thread]:
                return
            del self._depths[thread]
            owners = (thread,) if self._depths else (thread, _ALL)
            for key in [key for key in self._counts if key[1] in owners]:
                _set_threads(*self._counts.pop(key))

    def _limit(self, library: Any, thread: int) -> None:
        count = library.num_threads
        if count is not None and count > 1:
            owner = thread if _counts_by_thread(library) else _ALL
            self._counts.setdefault((library.filepath, owner), (library, count))
            _set_threads(library, 1)


def _blas_libraries() -> list[Any]:
    """The BLAS libraries that are loaded, as threadpoolctl describes them."""
    from threadpoolctl import ThreadpoolController

    return list(ThreadpoolController().select(user_api="blas").lib_controllers)


def _counts_by_thread(library: Any) -> bool:
    """Whether the number of threads belongs to a Python thread, not to the process."""
    kind = library.internal_api, library.threading_layer
    return kind == ("openblas", "openmp") or kind[0] == "mkl"


def _set_threads(library: Any, count: int) -> None:
    # The first Python thread that sets the number of OpenBLAS would be the only one
    # that may; here the last one to leave restores it.
    release = getattr(library, "clear_controlling_thread", None)
    if release is not None:
        release(force=True)
    library.set_num_threads(count)
    if release is not None:
        release(force=True)


serial_blas = _SerialBlas()
"""`with serial_blas:` or `@serial_blas`, for whatever multiplies small matrices."""


class Threads:
    """A few threads, as many as numba is given (NUMBA_NUM_THREADS).

    Args:
        count: Number of threads; default what numba takes, one per available core.
    """

    def __init__(self, count: int | None = None) -> None:
        """Start nothing yet; threads begin with the first work."""
        if count is None:
            from numba import config

            count = int(config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
        self.count = count
        # Ends with this object; a module-wide pool would hang in a forked process.
        self._pool = ThreadPoolExecutor(count) if count > 1 else None

    def __reduce__(self) -> tuple[type[Threads], tuple[int]]:
        """Another process starts as many of its own."""
        return Threads, (self.count,)

    def map(
        self, work: Callable[[_Piece], _Result], pieces: Sequence[_Piece]
    ) -> Iterator[_Result]:
        """Results of the pieces, in their order; a single one takes no thread."""
        if self._pool is None or len(pieces) == 1:
            return map(work, pieces)
        return self._pool.map(serial_blas(work), pieces)

    def slices(self, length: int, least: int = 1) -> list[slice]:
        """About equal slices of a length, one for each thread.

        Args:
            length: Length to be sliced.
            least: Length below which a slice is not worth a thread.
        """
        count = max(1, min(self.count, length // max(least, 1)))
        cuts = [length * k // count for k in range(count + 1)]
        return [slice(a, b) for a, b in pairwise(cuts)]
