"""Pieces of work on several threads, and that their number changes no result."""

from __future__ import annotations

import os
import subprocess
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import numba
import numpy as np
import pytest
from threadpoolctl import ThreadpoolController, threadpool_limits

import calib_pin
import calib_pin.compiled.threads
from calib_pin.compiled.threads import Threads, serial_blas
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.setup import Setup, SolverSetup

FIT = """
import numpy as np
import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.fit import fit
from calib_pin.setup import Setup, SolverSetup
from calib_pin.compiled.threads import Threads
from dataclasses import replace
from calib_pin.estimation import population

population.WORTHWHILE = 1  # Threads even for as little work as this.
evolution = {"maxiter": 20, "population_size": 20}
setup = Setup(solver=SolverSetup(name="hybrid", evolution=evolution))
problem = nominal_problem(calib_pin.load_chain("space6"), "position", setup)
rng = np.random.default_rng(1)
truth = calib_pin.draw_errors(problem.parameters, rng)
rows = calib_pin.simulate(problem, truth, rng, count=50, noise=1e-4)
found = fit(replace(problem, data=rows), np.random.default_rng(0))
print(Threads().count, found.solution.evolution.nit, found.theta.tobytes().hex())
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


CALIBRATIONS = """
import numpy as np
import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.setup import Setup, SolverSetup

chain = calib_pin.load_chain("space6")
problem = nominal_problem(chain, "pose", Setup())
rng = np.random.default_rng(1)
truth = calib_pin.draw_errors(problem.parameters, rng)
rows = calib_pin.simulate(problem, truth, rng, count=150, noise=1e-4)
few = {"parameters": ("joint-offset",)}
for setup in (
    Setup(),
    Setup(solver=SolverSetup(name="two-step")),
    Setup(learned="network", **few),
    Setup(learned="gaussian-process", **few),
):
    result = calib_pin.calibrate(chain, rows, setup, validate=False)
    poses = result.model.of().poses(rows.q)
    print(poses.tobytes().hex(), result.covariance.tobytes().hex())
"""


@pytest.mark.slow
def test_results_are_the_same_with_any_number_of_blas_threads() -> None:
    outputs = set()
    for count in ("1", "2", "3"):
        result = subprocess.run(
            [sys.executable, "-c", CALIBRATIONS],
            env={**os.environ, "OPENBLAS_NUM_THREADS": count},
            capture_output=True,
            text=True,
            check=True,
        )
        assert len(result.stdout.splitlines()) == 4
        outputs.add(result.stdout)
    assert len(outputs) == 1


@pytest.mark.parametrize("solver", ["gauss-newton", "two-step"])
def test_a_fit_is_the_same_with_any_number_of_blas_threads(solver: str) -> None:
    chain = calib_pin.load_chain("space6")
    setup = Setup(solver=SolverSetup(name=solver))
    problem = nominal_problem(chain, "pose", setup)
    rng = np.random.default_rng(1)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, truth, rng, count=60, noise=1e-4)
    found = []
    for count in (1, 3):
        with threadpool_limits(count, user_api="blas"):
            result = calib_pin.calibrate(chain, rows, setup, validate=False)
        found.append(
            (result.model.of().poses(rows.q).tobytes(), result.covariance.tobytes())
        )
    assert found[0] == found[1]


def blas_threads() -> set[int]:
    libraries = ThreadpoolController().select(user_api="blas").lib_controllers
    return {library.num_threads for library in libraries}


@pytest.fixture
def three() -> Iterator[None]:
    with threadpool_limits(3, user_api="blas"):
        yield


@pytest.mark.usefixtures("three")
class TestSerialBlas:
    def test_it_holds_within_and_no_longer(self) -> None:
        with serial_blas:
            assert blas_threads() == {1}
            with serial_blas:
                assert blas_threads() == {1}
            assert blas_threads() == {1}
        assert blas_threads() == {3}

    def test_an_error_restores_what_was_there(self) -> None:
        @serial_blas
        def fails() -> None:
            assert blas_threads() == {1}
            raise ZeroDivisionError

        with pytest.raises(ZeroDivisionError):
            fails()
        assert blas_threads() == {3}

    def test_the_last_thread_to_leave_restores(self) -> None:
        inside, leave = threading.Event(), threading.Event()

        def stay() -> None:
            with serial_blas:
                inside.set()
                assert leave.wait(10.0)
                assert blas_threads() == {1}

        with ThreadPoolExecutor(1) as pool:
            with serial_blas:
                done = pool.submit(stay)
                assert inside.wait(10.0)
            assert blas_threads() == {1}
            leave.set()
            done.result(10.0)
        assert blas_threads() == {3}
        # Whoever wants another number can still set it, from any thread.
        with threadpool_limits(2, user_api="blas"):
            assert blas_threads() == {2}

    def test_public_functions_hold_it(self) -> None:
        seen = []
        chain = calib_pin.load_chain("space6")
        problem = nominal_problem(chain, "position", Setup())
        rng = np.random.default_rng(1)
        rows = calib_pin.simulate(
            problem, np.zeros(len(problem.parameters)), rng, count=60, noise=1e-4
        )
        calib_pin.calibrate(
            chain, rows, progress=lambda *_: seen.append(blas_threads())
        )
        assert seen
        assert all(counts == {1} for counts in seen)
        assert blas_threads() == {3}


def test_generators_cannot_hold_it() -> None:
    def numbers() -> Iterator[int]:
        yield 1

    with pytest.raises(TypeError, match="'numbers' is a generator"):
        serial_blas(numbers)


@dataclass
class Library:
    """A library whose number of threads belongs to each Python thread, or to all."""

    filepath: str
    internal_api: str = "openblas"
    threading_layer: str = "pthreads"

    def __post_init__(self) -> None:
        self._counts: dict[int, int] = {}

    @property
    def _owner(self) -> int:
        shared = (self.internal_api, self.threading_layer) == ("openblas", "pthreads")
        return 0 if shared else threading.get_ident()

    @property
    def num_threads(self) -> int:
        return self._counts.get(self._owner, 4)

    def set_num_threads(self, count: int) -> None:
        self._counts[self._owner] = count


def test_a_library_that_comes_late_is_limited_as_well(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    early, late = Library("early"), Library("late")
    loaded = [early]
    monkeypatch.setattr(
        calib_pin.compiled.threads, "_blas_libraries", lambda: list(loaded)
    )
    limit = type(serial_blas)()
    with limit:
        loaded.append(late)
        monkeypatch.setitem(sys.modules, "a module of the late library", os)
        with limit:
            assert (early.num_threads, late.num_threads) == (1, 1)
        assert late.num_threads == 1
    assert (early.num_threads, late.num_threads) == (4, 4)


@pytest.mark.parametrize(
    ("api", "layer"),
    [("openblas", "openmp"), ("mkl", "intel"), ("openblas", "pthreads")],
)
def test_libraries_that_count_by_python_thread(
    api: str, layer: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    library = Library("library", api, layer)
    monkeypatch.setattr(
        calib_pin.compiled.threads, "_blas_libraries", lambda: [library]
    )
    limit = type(serial_blas)()

    def elsewhere() -> tuple[int, int]:
        with limit:
            within = library.num_threads
        return within, library.num_threads

    with ThreadPoolExecutor(1) as pool:
        with limit:
            assert library.num_threads == 1
            assert pool.submit(elsewhere).result(10.0) == (
                1,
                1 if layer == "pthreads" else 4,
            )
            assert library.num_threads == 1
        assert library.num_threads == 4
