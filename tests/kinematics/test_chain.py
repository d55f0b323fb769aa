"""Kinematics between any two links, against yourdfpy and central differences."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.errors import RobotError
from calib_pin.io.urdf import load_chain, load_robot
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.joint_space import FREE_TRAVEL
from calib_pin.kinematics.robot import Robot
from calib_pin.setup import Payload
from tests.shared import chain_of, joint, refused, urdf_of

IndependentPoses = Callable[..., Any]


def placement(rng: np.random.Generator) -> pin.SE3:
    return pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-1.0, 1.0, 3))


def some_chains(robot: Robot, rng: np.random.Generator) -> list[Chain]:
    """Up to three chains from the root, and three between any two links."""
    leaves = [str(leaf) for leaf in rng.permutation(robot.leaves)]
    pairs = [(robot.root, leaf) for leaf in leaves[:3]]
    pairs += [tuple(map(str, rng.choice(robot.links, 2))) for _ in range(3)]
    chains = []
    for base, tip in pairs:
        try:
            chains.append(Chain(robot, base, tip))
        except RobotError as error:  # No moving joint, or a refused one.
            assert "no moving joint" in error.reason or "cannot contain" in error.reason
    return chains


def assert_regressor(chain: Chain, q: np.ndarray, step: float = 1e-5) -> None:
    """Compare with central differences of the body twist of the tip."""
    T, R = chain.regressor(q)
    # Products of up to 30 placements of a meter: some hundred eps.
    np.testing.assert_allclose(T, chain.poses(q), rtol=0, atol=1e-13)
    assert R.shape == (len(q), 6, 6 * len(chain.joints))
    for k in range(R.shape[2]):
        poses = []
        for amount in (step, -step):
            moved = list(chain.placements)
            moved[k // 6] = moved[k // 6] * pin.exp6(amount * np.eye(6)[k % 6])
            poses.append(chain.poses(q, moved))
        for i in range(len(q)):
            ahead, behind = (
                pin.log6(pin.SE3(T[i]).actInv(pin.SE3(pose[i]))).vector
                for pose in poses
            )
            expected = (ahead - behind) / (2 * step)
            np.testing.assert_allclose(R[i, :, k], expected, rtol=0, atol=1e-8)


# Every robot of example-robot-data.


def test_poses_agree_with_yourdfpy(
    example_robot: Path, independent_poses: IndependentPoses
) -> None:
    robot = load_robot(example_robot)
    rng = np.random.default_rng(len(robot.source))
    # Joints outside a chain, and above both its ends, move too.
    q = {name: rng.uniform(-1.5, 1.5) for name in list(robot.model.names)[1:]}
    q = {name: value for name, value in q.items() if name not in robot.refused}
    driven = {name: value for name, value in q.items() if name not in robot.mimics}
    for name, mimic in robot.mimics.items():
        q[name] = mimic.factor * q[mimic.leader] + mimic.offset
    chains = some_chains(robot, rng)
    frames = [(chain.base, chain.tip) for chain in chains]
    expected = independent_poses(robot.source, driven, frames)
    for chain, pose in zip(chains, expected, strict=True):
        found = chain.poses(np.array([[q[name] for name in chain.joints]]))
        np.testing.assert_allclose(found, [pose], rtol=0, atol=1e-9)


def test_joints_from_base_to_tip() -> None:
    base, tip = "gripper_left_base_link", "gripper_right_base_link"
    chain = load_chain("example:talos_reduced", base=base, tip=tip)
    left = tuple(f"arm_left_{k}_joint" for k in range(7, 0, -1))
    right = tuple(f"arm_right_{k}_joint" for k in range(1, 8))
    assert chain.joints == left + right
    assert chain.reversed.tolist() == 7 * [True] + 7 * [False]
    # Turned round it is the inverse.
    back = Chain(chain.robot, tip, base)
    assert back.joints == chain.joints[::-1]
    q = chain.random_configurations(3, np.random.default_rng(0))
    product = chain.poses(q) @ back.poses(q[:, ::-1])
    np.testing.assert_allclose(product, np.tile(np.eye(4), (3, 1, 1)), atol=1e-12)
    assert_regressor(chain, q[:1])


# Kinds of joints.

KINDS = [
    ("revolute", (0, 0, 1)),
    ("continuous", (0, 0, -1)),
    ("prismatic", (0, -1, 0)),
    ("revolute", (1, 2, 3)),
    ("continuous", (-2, 0.1, 0)),
    ("prismatic", (0, 3, 4)),
]


@pytest.mark.parametrize(("kind", "axis"), KINDS)
def test_joint_kinds_and_axes(
    kind: str, axis: tuple[float, ...], independent_poses: IndependentPoses
) -> None:
    rng = np.random.default_rng(3)
    # yourdfpy does not normalize the axes of prismatic joints.
    unit = np.array(axis) / np.linalg.norm(axis)
    given = unit if kind == "prismatic" else axis
    urdf = urdf_of(
        joint("first", "a b", placement(rng), given, kind),
        joint("second", "b c", placement(rng), "0 1 0"),
    )
    chain = chain_of(urdf)
    assert chain.revolute.tolist() == [kind != "prismatic", True]
    # Turned from the frame of the joint and back: some ten eps.
    np.testing.assert_allclose(chain.axes, [unit, [0, 1, 0]], rtol=0, atol=1e-14)
    q = rng.uniform(-1.8, 1.8, (3, 2))
    if kind == "continuous":
        q[0, 0] = 40.0
    for row, pose in zip(q, chain.poses(q), strict=True):
        named = {"first": row[0], "second": row[1]}
        (expected,) = independent_poses(urdf.encode(), named, [("a", "c")])
        np.testing.assert_allclose(pose, expected, rtol=0, atol=1e-12)
    assert_regressor(chain, q)
    assert_regressor(chain_of(urdf, "c", "a"), q[:, ::-1])


# What a chain leaves alone.


def test_robot_is_never_changed() -> None:
    robot = load_robot("example:panda")
    before = robot.model.copy()
    chain = Chain(robot, tip="panda_link8")
    other = Chain(robot, "panda_link8", "panda_leftfinger")
    q = chain.random_configurations(2, np.random.default_rng(0))
    nominal = chain.poses(q)
    kept = [M.copy() for M in chain.placements]
    rng = np.random.default_rng(1)
    moved = [M * pin.exp6(rng.normal(size=6)) for M in chain.placements]
    assert np.abs(chain.poses(q, moved) - nominal).max() > 0.1
    chain.regressor(q, moved)
    # Another chain of the same robot has its own model.
    other.poses(np.zeros((1, 1)), [pin.SE3.Identity()])
    # Without placements the nominal ones are back, and none has been touched.
    np.testing.assert_array_equal(chain.poses(q), nominal)
    np.testing.assert_array_equal(chain.regressor(q)[0], nominal)
    assert all(a == b for a, b in zip(kept, chain.placements, strict=True))
    assert robot.model == before


# Gravity.

GRAVITY = (1.0, -3.0, -9.0)
LOAD = Payload(2.5, (0.1, -0.2, 0.3))
MASSES = {
    "b": (4.0, (0.1, 0.0, 0.2)),
    "c": (3.0, (0.0, -0.3, 0.1)),
    "d": (2.0, (0.2, 0.1, 0.0)),
    "e": (1.0, (-0.1, 0.2, 0.4)),
    "tool": (0.5, (0.0, 0.0, 0.2)),
    "f": (1.5, (0.3, 0.0, 0.0)),
    "g": (0.7, (0.0, 0.1, 0.0)),
}


@pytest.fixture
def heavy_urdf() -> str:
    """Two branches with all kinds of joints; each link has a mass of its own."""
    rng = np.random.default_rng(12)
    joints = {
        "above": ("a", "b", "revolute", (0, 1, 0)),
        "one": ("b", "c", "continuous", (1, 2, 3)),
        "two": ("c", "d", "prismatic", (0, 0, -1)),
        "three": ("d", "e", "revolute", (1, 0, 0)),
        "flange": ("e", "tool", "fixed", ()),
        "aside": ("b", "f", "continuous", (0, -1, 1)),
        "beyond": ("f", "g", "revolute", (0, 0, 1)),
    }
    return urdf_of(
        *(
            joint(name, f"{parent} {child}", placement(rng), axis, kind, **mass)
            for name, (parent, child, kind, axis) in joints.items()
            for mass in [{"mass": MASSES[child]}]
        )
    )


@pytest.mark.parametrize(
    ("base", "tip", "payload"),
    [
        ("a", "tool", LOAD),
        ("tool", "a", LOAD),
        # The joint above is locked, and turns the frame that gravity is given in.
        ("b", "e", None),
        ("e", "b", LOAD),
        # Two branches, with a locked joint beyond the base.
        ("f", "tool", LOAD),
        ("tool", "g", None),
    ],
)
def test_torques_of_gravity_are_its_virtual_work(
    base: str,
    tip: str,
    payload: Payload | None,
    heavy_urdf: str,
    independent_poses: IndependentPoses,
) -> None:
    chain = chain_of(heavy_urdf, base, tip)
    loads = list(MASSES.items())
    if payload is not None:
        loads.append((tip, (payload.mass, payload.com)))
    frames = [("a", link) for link, _ in loads]

    def links(q: np.ndarray) -> list[np.ndarray]:
        named = dict(zip(chain.joints, q, strict=True))
        still = dict.fromkeys(("above", "one", "two", "three", "aside", "beyond"), 0.0)
        return independent_poses(heavy_urdf.encode(), {**still, **named}, frames)

    (stand,) = independent_poses(heavy_urdf.encode(), {}, [("a", base)])
    gravity = stand[:3, :3] @ GRAVITY

    def potential(q: np.ndarray) -> float:
        return -sum(
            mass * gravity @ (T @ [*center, 1.0])[:3]
            for (_, (mass, center)), T in zip(loads, links(q), strict=True)
        )

    q = chain.random_configurations(2, np.random.default_rng(3))
    found = chain.gravity_torques(q, GRAVITY, payload)
    assert found.shape == q.shape
    step = 2e-3
    expected = np.empty_like(q)
    for (i, k), _ in np.ndenumerate(q):
        shift = step * np.eye(q.shape[1])[k]
        near, far = (
            potential(q[i] + s * shift) - potential(q[i] - s * shift) for s in (1, 2)
        )
        expected[i, k] = -(8.0 * near - far) / (12.0 * step)
    assert np.abs(expected).max() > 5.0
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-8)


def test_torques_are_those_of_nominal_geometry(heavy_urdf: str) -> None:
    chain = chain_of(heavy_urdf, "f", "tool")
    rng = np.random.default_rng(0)
    q = chain.random_configurations(4, rng)
    T, torques = chain.poses(q), chain.gravity_torques(q, GRAVITY, LOAD)
    chain.poses(q, [placement(rng) for _ in chain.joints])
    np.testing.assert_array_equal(chain.gravity_torques(q, GRAVITY, LOAD), torques)
    # Neither masses nor gravity stay behind.
    chain.gravity_torques(q, (0.0, 0.0, 5.0), Payload(100.0, (0.0, 0.0, 0.0)))
    np.testing.assert_array_equal(chain.gravity_torques(q, GRAVITY, LOAD), torques)
    np.testing.assert_array_equal(chain.poses(q), T)
    assert chain.gravity_torques(q[:0], GRAVITY).shape == (0, len(chain.joints))
    # A payload on the root bends nothing.
    back = chain_of(heavy_urdf, "tool", "a")
    q_back = back.random_configurations(3, rng)
    bare, loaded = (back.gravity_torques(q_back, GRAVITY, one) for one in (None, LOAD))
    np.testing.assert_array_equal(loaded, bare)
    # A turn more of a joint without limits is the same place.
    turned = q + 2.0 * np.pi * np.isin(chain.joints, ("one", "aside"))
    np.testing.assert_allclose(
        chain.gravity_torques(turned, GRAVITY, LOAD), torques, rtol=0, atol=1e-12
    )


# Names.


def test_link_and_joint_of_one_name() -> None:
    names = ("hip", "knee", "ankle", "toe", "heel")
    # Each joint is called as the link it carries, or as another one.
    urdf = urdf_of(
        {"name": "hip", "parent": "body", "child": "hip", "axis": (1, 0, 0)},
        {"name": "knee", "parent": "hip", "child": "ankle", "axis": (0, 1, 0)},
        {"name": "ankle", "parent": "ankle", "child": "knee", "axis": (1, 2, 3)},
        {"name": "toe", "parent": "knee", "child": "toe", "type": "fixed"},
        {"name": "body", "parent": "hip", "child": "heel"},
    )
    rng = np.random.default_rng(0)
    plain = urdf.replace('link="', 'link="link_').replace(
        '<link name="', '<link name="link_'
    )
    for base in ("body", *names):
        for tip in names:
            if base == tip or {base, tip} == {"knee", "toe"}:
                continue
            chain = chain_of(urdf, base, tip)
            twin = chain_of(plain, f"link_{base}", f"link_{tip}")
            assert chain.joints == twin.joints
            q = rng.normal(size=(2, len(chain.joints)))
            np.testing.assert_array_equal(chain.poses(q), twin.poses(q))


# Limits.


def test_limits() -> None:
    kinds = [
        ("revolute", (-1.0, 2.5)),
        ("continuous", ()),
        ("revolute", (0.0, 0.0)),
        ("prismatic", (0.0, 0.35)),
        ("prismatic", (0.0, 0.0)),
        ("revolute", (-1e9, 1e9)),
        ("revolute", (1.0, -1.0)),
    ]
    urdf = urdf_of(
        *(
            joint(f"j{k}", f"l{k} l{k + 1}", kind=kind, limits=limits)
            for k, (kind, limits) in enumerate(kinds)
        )
    )
    chain = chain_of(urdf)
    free = (-np.pi, np.pi)
    slide = (-FREE_TRAVEL, FREE_TRAVEL)
    expected = [(-1.0, 2.5), free, free, (0.0, 0.35), slide, free, free]
    np.testing.assert_array_equal(np.column_stack([chain.lower, chain.upper]), expected)
    q = chain.random_configurations(1000, np.random.default_rng(0))
    assert ((chain.lower <= q) & (q <= chain.upper)).all()
    span = q.max(axis=0) - q.min(axis=0)
    assert (span > 0.97 * (chain.upper - chain.lower)).all()
    again = chain.random_configurations(1000, np.random.default_rng(0))
    np.testing.assert_array_equal(q, again)
    back = chain_of(urdf, "l7", "l0")
    np.testing.assert_array_equal(chain.lower[::-1], back.lower)
    np.testing.assert_array_equal(chain.upper[::-1], back.upper)


# What is refused.


@pytest.mark.parametrize(
    ("base", "tip", "changes"),
    [
        ("a", "d", {"type": "floating"}),
        ("d", "a", {"type": "planar"}),
        ("e", "d", {"more": '<mimic joint="j"/>'}),
        ("a", "d", {"more": '<mimic joint="j10"/>'}),
    ],
)
def test_refused_joints(base: str, tip: str, changes: dict[str, str]) -> None:
    urdf = urdf_of(
        {"name": "j1", "parent": "a", "child": "b"},
        {"name": "j10", "parent": "b", "child": "c", **changes},
        {"name": "j11", "parent": "c", "child": "d"},
        {"name": "j12", "parent": "a", "child": "e"},
    )
    with refused(RobotError, "'j10'", file="test.urdf"):
        chain_of(urdf, base, tip)
    assert chain_of(urdf, "e", "b").joints == ("j12", "j1")


def test_frames_that_make_no_chain() -> None:
    joint = {"name": "j", "parent": "base_link", "child": "flange"}
    urdf, frames = urdf_of(joint), {"allowed": "base_link, flange"}
    with refused(RobotError, ["'flnge'", "'flange'?"], **frames):
        chain_of(urdf, tip="flnge")
    with refused(RobotError, ["'bas_link'", "'base_link'?"], **frames):
        chain_of(urdf, base="bas_link")
    # A joint is not a frame.
    with refused(RobotError, "'j'", **frames):
        chain_of(urdf, tip="j")
    with refused(RobotError, "0 possible tips"):
        chain_of(urdf, "flange")
    with refused(RobotError, "'flange'", file="test.urdf"):
        chain_of(urdf_of({**joint, "type": "fixed"}))
    # Sixty links are too many to list.
    with refused(RobotError, "'gripper_left'", allowed=None):
        load_chain("example:talos_reduced", tip="gripper_left")
    fork = urdf_of(
        {"name": "j", "parent": "a", "child": "b"},
        {"name": "k", "parent": "b", "child": "c", "type": "fixed"},
        {"name": "l", "parent": "b", "child": "d", "type": "fixed"},
    )
    with refused(RobotError, "2 possible tips", file="test.urdf", allowed="c, d"):
        chain_of(fork)
    # From one leaf only the other is left.
    with refused(RobotError, ["'c'", "'d'"]):
        chain_of(fork, "c")
    alone = parse_robot(b'<robot name="r"><link name="a"/></robot>', "r.urdf")
    with refused(RobotError, file="r.urdf"):
        Chain(alone)
    # An arm of 800 mm.
    with refused(RobotError, "'flange' is 800 m from 'base_link'", file="test.urdf"):
        chain_of(urdf_of({**joint, "placement": "0 0 800"}))


def test_a_link_stands_still_in_itself(heavy_urdf: str) -> None:
    q = np.zeros((3, 0))
    for link in ("a", "c", "tool"):
        chain = chain_of(heavy_urdf, link, link)
        assert (chain.joints, chain.tip_joint) == ((), None)
        still = np.tile(np.eye(4), (3, 1, 1))
        np.testing.assert_allclose(chain.poses(q), still, rtol=0, atol=1e-13)
        for derivatives in (chain.regressor, chain.jacobian):
            T, J = derivatives(q)
            np.testing.assert_array_equal(T, chain.poses(q))
            assert J.shape == (3, 6, 0)
        assert chain.gravity_torques(q, GRAVITY, LOAD).shape == (3, 0)
        assert chain.joint_frames().shape == (0, 4, 4)
        assert chain.motions.shape == (0, 6)
        drawn = chain.random_configurations(3, np.random.default_rng(0))
        assert drawn.shape == (3, 0)
