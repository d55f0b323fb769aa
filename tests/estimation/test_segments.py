"""The error model as segments against the error model itself."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.estimation.segments import Segments
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.setup import Setup

GEOMETRY = ("placement", "link-transform", "dh", "dh-full", "joint-offset")
ROBOTS = {
    "space6": (None, None),
    # A prismatic joint, skewed frames, and a tip without a fixed joint.
    "example:tiago_no_hand": (None, "arm_7_link"),
    # Two branches: seven joints are passed backwards, seven forwards.
    "example:talos_reduced": ("gripper_right_base_link", "gripper_left_base_link"),
    # Backwards only, a prismatic joint among them.
    "example:panda": ("panda_leftfinger", "panda_link0"),
}
AXES = [(0, 0, 1), (0, 0, -1), (1, 0, 0), (0, -1, 0), (1, 2, 3), (1e-7, 0, -1)]


def model_of(chain: Chain, *parameterizations: str) -> ErrorModel:
    """An error model between frames that stand somewhere."""
    rng = np.random.default_rng(2)
    frames = (pin.exp6(rng.normal(size=6)) for _ in range(2))
    return ErrorModel.create(chain, parameterizations).with_frames(*frames)


def product(segments: Segments, q: Floats, theta: Floats) -> Floats:
    """`L_0 Z_1(q_1) L_1 ... Z_n(q_n) L_n` written out, shape (N, 4, 4)."""
    links = [as_pose(link) for link in segments.links(theta[None])[0]]
    result = []
    for row in q * segments.signs:
        T = links[0]
        for i, position in enumerate(row):
            twist = np.zeros(6)
            twist[5 if segments.revolute[i] else 2] = position
            T = T * pin.exp6(twist) * links[i + 1]
        result.append(T.homogeneous)
    return np.array(result)


def as_pose(link: Floats) -> pin.SE3:
    rows = link.reshape(3, 4)
    return pin.SE3(rows[:, :3], rows[:, 3])


def assert_same_poses(model: ErrorModel) -> None:
    rng = np.random.default_rng(3)
    segments = Segments.of(model)
    q = model.chain.random_configurations(4, rng)
    # Large enough that the order of the screws matters.
    for size in (0.0, 0.1, 1.0):
        theta = size * rng.normal(size=len(model.parameters))
        expected = model.poses(q, theta)
        found = product(segments, q, theta)
        size = max(1.0, np.abs(expected).max())
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13 * size)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("name", GEOMETRY)
def test_poses_are_those_of_the_error_model(name: str, robot: str) -> None:
    base, tip = ROBOTS[robot]
    assert_same_poses(model_of(load_chain(robot, base=base, tip=tip), name))


@pytest.mark.parametrize("kind", ["revolute", "continuous", "prismatic"])
@pytest.mark.parametrize("axis", AXES)
@pytest.mark.parametrize("ends", [("a", "c"), ("c", "a"), ("b", "c"), ("c", "d")])
def test_any_axis_both_ways(
    kind: str,
    axis: tuple[float, ...],
    ends: tuple[str, str],
    urdf_of: Callable[..., str],
    chain_of: Callable[..., Chain],
) -> None:
    rng = np.random.default_rng(4)
    joints = [("first", "a", "b"), ("second", "b", "c"), ("other", "a", "d")]
    urdf = urdf_of(
        *(
            {
                "name": name,
                "parent": parent,
                "child": child,
                "placement": pin.exp6(rng.normal(size=6)),
                "type": kind,
                "axis": axis,
            }
            for name, parent, child in joints
        )
    )
    chain = chain_of(urdf, *ends)
    segments = Segments.of(model_of(chain, "placement"))
    assert segments.signs.tolist() == np.where(chain.reversed, -1.0, 1.0).tolist()
    assert segments.revolute.tolist() == [kind != "prismatic"] * len(chain.joints)
    assert_same_poses(model_of(chain, "placement", "joint-offset"))


def test_screws_stand_in_the_order_they_apply() -> None:
    """Those of joints that are passed backwards the other way round."""
    base, tip = "gripper_right_base_link", "gripper_left_base_link"
    chain = load_chain("example:talos_reduced", base=base, tip=tip)
    model = model_of(chain, "placement")
    segments = Segments.of(model)
    order: list[int] = []
    places: list[int] = []
    # Seven joints backwards end their segment, seven forwards begin it.
    for place, segment in enumerate([*range(8), *range(7, 14), 14, 14]):
        found = [k for k, screw in enumerate(model.screws) if screw.frame == place]
        order += found[::-1] if 1 <= place <= 7 else found
        places += [segment] * len(found)
    assert segments.parameter.tolist() == order
    assert segments.places.tolist() == places
    assert [screw.parameter for screw in segments.screws] == [
        model.screws[k].parameter for k in order
    ]


def test_joint_corrections_belong_to_no_segment(framed: Setup) -> None:
    base, tip = ROBOTS["example:talos_reduced"]
    chain = load_chain("example:talos_reduced", base=base, tip=tip)
    kinds = ("transmission", "placement", "compliance")
    model = ErrorModel.create(chain, kinds, setup=framed)
    corrections = set(model.joint_corrections.tolist())
    assert len(corrections) == 14 * (9 + 1)
    segments = Segments.of(model)
    assert corrections.isdisjoint(segments.parameter.tolist())
    assert len(segments.parameter) + len(corrections) == len(model.parameters)
    # They are the joint positions that the segments are asked for.
    rng = np.random.default_rng(7)
    q = chain.random_configurations(4, rng)
    theta = 0.02 * rng.normal(size=len(model.parameters))
    found = product(segments, model.joint_positions(q, theta), theta)
    assert np.abs(model.joint_positions(q, theta) - q).max() > 0.1
    np.testing.assert_allclose(found, model.poses(q, theta), rtol=0, atol=1e-13)


def test_links_of_members_are_those_of_each() -> None:
    segments = Segments.of(model_of(load_chain("space6"), "placement"))
    theta = np.random.default_rng(5).normal(size=(3, len(segments.screws)))
    links = segments.links(theta)
    assert links.shape == (3, 7, 12)
    for member, found in zip(theta, links, strict=True):
        np.testing.assert_array_equal(segments.links(member[None])[0], found)
    np.testing.assert_array_equal(segments.links(0.0 * theta)[0], segments.constants)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("name", GEOMETRY)
def test_columns_agree_with_central_differences(name: str, robot: str) -> None:
    base, tip = ROBOTS[robot]
    segments = Segments.of(model_of(load_chain(robot, base=base, tip=tip), name))
    count, step = len(segments.screws), 1e-6
    theta = 0.1 * np.random.default_rng(6).normal(size=count)
    columns = segments.columns(theta)
    assert columns.shape == (6 * len(segments.constants), count)
    nominal = [as_pose(link) for link in segments.links(theta[None])[0]]
    ahead, behind = (
        segments.links(theta + sign * step * np.eye(count)) for sign in (1.0, -1.0)
    )
    for k in range(count):
        logs = [
            np.concatenate(
                [
                    pin.log6(at.actInv(as_pose(link))).vector
                    for at, link in zip(nominal, moved[k], strict=True)
                ]
            )
            for moved in (ahead, behind)
        ]
        expected = (logs[0] - logs[1]) / (2.0 * step)
        np.testing.assert_allclose(columns[:, k], expected, rtol=0, atol=1e-8)
