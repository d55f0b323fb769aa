"""Plans on several workers: the same bytes as in one."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from dataclasses import replace
from multiprocessing import get_context
from typing import Any

import pytest

import calib_pin
from calib_pin.setup import FrameSetup, Region, Setup
from calib_pin.solvers import Status
from calib_pin.workers import SERIAL, Workers

TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1))
SETUP = Setup(tool_frame=TOOL, region=Region(box=((-0.9, -0.9, 0.0), (1.5, 1.5, 2.2))))


def sent(work: Callable[..., Any], *arguments: Any) -> Any:
    """A result as another process gives it: all is sent there and back."""
    there = pickle.loads(pickle.dumps((work, arguments)))
    return pickle.loads(pickle.dumps(there[0](*there[1])))


class Pool:
    """Two workers, each task of which is sent, in this process or to another."""

    count = 2

    def __init__(self, executor: ProcessPoolExecutor | None = None) -> None:
        self._executor = executor
        self.done: dict[str, int] = {}

    def map(
        self, work: Callable[..., Any], shared: Any, items: Iterable[Any]
    ) -> Iterator[Any]:
        name = work.__name__.strip("_")
        for item in items:
            self.done[name] = self.done.get(name, 0) + 1
            if self._executor is None:
                yield sent(work, shared, item)
            else:
                yield self._executor.submit(work, shared, item).result()


def of_offsets(workers: Workers) -> Any:
    """By exchange, then by gradient."""
    chain = calib_pin.load_chain("space6")
    still = FrameSetup(estimate=False)
    tool = replace(TOOL, estimate=False)
    setup = Setup(parameters=("joint-offset",), base_frame=still, tool_frame=tool)
    options = {"method": "gradient", "candidates": 60, "workers": workers}
    return calib_pin.plan(chain, "position", 3, setup, **options)


def test_plans_do_not_depend_on_the_workers() -> None:
    pool = Pool()
    serial, parallel = (of_offsets(workers) for workers in (SERIAL, pool))
    assert set(pool.done) == {"block", "descend"}
    assert_equal(serial, parallel)


@pytest.mark.slow
def test_other_processes_begin_with_nothing() -> None:
    with ProcessPoolExecutor(1, mp_context=get_context("spawn")) as executor:
        assert_equal(of_offsets(SERIAL), of_offsets(Pool(executor)))


def assert_equal(one: Any, other: Any) -> None:
    assert one.q.tobytes() == other.q.tobytes()
    covariances = (plan.predicted.covariance.tobytes() for plan in (one, other))
    assert len(set(covariances)) == 1
    for name in ("value", "random", "steps", "tried", "candidates", "status"):
        assert getattr(one, name) == getattr(other, name), name
    for name in ("aims", "unmeasurable", "blocked", "method"):
        assert getattr(one, name) == getattr(other, name), name


@pytest.mark.parametrize("stage", ["exchange", "gradient"])
def test_stopped_plans_of_several_workers(stage: str) -> None:
    """They are valid, and what was not begun is left."""
    stages = list[str]()

    def progress(told: str, part: float) -> bool:
        stages.append(told)
        return told == stage

    plan = calib_pin.plan(
        calib_pin.load_chain("space6"),
        "position",
        12,
        SETUP,
        candidates=100,
        progress=progress,
        workers=Pool(),
    )
    assert plan.status is Status.STOPPED
    assert len(plan.q) == 12 and plan.value < plan.random
    assert stages.count("gradient") == (stage == "gradient")
