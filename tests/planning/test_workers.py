"""Plans on several processes: the same bytes as in one."""

from __future__ import annotations

import pickle
import subprocess
import sys
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.io.collision import load_collisions
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import BlockKey
from calib_pin.planning.criteria import CRITERIA, Prediction
from calib_pin.planning.information import Information
from calib_pin.planning.plan import Plan
from calib_pin.setup import FrameSetup, Obstacle, PlaneSetup, Region, Setup
from calib_pin.solvers import Status
from calib_pin.workers import SERIAL, Workers

REGION = Region(box=((-0.9, -0.9, 0.0), (1.5, 1.5, 2.2)))
TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1))
SETUP = Setup(tool_frame=TOOL, region=REGION)
OBSTACLE = Obstacle(sphere=0.2, xyz=(0.1, -0.6, 0.6))


class Pool:
    """Two processes that start from nothing, so that all must be sent to them."""

    count = 2

    def __init__(self, executor: ProcessPoolExecutor) -> None:
        self._executor = executor
        self.done: dict[str, int] = {}

    def map(
        self, work: Callable[..., Any], shared: Any, items: Iterable[Any]
    ) -> Iterator[Any]:
        """Results in order; read a little ahead."""
        pending = deque[Future[Any]]()
        for item in items:
            pending.append(self._executor.submit(work, shared, item))
            if len(pending) > 2 * self.count:
                yield self._next(work, pending)
        while pending:
            yield self._next(work, pending)

    def _next(self, work: Callable[..., Any], pending: deque[Future[Any]]) -> Any:
        name = work.__name__.strip("_")
        self.done[name] = self.done.get(name, 0) + 1
        return pending.popleft().result()


@pytest.fixture(scope="module")
def executor() -> Iterator[ProcessPoolExecutor]:
    with ProcessPoolExecutor(2, mp_context=get_context("spawn")) as executor:
        yield executor


@pytest.fixture
def pool(executor: ProcessPoolExecutor) -> Pool:
    return Pool(executor)


def bytes_of(plan: Plan) -> tuple[object, ...]:
    """All that a plan says."""
    covariance = plan.predicted.covariance
    told = plan.value, plan.random, plan.steps, plan.tried, plan.candidates, plan.status
    rest = plan.aims, plan.unmeasurable, plan.blocked, plan.method
    return plan.q.tobytes(), covariance.tobytes(), told, rest


def of_a_region(workers: Workers) -> Plan:
    """By exchange and gradient."""
    chain = calib_pin.load_chain("space6")
    return calib_pin.plan(chain, "position", 10, SETUP, candidates=400, workers=workers)


def without_collisions(workers: Workers) -> Plan:
    """Solids of the robot and of its cell."""
    chain = calib_pin.load_chain("space7")
    return calib_pin.plan(
        chain,
        "pose",
        8,
        Setup(tool_frame=TOOL),
        method="gradient",
        candidates=300,
        collisions=load_collisions(chain, (OBSTACLE,)),
        workers=workers,
    )


def of_meshes(workers: Workers) -> Plan:
    """Meshes and their hulls."""
    chain = calib_pin.load_chain("example:ur10_robot", tip="tool0")
    return calib_pin.plan(
        chain,
        "position",
        12,
        criterion="condition",
        method="greedy",
        candidates=300,
        collisions=load_collisions(chain, (OBSTACLE,)),
        workers=workers,
    )


def of_very_many(workers: Workers) -> Plan:
    """More than are in memory; of the planes one is out of reach."""
    planes = {
        "floor": PlaneSetup((0.1, 0.2, 1.0), 1.5),
        "wall": PlaneSetup((1.0, 0.3, 0.2), -3.0),
        "far": PlaneSetup((1.0, 0.0, 0.0), -50.0),
    }
    return calib_pin.plan(
        calib_pin.load_chain("space6"),
        "plane-distance",
        30,
        Setup(parameters=("joint-offset",), tool_frame=TOOL, planes=planes),
        criterion="O1",
        method="greedy",
        candidates=9000,
        workers=workers,
    )


def apart(workers: Workers) -> Plan:
    """Candidates that keep a distance."""
    chain = calib_pin.load_chain("space7")
    return calib_pin.plan(
        chain, "pose", 8, candidates=600, distance=0.3, method="greedy", workers=workers
    )


@pytest.mark.parametrize(
    ("planned", "work"),
    [
        (of_a_region, {"block", "seen", "descend"}),
        (without_collisions, {"block", "seen", "descend"}),
        (of_meshes, {"block", "seen"}),
        (of_very_many, {"block", "seen", "answers"}),
        (apart, {"block", "seen"}),
    ],
)
def test_plans_do_not_depend_on_the_workers(
    planned: Callable[[Workers], Plan], work: set[str], pool: Pool
) -> None:
    serial, parallel = planned(SERIAL), planned(pool)
    assert bytes_of(parallel) == bytes_of(serial)
    # It was not done in this process.
    assert set(pool.done) == work and all(pool.done.values())


@pytest.mark.parametrize("stage", ["candidates", "exchange", "passes", "gradient"])
def test_stopped_plans_of_several_processes(stage: str, pool: Pool) -> None:
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
        candidates=6000,
        progress=progress,
        workers=pool,
    )
    assert plan.status is (
        Status.CONVERGED if stage == "candidates" else Status.STOPPED
    )
    assert len(plan.q) == 12 and np.isfinite(plan.value)
    assert stages.count("gradient") <= (1 if stage == "gradient" else 100)
    if stage != "candidates":
        assert plan.value < plan.random


def test_criteria_travel() -> None:
    """Those by their functions, not by their names."""
    rows = np.random.default_rng(0).normal(size=(2, 30, 6))
    U = rows[:, :12].reshape(-1, 6)
    found = Information.of(U.T @ U, 2)
    assert found is not None
    for criterion in (*CRITERIA.values(), Prediction(np.eye(6))):
        sent = pickle.loads(pickle.dumps(criterion))
        assert sent.name == criterion.name
        assert sent.cost(found) == criterion.cost(found)
        barred = np.zeros(30, bool)
        trials = (one.trials(found, rows, 1.0) for one in (sent, criterion))
        assert len({one.best(barred) for one in trials}) == 1
        slopes = [one.slope(found, 4.0) for one in (sent, criterion)]
        assert slopes[0][0] == slopes[1][0]
        assert slopes[0][1].tobytes() == slopes[1][1].tobytes()


def test_trees_of_chains_travel(tree: Chains, pool: Pool) -> None:
    keys = tuple(BlockKey("position", side) for side in tree.names)
    options: dict[str, Any] = {"method": "gradient", "candidates": 300}
    setup = Setup(tool_frame=FrameSetup((0.05, 0.03, 0.1)))
    plans = [
        calib_pin.plan(tree, keys, 16, setup, workers=workers, **options)
        for workers in (SERIAL, pool)
    ]
    assert bytes_of(plans[0]) == bytes_of(plans[1])


MILLION = """
import resource
import calib_pin

plan = calib_pin.plan(
    calib_pin.load_chain("space6"),
    "position",
    30,
    method="exchange",
    candidates=1_000_000,
    progress=lambda stage, part: stage == "passes" and part == 1.0,
)
assert plan.candidates == 1_000_000 and plan.value < plan.random
print(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss)
"""


@pytest.mark.slow
def test_a_million_candidates_take_little_memory() -> None:
    """Their rows alone would take 0.6 GB, and a search has several copies of them."""
    child = subprocess.run(
        [sys.executable, "-c", MILLION], capture_output=True, text=True, check=True
    )
    assert 1024 * int(child.stdout) < 1e9
