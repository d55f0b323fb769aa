"""Very many measurements: time, memory, and what the processor's arithmetic allows.

Operations of a measurement (x, y, z) of a robot with n joints, M = 6 (n + 1) + 1
columns (the twists behind every link, and the residual), one for each sum and each
product:

- the pose, a point (25) and three directions (21 each) through every joint: 88 n
- three covectors of the tool (a turn and a wrench, 58) through every joint: 174 n
- the products of all pairs of columns, three components: 3 M (M + 1)
- instead of these, where the rank is decided, Householder reflections: 6 M^2

A step takes the first three, a cost the first one, a decision the first two and the
last. What is smaller does not count: residuals, weights, parameters, steps. The peak is
that of a product of large matrices with one thread, times the threads.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numba import config

import calib_pin
from benchmarks.timing import best
from calib_pin.estimation.formulation import nominal_problem
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
OPERATIONS = {
    "square": POSE,
    "normal": POSE + COVECTORS + 3 * COLUMNS * (COLUMNS + 1),
    "factorize": POSE + COVECTORS + 6 * COLUMNS**2,
}
"""Operations of a measurement by kind of pass."""


def main() -> None:
    """Print a table; every size has a process of its own."""
    threads = int(config.NUMBA_NUM_THREADS)  # type: ignore[attr-defined]
    peak = threads * _gemm()
    print(
        f"space6, position, 48 parameters; {threads} threads, "
        f"{peak / 1e9:.0f} GFlop/s at most"
    )
    print(
        f"{'measured':>10}{'seconds':>9}{'us each':>8}{'MB':>6}{'steps':>7}{'costs':>7}"
        f"{'factors':>9}{'bound':>8}{'part':>7}{'sigma0':>8}"
    )
    for size in SIZES:
        command = [sys.executable, "-m", "benchmarks.rows", str(size)]
        answer = subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout
        found = json.loads(answer)
        passes, seconds = found["passes"], found["seconds"]
        bound = sum(OPERATIONS[kind] * rows for kind, rows in passes.items()) / peak
        counts = [passes.get(kind, 0) / size for kind in ("normal", "square")]
        print(
            f"{size:>10}{seconds:>9.3f}{1e6 * seconds / size:>8.2f}"
            f"{found['memory'] / 1e6:>6.0f}{counts[0]:>7.1f}{counts[1]:>7.1f}"
            f"{passes.get('factorize', 0) / size:>9.1f}{bound:>7.3f}s"
            f"{100 * bound / seconds:>6.0f}%{found['sigma0']:>8.4f}"
        )
    print("steps, costs, factors: passes over all; bound: floating-point bound")


def _gemm() -> float:
    """Operations per second of a product of matrices, by one thread."""
    size = 1200
    A = np.random.default_rng(0).normal(size=(size, size))
    return 2.0 * size**3 / best(lambda: A @ A, 10)


def _measure(size: int) -> dict[str, object]:
    """Calibrate by so many rows; seconds, bytes at most, and passes over rows."""
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
    # Compiles, and loads what is loaded once.
    few = data.rows(np.arange(SIZES[0]))
    calib_pin.calibrate(chain, few, validate=False)
    passes: Counter[str] = Counter()
    for kind in OPERATIONS:
        setattr(ManyRows, kind, _counted(getattr(ManyRows, kind), kind, passes))
    start = time.perf_counter()
    found = calib_pin.calibrate(chain, data, validate=False)
    seconds = time.perf_counter() - start
    return {
        "seconds": seconds,
        "memory": 1024 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss,
        "passes": passes,
        "sigma0": found.statistics.sigma0,
    }


def _simulated(nominal: Problem, truth: Floats, q: Floats) -> Floats:
    """Exact positions (N, 3), without a pose for each."""
    empty = Measurements(nominal.data.joints, q, "position", np.zeros((len(q), 3)))
    problem = replace(nominal, data=Observations.of(empty))
    (exact,) = ManyRows(problem.blocks, problem.sigma).errors(truth)
    return exact


def _counted(
    method: Callable[..., object], kind: str, passes: Counter[str]
) -> Callable[..., object]:
    """A method of `ManyRows` that notes how many rows it has passed over."""

    def counted(self: ManyRows, *arguments: object) -> object:
        passes[kind] += sum(len(chunk.data) for chunk in self._chunks)
        return method(self, *arguments)

    return counted


if __name__ == "__main__":
    print(json.dumps(_measure(int(sys.argv[1]))))
