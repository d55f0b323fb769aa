"""Machine code on disk: what is damaged there is compiled again.

numba trusts its files. An empty index, as a crash of the machine leaves it, would end
every command, and machine code with a wrong bit the process.
"""

from __future__ import annotations

import pickle
from contextlib import suppress
from hashlib import sha256
from typing import Any

from numba.core import caching, serialize

# numba has no types.
_numba: Any = caching
_dumps: Any = serialize.dumps


class _Sealed(_numba.CompileResultCacheImpl):  # type: ignore[misc]
    """Machine code with its SHA-256."""

    def reduce(self, result: Any) -> tuple[bytes, bytes]:
        data: bytes = _dumps(super().reduce(result))
        return sha256(data).digest(), data

    def rebuild(self, context: Any, payload: tuple[bytes, bytes]) -> Any:
        digest, data = payload
        if sha256(data).digest() != digest:
            raise ValueError("the machine code is damaged")
        return super().rebuild(context, pickle.loads(data))


class Cache(_numba.FunctionCache):  # type: ignore[misc]
    """numba's cache of a function, which never fails."""

    _impl_class = _Sealed

    def load_overload(self, signature: Any, context: Any) -> Any:
        """The machine code for a signature; None if it must be compiled."""
        try:
            return super().load_overload(signature, context)
        except Exception:  # Anything may come out of a damaged file.
            with suppress(OSError):
                self.flush()
            return None

    def save_overload(self, signature: Any, result: Any) -> None:
        """Keep machine code, where the disk takes it."""
        with suppress(Exception):
            super().save_overload(signature, result)
