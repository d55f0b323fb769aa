"""Pieces of work on several threads, and that their number changes no result."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from itertools import pairwise

import numba
import pytest

from calib_pin.threads import Threads

FIT = """
import numpy as np
import calib_pin
from calib_pin.formulation import nominal_problem
from calib_pin.fit import fit
from calib_pin.setup import Setup, SolverSetup
from calib_pin.threads import Threads
from dataclasses import replace
import calib_pin.population

calib_pin.population.WORTHWHILE = 1  # Threads even for as little work as this.
evolution = {"maxiter": 20, "population_size": 20}
setup = Setup(solver=SolverSetup(name="hybrid", evolution=evolution))
problem = nominal_problem(calib_pin.load_chain("space6"), "position", setup)
rng = np.random.default_rng(1)
truth = calib_pin.draw_errors(problem.parameters, rng)
rows = calib_pin.simulate(problem, truth, rng, count=50, noise=1e-4)
found = fit(replace(problem, data=rows), np.random.default_rng(0))
print(Threads().count, found.evolution.nit, found.theta.tobytes().hex())
"""


@pytest.mark.parametrize("count", [1, 2, 3])
def test_results_come_in_the_order_of_the_pieces(count: int) -> None:
    # The first piece waits for the second, where there is a thread for it.
    second = threading.Event()

    def work(piece: int) -> tuple[int, str]:
        if piece == 1:
            second.set()
        if piece == 0 and count > 1:
            assert second.wait(10.0)
        return piece**2, threading.current_thread().name

    squares, names = zip(*Threads(count).map(work, range(5)), strict=True)
    assert squares == (0, 1, 4, 9, 16)
    here = threading.current_thread().name
    assert (set(names) == {here}) == (count == 1)
    assert (here in names) == (count == 1)


@pytest.mark.parametrize("count", [1, 2])
def test_errors_come_out_of_the_threads(count: int) -> None:
    with pytest.raises(ZeroDivisionError):
        list(Threads(count).map(lambda piece: 1 / piece, [1, 0, 2]))


def test_slices_that_are_worth_a_thread() -> None:
    threads = Threads(4)
    assert len(threads.slices(150, 400)) == 1
    assert len(threads.slices(150, 70)) == 2
    assert len(threads.slices(150, 1)) == 4


@pytest.mark.parametrize("count", [1, 2, 3, 8])
@pytest.mark.parametrize("length", [0, 1, 2, 3, 7, 100])
def test_slices_cover_the_length(length: int, count: int) -> None:
    slices = Threads(count).slices(length)
    assert len(slices) == max(1, min(count, length))
    assert (slices[0].start, slices[-1].stop) == (0, length)
    assert all(a.stop == b.start for a, b in pairwise(slices))
    sizes = [part.stop - part.start for part in slices]
    assert max(sizes) - min(sizes) <= 1


def test_as_many_threads_as_numba_takes(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(numba.config, "NUMBA_NUM_THREADS", 3)
    assert Threads().count == 3
    assert Threads(2).count == 2


def test_a_seeded_fit_is_the_same_with_any_number_of_threads() -> None:
    outputs = []
    for count in (1, 2):
        result = subprocess.run(
            [sys.executable, "-c", FIT],
            env={**os.environ, "NUMBA_NUM_THREADS": str(count)},
            capture_output=True,
            text=True,
            check=True,
        )
        threads, generations, theta = result.stdout.split()
        assert (threads, generations) == (str(count), "20")
        outputs.append(theta)
    assert outputs[0] == outputs[1]
    assert len(outputs[0]) == 48 * 16
