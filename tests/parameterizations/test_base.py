"""What all parameterizations share: names, units, places, combinations, frames."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.errors import OptionError
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.parameterizations import (
    PARAMETERIZATIONS,
    frame_screws,
    parameterization,
)
from calib_pin.parameterizations.base import ANGLE_SCALE, LENGTH_SCALE, owner
from calib_pin.parameterizations.compliance import Compliance
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.setup import Payload, Setup

COMPONENTS = {
    "placement": ["x", "y", "z", "rx", "ry", "rz"],
    "link-transform": ["mx", "my", "mz", "dx", "dy", "dz"],
    "dh": ["theta", "d", "a", "alpha", "beta"],
    "dh-full": ["theta", "d", "a", "alpha", "beta"],
    "joint-offset": ["q"],
    "transmission": [
        *("gain", "sin1", "cos1", "sin2", "cos2"),
        *("motor_sin", "motor_cos", "motor_sin2", "motor_cos2"),
    ],
    "motor-ripple": ["motor_sin", "motor_cos", "motor_sin2", "motor_cos2"],
    "compliance": ["k"],
    "hysteresis": ["backlash"],
    "cross-compliance": ["kx", "ky"],
    "thermal": ["growth"],
    "warm-up": ["growth"],
    "instrument-drift": [
        f"{component}{part}"
        for component in ("x", "y", "z", "rx", "ry", "rz")
        for part in range(1, 9)
    ],
}
GEOMETRY = ("placement", "link-transform", "dh", "dh-full", "joint-offset")
ROBOTS = [
    ("space6", None, None),
    ("example:tiago_no_hand", None, "arm_7_link"),
    ("example:talos_reduced", "gripper_right_base_link", "gripper_left_base_link"),
    ("example:panda", "panda_link8", "panda_link0"),
]


def test_registry() -> None:
    assert set(PARAMETERIZATIONS) == set(COMPONENTS)
    for name, member in PARAMETERIZATIONS.items():
        assert member.of_setup(Setup()).name == name
        assert parameterization(name).name == name


def test_what_the_user_states_reaches_the_parameterization(framed: Setup) -> None:
    chain = load_chain("space6")
    names = [s.parameter.name for s in parameterization("transmission").screws(chain)]
    assert not any("motor" in name for name in names)
    with_motors = parameterization("transmission", framed).screws(chain)
    assert len(with_motors) == len(names) + 4 * 6
    # Without the payload there is nothing to bend this robot.
    with pytest.raises(OptionError, match="no mass that loads a joint"):
        parameterization("compliance").screws(chain)
    assert len(parameterization("compliance", framed).screws(chain)) == 6


def test_several_payloads_reach_the_compliance(framed: Setup) -> None:
    payloads = {
        "light": Payload(1.0, (0.0, 0.0, 0.0)),
        "heavy": Payload(9.0, (0.0, 0.0, 0.0)),
    }
    several = parameterization("compliance", replace(framed, payloads=payloads))
    assert isinstance(several, Compliance)
    assert several.payloads == payloads and several.gravity == framed.gravity


def test_unknown_name(refused: Callable[..., Any]) -> None:
    reason = "parameterization 'placment'", "mean 'placement'?"
    allowed = "placement, link-transform, dh, dh-full, joint-offset"
    with refused(OptionError, reason, allowed=allowed):
        parameterization("placment")


@pytest.mark.parametrize(("robot", "base", "tip"), ROBOTS)
@pytest.mark.parametrize("name", PARAMETERIZATIONS)
def test_names(
    name: str, robot: str, base: str | None, tip: str | None, framed: Setup
) -> None:
    chain = load_chain(robot, base=base, tip=tip)
    screws = parameterization(name, framed).screws(chain)
    kind = {"dh-full": "dh", "motor-ripple": "transmission"}.get(name, name)
    drifts = name == "instrument-drift"
    owners = ["base"] if drifts else [*chain.joints, chain.tip_joint]
    for screw in screws:
        joint, of_kind, component = screw.parameter.name.rsplit(".", 2)
        assert of_kind == kind
        assert component in COMPONENTS[name]
        assert joint in owners
        assert drifts == (screw.frame == 0)
        assert 0 <= screw.frame <= len(chain.joints) + 1
        assert (screw.basis is None) == (name in GEOMETRY)
        assert screw.parameter.nuisance == drifts and screw.parameter.free
    names = [screw.parameter.name for screw in screws]
    assert len(set(names)) == len(names)
    # Joint by joint from base to tip.
    joints = list(dict.fromkeys(name.rsplit(".", 2)[0] for name in names))
    assert joints == [joint for joint in owners if joint in joints]


@pytest.mark.parametrize(("robot", "base", "tip"), ROBOTS)
@pytest.mark.parametrize("name", GEOMETRY)
def test_units_and_scales_of_geometry(
    name: str, robot: str, base: str | None, tip: str | None
) -> None:
    for screw in parameterization(name).screws(load_chain(robot, base=base, tip=tip)):
        linear, angular = np.linalg.norm(screw.twist.reshape(2, 3), axis=1)
        if screw.parameter.unit == "m":
            assert (screw.parameter.scale, angular) == (LENGTH_SCALE, 0.0)
            assert abs(linear - 1.0) < 1e-12
        else:
            assert (screw.parameter.unit, screw.parameter.scale) == ("rad", ANGLE_SCALE)
            assert abs(angular - 1.0) < 1e-12
            # A turn, without a shift along its axis.
            assert abs(screw.twist[:3] @ screw.twist[3:]) < 1e-12


@pytest.mark.parametrize("name", PARAMETERIZATIONS)
def test_zero_is_the_nominal_robot(name: str, framed: Setup) -> None:
    chain = load_chain("example:tiago_no_hand", tip="arm_7_link")
    model = ErrorModel.create(chain, [name], setup=framed)
    q = chain.random_configurations(3, np.random.default_rng(0))
    zero = np.zeros(len(model.parameters))
    np.testing.assert_array_equal(model.poses(q, zero), chain.poses(q))


def test_combinations_go_place_by_place() -> None:
    chain = load_chain("space6")
    model = ErrorModel.create(chain, ["joint-offset", "placement"])
    places = [screw.frame for screw in model.screws]
    assert places == sorted(places)
    names = model.parameters.names
    assert names[:6] == tuple(
        f"base.frame.{c}" for c in ("x", "y", "z", "rx", "ry", "rz")
    )
    assert names[6] == "joint_1.joint-offset.q"
    assert names[7:13] == tuple(
        f"joint_1.placement.{c}" for c in ("x", "y", "z", "rx", "ry", "rz")
    )
    assert names[-6] == "tool.frame.x"
    assert len(names) == 6 * 8 + 6
    # The other way round the offset comes behind the six.
    other = ErrorModel.create(chain, ["placement", "joint-offset"]).parameters.names
    assert set(other) == set(names)
    assert other[12] == "joint_1.joint-offset.q"


@pytest.mark.parametrize("twice", [["placement", "placement"], ["dh", "dh-full"]])
def test_a_parameter_cannot_be_defined_twice(twice: list[str]) -> None:
    with pytest.raises(OptionError, match="is defined twice"):
        ErrorModel.create(load_chain("space6"), twice)


def test_no_parameterization_at_all() -> None:
    model = ErrorModel.create(load_chain("space6"), [])
    assert len(model.parameters) == 12
    T, J = model.jacobian(np.zeros((2, 6)), np.zeros(12))
    assert (T.shape, J.shape) == ((2, 4, 4), (2, 6, 12))


def test_joints_called_base_and_tool(
    urdf_of: Callable[..., str], chain_of: Callable[..., Chain]
) -> None:
    assert [owner(name) for name in ("base", "tool", "Base", "tool0")] == [
        "joint:base",
        "joint:tool",
        "Base",
        "tool0",
    ]
    chain = chain_of(
        urdf_of(
            {"name": "base", "parent": "a", "child": "b"},
            {"name": "elbow", "parent": "b", "child": "c", "axis": (0, 1, 0)},
            {"name": "tool", "parent": "c", "child": "d", "type": "fixed"},
        )
    )
    names = ErrorModel.create(chain, ["link-transform"]).parameters.names
    owners = list(dict.fromkeys(name.rsplit(".", 2)[0] for name in names))
    assert owners == ["base", "joint:base", "elbow", "joint:tool", "tool"]
    assert "base.frame.x" in names and "joint:base.link-transform.mx" in names
    load = Setup(payloads={"load": Payload(1.0, (0.1, 0.0, 0.0))})
    for kind in ("placement", "joint-offset", "dh", "transmission", "compliance"):
        of_kind = ErrorModel.create(chain, [kind], setup=load).parameters.names
        assert any(name.startswith(f"joint:base.{kind}.") for name in of_kind)
        assert not any(name.startswith(f"base.{kind}.") for name in of_kind)


TWIST = ("x", "y", "z", "rx", "ry", "rz")


@pytest.mark.parametrize("free", [True, False])
def test_screws(free: bool) -> None:
    screws = frame_screws("tool", 8, free=free)
    names = [f"tool.frame.{component}" for component in TWIST]
    assert [screw.parameter.name for screw in screws] == names
    assert [screw.parameter.unit for screw in screws] == 3 * ["m"] + 3 * ["rad"]
    np.testing.assert_array_equal([screw.twist for screw in screws], np.eye(6))
    for screw in screws:
        assert screw.frame == 8
        assert screw.parameter.nuisance
        assert screw.parameter.free == free
        assert screw.parameter.scale == 1.0


def test_frames_follow_their_references() -> None:
    chain = load_chain("space6")
    rng = np.random.default_rng(0)
    B, X = pin.exp6(rng.normal(size=6)), pin.exp6(rng.normal(size=6))
    model = ErrorModel.create(chain, [], estimate_tool=False).with_frames(B, X)
    assert model.parameters.free.tolist() == 6 * [True] + 6 * [False]
    theta = rng.normal(size=12) * 0.3
    errors = []
    for part in (theta[:6], theta[6:]):
        product = pin.SE3.Identity()
        for k in range(6):
            product = product * pin.exp6(part[k] * np.eye(6)[k])
        errors.append(product)
    q = chain.random_configurations(4, rng)
    left, right = (B * errors[0]).homogeneous, (X * errors[1]).homogeneous
    expected = left @ chain.poses(q) @ right
    np.testing.assert_allclose(model.poses(q, theta), expected, rtol=0, atol=1e-13)
    # The frames are no part of the robot.
    np.testing.assert_array_equal(model.tip_poses(q, theta), chain.poses(q))
