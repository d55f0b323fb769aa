"""Pieces of work on several threads, and that their number changes no result."""

from __future__ import annotations

import os
import sys
import threading
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from itertools import pairwise

import pytest
from threadpoolctl import ThreadpoolController, threadpool_limits

import calib_pin
import calib_pin.compiled.threads
from calib_pin.compiled.threads import Threads, serial_blas
from calib_pin.setup import Setup, SolverSetup
from tests.shared import simulated

# Pieces.


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
    with pytest.raises(ZeroDivisionError):
        list(Threads(count).map(lambda piece: 1 / piece, [1, 0, 2]))


def test_slices_cover_the_length() -> None:
    for count in (1, 2, 3, 8):
        for length in (0, 1, 2, 3, 7, 100):
            slices = Threads(count).slices(length)
            assert len(slices) == max(1, min(count, length))
            assert (slices[0].start, slices[-1].stop) == (0, length)
            assert all(a.stop == b.start for a, b in pairwise(slices))
            sizes = [part.stop - part.start for part in slices]
            assert max(sizes) - min(sizes) <= 1
    # As many as are worth a thread.
    found = [len(Threads(4).slices(150, least)) for least in (400, 70, 1)]
    assert found == [1, 2, 4]


# Results.


def test_a_fit_is_the_same_with_any_number_of_blas_threads() -> None:
    problem, _ = simulated("pose", size=1.0, noise=1e-4)
    setup, found = Setup(solver=SolverSetup(name="two-step")), []
    for count in (1, 3):
        with threadpool_limits(count, user_api="blas"):
            result = calib_pin.calibrate(
                problem.chains, problem.data, setup, validate=False
            )
        poses = result.model.of().poses(problem.data.q)
        found.append((poses.tobytes(), result.covariance.tobytes()))
    assert found[0] == found[1]


# The guard of the BLAS.


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
        @serial_blas
        def fails() -> None:
            assert blas_threads() == {1}
            raise ZeroDivisionError

        with serial_blas:
            assert blas_threads() == {1}
            with serial_blas:
                pass
            assert blas_threads() == {1}
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
        problem, _ = simulated("position", noise=1e-4)
        calib_pin.calibrate(
            problem.chains,
            problem.data,
            validate=False,
            progress=lambda *_: seen.append(blas_threads()),
        )
        assert seen and all(counts == {1} for counts in seen)
        assert blas_threads() == {3}


def test_generators_cannot_hold_it() -> None:
    def numbers() -> Iterator[int]:
        yield 1

    with pytest.raises(TypeError, match="'numbers'"):
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


@pytest.fixture
def loaded(monkeypatch: pytest.MonkeyPatch) -> list[Library]:
    """Libraries that are loaded, in the place of those that are."""
    found: list[Library] = []
    name = "_blas_libraries"
    monkeypatch.setattr(calib_pin.compiled.threads, name, lambda: list(found))
    return found


def test_a_library_that_comes_late_is_limited_as_well(
    loaded: list[Library], monkeypatch: pytest.MonkeyPatch
) -> None:
    limit, found = type(serial_blas)(), (Library("early"), Library("late"))
    loaded.append(found[0])
    with limit:
        loaded.append(found[1])
        monkeypatch.setitem(sys.modules, "a module of the late library", os)
        with limit:
            assert [library.num_threads for library in found] == [1, 1]
    assert [library.num_threads for library in found] == [4, 4]


@pytest.mark.parametrize(
    ("api", "layer"),
    [("openblas", "openmp"), ("mkl", "intel"), ("openblas", "pthreads")],
)
def test_libraries_that_count_by_python_thread(
    api: str, layer: str, loaded: list[Library]
) -> None:
    library = Library("library", api, layer)
    loaded.append(library)
    limit = type(serial_blas)()

    def elsewhere() -> tuple[int, int]:
        with limit:
            within = library.num_threads
        return within, library.num_threads

    after = 1 if layer == "pthreads" else 4
    with ThreadPoolExecutor(1) as pool:
        with limit:
            assert library.num_threads == 1
            assert pool.submit(elsewhere).result(10.0) == (1, after)
            assert library.num_threads == 1
        assert library.num_threads == 4
