"""Errors of joints that follow another: their leader's, by the factor of each."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.parameterizations.base import drives
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.setup import Payload, Setup
from tests.shared import joint, urdf_of

SETUP = Setup(
    gravity=(1.0, -2.0, -9.5),
    payloads={"load": Payload(2.0, (0.05, -0.1, 0.2))},
    gear_ratios={"*": -31.5},
)
MOTIONS = ("joint-offset", "transmission", "compliance", "hysteresis")
OTHERS = ("motor-ripple", "thermal", "instrument-drift")


@pytest.fixture(scope="module")
def arm() -> Chains:
    """A chain of five joints: a leader, two that follow it, and one that stands still.

    One of those that follow slides and moves by meters per radian.
    """

    def heavy(name: str, k: int, mimic: str = "", **more: Any) -> dict[str, Any]:
        rng = np.random.default_rng(k)
        at = pin.SE3(pin.exp3(rng.normal(size=3)), rng.uniform(-1, 1, 3))
        mass = 1.0 + k, tuple(rng.uniform(-0.3, 0.3, 3))
        more = {"axis": "0 0.6 0.8", "mass": mass, "more": mimic, **more}
        return joint(name, f"l{k} l{k + 1}", at, limits="-2 2", **more)

    joints = (
        heavy("lead", 0),
        heavy("turn", 1, '<mimic joint="lead" multiplier="-0.5" offset="0.2"/>'),
        heavy("free", 2),
        heavy("still", 3, '<mimic joint="free" multiplier="0" offset="0.3"/>'),
        heavy(
            "slide",
            4,
            '<mimic joint="turn" multiplier="-0.4" offset="0.1"/>',
            kind="prismatic",
        ),
    )
    return Chains(parse_robot(urdf_of(*joints).encode(), "arm.urdf"))


def amounts(model: ErrorModel, size: float, seed: int = 0) -> Floats:
    """Random values of the parameters, the same for all screws of one."""
    drawn = np.random.default_rng(seed).normal(size=len(model.parameters))
    values = dict(zip(model.parameters.names, drawn, strict=True))
    return size * model.parameters.vector(values) * model.parameters.scales


def test_drives(arm: Chains) -> None:
    found = [(d.joint, d.unit, d.frame, d.factor, d.offset) for d in drives(arm[""])]
    assert found == [
        ("lead", "rad", 1, 1.0, 0.0),
        ("lead", "rad", 2, -0.5, 0.2),
        ("free", "rad", 3, 1.0, 0.0),
        # -0.4 (-0.5 q + 0.2) + 0.1
        ("lead", "rad", 5, 0.2, pytest.approx(0.02)),
    ]


@pytest.mark.parametrize("name", sorted({*PARAMETERIZATIONS} - {*OTHERS}))
def test_parameters_of_motions_are_those_of_the_drive(name: str, arm: Chains) -> None:
    """Every other one each joint has for itself, whatever it follows."""
    model = ErrorModel.create(arm[""], [name], setup=SETUP)
    names = [p.name for p in model.parameters if not p.nuisance]
    owners = [name.split(".")[0] for name in names]
    if name in MOTIONS:
        # Of the lead and of two that follow it.
        assert owners.count("lead") == 3 * owners.count("free")
        assert set(owners) == {"lead", "free"}
    else:
        assert len(set(names)) == len(names)
        assert set(owners) == set(arm[""].joints)


def test_errors_of_the_drive_move_all(arm: Chains) -> None:
    """Its gear, and its offset."""
    model = ErrorModel.create(arm[""], ["transmission"], setup=SETUP)
    q = arm.random_configurations(5, np.random.default_rng(1))
    values = {
        "lead.transmission.gain": 0.01,
        "lead.transmission.sin2": -0.03,
        "lead.transmission.motor_sin": 0.004,
    }
    drive = q[:, 0]
    dq = 0.01 * drive - 0.03 * np.sin(2 * drive) + 0.004 * np.sin(-31.5 * drive)
    expected = arm.follow(np.column_stack([drive + dq, q[:, 1:]]))
    found = model.joint_positions(q, model.parameters.vector(values))
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-13)
    model = ErrorModel.create(arm[""], ["joint-offset"])
    values = {"lead.joint-offset.q": 0.01, "free.joint-offset.q": -0.02}
    moved = arm.follow(q + np.array([0.01, 0.0, -0.02, 0.0, 0.0]))
    found = model.poses(q, model.parameters.vector(values))
    np.testing.assert_allclose(found, arm[""].poses(moved), rtol=0, atol=1e-13)


def test_a_drive_gives_way_to_all_that_it_holds(arm: Chains) -> None:
    chain, load = arm[""], SETUP.payloads["load"]
    model = ErrorModel.create(chain, ["compliance"], setup=SETUP)
    q = arm.random_configurations(4, np.random.default_rng(1))
    theta = model.parameters.vector({"lead.compliance.k": 1e-3})
    dq = model.joint_positions(q, theta) - q
    # Virtual work: the torque is the slope of the potential along the drive's way.
    robot = chain.robot.model.copy()
    robot.gravity.linear = np.array(SETUP.gravity)
    mass = pin.Inertia(load.mass, np.array(load.com), np.zeros((3, 3)))
    tip = robot.frames[robot.getFrameId(chain.tip, pin.FrameType.BODY)]
    robot.appendBodyToJoint(tip.parentJoint, mass, tip.placement)
    data, step = robot.createData(), 1e-5

    def potential(by: float) -> Floats:
        moved = arm.follow(q + np.array([by, 0, 0, 0, 0]))
        return np.array([pin.computePotentialEnergy(robot, data, row) for row in moved])

    torque = (potential(-step) - potential(step)) / (2.0 * step)
    assert np.abs(torque).min() > 0.5
    factors = np.array([1.0, -0.5, 0.0, 0.0, 0.2])
    # Energies of some 100 J have 1e-14 J of rounding, which the step makes 1e-9 Nm.
    np.testing.assert_allclose(dq, 1e-3 * np.outer(torque, factors), atol=1e-10)


@pytest.mark.parametrize(
    ("name", "ends"),
    [
        ("joint-offset", (None, None)),
        ("transmission", ("l5", "l0")),
        ("compliance", ("l3", "l5")),
        ("compliance", ("l5", "l0")),
        ("motor-ripple", (None, None)),
        ("cross-compliance", ("l5", "l0")),
    ],
)
def test_the_sum_of_columns_is_the_derivative(
    name: str, ends: tuple[str | None, str | None], arm: Chains
) -> None:
    chains = Chains(arm.robot, *ends)
    model = ErrorModel.create(chains[""], [name], setup=SETUP)
    q = chains.random_configurations(3, np.random.default_rng(2))
    q = q[:, chains.columns("")]
    theta = amounts(model, 5.0)
    _, J = model.jacobian(q, theta)
    names = np.array(model.parameters.names)
    for parameter in set(names):
        mine = names == parameter
        scale = model.parameters.scales[mine][0]
        step = 1e-3 * scale if scale < 1.0 else 1e-5
        ahead, behind = (model.poses(q, theta + by * mine) for by in (step, -step))
        for i in range(len(q)):
            twist = pin.log6(pin.SE3(behind[i]).actInv(pin.SE3(ahead[i]))).vector
            found = J[i][:, mine].sum(axis=1)
            # Rounding of 1e-15 over the step, and a third-order remainder.
            atol = 1e-13 / step + 1e-8 * np.abs(found).max()
            np.testing.assert_allclose(found, twist / (2 * step), rtol=0, atol=atol)
