"""Plans: what every method returns, rows that are there already, stopping."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import calib_pin
from benchmarks.exact import exact_problem
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.identifiability import observability
from calib_pin.estimation.nominal import registered
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.parameterizations import frame_pose
from calib_pin.planning.plan import Plan
from calib_pin.planning.search import METHODS
from calib_pin.setup import FrameSetup, PlaneSetup, Region, Setup
from calib_pin.solvers import Status
from tests.shared import refused, simulated

COUNT = 12
REGION = Region(box=((-0.9, -0.9, 0.0), (1.5, 1.5, 2.2)))
TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1))
SETUP = Setup(tool_frame=TOOL, region=REGION, limits={"joint_1": (-1.0, 2.0)})
PLANES = Setup(
    parameters=("joint-offset",),
    tool_frame=FrameSetup(estimate=False),
    planes={
        "floor": PlaneSetup((0.1, 0.2, 1.0), 1.5),
        "wall": PlaneSetup((1.0, 0.3, 0.2), -3.0),
    },
)
CHAIN = calib_pin.load_chain("space6")
KNOWN = replace(
    SETUP,
    parameters=("joint-offset",),
    base_frame=FrameSetup(estimate=False),
    tool_frame=replace(TOOL, estimate=False),
)
FEW = {"setup": KNOWN, "count": 4}
"""A set whose search ends soon."""


@pytest.fixture
def few_draws(monkeypatch: pytest.MonkeyPatch) -> None:
    """Configurations are soon looked for in vain."""
    monkeypatch.setattr("calib_pin.planning.workspace.LEAST_DRAWS", 3000)
    monkeypatch.setattr("calib_pin.planning.workspace.DRAWS", 50)


class Calls:
    """Progress of a search: what it was told; it is asked to stop after so many."""

    def __init__(self, most: int) -> None:
        self.most = most
        self.told: list[tuple[str, float]] = []

    def __call__(self, stage: str, part: float) -> bool:
        assert 0.0 <= part <= 1.0
        self.told.append((stage, part))
        return len(self.told) >= self.most


def small(calls: int | Calls = 10**9, **options: Any) -> Plan:
    """A quick plan in a part of the workspace."""
    given: dict[str, Any] = {"candidates": 60, "method": "exchange"} | options
    arguments = given.pop("count", COUNT), given.pop("setup", SETUP)
    chain, model = given.pop("chain", CHAIN), given.pop("model", "position")
    progress = calls if isinstance(calls, Calls) else Calls(calls)
    return calib_pin.plan(chain, model, *arguments, progress=progress, **given)


def matrix(problem: Problem, q: Floats, target: tuple[str, ...]) -> Floats:
    """Whitened, scaled Jacobian of configurations at nominal geometry."""
    zero = np.zeros(len(problem.parameters))
    _, J = exact_problem(problem, zero, q, target).linearize(zero)
    return J * problem.parameters.scales


def value_of(criterion: str, problem: Problem, J: Floats, count: int) -> float:
    """Of the robot, the nuisances projected out, without what is zero."""
    nuisance = problem.parameters.nuisance
    U, s, _ = np.linalg.svd(J[:, nuisance], full_matrices=False)
    Q = U[:, s > 1e-9 * s[0]]
    robot = J[:, ~nuisance] - Q @ (Q.T @ J[:, ~nuisance])
    s = np.linalg.svd(robot, compute_uv=False)
    s = s[s > 1e-9 * s[0]]
    if criterion == "condition":
        return float(s[0] / s[-1])
    return observability(s, count)[criterion]


def better(criterion: str, value: float, other: float) -> bool:
    lower = criterion in ("condition", "prediction")
    return value < other if lower else value > other


def check_set(plan: Plan, count: int = COUNT, setup: Setup = SETUP) -> None:
    """Limits, region, few digits, and that no configuration comes twice."""
    assert plan.q.shape == (count, 6)
    assert len(plan.target) == count
    assert len(np.unique(plan.q, axis=0)) == count
    lower, upper = CHAIN.lower.copy(), CHAIN.upper.copy()
    if "joint_1" in setup.limits:
        lower[0], upper[0] = setup.limits["joint_1"]
    assert (plan.q >= lower).all() and (plan.q <= upper).all()
    assert (plan.q == np.round(plan.q, 6)).all()
    if setup.region is not None:
        tool = frame_pose(setup.tool_frame).homogeneous
        points = (CHAIN.poses(plan.q) @ tool)[:, :3, 3]
        low, high = np.array(setup.region.box)
        assert (points >= low).all() and (points <= high).all()


# --- every method, every criterion -------------------------------------------------


@pytest.mark.parametrize(
    ("method", "criterion"),
    [
        ("exchange", "prediction"),
        ("gradient", "O1"),
        ("pso", "O1"),
        ("ga", "O3"),
        ("auto", "condition"),
        ("greedy", "O5"),
    ],
)
def test_methods_find_sets_better_than_chance(method: str, criterion: str) -> None:
    plan = small(25, method=method, criterion=criterion)
    check_set(plan)
    # With the time it goes on along the gradient.
    found = ("exchange", "gradient") if method == "auto" else (method,)
    assert plan.method in found
    assert plan.criterion == criterion
    assert better(criterion, plan.value, plan.random)
    # The value is what it says, by other means.
    if criterion != "prediction":
        J = matrix(plan.problem, plan.q, plan.target)
        expected = value_of(criterion, plan.problem, J, COUNT)
        assert plan.value == pytest.approx(expected, rel=1e-6)
    else:
        assert plan.value == pytest.approx(plan.predicted.position, rel=1e-9)


@pytest.fixture(scope="module")
def searched() -> tuple[Plan, list[str]]:
    """A plan by the usual methods after one another, and the stages it went through."""
    calls = Calls(10**9)
    plan = small(calls, method="auto", **FEW)
    return plan, [stage for stage, _ in calls.told]


def test_better_methods_find_better_sets(searched: tuple[Plan, list[str]]) -> None:
    plan, stages = searched
    check_set(plan, 4)
    assert plan.status is Status.CONVERGED
    expected = ["candidates", "start", "exchange", "gradient", "table"]
    assert list(dict.fromkeys(stages)) == expected
    greedy, exchange = (small(method=m, **FEW).value for m in ("greedy", "exchange"))
    assert plan.value <= exchange * (1 + 1e-6) and exchange <= greedy * (1 + 1e-6)
    assert plan.value < 0.97 * greedy


@pytest.mark.parametrize("method", ["auto", "ga"])
def test_seeds_reproduce_bit_by_bit(method: str) -> None:
    np.random.seed(5)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    first, again, other = (small(12, method=method, seed=s) for s in (3, 3, 4))
    assert first.q.tobytes() == again.q.tobytes()
    assert (first.value, first.random) == (again.value, again.random)
    assert first.steps == again.steps
    assert first.predicted.covariance.tobytes() == again.predicted.covariance.tobytes()
    assert first.q.tobytes() != other.q.tobytes()
    # Global chance is left alone.
    assert (np.random.get_state()[1] == before).all()  # noqa: NPY002


def test_steps_lead_from_the_least_to_twice_the_set() -> None:
    plan = small(criterion="O1")
    counts = [step.count for step in plan.steps]
    assert counts == list(range(counts[0], 2 * COUNT + 1))
    assert 9 <= counts[0] < COUNT
    own = next(step for step in plan.steps if step.count == COUNT)
    assert own.value == pytest.approx(plan.value, rel=1e-5)
    assert own.position == pytest.approx(plan.predicted.position, rel=1e-5)
    # More rows never make the tip worse.
    positions = [step.position for step in plan.steps]
    assert all(b <= a * (1 + 1e-9) for a, b in pairwise(positions))


# --- joint corrections -------------------------------------------------------------


def test_sets_for_joint_corrections() -> None:
    kinds = ("joint-offset", "transmission", "compliance")
    job: dict[str, Any] = {
        "chain": calib_pin.load_chain("pa10"),
        "setup": Setup(parameters=kinds, tool_frame=TOOL, region=REGION),
        "count": 24,
        "criterion": "O1",
    }
    plan = small(10, method="auto", **job)
    # The gradient does not know them.
    assert plan.method == "exchange" and plan.q.shape == (24, 7)
    assert plan.value > plan.random
    J = matrix(plan.problem, plan.q, plan.target)
    assert plan.value == pytest.approx(value_of("O1", plan.problem, J, 24), rel=1e-6)
    found = {p.name: p for p in plan.parameters}
    assert found["joint_2.compliance.k"].sigma
    assert found["joint_4.transmission.sin2"].sigma
    assert found["joint_2.compliance.k"].unit == "rad/Nm"
    with pytest.raises(OptionError) as caught:
        small(method="gradient", **job)
    assert caught.value.allowed == "exchange, greedy, pso, ga"


# --- targets -----------------------------------------------------------------------


@pytest.mark.parametrize("method", ["exchange", "greedy"])
def test_several_planes(method: str) -> None:
    """Each plane is unknown, so each must be measured often enough."""
    planes = PLANES.planes | {"far": PlaneSetup((1.0, 0.0, 0.0), -50.0)}
    setup = replace(PLANES, planes=planes)
    plan = small(40, model="plane-distance", setup=setup, count=16, method=method)
    check_set(plan, 16, PLANES)
    assert set(plan.target) == {"floor", "wall"} and plan.unmeasurable == ("far",)
    assert min(plan.target.count(name) for name in ("floor", "wall")) >= 3
    assert better("prediction", plan.value, plan.random)
    # Every beam meets its plane at less than seventy degrees within five meters.
    T = CHAIN.poses(plan.q)
    for pose, target in zip(T, plan.target, strict=True):
        stated = planes[target]
        normal = np.array(stated.normal)
        along = normal @ pose[:3, 2]
        distance = -(normal @ pose[:3, 3] + stated.offset) / along
        assert 0.0 <= distance <= 5.0
        assert abs(along) / np.linalg.norm(normal) >= np.cos(np.radians(70.0)) - 1e-9


def test_additions_look_at_planes_that_were_not_measured() -> None:
    setup = calib_pin.read_setup(calib_pin.robot_file("space6", "setup.yaml"))
    rows = simulated("plane-distance", setup, 40, noise=None)[0].data
    planes = {**setup.planes, "side": PlaneSetup((1.0, 0.3, 0.2), -1.5)}
    ranger = replace(setup.ranger, range=(0.0, 1.2))
    assert rows.only.values.max() > 1.2
    more = replace(setup, planes=planes, ranger=ranger)
    plan = small(model="plane-distance", setup=more, measured=rows, candidates=1000)
    assert "side" in plan.target
    # The window is the one that the setup states, however far the rows reached.
    zero, rng = np.zeros(len(plan.problem.parameters)), np.random.default_rng(1)
    seen = calib_pin.simulate(plan.problem, zero, rng, q=plan.q, target=plan.target)
    assert seen.only.values.max() < 1.2


def test_a_target_that_nobody_has_placed_is_beside_the_tip() -> None:
    """At the tip, on the last axis, it would tell less than a real one does."""
    plan = small(setup=Setup(), method="greedy")
    assert plan.assumed_tool and plan.predicted.rank == 27
    known = Setup(tool_frame=FrameSetup((0.0, 0.0, 0.1)))
    stated = small(setup=known, method="greedy")
    assert not stated.assumed_tool and stated.predicted.rank == 25
    assert not small(model="pose", setup=Setup(), method="greedy").assumed_tool


# --- rows that are there already ---------------------------------------------------


@pytest.fixture(scope="module")
def measured() -> Observations:
    """Twelve poor rows: all of them near one configuration."""
    q = 0.3 + 0.25 * np.random.default_rng(8).normal(size=(12, 6))
    return simulated("position", SETUP, 0, 1.0, 8, q=q, noise=2e-4)[0].data


def test_additions_beat_random_ones(measured: Observations) -> None:
    plan = small(count=4, measured=measured, criterion="O1")
    check_set(plan, 4)
    assert plan.measured == 12
    # Begin where the robot stands.
    first, last = np.abs(plan.q[[0, -1]] - measured.q[-1]).max(axis=1)
    assert first <= last
    # All of it together, as a fit would see it.
    problem = make_problem(CHAIN, measured, SETUP)
    zero = np.zeros(len(problem.parameters))
    problem = registered(problem, zero)
    # The stated sigma of the measured rows, the usual one of those to come.
    old = problem.linearize(zero)[1] * problem.parameters.scales

    def value(q: Floats) -> float:
        data = exact_problem(problem, zero, q, ("",) * len(q)).data
        new = replace(problem, data=data).linearize(zero)[1]
        J = np.concatenate([old, new * problem.parameters.scales])
        return value_of("O1", problem, J, 12 + len(q))

    rng = np.random.default_rng(3)
    pool = small(count=100, candidates=100, method="greedy").q
    assert value(plan.q) > max(value(rng.permutation(pool)[:4]) for _ in range(20))
    assert plan.value == pytest.approx(value(plan.q), rel=1e-5)


@pytest.mark.parametrize("criterion", ["condition", "O1", "prediction"])
def test_one_addition_is_the_best_of_all_candidates(
    criterion: str, measured: Observations
) -> None:
    """With one to choose, greedy has looked at every candidate."""
    job: dict[str, Any] = {"measured": measured, "criterion": criterion}
    greedy, exchange = (small(count=1, method=m, **job) for m in ("greedy", "exchange"))
    check_set(greedy, 1)
    # The digits that a plan is rounded to show in the ninth one of the criterion.
    assert exchange.value == pytest.approx(greedy.value, rel=1e-7)
    # Steps begin with none.
    assert [step.count for step in greedy.steps] == [0, 1, 2]
    assert np.isfinite([step.value for step in greedy.steps]).all()
    assert greedy.steps[1].value == pytest.approx(greedy.value, rel=1e-5)


def test_prior_rows_count() -> None:
    """What is known beforehand need not be measured: a few rows are enough."""
    with pytest.raises(OptionError):
        small(count=3)

    def known(size: float) -> Plan:
        prior = {"*.placement.*": size, "base.*": 1e-2, "tool.*": 1e-2}
        return small(count=3, setup=replace(SETUP, prior=prior))

    plan, stronger = known(1e-3), known(1e-4)
    check_set(plan, 3)
    # The prior itself is the covariance before anything is measured.
    sigma = np.sqrt(np.diag(plan.predicted.covariance))
    assert (sigma <= plan.problem.parameters.priors * (1 + 1e-9)).all()
    assert stronger.value < plan.value


# --- stopping ----------------------------------------------------------------------


@pytest.mark.parametrize("after", [1, 20])
@pytest.mark.parametrize("method", METHODS)
def test_a_stopped_search_returns_a_valid_plan(method: str, after: int) -> None:
    calls = Calls(after)
    plan = small(calls, method=method)
    check_set(plan)
    assert np.isfinite(plan.value) and np.isfinite(plan.predicted.position)
    assert calls.told[0] == ("candidates", 0.0)
    # By the time of the table the search has ended by itself.
    if len(calls.told) >= after and calls.told[after - 1][0] != "table":
        assert plan.status is Status.STOPPED
    # It stops soon: the search asks a few more times at most.
    assert len(calls.told) <= max(after, 2) + 60


# --- what cannot be ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "fields"),
    [
        ({"criterion": "conditions"}, {"allowed": ["condition", "O5"]}),
        ({"method": "sa"}, {"allowed": ["exchange", "gradient"]}),
        ({"model": "positions"}, {"allowed": ["position", "pose"]}),
        ({"count": 0}, {"value": 0, "reason": "count"}),
        ({"candidates": 0}, {"value": 0, "reason": "candidates"}),
        ({"count": 4}, {"reason": ["4", "27"], "allowed": "9"}),
        ({"count": 5, "candidates": 5}, {"reason": "5"}),
        ({"setup": replace(SETUP, fixed=("*",))}, {"file": "space6"}),
    ],
)
def test_impossible_requests(
    options: dict[str, Any], fields: dict[str, Any], few_draws: None
) -> None:
    with refused(InputError, **fields):
        small(**options)


def test_rows_that_show_no_frames_are_refused() -> None:
    problem, _ = simulated("position", SETUP, 2, noise=None)
    with refused(InputError, "6 measured"):
        small(measured=problem.data)


@pytest.mark.parametrize(
    ("model", "setup"), [("pose", SETUP), ("plane-distance", PLANES)]
)
def test_the_number_it_asks_for_is_enough(model: str, setup: Setup) -> None:
    job: dict[str, Any] = {"model": model, "setup": setup, "method": "greedy"}
    with pytest.raises(OptionError) as caught:
        small(count=2, **job)
    number = int(str(caught.value.allowed).split()[0])
    assert len(small(count=number, **job).q) == number
    with pytest.raises(OptionError):
        small(count=number - 1, **job)


def test_a_joint_that_is_held_plans_for_the_others() -> None:
    setup = replace(SETUP, limits={"joint_3": (0.3, 0.3)}, region=None)
    plan = small(60, setup=setup, method="gradient", count=14)
    assert (plan.q[:, 2] == 0.3).all()
    assert plan.predicted.rank < small(method="greedy").predicted.rank
    assert better("prediction", plan.value, plan.random)


@pytest.mark.slow
def test_what_is_planned_for_a_ranger_can_be_measured_by_real_robots() -> None:
    """Descents end at the edge of the window; a robot with errors looks beside it."""
    chain = calib_pin.load_chain("space6")
    setup = calib_pin.read_setup(calib_pin.robot_file("space6", "setup.yaml"))
    plan = calib_pin.plan(chain, "plane-distance", 30, setup, candidates=150)
    for seed in range(30):
        rng = np.random.default_rng(seed)
        theta = calib_pin.draw_errors(plan.problem.parameters, rng)
        rows = calib_pin.simulate(plan.problem, theta, rng, q=plan.q)
        assert len(rows) == 30
