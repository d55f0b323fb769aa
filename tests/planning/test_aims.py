"""What is measured at a configuration, and plans of several chains and instruments."""

from __future__ import annotations

from dataclasses import replace
from itertools import groupby

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import OptionError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.identifiability import observability
from calib_pin.estimation.nominal import asked
from calib_pin.estimation.problem import Problem, sigma_at
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Observations
from calib_pin.planning.aims import Aim, Aims
from calib_pin.planning.plan import Plan
from calib_pin.planning.workspace import Workspace
from calib_pin.setup import (
    CameraSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    Setup,
    ToolSetup,
)
from calib_pin.simulation import simulate

TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1))
BOARD = {f"c{k}": PointSetup((0.04 * (k % 4), 0.04 * (k // 4), 0.1)) for k in range(12)}
PLANES = {
    "floor": PlaneSetup((0.1, 0.2, 1.0), 1.5),
    "wall": PlaneSetup((1.0, 0.3, 0.2), -3.0),
}
CAMERA = CameraSetup("world", (900.0, 900.0), (320.0, 240.0), size=(640, 480))
FAR = FrameSetup((0.1, -0.2, 3.0), (0.3, -0.2, 0.4), estimate=True)
ARMS = (BlockKey("position", "left"), BlockKey("position", "right"))
TREE = Setup(
    parameters=("joint-offset",),
    tools={name: ToolSetup((0.04, 0.05, 0.1)) for name in ("finger", "right_link_3")},
)


def aims_of(setup: Setup, *keys: BlockKey) -> Aims:
    problem = nominal_problem(calib_pin.load_chain("space6"), keys, setup)
    return Aims.of(problem, keys)


def information(plan: Plan, problem: Problem) -> Floats:
    """Scaled identification matrix of a plan, target by target, shape (M, P)."""
    zero, rows = np.zeros(len(problem.parameters)), []
    aims = Aims.of(problem, problem.data.keys)
    for q, aim in zip(plan.q, plan.aims, strict=True):
        code = np.array([aims.each.index(aim)])
        for look in aims.looks:
            if look.of_aim[code[0]] < 0:
                continue
            visible = look.seen(q[None], code)[0]
            for k in look.targets(code)[0][visible]:
                at = asked(problem, look.term.key, q[None], (look.names[k],))
                sigma = sigma_at(problem, look.term.key, 1)
                rows.append(problem.jacobian(zero, at, sigma)[0])
    J = np.concatenate(rows) * problem.parameters.scales
    return np.where(problem.parameters.free, J, 0.0)


def o1(problem: Problem, J: Floats, count: int) -> float:
    nuisance = problem.parameters.nuisance
    U, s, _ = np.linalg.svd(J[:, nuisance], full_matrices=False)
    Q = U[:, s > 1e-9 * s[0]]
    s = np.linalg.svd(J[:, ~nuisance] - Q @ (Q.T @ J[:, ~nuisance]), compute_uv=False)
    return observability(s[s > 1e-9 * s[0]], count)["O1"]


# --- what is measured together -----------------------------------------------------


def test_a_tracker_sees_all_and_a_beam_meets_one() -> None:
    tracker, ranger = BlockKey("position"), BlockKey("plane-distance")
    points = Setup(targets={name: PointSetup((0, 0, 0.1)) for name in "abc"})
    (all_at_once,) = aims_of(points, tracker).each
    assert all_at_once == Aim(tracker, "")
    one = replace(points, targets={"a": points.targets["a"]})
    assert aims_of(one, tracker).each == (Aim(tracker, "a"),)
    beams = aims_of(Setup(planes=PLANES), ranger)
    assert beams.each == (Aim(ranger, "floor"), Aim(ranger, "wall"))


def test_instruments_of_one_place_measure_together() -> None:
    """Each of the two planes with all points; from another station only these."""
    tracker, ranger = BlockKey("position", "", "a"), BlockKey("plane-distance", "", "a")
    moved = BlockKey("position", "", "b")
    setup = Setup(planes=PLANES, targets={n: PointSetup((0, 0, 0.1)) for n in "pq"})
    found = aims_of(setup, tracker, ranger, moved)
    assert found.each == (Aim(tracker, "floor"), Aim(tracker, "wall"), Aim(moved, ""))
    taken = {look.term.key: look.of_aim.tolist() for look in found.looks}
    assert taken == {tracker: [0, 0, -1], moved: [-1, -1, 0], ranger: [0, 1, -1]}
    assert [look.each for look in found.looks] == [2, 2, 1]


def test_what_stands_still_is_not_planned(tree: Chains) -> None:
    post = BlockKey("position", "world")
    chains = tree.named(("left", "world"))
    problem = nominal_problem(chains, (ARMS[0], post), TREE)
    assert [aim.key for aim in Aims.of(problem, (ARMS[0], post)).each] == [ARMS[0]]
    with pytest.raises(OptionError):
        Aims.of(problem, (post,))


# --- boards ------------------------------------------------------------------------


def test_an_image_counts_with_all_corners_that_are_seen() -> None:
    chain = calib_pin.load_chain("space6")
    setup = Setup(
        parameters=("joint-offset",),
        base_frame=FAR,
        tool_frame=TOOL,
        camera=CAMERA,
        targets=BOARD,
    )
    options = {"criterion": "O1", "method": "greedy", "candidates": 50}
    plan = calib_pin.plan(chain, "camera", 8, setup, **options)
    assert plan.target == ("",) * 8 and not plan.places and not plan.unmeasurable
    problem = nominal_problem(chain, "camera", setup)
    J = information(plan, problem)
    assert 8 * 12 < len(J) <= 8 * 24
    assert plan.value == pytest.approx(o1(problem, J, 8), rel=1e-6)
    assert plan.value > plan.random
    # Simulated, an image is measured as it was planned, or with corners at its edge.
    zero, rng = np.zeros(len(problem.parameters)), np.random.default_rng(0)
    rows = simulate(problem, zero, rng, q=plan.q, per_configuration=True)
    assert len(J) / 2 <= len(rows) <= 8 * 12 and rows.configurations == 8


def test_a_tracker_and_a_ranger_together() -> None:
    """Each configuration tells what both say, of all points and of one plane."""
    chain = calib_pin.load_chain("space6")
    points = {n: PointSetup(p) for n, p in zip("pq", np.eye(3)[:2] / 9, strict=True)}
    keys = (BlockKey("position"), BlockKey("plane-distance"))
    setup = Setup(parameters=("joint-offset",), planes=PLANES, targets=points)
    calls = iter(range(10**9))
    plan = calib_pin.plan(
        chain,
        keys,
        14,
        setup,
        criterion="O1",
        method="gradient",
        candidates=50,
        progress=lambda *_: next(calls) > 30,
    )
    assert set(plan.target) <= {"floor", "wall"} and not plan.assumed_tool
    problem = nominal_problem(chain, keys, setup)
    J = information(plan, problem)
    assert len(J) == 14 * (2 * 3 + 1)
    assert plan.value == pytest.approx(o1(problem, J, 14), rel=1e-6)
    assert plan.value > plan.random


# --- several chains ----------------------------------------------------------------


@pytest.mark.parametrize("method", ["exchange", "gradient", "pso", "ga"])
def test_plans_of_two_arms(method: str, tree: Chains) -> None:
    calls = iter(range(10**9))
    plan = calib_pin.plan(
        tree,
        ARMS,
        12,
        TREE,
        criterion="O1",
        method=method,
        candidates=60,
        progress=lambda *_: next(calls) > 20,
    )
    chains = [aim.key.chain for aim in plan.aims]
    assert plan.places == {"chain": tuple(chains)}
    assert [name for name, _ in groupby(chains)] in (
        ["left", "right"],
        ["right", "left"],
    )
    # Of each arm as many as tell most: the torso is shared.
    assert 3 <= chains.count("left") <= 9
    names = tree.joints
    follower, leader = names.index("left_finger"), names.index("left_3")
    np.testing.assert_allclose(plan.q[:, follower], 0.5 * plan.q[:, leader] + 0.1)
    for k, name in enumerate(names):
        other = {"left": "right", "right": "left"}.get(name.partition("_")[0])
        if other is not None and name != "left_finger":
            resting = np.array(chains) == other
            assert not plan.q[resting, k].any() and plan.q[~resting, k].all()
    problem = nominal_problem(tree, ARMS, TREE)
    J = information(plan, problem)
    assert plan.value == pytest.approx(o1(problem, J, 12), rel=1e-6)
    assert plan.value > plan.random


def test_the_other_arm_rests_where_it_touches_nothing(tree: Chains) -> None:
    """Not at zero, where an arm may hang through the body."""
    shoulder = tree.joints.index("right_0")

    class Body:
        def free(self, q: Floats) -> Floats:
            return np.abs(q[:, shoulder] + 1.0) < 0.4

    problem = nominal_problem(tree, ARMS, TREE)
    workspace = Workspace.create(problem, Body())
    found = workspace.candidates(40, np.random.default_rng(0))
    resting = found.q[found.aim == 0][:, shoulder]
    assert len(resting) > 10 and len(set(resting)) == 1
    assert abs(resting[0] + 1.0) < 0.4 and resting[0] == np.round(resting[0], 6)
    assert len(set(found.q[found.aim == 1][:, shoulder])) > 3


def test_additions_to_two_stations(tree: Chains) -> None:
    """They go on from all that is there, also from what is not planned."""
    keys = (*(key._replace(station=s) for s in "ab" for key in ARMS),)
    post = BlockKey("position", "world", "a")
    chains = tree.named(("left", "right", "world"))
    points = {"here": FrameSetup((1, 2, 3)), "there": FrameSetup((3, 2, 1))}
    setup = replace(TREE, stations=dict(zip("ab", points.values(), strict=True)))
    problem = nominal_problem(chains, keys, setup)
    zero, rng = np.zeros(len(problem.parameters)), np.random.default_rng(1)
    measured = simulate(problem, zero, rng, count=60, noise=1e-4)
    options = {"method": "exchange", "candidates": 60}
    plan = calib_pin.plan(chains, "position", 6, setup, measured=measured, **options)
    assert plan.measured == 60 and plan.q.shape == (6, len(tree.joints))
    assert set(plan.places) == {"chain", "station"}
    only = (keys[0],)
    plan = calib_pin.plan(chains, only, 6, setup, measured=measured, **options)
    assert {aim.key for aim in plan.aims} == {keys[0]}
    assert plan.predicted.position < 1e-3
    for kind in ((post,), "pose"):
        with pytest.raises(OptionError):
            calib_pin.plan(chains, kind, 6, setup, measured=measured, **options)


def test_contacts_are_not_planned_but_counted(tree: Chains) -> None:
    chain = calib_pin.load_chain("space6")
    sockets = {"s/0": PointSetup((0.6, 0.3, 0.4)), "s/1": PointSetup((0.5, -0.2, 0.6))}
    keys = (BlockKey("position"), BlockKey("fixed-point"))
    setup = Setup(tool_frame=TOOL, sockets=sockets)
    with pytest.raises(OptionError, match="fixed-point"):
        calib_pin.plan(chain, keys, 12, setup)
    problem = nominal_problem(chain, keys, setup)
    zero, rng = np.zeros(len(problem.parameters)), np.random.default_rng(1)
    both = simulate(problem, zero, rng, count=48, noise=1e-4)
    options = {"method": "greedy", "candidates": 60}
    values = [
        calib_pin.plan(chain, keys[:1], 6, setup, measured=rows, **options).value
        for rows in (both, Observations.of(both.blocks[0]))
    ]
    assert values[0] < values[1]
