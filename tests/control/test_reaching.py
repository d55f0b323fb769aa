"""Inverse kinematics: exact, within limits, closest to the start, and honest."""

from __future__ import annotations

from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.control.calibrated import kinematics
from calib_pin.control.joints import Joints, Kinematics, Solutions
from calib_pin.control.reaching import Task, reach, search
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats, so3_log
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.calibrated_model import CalibratedChain, CalibratedModel
from tests.shared import chain_of, joint, urdf_of

ROBOTS = {
    "ur10": ("example:ur10_robot", None, "tool0"),
    "pa10": ("pa10", None, None),
    "panda": ("example:panda", None, "panda_hand"),
    # A prismatic joint, and a branch that is passed backwards.
    "tiago": ("example:tiago_no_hand", None, "arm_7_link"),
    "talos": (
        "example:talos_reduced",
        "gripper_right_base_link",
        "gripper_left_base_link",
    ),
}
FRAMES = Setup(
    base_frame=FrameSetup((0.1, -0.2, 0.05), (0.3, -0.2, 0.4)),
    tool_frame=FrameSetup((0.02, 0.03, 0.1), (-0.1, 0.2, 0.3)),
)


def commands(
    model: CalibratedChain,
    targets: Floats,
    start: Floats | None = None,
    orientation: bool = True,
    **ends: Any,
) -> Solutions:
    joints, real = Joints.of(model.chain), kinematics(model, **ends)
    return search(Task.of(real, targets, joints, start, orientation))


def robot(name: str) -> Chain:
    file, base, tip = ROBOTS[name]
    return load_chain(file, base=base, tip=tip)


def calibrated(chain: Chain, size: float = 1e-3, **settings: Any) -> CalibratedChain:
    """A robot with errors of geometry, and of gears where there are any."""
    setup = replace(FRAMES, **settings)
    problem = nominal_problem(chain, "pose", setup)
    theta = np.random.default_rng(0).normal(size=len(problem.parameters))
    theta[problem.parameters.nuisance] = 0.0
    return CalibratedModel.create(problem, size * theta).of()


def configurations(chain: Chain, count: int, seed: int = 1) -> Floats:
    joints, rng = Joints.of(chain), np.random.default_rng(seed)
    lower = np.maximum(joints.lower, -np.pi)
    return rng.uniform(lower, np.minimum(joints.upper, np.pi), (count, len(lower)))


def beside(chain: Chain, q: Floats, size: float) -> Floats:
    noise = np.random.default_rng(2).normal(size=q.shape)
    return Joints.of(chain).within(q + size * noise)


def errors(T: Floats, targets: Floats) -> tuple[Floats, Floats]:
    """Distances [m] and angles [rad]."""
    turned = np.swapaxes(T[:, :3, :3], 1, 2) @ targets[:, :3, :3]
    way = (T - targets)[:, :3, 3]
    return np.linalg.norm(way, axis=1), np.linalg.norm(so3_log(turned), axis=1)


def check(model: CalibratedChain, found: Solutions, targets: Floats) -> None:
    """Reached, exactly, within the limits."""
    assert found.reached.all()
    distances, angles = errors(model.poses(found.q), targets)
    assert distances.max() < 1e-9
    assert angles.max() < 1e-9
    np.testing.assert_allclose(found.position, distances, atol=1e-12)
    joints = Joints.of(model.chain)
    assert (found.q >= joints.lower).all()
    assert (found.q <= joints.upper).all()


# --- exact -------------------------------------------------------------------------


@pytest.mark.parametrize("name", ROBOTS)
def test_targets_are_reached_with_a_start_and_without(name):
    chain = robot(name)
    model = calibrated(chain)
    q = configurations(chain, 40)
    targets, start = model.poses(q), beside(chain, q, 3e-3)
    check(model, commands(model, targets), targets)
    before = targets.copy(), start.copy()
    found = commands(model, targets, start)
    check(model, found, targets)
    assert np.median(np.abs(found.q - start)) < 0.01
    np.testing.assert_array_equal(commands(model, targets, start).q, found.q)
    # Arguments stay as they are.
    np.testing.assert_array_equal(targets, before[0])
    np.testing.assert_array_equal(start, before[1])
    for none in (None, start[:0]):
        nothing = commands(model, targets[:0], none)
        assert nothing.q.shape == (0, len(chain.joints))
        assert len(nothing) == len(nothing.reached) == len(nothing.position) == 0


# Of the mimic joints the leader is a joint of the chain, or stands beside it.
FOLLOWERS = {
    "within": {"j3": ("j1", -0.5, 0.2)},
    "beside": {"j1": ("side", 2.0, 0.1), "j4": ("side", -1.0, 0.0)},
}


@pytest.fixture
def following(request) -> Chain:
    """A chain of seven joints, some of which follow others."""
    rng = np.random.default_rng(7)

    def skew(name: str, ends: str, more: str = "") -> dict[str, Any]:
        place = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-0.4, 0.4, 3))
        return joint(name, ends, place, "0 0.6 0.8", limits="-2 2", more=more)

    mimics = {
        name: f'<mimic joint="{leader}" multiplier="{factor}" offset="{offset}"/>'
        for name, (leader, factor, offset) in FOLLOWERS[request.param].items()
    }
    joints = [
        skew(f"j{k}", f"l{k} l{k + 1}", mimics.get(f"j{k}", "")) for k in range(7)
    ]
    return chain_of(urdf_of(skew("side", "l0 s"), *joints), "l0", "l7")


@pytest.mark.parametrize(
    ("following", "near"), [("within", False), ("beside", True)], indirect=["following"]
)
def test_mimic_joints_follow(following, near):
    model = calibrated(following)
    q = following.random_configurations(30, np.random.default_rng(3))
    targets = model.poses(q)
    # A start of which the mimic joints do not follow counts by what moves them.
    start = q + 3e-3 * np.random.default_rng(2).normal(size=q.shape) if near else None
    found = commands(model, targets, start)
    assert found.reached.all()
    distances, angles = errors(model.poses(found.q), targets)
    assert distances.max() < 1e-9 and angles.max() < 1e-9
    assert not near or np.abs(found.q - q).max() < 0.1
    assert len(Joints.of(following).lower) == 6
    if "j3" in following.mimics:
        np.testing.assert_allclose(found.q[:, 3], 0.2 - 0.5 * found.q[:, 1], atol=1e-12)
    else:
        side = -found.q[:, 4]
        np.testing.assert_allclose(found.q[:, 1], 2.0 * side + 0.1, atol=1e-12)
    assert (found.q >= following.lower).all() and (found.q <= following.upper).all()


@pytest.mark.parametrize("name", ["ur10", "pa10"])
def test_only_positions(name):
    chain = robot(name)
    model = calibrated(chain)
    targets = model.poses(configurations(chain, 50))
    found = commands(model, targets, orientation=False)
    assert found.reached.all()
    assert errors(model.poses(found.q), targets)[0].max() < 1e-9
    assert (found.orientation == 0.0).all()
    # The rotation of a target is not looked at.
    targets[:, :3, :3] = np.nan
    again = commands(model, targets, orientation=False)
    np.testing.assert_array_equal(again.q, found.q)


def test_singular_targets():
    chain = robot("ur10")
    model = calibrated(chain, size=0.0)
    # Stretched elbows, aligned wrists, both, and the zero position.
    q = configurations(chain, 40)
    for k, joints in enumerate(((2,), (4,), (2, 4), range(len(chain.joints)))):
        q[k::4, list(joints)] = 0.0
    targets = model.poses(q)
    # Where the arm just reaches, the error is that of the joints squared.
    found = commands(model, targets, beside(chain, q, 0.1))
    check(model, found, targets)
    # The logarithm of a half turn has no derivative.
    q = configurations(chain, 20)
    targets = model.poses(q + np.pi * np.eye(6)[5])
    check(model, commands(model, targets, q), targets)


def test_frames_and_points():
    model = calibrated(robot("ur10"))
    q = configurations(model.chain, 4)
    F = model.error.tip_poses(q, model.theta)
    base, tool = model.error.base.homogeneous, model.error.tool.homogeneous
    for frame, point in product(("measuring", "base"), ("tool", "tip")):
        left = base if frame == "measuring" else np.eye(4)
        right = tool if point == "tool" else np.eye(4)
        evaluate = kinematics(model, frame=frame, point=point)
        T, J = evaluate(q)
        np.testing.assert_allclose(T, left @ F @ right, atol=1e-13)
        for k, step in enumerate(1e-6 * np.eye(q.shape[1])):
            ahead, behind = (evaluate(q + sign * step)[0] for sign in (1.0, -1.0))
            turned = np.swapaxes(behind[:, :3, :3], 1, 2) @ ahead[:, :3, :3]
            R, moved = np.swapaxes(T[:, :3, :3], 1, 2), (ahead - behind)[:, :3, 3:]
            linear = (R @ moved)[:, :, 0]
            twist = np.hstack([linear, so3_log(turned)]) / 2e-6
            np.testing.assert_allclose(J[:, :, k], twist, atol=1e-8)
        found = commands(model, T, q + 0.01, frame=frame, point=point)
        np.testing.assert_allclose(found.q, q, atol=1e-6)


# --- limits ------------------------------------------------------------------------


@pytest.mark.parametrize("name", ["ur10", "tiago"])
def test_limits_are_never_left(name):
    chain = robot(name)
    joints = Joints.of(chain)
    narrow = replace(joints, lower=0.3 * joints.lower, upper=0.3 * joints.upper)
    narrow = replace(
        narrow,
        lower=np.maximum(narrow.lower, joints.lower),
        upper=np.maximum(narrow.upper, narrow.lower + 0.1),
    )
    model = calibrated(chain)
    evaluate, seen = kinematics(model), []

    def watched(q: Floats) -> tuple[Floats, Floats]:
        seen.append(q)
        return evaluate(q)

    # Half of the targets are behind the limits, others at one, and the starts outside.
    q = configurations(chain, 40)
    q[::2] = narrow.within(q[::2])
    q[::8, 1] = narrow.upper[1]
    targets = model.poses(q)
    found = search(Task.of(watched, targets, narrow, q + 0.5))
    assert found.reached[::2].mean() > 0.9
    every = np.concatenate([found.q, *seen])
    assert (every >= narrow.lower).all()
    assert (every <= narrow.upper).all()
    assert found.reached.sum() < 40
    distances, angles = errors(evaluate(found.q)[0], targets)
    np.testing.assert_allclose(found.position, distances, atol=1e-12)
    np.testing.assert_allclose(found.orientation, angles, atol=1e-9)
    assert (found.reached == (np.maximum(distances, angles) < 1e-9)).all()


def test_continuous_joints_stay_in_the_turn_of_the_start():
    place = pin.SE3(pin.exp3(np.array([0.5, 0.2, 0.1])), np.array([0.3, 0.1, 0.4]))
    chain = chain_of(
        urdf_of(
            *(
                joint(f"j{k}", f"{k} {k + 1}", place, axis, "continuous")
                for k, axis in enumerate(2 * ["0 0 1", "0 1 0", "1 0 0"])
            )
        )
    )
    model = calibrated(chain)
    turns = 2.0 * np.pi * np.array([1.0, -1.0, 2.0, 0.0, 5.0, -3.0])
    q = configurations(chain, 20)
    targets = model.poses(q)
    found = commands(model, targets, q + turns + 1e-2)
    check(model, found, targets)
    np.testing.assert_allclose(found.q, q + turns, atol=1e-6)
    # From far away as well, and with gears whose errors grow from turn to turn.
    model = calibrated(chain, parameters=("placement", "transmission"))
    targets = model.poses(q)
    start = np.full_like(q, 20.0)
    found = commands(model, targets, start)
    check(model, found, targets)
    assert np.abs(found.q - start).max() < np.pi + 0.1
    assert np.abs(commands(model, targets).q).max() < np.pi + 0.1


# --- redundancy --------------------------------------------------------------------


def optimality(evaluate: Kinematics, found: Solutions, start: Floats, joints: Joints):
    """What is left of the way to the start, were the target held, (N,).

    At the closest solution the way is a combination of the rows of J and of what
    joints at their limits are pushed outward with.
    """
    _, J = evaluate(found.q)
    way, at_limit = start - found.q, joints.at_limit(found.q)
    left = np.empty(len(way))
    for k, free in enumerate(~at_limit):
        y = np.linalg.lstsq(J[k][:, free].T, way[k, free], rcond=None)[0]
        rest = way[k] - J[k].T @ y
        inward = np.where(found.q[k] >= joints.upper, -rest, rest)
        left[k] = np.where(free, np.abs(rest), inward).max()
    return left


@pytest.mark.parametrize(
    ("name", "size"), [("pa10", 0.2), ("tiago", 3e-3), ("talos", 0.2)]
)
def test_closest_to_the_start(name, size):
    chain = robot(name)
    model, joints = calibrated(chain), Joints.of(chain)
    q = configurations(chain, 50)
    targets, start = model.poses(q), beside(chain, q, size)
    evaluate = kinematics(model)
    found = reach(Task.of(evaluate, targets, joints, start))
    assert found.reached.mean() >= 0.98
    left = optimality(evaluate, found, start, joints)[found.reached]
    assert np.quantile(left, 0.95) < 1e-7
    moved = np.linalg.norm(found.q - start, axis=1)
    assert (moved <= np.linalg.norm(q - start, axis=1) + 1e-9)[found.reached].all()


# --- what cannot be reached --------------------------------------------------------


@pytest.mark.parametrize("given", [True, False])
def test_rows_out_of_reach_do_not_disturb_the_others(given):
    chain = robot("pa10")
    model = calibrated(chain)
    q = configurations(chain, 5)
    targets, start = model.poses(q), q + 0.05 if given else None
    targets[::2, :3, 3] *= 5.0
    targets[::2, 2, 3] += 3.0
    targets[4, 0, 3] = np.nan
    found = commands(model, targets, start)
    np.testing.assert_array_equal(found.reached, [False, True, False, True, False])
    assert (found.position[:4:2] > 0.5).all()
    joints = Joints.of(chain)
    np.testing.assert_array_equal(joints.within(found.q), found.q)
    distances, _ = errors(model.poses(found.q), targets)
    np.testing.assert_allclose(found.position[:4], distances[:4], atol=1e-12)
    for k in (1, 3):
        one = None if start is None else start[k : k + 1]
        alone = commands(model, targets[k : k + 1], one)
        assert alone.reached[0]
        # Without a start chance decides which of several solutions is met first.
        assert not given or np.abs(alone.q[0] - found.q[k]).max() < 1e-6
