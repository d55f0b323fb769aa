"""A criterion of a benchmark: its jobs, and lines with a figure beside a limit."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from typing import Generic, TypeVar

import numpy as np

T = TypeVar("T")

NUMBERS = 12
"""Job numbers that a line names at most."""


@dataclass(frozen=True)
class Line:
    """A figure beside its limit.

    Attributes:
        text: What it is.
        figure: The figure.
        limit: Its limit; empty where it only informs.
        passed: Whether it is kept; None where it only informs or is not available.
    """

    text: str
    figure: str
    limit: str = ""
    passed: bool | None = None

    def __str__(self) -> str:
        """The line with a mark in front."""
        mark = {True: "pass", False: "FAIL", None: "    "}[self.passed]
        limit = f"  ({self.limit})" if self.limit else ""
        return f"{mark} {self.text}: {self.figure}{limit}"


@dataclass(frozen=True)
class Criterion(Generic[T]):
    """One of the criteria.

    Attributes:
        number: Its number.
        title: Its name.
        count: Jobs of a full run.
        run: Outcome of the job of a number.
        judge: Lines about the outcomes.
        least: Jobs that a partial run has at least.
        alone: Whether its jobs need the machine for themselves, to read clocks.
    """

    number: int
    title: str
    count: int
    run: Callable[[int], T]
    judge: Callable[[Sequence[T]], Iterator[Line]]
    least: int = 1
    alone: bool = False


def at_most(
    text: str, jobs: Sequence[int], total: int, percent: float, least: bool = False
) -> Line:
    """A share of jobs that must stay below a limit, or above one.

    Args:
        text: What is counted.
        jobs: Numbers of the jobs that are counted.
        total: Number of all jobs.
        percent: The limit [%].
        least: Whether the share must be at least that.
    """
    if not total:
        return missing(text)
    share = 100.0 * len(jobs) / total
    figure = f"{len(jobs)} of {total} ({share:.1f} %)"
    passed = share >= percent if least else share <= percent
    if jobs and not least:
        figure += f" {named(jobs)}"
    return Line(text, figure, f"at {'least' if least else 'most'} {percent} %", passed)


def between(
    text: str, figure: float, low: float, high: float, chance: float = 0.0
) -> Line:
    """A figure that must lie between limits.

    Args:
        text: What it is.
        figure: The figure.
        low: Lower limit.
        high: Upper limit.
        chance: Standard error of the figure, by as many jobs as there are; the limits
            are widened by two of them.
    """
    if not np.isfinite(figure):
        return missing(text)
    passed = bool(low - 2.0 * chance <= figure <= high + 2.0 * chance)
    shown = f"{figure:.3f}" + (f" +- {chance:.3f}" if chance else "")
    limit = f"at most {high:g}" if low == -np.inf else f"{low:g} to {high:g}"
    return Line(text, shown, limit, passed)


def square(
    text: str, squares: Sequence[float], low: float = -np.inf, high: float = np.inf
) -> Line:
    """Mean of squared ratios of actual by predicted errors, which should be one.

    Its chance is that of errors in two directions, chi-square with two degrees of
    freedom by these: the mean of a prediction that is far off must not hide behind the
    scatter that it causes itself.
    """
    ratios = np.array(squares)
    ratios = ratios[np.isfinite(ratios)]
    if not len(ratios):
        return missing(text)
    return between(text, float(ratios.mean()), low, high, 1.0 / len(ratios) ** 0.5)


def missing(text: str) -> Line:
    """A figure that the results do not have."""
    return Line(text, "not available")


def named(jobs: Sequence[int]) -> str:
    """Job numbers, the first of them."""
    shown = " ".join(map(str, jobs[:NUMBERS]))
    return f"[jobs {shown}{' ...' if len(jobs) > NUMBERS else ''}]"
