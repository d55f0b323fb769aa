"""The jobs that the options name, and what came out of them."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import Any

from benchmarks.field import away, trial
from benchmarks.field.days import INSTRUMENTS, JOBS
from benchmarks.field.mishaps import MISHAPS
from calib_pin.cli.options import asked_workers
from calib_pin.compiled.threads import serial_blas

SEED = 44
"""Seed of the jobs that nobody chose."""


def main() -> None:
    """Run the jobs; exit status 1 if a limit is not kept."""
    options = _options()
    begin, first = time.perf_counter(), JOBS * options.seed
    turns: Sequence[int] = options.job or range(options.count)
    jobs, judge = _jobs(turns, first, options)
    found = []
    for outcome in _outcomes(jobs, options.workers):
        found.append(outcome)
        if options.tell:
            print(outcome, flush=True)
    minutes = (time.perf_counter() - begin) / 60.0
    print(f"\n{len(found)} days, seed {options.seed}, {minutes:.1f} min")
    lines = list(judge(found))
    print(*(f"  {line}" for line in lines), sep="\n", flush=True)
    if any(line.passed is False for line in lines):
        sys.exit(1)


def _jobs(
    turns: Sequence[int], first: int, options: argparse.Namespace
) -> tuple[list[Callable[[], Any]], Callable[[Any], Iterator[Any]]]:
    """Jobs that can be sent to a process, and what judges their outcomes."""
    if options.away:
        return [partial(away.run, first + turn) for turn in turns], away.judge
    named = options.only or list(MISHAPS)
    instruments = tuple(n for n in named if n in INSTRUMENTS) or tuple(INSTRUMENTS)
    names = [
        name
        for name in [n for n in named if n in MISHAPS] or MISHAPS
        if {*MISHAPS[name].instruments} & {*instruments}
    ]
    if not names:
        sys.exit(f"there is no such mishap with {' or '.join(instruments)}")
    return [
        partial(trial.run, first + turn, names[turn % len(names)], instruments)
        for turn in turns
    ], trial.judge


def _outcomes(jobs: Sequence[Callable[[], Any]], workers: int | None) -> Iterator[Any]:
    """Outcomes of jobs, in their order."""
    with asked_workers(1 if len(jobs) == 1 else workers, None) as force:
        yield from force.map(_outcome, None, jobs)


@serial_blas
def _outcome(_: None, job: Callable[[], Any]) -> Any:
    return job()


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="scripts/benchmark field")
    parser.add_argument("--count", type=int, help="number of jobs")
    parser.add_argument("--seed", type=int, default=SEED, help="seed of the jobs")
    parser.add_argument(
        "--only",
        metavar="NAMES",
        type=lambda text: [name.strip() for name in text.split(",")],
        help=f"mishaps ({'; '.join(MISHAPS)}) and instruments "
        f"({'; '.join(INSTRUMENTS)})",
    )
    parser.add_argument("--workers", type=int, help="processes, default every core")
    parser.add_argument("--away", action="store_true", help="promises away instead")
    parser.add_argument(
        "--job", type=int, action="append", default=[], help="this turn alone"
    )
    parser.add_argument("--tell", action="store_true", help="print every outcome")
    words = sys.argv[1:]
    options = parser.parse_args([word for word in words if word != "field"])
    known = {*MISHAPS, *INSTRUMENTS}
    for name in options.only or ():
        if name not in known:
            parser.error(f"unknown mishap {name}; there are {', '.join(sorted(known))}")
    if options.count is None:
        options.count = 40 if options.away else 2 * len(MISHAPS)
    return options
