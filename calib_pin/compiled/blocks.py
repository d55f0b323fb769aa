"""The layout that compiled kernels share: joint motions of configurations in blocks.

Joint motions do not depend on parameters and are computed once: `motions` holds cosine,
sine and shift of every joint position. The innermost loops of the kernels run over a
block of configurations in one array whose parts lie a constant distance apart, so that
the compiler sees that they do not overlap and uses vector instructions.

numba keeps machine code on disk and notices a change only in a function's own file. So
compiled functions call none of another file, and files share this layout alone.

numba trusts its files: an empty index, as a crash of the machine leaves it, would end
every command, and machine code with a wrong bit the process. Here what is damaged on
disk is compiled again.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable
from contextlib import suppress
from hashlib import sha256
from math import cos, sin
from typing import Any, TypeVar, cast

import numpy as np
from numba import njit
from numba.core import caching, serialize
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats

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


Booleans = NDArray[np.bool_]
Indices = NDArray[np.int64]

BLOCK = 128
"""Configurations in a block; a constant, for the distances within work arrays.

It is compiled in: clear the machine code (`__pycache__`) after a change.
"""

_Function = TypeVar("_Function", bound=Callable[..., object])


def compiled(function: _Function) -> _Function:
    """Compile at the first call and keep the machine code on disk.

    Sums may be reordered and contracted, which vector instructions need; not-a-number
    and infinity keep their meaning.
    """
    options: dict[str, Any] = {
        "nogil": True,
        "error_model": "numpy",
        "fastmath": {"reassoc", "contract", "nsz", "arcp"},
    }
    jit = njit(**options)(function)
    with suppress(RuntimeError):  # No folder to keep it in: a read-only installation.
        jit._cache = Cache(function)
    return cast(_Function, jit)


def motions(q: Floats, revolute: Booleans) -> tuple[Floats, Indices]:
    """Joint motions of configurations in blocks.

    Args:
        q: Joint positions, shape (N, n) [rad, m], signs of reversed joints applied.
        revolute: True for joints that turn, shape (n,).

    Returns:
        Cosines, then sines, then shifts of every block, shape (blocks, n, 3 BLOCK), and
        the first row of every block with the number of rows behind, (blocks + 1,).
    """
    starts = np.array([*range(0, len(q), BLOCK), len(q)])
    result = np.zeros((len(starts) - 1, q.shape[1], 3 * BLOCK))
    _fill_motions(q, revolute, starts, result)
    return result, starts


@compiled
def _fill_motions(
    q: Floats, revolute: Booleans, starts: Indices, result: Floats
) -> None:
    for block in range(len(result)):
        for row in range(starts[block], starts[block + 1]):
            k = row - starts[block]
            for joint in range(q.shape[1]):
                motion, position = result[block, joint], q[row, joint]
                if revolute[joint]:
                    motion[k], motion[BLOCK + k] = cos(position), sin(position)
                else:
                    motion[k], motion[2 * BLOCK + k] = 1.0, position
