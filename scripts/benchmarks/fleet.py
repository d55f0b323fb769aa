"""Work over many processes: scaling, what a job costs beside itself, saturation.

    scripts/benchmark fleet [--robots 10000]

Robots are UR10 with a tracker, 30 positions each, as `fleet --monte-carlo` draws them.
"""

from __future__ import annotations

import argparse
import resource
import sys
import time
from collections.abc import Iterator
from concurrent.futures import Future
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any

from benchmarks.timing import best
from calib_pin.estimation.fit import fit_model
from calib_pin.io.urdf import load_chains
from calib_pin.monte_carlo import Study, outlooks, study_of, try_robot
from calib_pin.observations import BlockKey, Observations
from calib_pin.setup import FrameSetup, LimitSetup, MonteCarloSetup, Setup
from calib_pin.simulation import simulate
from calib_pin.workers.base import Workers
from calib_pin.workers.local import LocalProcesses, cores

JOBS = 10_000
"""Jobs whose cost beside their own work is measured."""

LASTING = 2e-3
"""Time that such a job takes [s]."""

FEW = 200
"""Robots of a comparison of one worker with several."""

FAKES = (1, 10, 100, 1000)
"""Workers that a fake executor stands for."""


def main() -> None:
    """Print the figures."""
    parser = argparse.ArgumentParser(prog="scripts/benchmark fleet")
    parser.add_argument("--robots", type=int, default=1000)
    words = [word for word in sys.argv[1:] if word not in ("fleet",)]
    options = parser.parse_args(words)
    study = _study()
    _robots(study, options.robots)
    _bare(study)
    _scaling(study)
    _overhead()
    _saturation()


def _study() -> Study:
    chains = load_chains(
        "example:ur10_robot", base="base_link", tip="tool0", names=("",)
    )
    setup = Setup(
        base_frame=FrameSetup((1.5, -0.4, 0.3), (0.3, 0.2, 2.0), estimate=True),
        tool_frame=FrameSetup((0.05, 0.08, 0.12), estimate=True),
        noise={"position": 5e-5},
        monte_carlo=MonteCarloSetup(configurations=(30,)),
    )
    return study_of(chains, [BlockKey("position")], setup)


def _bare(study: Study) -> None:
    """A robot of a study against the fit alone."""
    robots = range(20)

    def each() -> None:
        for robot in robots:
            try_robot(study, robot)

    measured = []
    for robot in robots:
        rng = study.stream(robot, 0)
        theta = study.sizes * rng.normal(size=len(study.sizes))
        rows = simulate(study.truth, theta, rng, count=30)
        blocks = tuple(replace(block, sigma=None) for block in rows.blocks)
        measured.append(Observations(blocks))

    def fits() -> None:
        for rows in measured:
            fit_model(study.chains, rows, study.setup, study.seed)

    each(), fits()
    seconds, fit = best(each, 3) / len(robots), best(fits, 3) / len(robots)
    print(f"a robot of a study, one core            {1e3 * seconds:9.1f} ms")
    print(f"  by the bare fit                       {seconds / fit:9.2f}   (<= 1.5)")


def _scaling(study: Study) -> None:
    """One worker against as many as there are cores."""
    spent = {}
    for count in (1, cores()):
        with LocalProcesses(count, patience=0.0) as workers:
            # Started, and all imported.
            list(workers.map(try_robot, study, range(4 * count)))
            begin = time.perf_counter()
            found = list(workers.map(try_robot, study, range(FEW)))
            spent[count] = time.perf_counter() - begin
            assert len(found) == FEW
    ratio = spent[1] / spent[cores()]
    print(f"1 -> {cores()} workers, {FEW} robots             {ratio:9.2f} x (>= 1.8)")


def _wait(seconds: float, item: int) -> int:
    """A job of some length that needs no core."""
    time.sleep(seconds)
    return item


def _overhead() -> None:
    """What a job costs beside its own work."""
    with LocalProcesses(patience=0.0) as workers:
        list(workers.map(_wait, 0.0, range(2 * workers.count)))
        begin = time.perf_counter()
        assert sum(workers.map(_wait, LASTING, range(JOBS))) == JOBS * (JOBS - 1) // 2
        spent = (time.perf_counter() - begin) * workers.count / JOBS
    begin = time.perf_counter()
    for _ in range(100):
        time.sleep(LASTING)
    own = (time.perf_counter() - begin) / 100
    over = 1e3 * (spent - own)
    print(f"a job beside its own work, {JOBS} jobs   {over:9.2f} ms (<= 5)")


class _Fake(Workers):
    """Workers that have nothing to do."""

    patience = 0.0

    def __init__(self, count: int) -> None:
        self.count = count

    def sharing(self, payload: bytes) -> nullcontext[Any]:
        return nullcontext(self._submit)

    def _submit(self, item: Any) -> Future[Any]:
        future: Future[Any] = Future()
        future.set_result(item)
        return future


def _saturation() -> None:
    """Time of the one who gives the work, by number of workers.

    Local processes cost more than the fake ones: what they get is pickled and goes
    through a pipe. Their share is measured with as many as there are cores.
    """
    print("items that can be given out in a second:")
    for count in FAKES:
        size = 20 * count + 1000
        items: Iterator[int] = iter(range(size))
        begin = time.process_time()
        for _ in _Fake(count).map(_wait, 0.0, items):
            pass
        each = (time.process_time() - begin) / size
        print(f"  {count:5} fake workers {1e6 * each:20.1f} us: {1.0 / each:9.0f}")
    with LocalProcesses(patience=0.0) as workers:
        list(workers.map(_wait, 0.0, range(2 * workers.count)))
        size = 1000 * workers.count
        begin = time.process_time()
        for _ in workers.map(_wait, 0.0, iter(range(size))):
            pass
        each = (time.process_time() - begin) / size
    print(f"  {cores():5} processes    {1e6 * each:20.1f} us: {1.0 / each:9.0f}")


def _robots(study: Study, robots: int) -> None:
    """Time per robot and core, and memory of the one who gives the work."""
    limit = LimitSetup(position=2e-4)
    with LocalProcesses(patience=0.0) as workers:
        list(workers.map(try_robot, study, range(2 * workers.count)))
        before = _resident()
        begin = time.perf_counter()
        found = workers.map(try_robot, study, range(robots))
        (outlook,) = outlooks((trial for own in found for trial in own), limit)
        spent = (time.perf_counter() - begin) * workers.count / robots
    grown = _resident() - before
    print(
        f"{robots} robots: {1e3 * spent:.1f} ms per robot and core; memory grows by "
        f"{grown:.1f} MB; covered {100 * outlook.coverage[0]:.1f} %, actual by "
        f"expected {outlook.honesty:.3f}"
    )


def _resident() -> float:
    """Memory that this process has now [MB]."""
    pages = int(Path("/proc/self/statm").read_text().split()[1])
    return pages * resource.getpagesize() / 2**20
