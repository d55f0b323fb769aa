"""Plans: what every method returns, rows that are there already, stopping."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.identifiability import observability
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.registration import registered
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.parameterizations import frame_pose
from calib_pin.planning.plan import CRITERION_NAMES, Plan
from calib_pin.planning.search import METHODS
from calib_pin.setup import FrameSetup, PlaneSetup, Region, Setup
from calib_pin.simulation import exact_problem
from calib_pin.solvers import Status

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


@pytest.fixture(scope="module")
def chain() -> Chain:
    return calib_pin.load_chain("space6")


def small(chain: Chain, **options: Any) -> Plan:
    """A quick plan in a part of the workspace."""
    given: dict[str, Any] = {"candidates": 100, "method": "exchange"} | options
    setup = given.pop("setup", SETUP)
    count = given.pop("count", COUNT)
    return calib_pin.plan(chain, given.pop("model", "position"), count, setup, **given)


def matrix(problem: Problem, q: Floats, target: tuple[str, ...]) -> Floats:
    """Whitened, scaled Jacobian of configurations at nominal geometry."""
    zero = np.zeros(len(problem.parameters))
    _, J = exact_problem(problem, zero, q, target).linearize(zero)
    return J * problem.parameters.scales


def singular_values(problem: Problem, J: Floats) -> Floats:
    """Those of the robot, the nuisances projected out, without those that are zero."""
    nuisance = problem.parameters.nuisance
    U, s, _ = np.linalg.svd(J[:, nuisance], full_matrices=False)
    Q = U[:, s > 1e-9 * s[0]]
    robot = J[:, ~nuisance] - Q @ (Q.T @ J[:, ~nuisance])
    s = np.linalg.svd(robot, compute_uv=False)
    return s[s > 1e-9 * s[0]]


def value_of(criterion: str, problem: Problem, J: Floats, count: int) -> float:
    s = singular_values(problem, J)
    if criterion == "condition":
        return float(s[0] / s[-1])
    return observability(s, count)[criterion]


def better(criterion: str, value: float, other: float) -> bool:
    if criterion in ("condition", "prediction"):
        return value < other
    return value > other


def check_set(plan: Plan, count: int, chain: Chain, setup: Setup = SETUP) -> None:
    """Limits, region, and that no configuration comes twice; by hand."""
    assert plan.q.shape == (count, 6)
    assert len(plan.target) == count
    assert len(np.unique(plan.q, axis=0)) == count
    lower, upper = chain.lower.copy(), chain.upper.copy()
    if "joint_1" in setup.limits:
        lower[0], upper[0] = setup.limits["joint_1"]
    assert (plan.q >= lower).all() and (plan.q <= upper).all()
    if setup.region is not None:
        tool = frame_pose(setup.tool_frame).homogeneous
        points = (chain.poses(plan.q) @ tool)[:, :3, 3]
        low, high = np.array(setup.region.box)
        assert (points >= low).all() and (points <= high).all()


# --- joint corrections -------------------------------------------------------------


@pytest.fixture(scope="module")
def corrected() -> Setup:
    kinds = ("joint-offset", "transmission", "compliance")
    return Setup(parameters=kinds, tool_frame=TOOL, region=REGION)


@pytest.mark.parametrize("method", [m for m in METHODS if m != "gradient"])
@pytest.mark.parametrize("criterion", ["prediction", "O1"])
def test_sets_for_joint_corrections(
    method: str, criterion: str, corrected: Setup
) -> None:
    chain = calib_pin.load_chain("pa10")
    calls = 0

    def enough(stage: str, part: float) -> bool:
        nonlocal calls
        calls += 1
        return calls > 10

    plan = small(
        chain,
        setup=corrected,
        count=24,
        method=method,
        criterion=criterion,
        progress=enough,
    )
    assert plan.method == ("exchange" if method == "auto" else method)
    assert plan.q.shape == (24, 7)
    assert better(criterion, plan.value, plan.random)
    if criterion == "O1":
        J = matrix(plan.problem, plan.q, plan.target)
        assert plan.value == pytest.approx(value_of("O1", plan.problem, J, 24))
    sigmas = {p.name: p.sigma for p in plan.parameters}
    assert sigmas["joint_2.compliance.k"] and sigmas["joint_4.transmission.sin2"]
    units = {p.name: p.unit for p in plan.parameters}
    assert units["joint_2.compliance.k"] == "rad/Nm"


def test_the_gradient_does_not_know_joint_corrections(
    corrected: Setup, refused: Callable[..., Any]
) -> None:
    chain = calib_pin.load_chain("pa10")
    others = "exchange, greedy, pso, ga"
    with refused(OptionError, ["joint correction", "'gradient'"], allowed=others):
        small(chain, setup=corrected, count=24, method="gradient")


# --- every method, every criterion -------------------------------------------------


@pytest.mark.parametrize("criterion", ["prediction", "O1", "O3"])
@pytest.mark.parametrize("method", METHODS)
def test_methods_find_sets_better_than_chance(
    method: str, criterion: str, chain: Chain
) -> None:
    # A swarm moves all configurations at once, which takes long.
    if method == "pso" and criterion != "O1":
        pytest.skip("the swarm is slow")
    calls = 0

    def enough(stage: str, part: float) -> bool:
        nonlocal calls
        calls += 1
        assert 0.0 <= part <= 1.0
        return calls > (25 if method in ("pso", "ga") else 60)

    plan = small(chain, method=method, criterion=criterion, progress=enough)
    check_set(plan, COUNT, chain)
    assert plan.method == ("gradient" if method == "auto" else method) or (
        method == "auto" and plan.method == "exchange"
    )
    assert plan.criterion == criterion
    assert calls > 0
    assert better(criterion, plan.value, plan.random)
    # The value is what it says, by other means.
    if criterion != "prediction":
        J = matrix(plan.problem, plan.q, plan.target)
        expected = value_of(criterion, plan.problem, J, COUNT)
        assert plan.value == pytest.approx(expected, rel=1e-6)
    else:
        assert plan.value == pytest.approx(plan.predicted.position, rel=1e-9)


@pytest.mark.parametrize("criterion", CRITERION_NAMES)
def test_random_sets_are_those_of_the_candidates(criterion: str, chain: Chain) -> None:
    plan = small(chain, criterion=criterion, method="greedy", candidates=400)
    if criterion == "prediction":
        return
    # The median of 25 sets of ours, from sets that a test draws by itself.
    rng = np.random.default_rng(11)
    values = []
    while len(values) < 40:
        q = chain.random_configurations(400, rng)
        tool = frame_pose(TOOL).homogeneous
        inside = REGION.contains((chain.poses(q) @ tool)[:, :3, 3])
        inside &= (q[:, 0] >= -1.0) & (q[:, 0] <= 2.0)
        q = q[inside][:COUNT]
        J = matrix(plan.problem, q, ("",) * COUNT)
        values.append(value_of(criterion, plan.problem, J, COUNT))
    low, high = np.quantile(values, [0.1, 0.9])
    assert low <= plan.random <= high


@pytest.fixture(scope="module")
def searched(chain: Chain) -> tuple[Plan, list[str]]:
    """A plan by the usual methods after one another, and the stages it went through."""
    stages: list[str] = []
    plan = small(
        chain, method="auto", progress=lambda stage, part: stages.append(stage)
    )
    return plan, stages


def test_better_methods_find_better_sets(
    chain: Chain, searched: tuple[Plan, list[str]]
) -> None:
    values = {m: small(chain, method=m).value for m in ("greedy", "exchange")}
    values["auto"] = searched[0].value
    assert values["auto"] <= values["exchange"] <= values["greedy"] * (1 + 1e-6)
    assert values["auto"] < 0.97 * values["greedy"]


@pytest.mark.parametrize("method", ["auto", "exchange", "ga", "greedy"])
def test_seeds_reproduce_bit_by_bit(method: str, chain: Chain) -> None:
    def run(seed: int) -> Plan:
        calls = iter(range(10**9))
        return small(
            chain,
            method=method,
            seed=seed,
            candidates=80,
            progress=lambda *_: next(calls) > 12,
        )

    first, again, other = run(3), run(3), run(4)
    assert first.q.tobytes() == again.q.tobytes()
    assert (first.value, first.random) == (again.value, again.random)
    assert first.steps == again.steps
    assert first.predicted.covariance.tobytes() == again.predicted.covariance.tobytes()
    assert first.q.tobytes() != other.q.tobytes()


def test_global_chance_is_left_alone(chain: Chain) -> None:
    np.random.seed(5)  # noqa: NPY002
    before = np.random.get_state()[1].copy()  # noqa: NPY002
    small(chain, method="greedy", candidates=40)
    assert (np.random.get_state()[1] == before).all()  # noqa: NPY002


def test_steps_lead_from_the_least_to_twice_the_set(chain: Chain) -> None:
    plan = small(chain, criterion="O1")
    counts = [step.count for step in plan.steps]
    assert counts == list(range(counts[0], 2 * COUNT + 1))
    assert 9 <= counts[0] < COUNT
    own = next(step for step in plan.steps if step.count == COUNT)
    assert own.value == pytest.approx(plan.value, rel=1e-5)
    assert own.position == pytest.approx(plan.predicted.position, rel=1e-5)
    # More rows never make the tip worse.
    positions = [step.position for step in plan.steps]
    assert all(b <= a * (1 + 1e-9) for a, b in pairwise(positions))


def test_configurations_have_few_decimals(
    chain: Chain, searched: tuple[Plan, list[str]]
) -> None:
    plan, _ = searched
    lower, upper = chain.lower, chain.upper
    at_limit = (plan.q == lower) | (plan.q == upper)
    assert (at_limit | (plan.q == np.round(plan.q, 6))).all()
    assert not at_limit.all()


def test_the_order_is_shorter_than_chance(chain: Chain) -> None:
    plan = small(chain, count=20)
    travel = np.abs(np.diff(plan.q, axis=0)).max(axis=1).sum()
    rng = np.random.default_rng(0)
    shuffled = [
        np.abs(np.diff(rng.permutation(plan.q), axis=0)).max(axis=1).sum()
        for _ in range(50)
    ]
    assert travel < min(shuffled)


@pytest.mark.parametrize(
    ("method", "distance"),
    [
        ("gradient", 0.8),
        pytest.param("exchange", 1.5, marks=pytest.mark.slow),
        pytest.param("auto", 0.8, marks=pytest.mark.slow),
    ],
)
def test_sets_keep_their_distance(method: str, distance: float, chain: Chain) -> None:
    plan = small(chain, method=method, distance=distance)
    check_set(plan, COUNT, chain)
    between = np.abs(plan.q[:, None] - plan.q[None]).max(axis=2)
    np.fill_diagonal(between, np.inf)
    assert between.min() >= distance
    # Nobody stopped it, whatever was held up on the way.
    assert plan.status is not Status.STOPPED
    assert better("prediction", plan.value, plan.random)


@pytest.mark.parametrize(
    ("method", "more"),
    [
        *(("exchange", 0), ("exchange", 2), ("greedy", 0)),
        pytest.param("auto", 2, marks=pytest.mark.slow),
    ],
)
def test_hardly_more_candidates_than_wanted(
    method: str, more: int, chain: Chain
) -> None:
    plan = small(chain, method=method, candidates=COUNT + more)
    check_set(plan, COUNT, chain)
    assert plan.candidates == COUNT + more


def test_the_condition_is_lowered_by_factors(chain: Chain) -> None:
    calls = iter(range(10**9))
    plan = small(
        chain,
        criterion="condition",
        method="auto",
        count=15,
        progress=lambda *_: next(calls) > 150,
    )
    check_set(plan, 15, chain)
    assert plan.value < 0.3 * plan.random


# --- targets -----------------------------------------------------------------------


@pytest.mark.parametrize("method", ["auto", "exchange", "greedy", "ga"])
def test_several_planes(method: str, chain: Chain) -> None:
    """Each plane is unknown, so each must be measured often enough."""
    calls = iter(range(10**9))
    plan = small(
        chain,
        model="plane-distance",
        setup=PLANES,
        count=16,
        method=method,
        progress=lambda *_: next(calls) > 40,
    )
    check_set(plan, 16, chain, PLANES)
    assert set(plan.target) == {"floor", "wall"}
    assert min(plan.target.count(name) for name in ("floor", "wall")) >= 3
    assert better("prediction", plan.value, plan.random)
    # Every beam meets its plane at less than seventy degrees within five meters.
    T = chain.poses(plan.q)
    for pose, target in zip(T, plan.target, strict=True):
        stated = PLANES.planes[target]
        normal = np.array(stated.normal)
        along = normal @ pose[:3, 2]
        distance = -(normal @ pose[:3, 3] + stated.offset) / along
        assert 0.0 <= distance <= 5.0
        assert abs(along) / np.linalg.norm(normal) >= np.cos(np.radians(70.0)) - 1e-9


@pytest.mark.parametrize(
    "method", ["exchange", "greedy", pytest.param("ga", marks=pytest.mark.slow)]
)
def test_no_more_rows_than_unknowns(method: str, chain: Chain) -> None:
    """Five offsets and two planes: of random sets few would do."""
    plan = small(chain, model="plane-distance", setup=PLANES, count=30)
    rank = plan.predicted.rank
    plan = small(chain, model="plane-distance", setup=PLANES, count=rank, method=method)
    check_set(plan, rank, chain, PLANES)
    assert np.isfinite(plan.value)
    # One row per unknown: the matrix is square and regular.
    J = matrix(plan.problem, plan.q, plan.target)
    assert np.linalg.matrix_rank(J, tol=1e-8 * np.linalg.norm(J, 2)) == rank


# --- rows that are there already ---------------------------------------------------


@pytest.fixture(scope="module")
def measured(chain: Chain) -> Observations:
    """Twelve poor rows: all of them near one configuration."""
    rng = np.random.default_rng(8)
    problem = nominal_problem(chain, "position", SETUP)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    q = 0.3 + 0.25 * rng.normal(size=(12, 6))
    return calib_pin.simulate(problem, theta, rng, q=q, noise=2e-4)


@pytest.mark.parametrize(
    "criterion",
    [
        *("prediction", "O1"),
        *(pytest.param(c, marks=pytest.mark.slow) for c in ("condition", "O3")),
    ],
)
def test_additions_beat_random_ones(
    criterion: str, chain: Chain, measured: Observations
) -> None:
    rng = np.random.default_rng(3)
    grid = chain.random_configurations(300, rng)
    plan = small(chain, count=4, measured=measured, criterion=criterion, tests=grid)
    check_set(plan, 4, chain)
    assert plan.measured == 12
    # All of it together, as a fit would see it.
    problem = make_problem(chain, measured, SETUP)
    problem = registered(problem, np.zeros(len(problem.parameters)))
    zero = np.zeros(len(problem.parameters))
    # The stated sigma of the measured rows, the usual one of those to come.
    old = problem.linearize(zero)[1] * problem.parameters.scales

    def value(q: Floats) -> float:
        data = exact_problem(problem, zero, q, ("",) * len(q)).data
        new = replace(problem, data=data).linearize(zero)[1]
        J = np.concatenate([old, new * problem.parameters.scales])
        if criterion == "prediction":
            basis = np.linalg.svd(J, full_matrices=False)[2][: plan.predicted.rank].T
            C = np.linalg.inv(basis.T @ J.T @ J @ basis)
            count = len(problem.only.error.screws)
            half = (basis * 1.0)[:count]
            tip = problem.only.error.jacobian(grid, zero[:count])[1][:, :3]
            tip = (tip * problem.parameters.scales[:count]) @ half
            return float(np.sqrt(np.einsum("nai,ij,naj->", tip, C, tip) / len(grid)))
        return value_of(criterion, problem, J, 12 + len(q))

    pool = small(chain, count=150, candidates=150, method="greedy").q
    others = [value(rng.permutation(pool)[:4]) for _ in range(30)]
    best = min(others) if criterion in ("prediction", "condition") else max(others)
    ours = value(plan.q)
    assert better(criterion, ours, best)
    assert plan.value == pytest.approx(ours, rel=1e-5)


def test_additions_begin_where_the_robot_stands(
    chain: Chain, measured: Observations
) -> None:
    plan = small(chain, count=6, measured=measured)
    first = np.abs(plan.q - measured.q[-1]).max(axis=1)[0]
    reversed_first = np.abs(plan.q - measured.q[-1]).max(axis=1)[-1]
    travel = np.abs(np.diff(plan.q, axis=0)).max(axis=1).sum()
    assert first + travel <= reversed_first + travel


@pytest.mark.parametrize("criterion", CRITERION_NAMES)
def test_one_addition_is_the_best_of_all_candidates(
    criterion: str, chain: Chain, measured: Observations
) -> None:
    """With one to choose, greedy has looked at every candidate."""
    plans = {
        method: small(
            chain, count=1, measured=measured, criterion=criterion, method=method
        )
        for method in ("greedy", "exchange")
    }
    for plan in plans.values():
        check_set(plan, 1, chain)
        assert plan.measured == 12
    # The digits that a plan is rounded to show in the ninth one of the criterion.
    assert plans["exchange"].value == pytest.approx(plans["greedy"].value, rel=1e-9)


def test_steps_of_additions_begin_with_none(
    chain: Chain, measured: Observations
) -> None:
    for criterion in ("O1", "prediction"):
        plan = small(chain, count=3, measured=measured, criterion=criterion)
        assert [step.count for step in plan.steps] == list(range(7))
        values = [step.value for step in plan.steps]
        assert np.isfinite(values).all()
        own = plan.steps[3]
        assert own.value == pytest.approx(plan.value, rel=1e-5)


def test_prior_rows_count(chain: Chain) -> None:
    """What is known beforehand need not be measured: a few rows are enough."""
    with pytest.raises(OptionError, match="3 configurations cannot determine"):
        small(chain, count=3)
    known = replace(
        SETUP, prior={"*.placement.*": 1e-3, "base.*": 1e-2, "tool.*": 1e-2}
    )
    for count in (1, 3):
        plan = small(chain, setup=known, count=count)
        check_set(plan, count, chain)
        # The prior itself is the covariance before anything is measured.
        scale = plan.problem.parameters.priors
        sigma = np.sqrt(np.diag(plan.predicted.covariance))
        assert (sigma <= scale * (1 + 1e-9)).all()
    stronger = replace(
        SETUP, prior={"*.placement.*": 1e-4, "base.*": 1e-2, "tool.*": 1e-2}
    )
    assert small(chain, setup=stronger, count=3).value < plan.value


# --- stopping ----------------------------------------------------------------------


@pytest.mark.parametrize(
    "after", [1, 20, *(pytest.param(n, marks=pytest.mark.slow) for n in (2, 5))]
)
@pytest.mark.parametrize("method", METHODS)
def test_a_stopped_search_returns_a_valid_plan(
    method: str, after: int, chain: Chain
) -> None:
    calls: list[tuple[str, float]] = []

    def progress(stage: str, part: float) -> bool:
        calls.append((stage, part))
        return len(calls) >= after

    plan = small(chain, method=method, progress=progress)
    check_set(plan, COUNT, chain)
    assert np.isfinite(plan.value) and np.isfinite(plan.predicted.position)
    assert calls[0] == ("candidates", 0.0)
    # By the time of the table the search has ended by itself.
    if len(calls) >= after and calls[after - 1][0] != "table":
        assert plan.status is Status.STOPPED
    # It stops soon: the search asks a few more times at most.
    assert len(calls) <= max(after, 2) + 60


def test_a_search_that_is_told_to_go_on_is_not_stopped(
    searched: tuple[Plan, list[str]],
) -> None:
    plan, stages = searched
    assert plan.status is Status.CONVERGED
    expected = ["candidates", "start", "exchange", "gradient", "table"]
    assert list(dict.fromkeys(stages)) == expected


def test_what_is_stopped_later_is_no_worse(chain: Chain) -> None:
    values = []
    for after in (2, 8, 20, 40):
        calls = iter(range(10**9))
        plan = small(
            chain,
            method="ga",
            progress=lambda *_, after=after, calls=calls: next(calls) >= after,
        )
        values.append(plan.value)
    assert values == sorted(values, reverse=True)
    assert values[-1] < values[0]


# --- what cannot be ----------------------------------------------------------------


@pytest.mark.parametrize(
    ("options", "fields"),
    [
        (
            {"criterion": "conditions"},
            {"reason": ["'conditions'", "mean 'condition'?"], "allowed": "O5"},
        ),
        (
            {"method": "sa"},
            {"reason": "method 'sa'", "allowed": ["exchange", "gradient"]},
        ),
        ({"model": "positions"}, {"reason": ["'positions'", "mean 'position'?"]}),
        ({"count": 0}, {"reason": "count", "value": 0, "allowed": "1 or more"}),
        ({"candidates": 0}, {"reason": "candidates", "allowed": "1 or more"}),
        ({"distance": -1.0}, {"reason": "distance", "value": -1.0}),
        (
            {"count": 30, "distance": 3.0},
            {"reason": "fewer than the 30 wanted", "allowed": "a shorter distance"},
        ),
        (
            {"count": 4},
            {"reason": "4 configurations cannot determine the 27", "allowed": "9 or"},
        ),
        ({"count": 5, "candidates": 5}, {"reason": "5 configurations cannot"}),
    ],
)
def test_impossible_requests(
    options: dict[str, Any],
    fields: dict[str, Any],
    chain: Chain,
    refused: Callable[..., Any],
) -> None:
    with refused(InputError, **fields):
        small(chain, **options)


def test_the_number_it_asks_for_is_enough(chain: Chain) -> None:
    for model, setup in (
        ("position", SETUP),
        ("pose", SETUP),
        ("plane-distance", PLANES),
    ):
        with pytest.raises(OptionError) as caught:
            small(chain, model=model, setup=setup, count=2)
        number = int(str(caught.value.allowed).split()[0])
        plan = small(chain, model=model, setup=setup, count=number)
        assert len(plan.q) == number
        with pytest.raises(OptionError):
            small(chain, model=model, setup=setup, count=number - 1)


def test_an_empty_region(chain: Chain) -> None:
    region = Region(box=((5.0, 5.0, 5.0), (6.0, 6.0, 6.0)))
    with pytest.raises(InputError, match="60000 outside the region"):
        small(chain, setup=replace(SETUP, region=region), candidates=1000)


def test_a_joint_that_is_held_plans_for_the_others(chain: Chain) -> None:
    setup = replace(SETUP, limits={"joint_3": (0.3, 0.3)}, region=None)
    for method in ("exchange", "gradient"):
        plan = small(chain, setup=setup, method=method, count=14)
        assert (plan.q[:, 2] == 0.3).all()
        assert plan.predicted.rank < small(chain, method="greedy").predicted.rank
        assert better("prediction", plan.value, plan.random)


# --- targets and tools -------------------------------------------------------------


@pytest.mark.parametrize(
    "method",
    [
        "exchange",
        *(pytest.param(m, marks=pytest.mark.slow) for m in ("gradient", "pso")),
    ],
)
def test_hardly_more_candidates_than_wanted_of_two_planes(method: str) -> None:
    """Every configuration looks at a plane that it sees, however few see it."""
    chain = calib_pin.load_chain("space6")
    setup = replace(
        calib_pin.read_setup(calib_pin.robot_file("space6", "setup.yaml")),
        planes={
            "near": PlaneSetup((0.0, 1.0, 4.6), -0.69),
            "side": PlaneSetup((1.0, 0.3, 0.2), -1.5),
        },
    )
    calls = iter(range(10**9))
    plan = calib_pin.plan(
        chain,
        "plane-distance",
        40,
        setup,
        method=method,
        candidates=44,
        progress=lambda *_: next(calls) > 200,
    )
    assert set(plan.target) == {"near", "side"} and plan.unmeasurable == ()
    zero = np.zeros(len(plan.problem.parameters))
    rng = np.random.default_rng(0)
    rows = calib_pin.simulate(plan.problem, zero, rng, q=plan.q, target=plan.target)
    assert len(rows) == 40


def test_planes_that_nothing_can_measure_are_named() -> None:
    chain = calib_pin.load_chain("space6")
    setup = calib_pin.read_setup(calib_pin.robot_file("space6", "setup.yaml"))
    planes = {**setup.planes, "far": PlaneSetup((1.0, 0.0, 0.0), -50.0)}
    plan = calib_pin.plan(
        chain, "plane-distance", 30, replace(setup, planes=planes), method="greedy"
    )
    assert plan.unmeasurable == ("far",) and set(plan.target) == {"wall"}


def test_additions_look_at_planes_that_were_not_measured() -> None:
    chain = calib_pin.load_chain("space6")
    setup = calib_pin.read_setup(calib_pin.robot_file("space6", "setup.yaml"))
    rng = np.random.default_rng(0)
    problem = nominal_problem(chain, "plane-distance", setup)
    zero = np.zeros(len(problem.parameters))
    rows = calib_pin.simulate(problem, zero, rng, count=40)
    planes = {**setup.planes, "side": PlaneSetup((1.0, 0.3, 0.2), -1.5)}
    ranger = replace(setup.ranger, range=(0.0, 1.2))
    more = replace(setup, planes=planes, ranger=ranger)
    assert rows.only.values.max() > 1.2
    plan = calib_pin.plan(
        chain, "plane-distance", 12, more, measured=rows, method="exchange"
    )
    assert "side" in plan.target
    # The window is the one that the setup states, however far the rows reached.
    zero = np.zeros(len(plan.problem.parameters))
    seen = calib_pin.simulate(plan.problem, zero, rng, q=plan.q, target=plan.target)
    assert seen.only.values.max() < 1.2


def test_a_target_that_nobody_has_placed_is_beside_the_tip() -> None:
    """At the tip, on the last axis, it would tell less than a real one does."""
    chain = calib_pin.load_chain("space6")
    plan = calib_pin.plan(chain, "position", 12, method="greedy")
    assert plan.assumed_tool and plan.predicted.rank == 27
    known = Setup(tool_frame=FrameSetup((0.0, 0.0, 0.1)))
    stated = calib_pin.plan(chain, "position", 12, known, method="greedy")
    assert not stated.assumed_tool and stated.predicted.rank == 25
    assert not calib_pin.plan(chain, "pose", 12, method="greedy").assumed_tool


def test_rows_that_show_no_frames_are_refused(chain: Chain) -> None:
    rng = np.random.default_rng(0)
    problem = nominal_problem(chain, "position", SETUP)
    zero = np.zeros(len(problem.parameters))
    rows = calib_pin.simulate(problem, zero, rng, count=2)
    with pytest.raises(InputError, match="to add to are too few: 6 measured"):
        small(chain, setup=SETUP, measured=rows)


def test_nothing_to_estimate_is_one_line(
    chain: Chain, refused: Callable[..., Any]
) -> None:
    with refused(OptionError, reason="no parameter of the robot can be", file="space6"):
        small(chain, setup=replace(SETUP, fixed=("*",)))
