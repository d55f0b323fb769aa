"""Shared by the benchmarks: clocks, a line of the table, simulated measurements."""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.setup import Setup

BESIDE = Path(__file__).parents[3] / "shared" / "data"
DATA = Path(os.environ.get("CALIB_PIN_DATA", BESIDE))
"""Folder of the real measurements, which are not in the repository."""


def best(job: Callable[[], object], repetitions: int = 7) -> float:
    """Shortest time of a job [s], the one that noise disturbs least."""
    times = []
    for _ in range(repetitions):
        start = time.perf_counter()
        job()
        times.append(time.perf_counter() - start)
    return min(times)


def processor_time(job: Callable[[], object]) -> float:
    """Processor time of a job, its threads and processes [s]."""
    before = _spent()
    job()
    return _spent() - before


def _spent() -> float:
    whose = resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN
    return sum(sum(resource.getrusage(who)[:2]) for who in whose)


def show(name: str, seconds: float, reference: str = "", other: float = 0.0) -> None:
    """One line of the table; without a reference, only the time."""
    ratio = f"  {other / seconds:6.1f} x the speed of {reference}" if reference else ""
    print(f"{name:<40}{1e3 * seconds:9.1f} ms{ratio}")


def simulated(
    chain: Chain,
    model: str,
    setup: Setup,
    count: int,
    noise: float | None = None,
    *,
    seed: int = 0,
    registered: bool = False,
) -> tuple[Problem, Floats, Measurements]:
    """A robot with random errors and its measurements.

    Args:
        chain: The nominal robot.
        model: Name of the measurement model.
        setup: The setup.
        count: Number of measurements.
        noise: Standard deviation of a component [m, rad, px].
        seed: Random seed.
        registered: Whether frames and instrument are nominal.

    Returns:
        The nominal problem, the true parameter values (P,), and the measurements.
    """
    nominal, rng = nominal_problem(chain, model, setup), np.random.default_rng(seed)
    truth = calib_pin.draw_errors(nominal.parameters, rng)
    if registered:
        truth = np.where(nominal.parameters.nuisance, 0.0, truth)
    data = calib_pin.simulate(nominal, truth, rng, count=count, noise=noise)
    return nominal, truth, data.only
