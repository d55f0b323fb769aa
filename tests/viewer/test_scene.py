"""Where links, tool points and error vectors are drawn."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.io.results import write_urdf
from calib_pin.io.robot_shapes import robot_shapes
from calib_pin.io.urdf import load_chain, load_robot
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.skeleton import Skeleton, drawn_link, floor_height
from calib_pin.kinematics.spatial import invert
from calib_pin.measurement_models.plane_distance import PlaneDistance
from calib_pin.measurement_models.pose import Pose
from calib_pin.measurement_models.position import Position
from calib_pin.measurement_models.references import Plane
from calib_pin.observations import BlockKey, Conditions
from calib_pin.setup import ChainSetup, Payload
from calib_pin.validation.evaluation import registered_robot
from calib_pin.validation.model_errors import Registered
from calib_pin.viewer.panel import sight
from calib_pin.viewer.scene import bodies_of, stage_errors
from tests.shared import joint, simulated, urdf_of

MIMICS = {"panda_finger_joint2": "panda_finger_joint1"}
"""Of the robots below; each moves like the other."""


def link_poses(robot: Any, positions: dict[str, float], base: str) -> dict[str, Any]:
    """Poses of all links in one of them, by Pinocchio."""
    model, data = robot.model, robot.model.createData()
    q = pin.neutral(model)
    for name, position in positions.items():
        joint = model.getJointId(name)
        values = [np.cos(position), np.sin(position)] if model.nqs[joint] == 2 else None
        start = model.idx_qs[joint]
        q[start : start + model.nqs[joint]] = values or [position]
    pin.framesForwardKinematics(model, data, q)
    T = {
        link: data.oMf[model.getFrameId(link, pin.FrameType.BODY)].homogeneous
        for link in robot.links
    }
    return {link: invert(T[base]) @ pose for link, pose in T.items()}


# --- links -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("name", "base", "tip"),
    [
        ("example:panda", None, "panda_hand"),
        ("example:kinova", None, "j2s6s200_link_6"),  # Continuous joints.
        ("example:talos_reduced", "gripper_right_base_link", "gripper_left_base_link"),
    ],
)
def test_links_are_those_of_the_corrected_urdf(calibrated, tmp_path, name, base, tip):
    chain = load_chain(name, base=base, tip=tip)
    model = calibrated(chain, Position())
    before = chain.robot.model.copy()
    nominal, corrected = bodies_of(chain.robot, chain.base, model)
    write_urdf(model, tmp_path / "corrected.urdf")
    rng = np.random.default_rng(3)
    skeleton = nominal.skeleton
    q = rng.uniform(skeleton.lower, skeleton.upper)
    positions = dict(zip(skeleton.joints, q, strict=True))
    for follower, leader in MIMICS.items():
        if leader in positions:
            positions[follower] = positions[leader]
    written = load_robot(tmp_path / "corrected.urdf")
    for body, robot in ((nominal, chain.robot), (corrected, written)):
        expected = link_poses(robot, positions, chain.base)
        for link, T in zip(skeleton.links, body.placements(q), strict=True):
            np.testing.assert_allclose(T, expected[link], atol=1e-12)
    # The tip is where the model has it, but for what no URDF holds.
    places = [skeleton.joints.index(joint) for joint in chain.joints]
    arm = model.of()
    pose = invert(arm.error.base.homogeneous) @ arm.poses(q[None, places])[0]
    tip_pose = corrected.placements(q)[skeleton.links.index(chain.tip)]
    np.testing.assert_allclose(tip_pose @ arm.tool.homogeneous, pose, atol=1e-9)
    assert chain.robot.model == before


def test_joint_corrections_turn_the_links(panda, calibrated):
    loads = {
        "light": Payload(1.0, (0.0, 0.0, 0.0)),
        "heavy": Payload(8.0, (0.0, 0.0, 0.2)),
    }
    model = calibrated(panda, Position(), "placement", "compliance", payloads=loads)
    _, corrected = bodies_of(panda.robot, panda.base, model)
    skeleton = corrected.skeleton
    q = skeleton.neutral + 0.2
    places = [skeleton.joints.index(joint) for joint in panda.joints]
    arm = model.of()
    tip = skeleton.links.index(panda.tip)
    found = {}
    for payload, carried in (("heavy", "heavy"), ("light", "light"), ("", "none")):
        expected = arm.error.tip_poses(
            q[None, places], arm.theta, Conditions((carried,))
        )[0]
        found[payload] = corrected.placements(q, payload)[tip]
        np.testing.assert_allclose(found[payload], expected, atol=1e-9)
    assert np.abs(found["heavy"] - found[""]).max() > 1e-4


def test_corrections_are_magnified_and_links_hang_together(panda, calibrated):
    """Small ones as many times as it is said; no link leaves its joint."""
    model = calibrated(panda, Position(), "placement", "compliance")
    small = replace(model, theta=1e-3 * model.theta)
    nominal, once = bodies_of(panda.robot, panda.base, small)
    assert nominal.magnified(50.0) is nominal
    q = nominal.skeleton.neutral + 0.3
    first = nominal.placements(q)
    moved = once.placements(q) - first
    for factor in (0.0, 1.0, 50.0):
        found = once.magnified(factor).placements(q) - first
        np.testing.assert_allclose(found, factor * moved, atol=2e-5 * factor)
    assert 1e-6 < np.abs(moved[:, :3, 3]).max() < 1e-4
    # Of a large one as well, the joints are where the links end.
    links = [
        nominal.skeleton.links.index(f"panda_{s}finger") for s in ("left", "right")
    ]
    gap, same = (
        np.linalg.norm(np.diff(T[links, :3, 3], axis=0))
        for T in (once.magnified(2000.0).placements(q), first)
    )
    assert gap == pytest.approx(same, abs=1e-9)


def test_fingers_follow_those_that_they_mimic():
    follows = '<mimic joint="a" multiplier="-2" offset="0.1"/>'
    left, right = joint("a", "base left"), joint("b", "base right", more=follows)
    text = urdf_of(left, right)
    robot = parse_robot(text.encode(), "test.urdf")
    skeleton = Skeleton(robot, "base")
    assert skeleton.joints == ("a",)
    placements = skeleton.placements(np.array([0.3]))
    for link, angle in (("left", 0.3), ("right", -0.5)):
        R = placements[skeleton.links.index(link), :3, :3]
        np.testing.assert_allclose(R, pin.rpy.rpyToMatrix(0.0, 0.0, angle), atol=1e-12)


# --- errors ------------------------------------------------------------------------


def test_vectors_end_where_the_robot_has_its_point(panda, calibrated, measured_rows):
    for measurement in (Position(), Pose()):
        model = calibrated(panda, measurement)
        rows = measured_rows(model, 12)
        errors = stage_errors(registered_robot(model, rows), panda.base)
        arm = model.of()
        to_base = arm.error.base.inverse()
        measured = rows.only.values[:, :3] @ to_base.rotation.T + to_base.translation
        predicted = (to_base.homogeneous @ arm.poses(rows.q))[:, :3, 3]
        np.testing.assert_allclose(errors.points - errors.vectors, measured, atol=1e-12)
        np.testing.assert_allclose(errors.points, predicted, atol=1e-12)
        lengths = np.linalg.norm(predicted - measured, axis=1)
        np.testing.assert_allclose(errors.sizes["position"], lengths, atol=1e-12)
    assert errors.units == {"position": "m", "orientation": "rad"}


def test_the_nominal_robot_is_registered(panda, calibrated, measured_rows):
    model = calibrated(panda, Position())
    rows = measured_rows(model, 30)
    ready = registered_robot(panda, rows, model.setup)
    before = stage_errors(ready, panda.base)
    assert ready.reason == ""
    after = stage_errors(registered_robot(model, rows), panda.base)
    sizes = [e.sizes["position"].mean() for e in (before, after)]
    assert sizes[0] > 1.3 * sizes[1]
    # The tracker stands where the nominal robot puts it, within its own errors.
    found = (before.points - before.vectors) - (after.points - after.vectors)
    assert np.abs(found).max() < 0.02
    assert registered_robot(panda, rows.rows(np.arange(2)), model.setup).reason


def test_other_measurements_have_sizes_only(panda, calibrated, measured_rows):
    wall = Plane("wall", np.array([1.0, 0.0, 0.0]), -2.0)
    ranger = calibrated(panda, PlaneDistance((wall,)))
    rows = measured_rows(ranger, 200, ("wall",) * 200)
    errors = stage_errors(registered_robot(ranger, rows), panda.base)
    assert np.isnan(errors.vectors).all()
    ((name, sizes),) = errors.sizes.items()
    assert np.isfinite(sizes).any() and errors.units == {name: "m"}
    expected = ranger.of().poses(rows.q)[:, :3, 3]
    base = ranger.of().error.base
    found = errors.points @ base.rotation.T + base.translation
    np.testing.assert_allclose(found, expected, atol=1e-12)


def test_several_chains_are_drawn_in_the_root():
    robot = load_robot("example:talos_reduced")
    hands = {side: f"gripper_{side}_base_link" for side in ("left", "right")}
    stated = {name: ChainSetup(link) for name, link in hands.items()}
    # What the left hand carries looks at the right one: its base moves.
    stated["touch"] = ChainSetup(hands["right"], hands["left"])
    chains = Chains(robot, setups=stated, names=("left", "touch"))
    keys = [BlockKey("position", "left"), BlockKey("position", "touch")]
    problem, theta = simulated(keys, count=6, seed=4, robot=chains)
    ready, data = Registered(problem, theta), problem.data
    link = drawn_link(chains)
    assert link == robot.root
    errors = stage_errors(ready, link)
    np.testing.assert_allclose(errors.vectors, 0.0, atol=1e-12)
    for k, q in enumerate(data.q):
        T = link_poses(robot, dict(zip(chains.joints, q, strict=True)), link)
        tips = [T[hands["left"]][:3, 3], T[hands["right"]][:3, 3]]
        np.testing.assert_allclose(errors.points[k], tips[k // 3], atol=1e-12)


# --- camera, floor ------ -----------------------------------------------------------


def test_all_is_in_view():
    points = np.random.default_rng(0).normal(size=(50, 3)) * [0.2, 0.3, 1.0]
    eye, center = sight(points)
    ahead = (center - eye) / np.linalg.norm(center - eye)
    assert ahead[2] < 0.0
    side = np.cross(ahead, [0.0, 0.0, 1.0])
    side /= np.linalg.norm(side)
    depth = (points - eye) @ ahead
    up = (points - eye) @ np.cross(side, ahead) / depth / np.tan(0.35)
    across = (points - eye) @ side / depth / np.tan(0.35)
    assert 0.85 < max(np.abs(up).max(), np.abs(across).max() / 1.1) < 1.0


@pytest.mark.parametrize(
    ("name", "height"),
    [
        # On its foot, although it is drawn from there.
        pytest.param("example:panda", 0.0, marks=pytest.mark.slow),
        ("example:ur10_robot", 0.0),  # Neutral, the wrist hangs below the foot.
    ],
)
def test_the_floor_is_under_the_robot(name, height):
    robot = load_robot(name)
    skeleton = Skeleton(robot, robot.root)
    found = floor_height(skeleton, robot_shapes(robot).parts)
    assert found == pytest.approx(height, abs=0.01)
