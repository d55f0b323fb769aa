"""The quick tier as other processors would round it: `scripts/test --shaken`.

Each setting is a run of its own: another BLAS kernel, kernels compiled for a processor
without vector instructions, and decompositions whose last bits are disturbed. A test
that fails under one of them compares figures closer than they are known.

As a pytest plugin (`-p shaken`) it disturbs the decompositions of numpy and scipy.
"""

from __future__ import annotations

import os
import re
import subprocess
import sys
import zlib
from collections.abc import Callable
from functools import wraps
from typing import Any

import numpy as np
import scipy.linalg

SETTINGS: dict[str, dict[str, str]] = {
    "as it is": {},
    "BLAS Haswell": {"OPENBLAS_CORETYPE": "Haswell"},
    "BLAS SkylakeX": {"OPENBLAS_CORETYPE": "SkylakeX"},
    "BLAS Zen": {"OPENBLAS_CORETYPE": "Zen"},
    "BLAS Prescott": {"OPENBLAS_CORETYPE": "Prescott"},
    "generic kernels": {"NUMBA_CPU_NAME": "generic", "NUMBA_CPU_FEATURES": ""},
    "disturbed 1": {"SHAKEN_SEED": "1"},
    "disturbed 2": {"SHAKEN_SEED": "2"},
    "all at once": {
        "OPENBLAS_CORETYPE": "Prescott",
        "NUMBA_CPU_NAME": "generic",
        "NUMBA_CPU_FEATURES": "",
        "SHAKEN_SEED": "3",
    },
}
"""Variables of the environment of each run."""

DECOMPOSITIONS = {
    np.linalg: ("cholesky", "eigh", "inv", "lstsq", "pinv", "qr", "solve", "svd"),
    scipy.linalg: ("cho_factor", "cho_solve", "cholesky", "solve_triangular"),
    scipy.linalg.lapack: ("dpotrf", "dpotri", "dpotrs", "dtrtri"),
}
SIZE = 4.0 * np.finfo(float).eps
"""Disturbance, relative: what another order of sums changes in a small matrix."""


def disturbed(values: Any, seed: int) -> Any:
    """Floating-point arrays, each value larger or smaller by `SIZE`.

    Signs follow from the content, so that equal input gives equal output.
    """
    if isinstance(values, tuple):
        found = [disturbed(value, seed) for value in values]
        return type(values)(*found) if hasattr(values, "_fields") else tuple(found)
    if not isinstance(values, np.ndarray) or values.dtype != np.float64:
        return values
    rng = np.random.default_rng([seed, zlib.crc32(np.ascontiguousarray(values))])
    return values * (1.0 + SIZE * rng.choice((-1.0, 1.0), values.shape))


def _shaken(function: Callable[..., Any], seed: int) -> Callable[..., Any]:
    @wraps(function)
    def call(*arguments: Any, **options: Any) -> Any:
        return disturbed(function(*arguments, **options), seed)

    return call


def pytest_configure() -> None:
    """Disturb decompositions before the package is imported."""
    seed = os.environ.get("SHAKEN_SEED")
    for module, names in DECOMPOSITIONS.items() if seed else ():
        for name in names:
            setattr(module, name, _shaken(getattr(module, name), int(seed or 0)))


def main() -> int:
    """Run pytest once for each setting and print a table of what failed."""
    rows = []
    for name, variables in SETTINGS.items():
        print(f"\n== {name} ==", flush=True)
        run = subprocess.run(
            [sys.executable, "-m", "pytest", "-p", "shaken", *sys.argv[1:]],
            env=os.environ | variables,
            stdout=subprocess.PIPE,
            text=True,
        )
        lines = run.stdout.splitlines()
        failed = [line for line in lines if re.match("(FAILED|ERROR) ", line)]
        rows.append((name, lines[-1] if lines else "", run.returncode))
        print("\n".join([*failed, *lines[-1:]]), flush=True)
    print("\nsetting             result")
    for name, summary, _ in rows:
        print(f"{name:18}  {summary.strip('= ')}")
    return max(status for *_, status in rows)


if __name__ == "__main__":
    sys.exit(main())
