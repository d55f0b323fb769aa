"""Very many measurements: time, memory, and what the processor's arithmetic allows.

Operations of a measurement (x, y, z) of a robot with n joints, M = 6 (n + 1) + 1
columns (the twists behind every link, and the residual), one for each sum and each
product:

- the pose, a point (25) and three directions (21 each) through every joint: 88 n
- three covectors of the tool (a turn and a wrench, 58) through every joint: 174 n
- Householder reflections of them into a triangular factor, three components: 6 M^2

A pass that linearizes takes all of these, one that predicts the first. What is smaller
does not count: residuals, weights, parameters, steps. The peak is that of a product of
large matrices with one thread, times the threads. Beside the fit stands a whole
calibration with its cross-validation, in a process of its own.

A second table compares models of one robot on the same measurements: joint corrections
with placements alone, without and with gross errors that the loss has to set aside; the
fit by itself, and a whole calibration with held-out measurements. A calibration with
joint corrections also fits and judges the geometry that a URDF can hold. Times are
those of the clock and of all processors; the latter depends less on what else runs.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable, Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from numba import config

import calib_pin
from benchmarks.timing import best
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.many_rows import ManyRows
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import FrameSetup, Setup

SIZES = (10_000, 100_000, 1_000_000)

NOISE = 1e-4
"""Standard deviation of a component [m]."""

JOINTS = 6
COLUMNS = 6 * (JOINTS + 1) + 1

POSE = 88 * JOINTS
COVECTORS = 174 * JOINTS
OPERATIONS = {"errors": POSE, "_factors": POSE + COVECTORS + 6 * COLUMNS**2}
"""Operations of a measurement by kind of pass."""

ROBOT = "example:ur10_robot"
PLACEMENT = ("placement",)
JOINTS_TOO = ("placement", "transmission", "compliance")
COMPARED = 1_000_000
"""Measurements of the second table."""

GROSS = 0.02
"""Part of the measurements that are wrong, by a deviation of `WRONG` [m]."""

WRONG = 0.02

HELD_OUT = 0.1
"""Part of the measurements that a calibration is checked on."""

PIECE = 50_000
"""Measurements that are simulated at once, so that no memory is needed beside."""


def main() -> None:
    """Print a table; every size has a process of its own."""
    threads = int(config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    peak = threads * _gemm()
    print(
        f"space6, position, 48 parameters; {threads} threads, "
        f"{peak / 1e9:.0f} GFlop/s at most"
    )
    print(
        f"{'measured':>10}{'seconds':>9}{'cpu':>8}{'us each':>8}{'MB':>6}{'passes':>8}"
        f"{'errors':>8}{'bound':>8}{'part':>6}{'sigma0':>8}{'calibrate':>11}{'cpu':>8}"
        f"{'MB':>6}{'cpu to fit':>12}"
    )
    for size in SIZES:
        found, whole = (_answer(str(size), what) for what in ("fit", "calibrate"))
        passes, seconds = found["passes"], found["seconds"]
        bound = sum(OPERATIONS[kind] * rows for kind, rows in passes.items()) / peak
        counts = [passes.get(kind, 0) / size for kind in ("_factors", "errors")]
        print(
            f"{size:>10}{seconds:>9.3f}{found['cpu']:>8.3f}{1e6 * seconds / size:>8.2f}"
            f"{found['memory'] / 1e6:>6.0f}{counts[0]:>8.1f}{counts[1]:>8.1f}"
            f"{bound:>7.3f}s{100 * bound / found['cpu'] * threads:>5.0f}%"
            f"{found['sigma0']:>8.4f}{whole['seconds']:>11.3f}{whole['cpu']:>8.3f}"
            f"{whole['memory'] / 1e6:>6.0f}{whole['cpu'] / found['cpu']:>12.2f}",
            flush=True,
        )
    print("passes, errors: over all, linearized and predicted; bound: floating-point")
    _compare(COMPARED)


def _compare(size: int) -> None:
    """Print what joint corrections and gross errors cost beside placements alone."""
    print(f"\nUR10, position, {size} measurements; ratios to placements without errors")
    print(
        f"{'what':>10}{'gross':>7}{'parameters':>11}{'seconds':>9}{'cpu':>7}{'MB':>6}"
        f"{'set aside':>10}{'sigma0':>8}{'time':>7}{'cpu':>6}{'memory':>7}"
    )
    for what in ("fit", "calibrate"):
        first: dict[str, float] = {}
        for gross in (0.0, GROSS):
            for kinds in (PLACEMENT, JOINTS_TOO):
                found = _answer(str(size), what, str(gross), *kinds)
                first = first or found
                ratios = [found[k] / first[k] for k in ("seconds", "cpu", "memory")]
                print(
                    f"{what:>10}{100 * gross:>6.0f}%{found['parameters']:>11}"
                    f"{found['seconds']:>9.2f}{found['cpu']:>7.2f}"
                    f"{found['memory'] / 1e6:>6.0f}{found['aside']:>10}"
                    f"{found['sigma0']:>8.4f}"
                    f"{ratios[0]:>7.2f}{ratios[1]:>6.2f}{ratios[2]:>7.2f}",
                    flush=True,
                )


def _answer(*given: str) -> dict[str, Any]:
    """What a process of its own measures."""
    command = [sys.executable, "-m", "benchmarks.rows", *given]
    answer = subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
    return dict(json.loads(answer))


def _gemm() -> float:
    """Operations per second of a product of matrices, by one thread."""
    size = 1200
    A = np.random.default_rng(0).normal(size=(size, size))
    return 2.0 * size**3 / best(lambda: A @ A, 10)


def _measure(size: int, what: str) -> dict[str, object]:
    """Fit or calibrate by so many rows; seconds, bytes at most, passes over rows."""
    rng = np.random.default_rng(0)
    chain = calib_pin.load_chain("space6")
    tool = Setup(tool_frame=FrameSetup((0.05, 0.1, 0.1)))
    nominal = nominal_problem(chain, "position", tool)
    truth = calib_pin.draw_errors(nominal.parameters, rng)
    q = chain.random_configurations(size, rng)
    values = _simulated(nominal, truth, q)
    values += rng.normal(size=values.shape) * NOISE
    data = Measurements(
        chain.joints, q, "position", values, np.full_like(values, NOISE)
    )

    def run(rows: Measurements) -> float:
        if what == "calibrate":
            return calib_pin.calibrate(chain, rows).statistics.sigma0
        problem = make_problem(chain, Observations.of(rows), Setup())
        return fit(problem, np.random.default_rng(0)).sigma0

    # Compiles, and loads what is loaded once.
    run(data.rows(np.arange(SIZES[0])))
    passes: Counter[str] = Counter()
    for kind in OPERATIONS:
        setattr(ManyRows, kind, _counted(getattr(ManyRows, kind), kind, passes))
    start, cpu = time.perf_counter(), time.process_time()
    sigma0 = run(data)
    return {
        "seconds": time.perf_counter() - start,
        "cpu": time.process_time() - cpu,
        "memory": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
        "passes": passes,
        "sigma0": sigma0,
    }


def _measure_model(
    size: int, what: str, gross: float, kinds: Sequence[str]
) -> dict[str, float]:
    """Fit or calibrate a model; the measurements are the same for all models."""
    rng = np.random.default_rng(0)
    chain = calib_pin.load_chain(ROBOT, base="base_link", tip="tool0")
    tool = Setup(tool_frame=FrameSetup((0.05, 0.1, 0.1)))
    nominal = nominal_problem(chain, "position", tool)
    truth = calib_pin.draw_errors(nominal.parameters, rng)
    q = chain.random_configurations(size, rng)
    values = _simulated(nominal, truth, q)
    values += rng.normal(size=values.shape) * NOISE
    wrong = rng.random(size) < gross
    values[wrong] += rng.normal(size=(int(wrong.sum()), 3)) * WRONG
    data = Measurements(
        chain.joints, q, "position", values, np.full_like(values, NOISE)
    )
    setup = Setup(parameters=tuple(kinds))
    # Compiles, and loads what is loaded once.
    few = data.rows(np.arange(SIZES[0]))
    calib_pin.calibrate(chain, few, Setup(), validate=False)
    start, cpu = time.perf_counter(), time.process_time()
    if what == "fit":
        problem = make_problem(chain, Observations.of(data), setup)
        fitted = fit(problem, np.random.default_rng(0))
        sigma0, outliers = fitted.sigma0, fitted.robust.outliers
    else:
        found = calib_pin.calibrate(chain, data, setup, holdout=HELD_OUT)
        sigma0, outliers = found.statistics.sigma0, found.statistics.outliers
    return {
        "seconds": time.perf_counter() - start,
        "cpu": time.process_time() - cpu,
        "memory": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
        "parameters": len(nominal_problem(chain, "position", setup).parameters),
        "aside": sum(outlier.weight == 0.0 for outlier in outliers),
        "sigma0": sigma0,
    }


def _simulated(nominal: Problem, truth: Floats, q: Floats) -> Floats:
    """Exact positions (N, 3), without a pose for each."""
    found = []
    for start in range(0, len(q), PIECE):
        piece = q[start : start + PIECE]
        empty = Measurements(
            nominal.data.joints, piece, "position", np.zeros((len(piece), 3))
        )
        problem = replace(nominal, data=Observations.of(empty))
        found.append(ManyRows(problem.blocks[0], problem.sigma).errors(truth))
    return np.concatenate(found)


def _counted(
    method: Callable[..., object], kind: str, passes: Counter[str]
) -> Callable[..., object]:
    """A method of `ManyRows` that notes how many rows it has passed over."""

    def counted(self: ManyRows, *arguments: object) -> object:
        passes[kind] += sum(len(chunk.data) for chunk in self._chunks)
        return method(self, *arguments)

    return counted


if __name__ == "__main__":
    count, what, *rest = sys.argv[1:]
    if rest:
        answer = _measure_model(int(count), what, float(rest[0]), rest[1:])
        print(json.dumps(answer))
    else:
        print(json.dumps(_measure(int(count), what)))
