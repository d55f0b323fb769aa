"""How many candidates are worth it: the criterion against their number.

Sets are chosen from the first 100, 300, 1000 and so on of the same quasi-random
candidates, by exchange alone and by exchange with descents along the gradient (`auto`).
With `--full` up to 100 000 of them.
"""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import NamedTuple

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

import calib_pin
from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.criteria import CRITERIA, Criterion, Prediction
from calib_pin.planning.planned_problem import TipTests, identification
from calib_pin.planning.search import Design, Search
from calib_pin.planning.workspace import Candidates, Workspace
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.tool_accuracy import SAMPLES
from calib_pin.workers.local import LocalProcesses

TOOL = FrameSetup((0.05, 0.03, 0.1))

LEAST, MANY, MOST = 100, 10_000, 100_000
"""Least number of candidates, the number that others compare with, and most."""

METHODS = ("exchange", "auto")


@dataclass(frozen=True)
class Case:
    """A robot that is measured.

    Attributes:
        title: What figures say of it.
        robot: Its name.
        tip: Its tip; none for that of the file.
        model: The measurement model.
        count: Number of configurations.
    """

    title: str
    robot: str
    tip: str | None
    model: str
    count: int

    def chain(self) -> Chain:
        """The robot."""
        return calib_pin.load_chain(self.robot, tip=self.tip)


CASES = {
    "ur10": Case("UR10, 30 positions", "example:ur10_robot", "tool0", "position", 30),
    "space7": Case("space7, 6 poses", "space7", None, "pose", 6),
}

UNITS = {"prediction": (1e3, "predicted error [mm]"), "condition": (1.0, "condition")}
"""Factor and name of each criterion."""


class OneExchange(Search):
    """A search whose descents begin with the exchange that was made already."""

    _exchange: Design | None = None

    def by_exchange(self) -> Design:
        """The exchange, once."""
        self._exchange = self._exchange or super().by_exchange()
        return self._exchange


class Job(NamedTuple):
    """A case, a criterion, a seed, and the numbers of candidates to try."""

    case: str
    criterion: str
    seed: int
    sizes: tuple[int, ...]


@serial_blas
def values(job: Job) -> list[tuple[float, ...]]:
    """Values of the criterion by each method, of more and more candidates."""
    case = CASES[job.case]
    problem = nominal_problem(case.chain(), case.model, Setup(tool_frame=TOOL))
    workspace, rng = Workspace.create(problem), np.random.default_rng(job.seed)
    every = workspace.candidates(max(*job.sizes, SAMPLES), rng)
    _, rows, known = identification(problem, workspace.aims, every)
    criterion: Criterion = CRITERIA["condition"]
    if job.criterion == "prediction":
        criterion = Prediction(TipTests.of(rows, every).position)
    result = []
    for size in job.sizes:
        first = Candidates(every.q[:size], every.aim[:size], every.drawn[:size])
        own, begin = np.random.default_rng(job.seed), time.process_time()
        search = OneExchange(rows, workspace, criterion, known, first, case.count, own)
        found = [search.by_exchange()]
        middle = time.process_time()
        found.append(search.automatic())
        seconds = middle - begin, time.process_time() - begin
        result.append(tuple(float(np.exp(one.cost)) for one in found))
        told = ", ".join(
            f"{method} {UNITS[job.criterion][0] * value:.5g} in {spent:.1f} s"
            for method, value, spent in zip(METHODS, result[-1], seconds, strict=True)
        )
        where = f"{case.title}, {job.criterion}, seed {job.seed}"
        print(f"{where}, {size} candidates: {told}", flush=True)
    return result


def _values(shared: None, job: Job) -> list[tuple[float, ...]]:
    return values(job)


def main() -> None:
    """Print the tables; draw the figure where asked to."""
    options = _options()
    most = options.most or (MOST if options.full else MANY)
    decades = np.log10(most / LEAST)
    count = 1 + round(options.steps * decades)
    sizes = [_round(LEAST * 10 ** (k / options.steps)) for k in range(count)]
    figure = Figure(figsize=(11.0, 3.7 * len(options.robots)), layout="constrained")
    shape = len(options.robots), len(options.criteria)
    grid = figure.subplots(*shape, squeeze=False)
    jobs = {
        (name, criterion): [
            Job(name, criterion, seed, tuple(sizes)) for seed in range(options.seeds)
        ]
        for name in options.robots
        for criterion in options.criteria
    }
    every = [job for of in jobs.values() for job in of]
    with LocalProcesses(options.processes, patience=0.0) as workers:
        found = workers.map(_values, None, every)
        for axes, key in zip(grid.flat, jobs, strict=True):
            table = np.full((options.seeds, len(sizes), len(METHODS)), np.nan)
            for row, one in zip(table, found, strict=False):
                row[: len(one)] = one
            _table(key, sizes, table)
            _draw(axes, key, sizes, table)
    if options.figure is not None:
        figure.savefig(options.figure, dpi=120)
        print(f"wrote {options.figure}")


def _round(size: float) -> int:
    """The size with one digit."""
    digits = 10 ** int(np.log10(size) + 1e-9)
    return int(round(size / digits) * digits)


def _table(key: tuple[str, str], sizes: Sequence[int], values: Floats) -> None:
    """Means over the seeds, and how far they are from those of `MANY` candidates.

    Args:
        key: Names of the case and of the criterion.
        sizes: Numbers of candidates.
        values: Values of the criterion, shape (seeds, sizes, methods); NaN of those
            that were not tried.
    """
    factor, name = UNITS[key[1]]
    logs = np.log(values)
    beside = sizes.index(MANY) if MANY in sizes else len(sizes) - 1
    change = 100.0 * np.expm1(np.nanmean(logs - logs[:, beside, None], axis=0))
    means = factor * np.exp(np.nanmean(logs, axis=0))
    print(f"{CASES[key[0]].title}: {name}, beside {sizes[beside]} of the same seeds")
    for size, mean, percent in zip(sizes, means, change, strict=True):
        parts = [
            f"{method} {value:9.5g} ({more:+6.2f} %)"
            for method, value, more in zip(METHODS, mean, percent, strict=True)
        ]
        print(f"  {size:>9}  {'   '.join(parts)}", flush=True)


def _draw(
    axes: Axes, key: tuple[str, str], sizes: Sequence[int], values: Floats
) -> None:
    """A line of each seed; the arguments are those of `_table`."""
    factor, name = UNITS[key[1]]
    labels = ("exchange", "exchange, then gradient (auto)")
    for k, label in enumerate(labels):
        for seed, of_seed in enumerate(factor * values[:, :, k]):
            axes.plot(
                sizes,
                of_seed,
                "o-",
                color=f"C{k}",
                label="" if seed else label,
                markersize=4,
                linewidth=1.0,
            )
    axes.set_xscale("log")
    axes.set_title(CASES[key[0]].title)
    axes.set_xlabel("number of candidates")
    axes.set_ylabel(name)
    axes.set_ylim(0.0, 1.35 * factor * np.nanmax(values))
    axes.grid(alpha=0.3)
    axes.legend(title="a line for each seed", loc="upper right", ncols=2)


def _options() -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog="scripts/benchmark candidates")
    parser.add_argument("--full", action="store_true", help="up to 100 000")
    parser.add_argument("--most", type=int, help="most candidates instead")
    parser.add_argument("--seeds", type=int, default=3, help="number of seeds")
    parser.add_argument("--steps", type=int, default=2, help="numbers a decade")
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--figure", type=Path, metavar="FILE", help="picture to write")
    for name, known in (("robots", CASES), ("criteria", UNITS)):
        parser.add_argument(
            f"--{name}",
            metavar="NAMES",
            type=lambda text: text.split(","),
            default=list(known),
            help=", ".join(known),
        )
    words = sys.argv[1:]
    return parser.parse_args([word for word in words if word != "candidates"])
