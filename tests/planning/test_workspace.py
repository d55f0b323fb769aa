"""Where configurations may be: limits, region, sight, spread."""

from __future__ import annotations

import re
from collections.abc import Callable
from dataclasses import replace
from itertools import groupby
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.stats import qmc

import calib_pin
from calib_pin.calibration import calibrate
from calib_pin.errors import InputError, OptionError, RobotError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.io.measurements import encode_configurations, read_held
from calib_pin.io.table import read_table
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Conditions, Observations, approached
from calib_pin.planning.plan import Plan, plan, sides_of
from calib_pin.planning.workspace import Aim, Aims, Workspace, sides_tried
from calib_pin.report.plan_text import plan_report
from calib_pin.setup import (
    Ball,
    CameraSetup,
    Cone,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    RangerSetup,
    Region,
    Setup,
    ToolSetup,
)
from calib_pin.simulation import draw_errors, simulate
from tests.planning.test_plan import Calls, value_of
from tests.planning.test_rows import rows_at
from tests.shared import chain_of, joint, refused, simulated, urdf_of

PLANES = {
    "floor": PlaneSetup((0.1, 0.2, 1.0), 1.5),
    "wall": PlaneSetup((1.0, 0.3, 0.2), -3.0),
}


# --- limits ------------------------------------------------------------------------


def test_limits_are_those_of_the_robot(workspace_of: Callable[..., Workspace]) -> None:
    workspace = workspace_of("space6")
    chain = workspace.problem.only.error.chain
    # But for a hundredth of a radian, where controllers would complain already.
    inside = workspace.lower - chain.lower, chain.upper - workspace.upper
    assert all(room.min() >= 0.01 and room.max() < 0.01 + 1e-6 for room in inside)
    digits = workspace.lower * 1e6
    assert digits == pytest.approx(np.round(digits), abs=1e-6)


def test_limits_narrow_by_name_and_glob(workspace_of: Callable[..., Workspace]) -> None:
    limits = {"joint_*": (-1.0, 9.0), "joint_3": (-7.0, 0.5), "joint_[12]": (0.0, 1.0)}
    workspace = workspace_of("space7", limits=limits)
    chain = workspace.problem.only.error.chain
    assert (chain.lower < -1.0).all() and (chain.upper < 9.0).all()
    upper = chain.upper - 0.01
    upper[:2], upper[2] = 1.0, 0.5
    assert workspace.lower.tolist() == [0.0, 0.0, -1.0, -1.0, -1.0, -1.0, -1.0]
    assert workspace.upper == pytest.approx(upper, abs=1e-6)
    # The chain itself stays as it is.
    assert chain.upper[2] > 0.5


def test_limits_of_the_urdf(
    workspace_of: Callable[..., Workspace], rng: np.random.Generator
) -> None:
    def limited(*limits: float) -> Workspace:
        first = joint("arm[1]", "l0 l1", limits="-2 2")
        second = joint("arm1", "l1 l2", axis="0 1 0", limits=limits)
        return workspace_of(chain_of(urdf_of(first, second)), **settings)

    settings: dict[str, Any] = {}
    held = limited(0.5, 0.5)
    assert (held.lower[1], held.upper[1]) == (0.5, 0.5)
    assert (held.candidates(20, rng).q[:, 1] == 0.5).all()
    # Two zeros mean no limit.
    assert limited(0.0, 0.0).upper[1] > 3.0
    with pytest.raises(RobotError, match="'arm1'"):
        limited(0.5, -0.5)
    # The name of a joint is no pattern.
    for key, lower in (("arm[1]", [-0.5, -1.99]), ("arm[0-9]", [-1.99, -0.5])):
        settings = {"limits": {key: (-0.5, 0.5)}}
        assert limited(-2.0, 2.0).lower.tolist() == lower


@pytest.mark.parametrize(
    ("limits", "fields"),
    [
        ({"joint_3": (3.5, 4.0)}, {"reason": "'joint_3'", "value": [3.5, 4.0]}),
        ({"joint_*": (0.0, 1.0), "joint_2": (1.5, 2.0)}, {"reason": "'joint_2'"}),
        ({"joint_2": (1.0, -1.0)}, {"reason": "'limits.joint_2'", "value": (1, -1)}),
        ({"joit_2": (0.0, 1.0)}, {"reason": ["'joit_2'", "'joint_2'?"]}),
        ({"elbow*": (0.0, 1.0)}, {"reason": "'elbow*'", "allowed": "joint_1, joint"}),
    ],
)
def test_limits_that_leave_nothing(
    limits: dict[str, Any],
    fields: dict[str, Any],
    workspace_of: Callable[..., Workspace],
) -> None:
    with refused(OptionError, **fields):
        workspace_of("space7", limits=limits)


def test_candidates_stay_within_the_limits(
    workspace_of: Callable[..., Workspace], rng: np.random.Generator
) -> None:
    workspace = workspace_of("space6", limits={"joint_2": (-0.3, 0.4)})
    found = workspace.candidates(1500, rng)
    assert found.q.shape == (1500, 6)
    assert found.tried == 1500  # As none is refused.
    assert (found.q >= workspace.lower).all() and (found.q <= workspace.upper).all()
    # They fill them, too.
    width = workspace.upper - workspace.lower
    assert (found.q.min(axis=0) < workspace.lower + 0.03 * width).all()
    assert (found.q.max(axis=0) > workspace.upper - 0.03 * width).all()
    assert workspace.inside(found.q, found.aim).all()
    beyond = found.q + width
    assert not workspace.inside(beyond, found.aim).any()


# --- spread ------------------------------------------------------------------------


def test_candidates_have_a_low_discrepancy(
    workspace_of: Callable[..., Workspace],
) -> None:
    workspace = workspace_of("space7")
    width, rng = workspace.upper - workspace.lower, np.random.default_rng(1)
    q = workspace.candidates(300, rng).q
    unit = (q - workspace.lower) / width
    assert qmc.discrepancy(unit) < 0.6 * qmc.discrepancy(rng.random(unit.shape))
    for column in unit.T:
        counts, _ = np.histogram(column, bins=15, range=(0.0, 1.0))
        # Chance alone gives 20 +- 4.4.
        assert 13 <= counts.min() <= counts.max() <= 27
    # The seed moves them, and more continue the same sequence.
    again, more, other = (
        workspace.candidates(count, np.random.default_rng(seed)).q
        for count, seed in ((300, 1), (330, 1), (300, 2))
    )
    assert again.tobytes() == more[:300].tobytes() == q.tobytes()
    assert np.abs(other - q).max() > 0.1


# --- region, sight -----------------------------------------------------------------


def tool_points(workspace: Workspace, q: np.ndarray) -> np.ndarray:
    """Where the tool is in the base, by the chain's own kinematics."""
    problem = workspace.problem
    F = problem.only.error.chain.poses(q)
    return (F @ problem.only.error.tool.homogeneous)[:, :3, 3]


@pytest.mark.parametrize(
    "region",
    [
        Region(cone=Cone((-1.0, 0.0, 0.5), (1.0, 0.2, 0.3), 0.5, (0.5, 2.5))),
        Region(
            box=((-1.0, -1.0, 0.0), (2.0, 2.0, 2.0)), sphere=Ball((0.5, 0.2, 1.0), 1.2)
        ),
    ],
    ids=["cone", "box and sphere"],
)
def test_candidates_lie_in_the_region(
    region: Region, workspace_of: Callable[..., Workspace], rng: np.random.Generator
) -> None:
    # The region is one of the base, wherever the instrument stands.
    frames = {
        "base_frame": FrameSetup((1.0, -2.0, 0.5), (0.3, -0.2, 0.4)),
        "tool_frame": FrameSetup((0.1, 0.05, 0.2)),
    }
    workspace = workspace_of("space6", region=region, **frames)
    found = workspace.candidates(100, rng)
    points = tool_points(workspace, found.q)
    assert len(found.q) == 100
    if region.box is not None:
        lower, upper = np.array(region.box)
        assert (points >= lower).all() and (points <= upper).all()
    if region.sphere is not None:
        center, radius = region.sphere.center, region.sphere.radius
        assert (np.linalg.norm(points - center, axis=1) <= radius).all()
    if region.cone is not None:
        ray = points - np.array(region.cone.apex)
        distance = np.linalg.norm(ray, axis=1)
        axis = np.array(region.cone.axis) / np.linalg.norm(region.cone.axis)
        assert (np.arccos(ray @ axis / distance) <= 0.5 + 1e-9).all()
        assert distance.min() >= 0.5 and distance.max() <= 2.5
    # Without it most would have been elsewhere.
    free = workspace_of("space6", **frames).candidates(200, rng)
    assert region.contains(tool_points(workspace, free.q)).mean() < 0.7
    assert not workspace.inside(free.q, free.aim).all()


@pytest.mark.parametrize("incidence", [0.4, 1.2])
def test_the_ranger_sees_its_planes(
    incidence: float, workspace_of: Callable[..., Workspace], rng: np.random.Generator
) -> None:
    ranger = RangerSetup(range=(0.3, 2.5), incidence=incidence)
    workspace = workspace_of("space6", "plane-distance", planes=PLANES, ranger=ranger)
    assert [aim.target for aim in workspace.aims.each] == ["floor", "wall"]
    found = workspace.candidates(60, rng)
    targets = [workspace.aims.each[k].target for k in found.aim]
    assert set(targets) == {"floor", "wall"}
    problem = workspace.problem
    T = problem.only.error.chain.poses(found.q) @ problem.only.error.tool.homogeneous
    T = problem.only.error.base.homogeneous @ T
    for pose, target in zip(T, targets, strict=True):
        normal = np.array(PLANES[target].normal)
        beam, origin = pose[:3, 2], pose[:3, 3]
        distance = -(normal @ origin + PLANES[target].offset) / (normal @ beam)
        assert 0.3 - 1e-9 <= distance <= 2.5 + 1e-9
        angle = np.arccos(min(1.0, abs(normal @ beam) / np.linalg.norm(normal)))
        assert angle <= incidence + 1e-9


# --- what cannot be ----------------------------------------------------------------


def test_reasons_are_counted_apart(
    workspace_of: Callable[..., Workspace], rng: np.random.Generator
) -> None:
    """What is not in the region is no matter of sight, and adds up to all tried."""
    workspace = workspace_of(
        "space6",
        "plane-distance",
        planes={"wall": PlaneSetup((1.0, 0.0, 0.0), -50.0)},
        region=Region(box=((-9.0, -9.0, 0.5), (9.0, 9.0, 9.0))),
    )
    with pytest.raises(InputError) as caught:
        workspace.candidates(10, rng)
    outside, unseen = re.search(
        r"(\d+) outside\D+(\d+) not", caught.value.reason
    ).groups()
    assert min(int(outside), int(unseen)) > 1000
    assert int(outside) + int(unseen) == 60_000


TOOL = FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1))
BOARD = {f"c{k}": PointSetup((0.04 * (k % 4), 0.04 * (k // 4), 0.1)) for k in range(12)}
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
    aims = Aims.of(problem, problem.data.keys)
    J = np.concatenate(
        [
            rows_at(problem, aims, q[None], np.array([aims.each.index(aim)]))
            for q, aim in zip(plan.q, plan.aims, strict=True)
        ]
    )
    J *= problem.parameters.scales
    return np.where(problem.parameters.free, J, 0.0)


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
    assert plan.value == pytest.approx(value_of("O1", problem, J, 8), rel=1e-6)
    assert plan.value > plan.random
    # Simulated, an image is measured as it was planned, or with corners at its edge.
    zero, rng = np.zeros(len(problem.parameters)), np.random.default_rng(0)
    rows = simulate(problem, zero, rng, q=plan.q, per_configuration=True)
    assert len(J) / 2 <= len(rows) <= 8 * 12 and rows.configurations == 8


@pytest.mark.slow
def test_a_tracker_and_a_ranger_together() -> None:
    """Each configuration tells what both say, of all points and of one plane."""
    chain = calib_pin.load_chain("space6")
    points = {n: PointSetup(p) for n, p in zip("pq", np.eye(3)[:2] / 9, strict=True)}
    keys = (BlockKey("position"), BlockKey("plane-distance"))
    setup = Setup(parameters=("joint-offset",), planes=PLANES, targets=points)
    plan = calib_pin.plan(
        chain,
        keys,
        14,
        setup,
        criterion="O1",
        method="gradient",
        candidates=50,
        progress=Calls(32),
    )
    assert set(plan.target) <= {"floor", "wall"} and not plan.assumed_tool
    problem = nominal_problem(chain, keys, setup)
    J = information(plan, problem)
    assert len(J) == 14 * (2 * 3 + 1)
    assert plan.value == pytest.approx(value_of("O1", problem, J, 14), rel=1e-6)
    assert plan.value > plan.random


# --- several chains ----------------------------------------------------------------


@pytest.mark.parametrize("method", ["exchange", "gradient", "pso", "ga"])
def test_plans_of_two_arms(method: str, tree: Chains) -> None:
    plan = calib_pin.plan(
        tree,
        ARMS,
        12,
        TREE,
        criterion="O1",
        method=method,
        candidates=60,
        progress=Calls(22),
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
    assert plan.value == pytest.approx(value_of("O1", problem, J, 12), rel=1e-6)
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
    measured = simulated(keys, setup, 60, robot=chains, noise=1e-4)[0].data
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
    both = simulated(keys, setup, 48, noise=1e-4)[0].data
    options = {"method": "greedy", "candidates": 60}
    values = [
        calib_pin.plan(chain, keys[:1], 6, setup, measured=rows, **options).value
        for rows in (both, Observations.of(both.blocks[0]))
    ]
    assert values[0] < values[1]


CHAIN = calib_pin.load_chain("space6")
SETUP = Setup(
    parameters=("placement", "hysteresis"),
    tool_frame=FrameSetup((0.1, 0.05, 0.15), estimate=True),
)


def test_sides_are_balanced() -> None:
    sides = sides_tried(nominal_problem(CHAIN, "position", SETUP)).astype(float)
    assert sides.shape == (8, 6)
    assert not sides.sum(axis=0).any()
    np.testing.assert_array_equal(sides.T @ sides, 8.0 * np.eye(6))
    plain = replace(SETUP, parameters=("placement",))
    assert not sides_tried(nominal_problem(CHAIN, "position", plain)).size


def test_a_plan_says_from_where_to_come(tmp_path: Path) -> None:
    options = {"method": "exchange", "candidates": 120}
    found = plan(CHAIN, "position", 30, SETUP, **options)
    told = sides_of(found)
    sides = np.stack([np.array(side) for side in told.values()], axis=1)
    assert list(told) == list(CHAIN.joints)
    # From both, each joint at a fifth of the configurations at least.
    assert np.abs(sides.mean(axis=0)).max() < 0.6
    assert "<joint>.direction" in str([*plan_report(found)])
    # They stand in the file, and are read as what is measured there.
    file = tmp_path / "plan.csv"
    file.write_bytes(encode_configurations(CHAIN, found.q, sides=told))
    held = read_held(read_table(file), CHAIN.joints, found.q)
    np.testing.assert_array_equal(held.direction, sides)
    # What is expected of the plan is what a calibration of it gets, and less than
    # the sides tell from which a plan without them would come.
    problem = nominal_problem(CHAIN, "position", SETUP)
    lost = np.array([".hysteresis." in name for name in problem.parameters.names])
    # Errors so large that a fit holds none of them back by their usual size.
    theta = 10.0 * draw_errors(problem.parameters, np.random.default_rng(0))

    def sigmas(conditions: Conditions) -> np.ndarray:
        rng = np.random.default_rng(0)
        job = {"q": found.q, "conditions": conditions, "noise": 1e-4}
        rows = simulate(problem, theta, rng, **job)
        fitted = calibrate(CHAIN, rows, SETUP, validate=False)
        return fitted.covariance.diagonal()[lost] ** 0.5

    unmeasured = sigmas(held)
    predicted = found.predicted.covariance.diagonal()[lost] ** 0.5
    np.testing.assert_allclose(unmeasured, predicted, rtol=0.35)
    came = sigmas(Conditions(direction=approached(found.q)))
    assert np.mean(np.log(unmeasured / came)) < 0.0
