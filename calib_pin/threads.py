"""Work on pieces of arrays with several threads.

The kernels release the interpreter, so that plain threads run them side by side. What
a piece computes must not depend on where it is cut; then results do not depend on the
number of threads either.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import ThreadPoolExecutor
from itertools import pairwise
from typing import TypeVar

__all__ = ["Threads"]

_Piece = TypeVar("_Piece")
_Result = TypeVar("_Result")


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

    def map(
        self, work: Callable[[_Piece], _Result], pieces: Sequence[_Piece]
    ) -> Iterator[_Result]:
        """Results of the pieces, in their order; a single one takes no thread."""
        if self._pool is None or len(pieces) == 1:
            return map(work, pieces)
        return self._pool.map(work, pieces)

    def slices(self, length: int, least: int = 1) -> list[slice]:
        """About equal slices of a length, one for each thread.

        Args:
            length: What is to be sliced.
            least: Length below which a slice is not worth a thread.
        """
        count = max(1, min(self.count, length // max(least, 1)))
        cuts = [length * k // count for k in range(count + 1)]
        return [slice(a, b) for a, b in pairwise(cuts)]
