"""Threads of libraries in a process, which read their number when they are loaded."""

from __future__ import annotations

import os

BLAS_THREADS = (
    "BLIS_NUM_THREADS",
    "MKL_NUM_THREADS",
    "OMP_NUM_THREADS",
    "OPENBLAS_NUM_THREADS",
    "VECLIB_MAXIMUM_THREADS",
)
"""Variables of BLAS libraries."""


def limit_blas() -> None:
    """Give BLAS libraries that this process loads from now on one thread."""
    os.environ.update(dict.fromkeys(BLAS_THREADS, "1"))
