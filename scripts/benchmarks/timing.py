"""How to measure, and a line of a table."""

from __future__ import annotations

import time
from collections.abc import Callable

__all__ = ["best", "show"]


def best(job: Callable[[], object], repetitions: int = 7) -> float:
    """Shortest time of a job [s], the one that noise disturbs least."""
    times = []
    for _ in range(repetitions):
        start = time.perf_counter()
        job()
        times.append(time.perf_counter() - start)
    return min(times)


def show(name: str, seconds: float, reference: str, other: float) -> None:
    """One line of the table."""
    ratio = other / seconds
    print(f"{name:<40}{1e3 * seconds:9.1f} ms  {ratio:6.1f} x the speed of {reference}")
