"""What all parameterizations share: names, units, places, combinations, frames."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.errors import OptionError
from calib_pin.io.urdf import load_chain
from calib_pin.parameterizations import PARAMETERIZATIONS, parameterization
from calib_pin.parameterizations.base import ANGLE_SCALE, LENGTH_SCALE, Screw, owner
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.setup import Payload, Setup
from tests.shared import FRAMED, chain_of, urdf_of

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
    with pytest.raises(OptionError, match="'placement'"):
        parameterization("placment")


@pytest.mark.parametrize(("robot", "base", "tip"), ROBOTS)
def test_names_units_and_scales(robot: str, base: str | None, tip: str | None) -> None:
    chain = load_chain(robot, base=base, tip=tip)
    for name, components in COMPONENTS.items():
        screws = parameterization(name, FRAMED).screws(chain)
        kind = {"dh-full": "dh", "motor-ripple": "transmission"}.get(name, name)
        drifts = name == "instrument-drift"
        owners = ["base"] if drifts else [*chain.joints, chain.tip_joint]
        for screw in screws:
            joint, of_kind, component = screw.parameter.name.rsplit(".", 2)
            assert of_kind == kind
            assert component in components
            assert joint in owners
            assert drifts == (screw.frame == 0)
            assert 0 <= screw.frame <= len(chain.joints) + 1
            assert (screw.basis is None) == (name in GEOMETRY)
            assert screw.parameter.nuisance == drifts and screw.parameter.free
            if name in GEOMETRY:
                assert_of_geometry(screw)
        names = [screw.parameter.name for screw in screws]
        assert len(set(names)) == len(names)
        # Joint by joint from base to tip.
        joints = list(dict.fromkeys(name.rsplit(".", 2)[0] for name in names))
        assert joints == [joint for joint in owners if joint in joints]


def assert_of_geometry(screw: Screw) -> None:
    """A shift of 1 m or a turn of 1 rad, without a shift along its axis."""
    linear, angular = np.linalg.norm(screw.twist.reshape(2, 3), axis=1)
    if screw.parameter.unit == "m":
        assert (screw.parameter.scale, angular) == (LENGTH_SCALE, 0.0)
        assert abs(linear - 1.0) < 1e-12
    else:
        assert (screw.parameter.unit, screw.parameter.scale) == ("rad", ANGLE_SCALE)
        assert abs(angular - 1.0) < 1e-12
        assert abs(screw.twist[:3] @ screw.twist[3:]) < 1e-12


def test_zero_is_the_nominal_robot() -> None:
    chain = load_chain("example:tiago_no_hand", tip="arm_7_link")
    q = chain.random_configurations(3, np.random.default_rng(0))
    for name in PARAMETERIZATIONS:
        model = ErrorModel.create(chain, [name], setup=FRAMED)
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


def test_a_parameter_cannot_be_defined_twice() -> None:
    for twice in (["placement", "placement"], ["dh", "dh-full"]):
        with pytest.raises(OptionError):
            ErrorModel.create(load_chain("space6"), twice)


def test_joints_called_base_and_tool() -> None:
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
    for kind in ("dh", "transmission", "compliance"):
        of_kind = ErrorModel.create(chain, [kind], setup=load).parameters.names
        assert any(name.startswith(f"joint:base.{kind}.") for name in of_kind)
        assert not any(name.startswith(f"base.{kind}.") for name in of_kind)


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
