"""Run the jobs of criteria, and print the figures beside their limits.

Jobs are numbered, so that each that fails can be run again by itself.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from typing import Any

from benchmarks.criterion import Criterion
from calib_pin.cli.options import asked_workers
from calib_pin.compiled.threads import serial_blas

SHARE = 10
"""Part of the jobs without `--full`: every tenth number's worth."""


def run_criteria(
    benchmark: str, criteria: Mapping[str, Criterion[Any]], seed: int
) -> None:
    """Run those that the options name, or all; exit status 1 if one fails.

    Args:
        benchmark: Name of the benchmark.
        criteria: The criteria by name, in the order of their numbers.
        seed: Seed of all jobs, beside their numbers.
    """
    options = _options(benchmark, list(criteria))
    failed = []
    for name in options.only:
        criterion = criteria[name]
        numbers: Sequence[int] = options.job
        if not numbers:
            count = criterion.count
            if not options.full:
                count = max(criterion.count // SHARE, criterion.least)
            numbers = range(options.first, options.first + (options.count or count))
        begin = time.perf_counter()
        found = []
        for outcome in _run(criterion, numbers, options):
            found.append(outcome)
            if options.job or options.tell:
                print(outcome, flush=True)
        minutes = (time.perf_counter() - begin) / 60.0
        print(
            f"\n{criterion.number}. {criterion.title} ({name}: {len(found)} jobs from "
            f"{numbers[0]}, seed {seed}, {minutes:.1f} min)"
        )
        for line in criterion.judge(found):
            print(f"  {line}", flush=True)
            if line.passed is False:
                failed.append(f"{name}: {line.text}")
    if failed:
        print("\nfailed:", *failed, sep="\n  ")
        sys.exit(1)


def _run(
    criterion: Criterion[Any], numbers: Sequence[int], options: argparse.Namespace
) -> Iterator[Any]:
    """Outcomes of jobs, in their order."""
    count = 1 if len(numbers) == 1 or criterion.alone else options.workers
    cluster = None if criterion.alone else options.cluster
    with asked_workers(None if cluster else count, cluster) as workers:
        yield from workers.map(_outcome, criterion.run, numbers)


@serial_blas
def _outcome(run: Callable[[int], Any], number: int) -> Any:
    """Outcome of a job."""
    return run(number)


def _options(benchmark: str, names: Sequence[str]) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog=f"scripts/benchmark {benchmark}")
    parser.add_argument(
        "--only",
        metavar="NAMES",
        type=lambda text: text.split(","),
        default=names,
        help=f"criteria: {', '.join(names)}",
    )
    parser.add_argument("--full", action="store_true", help="all jobs, not a tenth")
    parser.add_argument("--count", type=int, help="number of jobs of each criterion")
    parser.add_argument("--first", type=int, default=0, help="number of the first job")
    parser.add_argument(
        "--job", type=int, action="append", default=[], help="this job alone"
    )
    parser.add_argument("--tell", action="store_true", help="print every outcome")
    parser.add_argument("--workers", type=int, help="processes, default every core")
    parser.add_argument("--cluster", help="a dask scheduler instead of processes")
    words = sys.argv[1:]
    options = parser.parse_args([word for word in words if word != benchmark])
    if unknown := [name for name in options.only if name not in names]:
        parser.error(f"unknown criterion {unknown[0]}; there are {', '.join(names)}")
    return options
