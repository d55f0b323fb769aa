"""Joints that sag: signs and sizes by hand, payloads, gravity, what can be known."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Conditions
from calib_pin.parameterizations.compliance import DEFLECTION, Compliance
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.parameterizations.loads import LEAST
from calib_pin.setup import FrameSetup, Payload, Setup
from calib_pin.simulation import exact_problem

UrdfOf = Callable[..., str]
ChainOf = Callable[..., Chain]

G = 9.81
K = 1e-3
MASS, CENTER, LENGTH = 3.0, 0.25, 0.6
SETUP = Setup(parameters=("compliance",))


def beam(axis: tuple[float, float, float] = (0, 1, 0)) -> list[dict[str, Any]]:
    """An arm along x that turns about y, with its mass on the way to the tool."""
    tool = pin.SE3(np.eye(3), np.array([LENGTH, 0.0, 0.0]))
    return [
        {
            "name": "j",
            "parent": "base",
            "child": "arm",
            "axis": axis,
            "mass": (MASS, (CENTER, 0.0, 0.0)),
        },
        {
            "name": "k",
            "parent": "arm",
            "child": "tool",
            "type": "fixed",
            "placement": tool,
        },
    ]


def model_of(chain: Chain, **stated: Any) -> ErrorModel:
    return ErrorModel.create(chain, ["compliance"], setup=replace(SETUP, **stated))


def deflection(chain: Chain, q: Floats, **stated: Any) -> Floats:
    """What all joints give way with a compliance of K each, shape (N, n)."""
    model = model_of(chain, **stated)
    theta = np.zeros(len(model.parameters))
    theta[model.joint_corrections] = K
    return model.joint_positions(q, theta) - q


ROUNDING = 2.0 * np.finfo(float).eps
"""Of a deflection, the difference of joint positions up to 2 rad."""

# By hand.


@pytest.mark.parametrize("axis", [(0, 1, 0), (0, -1, 0)])
def test_an_arm_sags(
    axis: tuple[float, float, float], urdf_of: UrdfOf, chain_of: ChainOf
) -> None:
    chain = chain_of(urdf_of(*beam(axis)))
    q = np.array([[0.0], [0.5], [-1.2], [np.pi / 2]])
    dq = deflection(chain, q)
    # A positive turn about +y lowers x; the lever is the horizontal distance.
    by_hand = axis[1] * K * MASS * G * CENTER * np.cos(q)
    np.testing.assert_allclose(dq, by_hand, rtol=0, atol=1e-15)
    holding = [
        pin.computeGeneralizedGravity(
            chain.robot.model, chain.robot.model.createData(), row
        )
        for row in q
    ]
    np.testing.assert_allclose(dq, -K * np.array(holding), rtol=0, atol=1e-15)
    # The tool comes down, whichever way the joint counts.
    model = model_of(chain)
    theta = model.parameters.vector({"j.compliance.k": K})
    lower = model.poses(q, theta)[:, 2, 3] - chain.poses(q)[:, 2, 3]
    assert (lower[:3] < 0.0).all()
    assert lower[0] == pytest.approx(-LENGTH * np.sin(K * MASS * G * CENTER))
    assert abs(lower[3]) < 1e-15


def test_a_payload_by_hand(urdf_of: UrdfOf, chain_of: ChainOf) -> None:
    """Its center of mass is given in the tip frame."""
    chain = chain_of(urdf_of(*beam()))
    load = {"load": Payload(5.0, (0.2, 0.7, 0.1))}
    q = np.array([[0.0], [0.8]])
    lever = CENTER * np.cos(q), (LENGTH + 0.2) * np.cos(q) + 0.1 * np.sin(q)
    expected = K * G * (MASS * lever[0] + 5.0 * lever[1])
    dq = deflection(chain, q, payloads=load)
    np.testing.assert_allclose(dq, expected, rtol=0, atol=ROUNDING)
    # Only what hangs behind the joint, and where the tip is told to be.
    shorter = deflection(chain_of(urdf_of(*beam()), tip="arm"), q, payloads=load)
    lever = CENTER * np.cos(q), 0.2 * np.cos(q) + 0.1 * np.sin(q)
    np.testing.assert_allclose(
        shorter, K * G * (MASS * lever[0] + 5.0 * lever[1]), rtol=0, atol=ROUNDING
    )


def test_the_direction_of_gravity(urdf_of: UrdfOf, chain_of: ChainOf) -> None:
    chain = chain_of(urdf_of(*beam()))
    q = np.array([[0.3], [-0.9]])
    usual = deflection(chain, q)
    ceiling = deflection(chain, q, gravity=(0.0, 0.0, G))
    np.testing.assert_allclose(ceiling, -usual, rtol=0, atol=ROUNDING)
    # On a wall whose x points down, the arm hangs at q = 0.
    wall = deflection(chain, q, gravity=(1.62, 0.0, 0.0))
    np.testing.assert_allclose(
        wall, -K * MASS * 1.62 * CENTER * np.sin(q), rtol=0, atol=ROUNDING
    )
    # The part along the axis does nothing.
    aside = deflection(chain, q, gravity=(0.0, 7.0, -G))
    np.testing.assert_allclose(aside, usual, rtol=0, atol=ROUNDING)


def test_a_joint_that_slides(urdf_of: UrdfOf, chain_of: ChainOf) -> None:
    """A lift gives way by its weight, in meters per newton, wherever it stands."""
    lift = {
        "name": "lift",
        "parent": "base",
        "child": "cage",
        "type": "prismatic",
        "mass": (10.0, (0.3, 0.1, 0.0)),
    }
    chain = chain_of(urdf_of(lift))
    q = np.array([[0.0], [1.5]])
    np.testing.assert_allclose(
        deflection(chain, q), -K * 10.0 * G, rtol=0, atol=ROUNDING
    )
    sideways = deflection(chain, q, gravity=(3.0, 4.0, -2.0))
    np.testing.assert_allclose(sideways, -K * 10.0 * 2.0, rtol=0, atol=ROUNDING)
    (parameter,) = (p for p in model_of(chain).parameters if not p.nuisance)
    assert (parameter.name, parameter.unit) == ("lift.compliance.k", "m/N")
    assert parameter.scale == pytest.approx(DEFLECTION / (10.0 * G))


# Against models that Pinocchio builds itself.


@pytest.mark.parametrize("flange", ["tip", None])
def test_a_payload_is_a_link_more(flange: str | None) -> None:
    """The robot with a link welded to its tip, read by Pinocchio."""
    chain = calib_pin.load_chain("pa10", tip="tool" if flange else "link_7")
    load = Payload(7.5, (0.05, -0.1, 0.2))
    center = " ".join(map(str, load.com))
    welded = chain.robot.source.decode().replace(
        "</robot>",
        f"""<link name="load"><inertial><origin xyz="{center}"/>
        <mass value="{load.mass}"/><inertia ixx="1" ixy="0" ixz="0" iyy="1" iyz="0"
        izz="1"/></inertial></link>
        <joint name="weld" type="fixed"><parent link="{chain.tip}"/>
        <child link="load"/></joint></robot>""",
    )
    model = pin.buildModelFromXML(welded)
    data = model.createData()
    q = chain.random_configurations(5, np.random.default_rng(0))
    expected = [-K * pin.computeGeneralizedGravity(model, data, row) for row in q]
    found = deflection(chain, q, payloads={"load": load})
    np.testing.assert_allclose(found, expected, rtol=0, atol=1e-14)
    assert np.abs(found - deflection(chain, q)).max() > K


def test_continuous_joints(urdf_of: UrdfOf, chain_of: ChainOf) -> None:
    """They have two entries in Pinocchio's configurations and one in its torques."""

    def arm(kind: str) -> Chain:
        rng = np.random.default_rng(4)
        return chain_of(
            urdf_of(
                *(
                    {
                        "name": f"j{k}",
                        "parent": f"l{k}",
                        "child": f"l{k + 1}",
                        "type": kind if k != 1 else "revolute",
                        "axis": (1, k, -1),
                        "placement": pin.exp6(rng.normal(size=6)),
                        "mass": (1.0 + k, rng.normal(size=3)),
                    }
                    for k in range(4)
                )
            )
        )

    q = np.random.default_rng(1).uniform(-2, 2, (5, 4))
    limited, endless = (deflection(arm(kind), q) for kind in ("revolute", "continuous"))
    assert np.abs(limited).max() > 10.0 * K
    np.testing.assert_allclose(endless, limited, rtol=0, atol=1e-15)


def test_a_chain_from_tool_to_base_is_the_same_robot() -> None:
    """The joints sag as they do; only what is held still is another end."""
    chain = calib_pin.load_chain("example:ur10_robot", tip="tool0")
    back = Chain(chain.robot, "tool0", "base_link")
    # Gravity is given in the base, here the tool where the joints are at zero.
    R = chain.poses(np.zeros((1, 6)))[0, :3, :3]
    turned = tuple(R.T @ [0.0, 0.0, -G])
    rng = np.random.default_rng(2)
    q, k = chain.random_configurations(4, rng), rng.uniform(1e-4, 1e-3, 6)
    dq = (deflection(chain, q) / K) * k
    assert np.abs(dq).max() > 1e-2
    names = [f"{joint}.compliance.k" for joint in chain.joints]
    for model, order in (
        (model_of(chain), slice(None)),
        (model_of(back, gravity=turned), slice(None, None, -1)),
    ):
        theta = model.parameters.vector(dict(zip(names, k, strict=True)))
        found = model.joint_positions(q[:, order], theta) - q[:, order]
        np.testing.assert_allclose(found, dq[:, order], rtol=0, atol=1e-14)
        expected = model.chain.poses(q[:, order] + dq[:, order])
        np.testing.assert_allclose(
            model.poses(q[:, order], theta), expected, rtol=0, atol=1e-14
        )


# Scales, and what cannot be used.


def test_a_scale_is_what_bends_a_joint_by_a_thousandth() -> None:
    chain = calib_pin.load_chain("pa10")
    parameters = [p for p in model_of(chain).parameters if not p.nuisance]
    q = chain.random_configurations(4000, np.random.default_rng(0))
    usual = np.sqrt(np.mean(chain.gravity_torques(q, Setup.gravity) ** 2, axis=0))
    scales = np.array([p.scale for p in parameters])
    assert {p.unit for p in parameters} == {"rad/Nm"}
    # The first axis and the last carry nothing: rounding is no scale.
    assert usual[0] < 1e-12 and usual[6] < LEAST * usual.max()
    expected = DEFLECTION / np.maximum(usual, LEAST * usual.max())
    np.testing.assert_allclose(scales, expected, rtol=0.1)
    # A heavier load makes softer joints less to be expected.
    loaded = model_of(chain, payloads={"load": Payload(20.0, (0.0, 0.0, 0.1))})
    heavy = np.array([p.scale for p in loaded.parameters if not p.nuisance])
    assert (heavy[1:6] < 0.7 * scales[1:6]).all()


def test_the_scales_do_not_depend_on_chance() -> None:
    chain = calib_pin.load_chain("pa10")
    first, second = (model_of(chain).parameters for _ in range(2))
    assert first.parameters == second.parameters


@pytest.mark.parametrize("robot", ["space6", "space7"])
def test_a_robot_without_masses(robot: str, refused: Callable[..., Any]) -> None:
    chain = calib_pin.load_chain(robot)
    reason, allowed = ["'compliance'", f"'{robot}' have no mass"], "<inertial>"
    with refused(OptionError, reason, file="s.yaml", allowed=allowed):
        nominal_problem(chain, "pose", replace(SETUP, file="s.yaml"))
    load = {"load": Payload(2.0, (0.1, 0.0, 0.0))}
    model = model_of(chain, payloads=load)
    assert len(model.joint_corrections) == len(chain.joints)


def test_a_payload_that_loads_nothing(urdf_of: UrdfOf, chain_of: ChainOf) -> None:
    """A turntable about gravity, with a wheel in its middle."""
    table = {
        "name": "table",
        "parent": "base",
        "child": "plate",
        "mass": (5.0, (0.3, 0.0, 0.0)),
    }
    chain = chain_of(urdf_of(table))
    with pytest.raises(OptionError, match="something that gravity pulls at"):
        Compliance(payloads={"load": Payload(3.0, (0.0, 0.0, 0.0))}).screws(chain)
    assert len(Compliance(gravity=(0.0, 1.0, -G)).screws(chain)) == 1


# Several payloads.

LOADS = {"light": Payload(1.0, (0.1, 0.0, 0.0)), "heavy": Payload(9.0, (0.0, 0.2, 0.1))}
CARRIED = ("heavy", "none", "light", "heavy", "none", "light")


def test_each_row_has_the_torques_of_its_payload() -> None:
    chain = calib_pin.load_chain("pa10")
    model = model_of(chain, payloads=LOADS)
    q = chain.random_configurations(6, np.random.default_rng(0))
    torques = model.basis(q, Conditions(CARRIED))
    for k, name in enumerate(CARRIED):
        (alone,) = chain.gravity_torques(q[k : k + 1], Setup.gravity, LOADS.get(name))
        np.testing.assert_allclose(torques[k], alone, rtol=0, atol=1e-13)
    assert (
        np.abs(torques[1] - model.basis(q, Conditions(("heavy",) * 6))[1]).max() > 1.0
    )
    # The heaviest one sets the scale.
    names = [f"{joint}.compliance.k" for joint in chain.joints]
    several, heavy = (
        [p.scale for p in model_of(chain, payloads=loads).parameters if p.name in names]
        for loads in (LOADS, {"heavy": LOADS["heavy"]})
    )
    assert several == heavy


def test_rows_that_name_no_payload(refused: Callable[..., Any]) -> None:
    chain = calib_pin.load_chain("pa10")
    q = chain.random_configurations(2, np.random.default_rng(0))
    one = model_of(chain, payloads={"only": LOADS["heavy"]})
    # The only one is carried, unless a row says that nothing is.
    expected = one.basis(q, Conditions(("only", "only")))
    np.testing.assert_array_equal(one.basis(q), expected)
    np.testing.assert_array_equal(one.basis(q, Conditions(("", "only"))), expected)
    nothing = model_of(chain).basis(q)
    np.testing.assert_array_equal(one.basis(q, Conditions(("none", "none"))), nothing)
    np.testing.assert_array_equal(
        model_of(chain).basis(q, Conditions(("none", ""))), nothing
    )
    allowed = "light, heavy, none"
    with refused(InputError, "several payloads", column="payload", allowed=allowed):
        model_of(chain, payloads=LOADS).basis(q, Conditions(("light", "")))
    with refused(InputError, ["'lihgt'", "mean 'light'?"], column="payload"):
        model_of(chain, payloads=LOADS).basis(q, Conditions(("light", "lihgt")))


def test_payloads_of_a_problem() -> None:
    """Poses and derivatives of each row are those of a robot with its payload alone."""
    chain = calib_pin.load_chain("pa10")
    setup = replace(SETUP, payloads=LOADS, tool_frame=FrameSetup((0.1, 0.0, 0.1)))
    problem = nominal_problem(chain, "position", setup)
    rng = np.random.default_rng(0)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    q = chain.random_configurations(6, rng)
    rows = exact_problem(problem, theta, q, ("",) * 6, conditions=Conditions(CARRIED))
    _, J = rows.linearize(theta)
    for k, name in enumerate(CARRIED):
        loads = {name: LOADS[name]} if name in LOADS else {}
        alone = nominal_problem(chain, "position", replace(setup, payloads=loads))
        alone = exact_problem(alone, theta, q[k : k + 1], ("",))
        np.testing.assert_allclose(
            alone.data.only.values[0], rows.data.only.values[k], atol=1e-14
        )
        part = alone.linearize(theta)[1]
        np.testing.assert_allclose(part, J[3 * k : 3 * k + 3], rtol=0, atol=1e-7)


def test_rows_of_an_unknown_payload(refused: Callable[..., Any]) -> None:
    chain = calib_pin.load_chain("pa10")
    setup = replace(SETUP, payloads=LOADS)
    problem = nominal_problem(chain, "position", setup)
    zero, q = np.zeros(len(problem.parameters)), np.zeros((2, 7))
    exact = exact_problem(
        problem, zero, q, ("", ""), conditions=Conditions(("light", "none"))
    )
    rows = replace(exact.data.only, lines=np.array([7, 8]), files=("m.csv",) * 2)
    place = {"file": "m.csv", "line": 8, "column": "payload"}
    for name, reason in (
        ("heavi", ["no payload 'heavi'", "mean 'heavy'?"]),
        ("", "several payloads, and the row names none"),
    ):
        with refused(InputError, reason, **place, allowed="light, heavy"):
            make_problem(
                chain, replace(rows, conditions=Conditions(("light", name))), setup
            )


def test_payloads_in_turn_are_recovered() -> None:
    """Simulated with either load, the compliance of every loaded joint comes out."""
    chain = calib_pin.load_chain("pa10")
    setup = replace(SETUP, payloads=LOADS, tool_frame=FrameSetup((0.1, 0.0, 0.1)))
    problem = nominal_problem(chain, "position", setup)
    rng = np.random.default_rng(0)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, theta, rng, count=40, noise=0.0)
    assert rows.payload == ("light", "heavy") * 20
    fitted = fit(replace(problem, data=rows), rng)
    robot = ~problem.parameters.nuisance
    scales = problem.parameters.scales
    error = ((fitted.theta - theta) / scales)[robot]
    # The first axis stands upright, and no load turns it.
    np.testing.assert_allclose(error[1:], 0.0, rtol=0, atol=1e-9)


def test_two_payloads_tell_a_lever_from_a_wave(
    urdf_of: UrdfOf, chain_of: ChainOf
) -> None:
    """With one, a torque of m g l cos q is what a wheel could do as well."""
    chain = chain_of(urdf_of(*beam()))
    both = ("transmission", "compliance")
    one = {"one": Payload(2.0, (0.1, 0.0, 0.0))}
    status, sums = identified(chain, parameters=both, payloads=one)
    assert sums and status["j.compliance.k"] == "coupled"
    two = {**one, "two": Payload(5.0, (0.1, 0.0, 0.0))}
    status, sums = identified(chain, parameters=both, payloads=two)
    assert not sums
    assert status["j.compliance.k"] == status["j.transmission.cos1"] == "identifiable"


# What can be known.


Sums = list[dict[str, float]]


def identified(chain: Chain, **stated: Any) -> tuple[dict[str, str], Sums]:
    """Status of every parameter of a joint, and the sums with a compliance."""
    found = calib_pin.identify(chain, "pose", replace(SETUP, **stated))
    own = {p.name: p.status for p in found.parameters if ".frame." not in p.name}
    sums = [dict(group.terms) for group in found.groups]
    return own, [terms for terms in sums if any(".compliance." in t for t in terms)]


def assert_sums(found: Sums, *expected: dict[str, float]) -> None:
    """Compare names and coefficients, the first of which is 1.

    Elimination solves with a well-conditioned matrix of some 1000 rows: its error is
    of the order of 1e-13.
    """
    assert [pytest.approx(terms, rel=1e-9) for terms in found] == list(expected)


def test_a_joint_about_gravity_is_unidentifiable() -> None:
    chain = calib_pin.load_chain("pa10")
    status, sums = identified(chain)
    assert status.pop("joint_1.compliance.k") == "unidentifiable"
    # The mass of the last link lies on its axis.
    assert status.pop("joint_7.compliance.k") == "unidentifiable"
    assert set(status.values()) == {"identifiable"}
    assert not sums
    # Either has a torque as soon as something stands aside, or the base inclines.
    payload = {"load": Payload(1.0, (0.1, 0.0, 0.0))}
    status, _ = identified(chain, payloads=payload)
    assert status["joint_1.compliance.k"] == "unidentifiable"
    assert status["joint_7.compliance.k"] == "identifiable"
    status, _ = identified(chain, gravity=(0.5, 0.0, -G))
    assert status["joint_1.compliance.k"] == "identifiable"


def test_a_single_lever_is_a_harmonic(urdf_of: UrdfOf, chain_of: ChainOf) -> None:
    """One joint alone: its torque is m g l cos q, which a wheel could do as well."""
    chain = chain_of(urdf_of(*beam()))
    torque = MASS * G * CENTER
    status, sums = identified(chain, parameters=("transmission", "compliance"))
    assert_sums(sums, {"j.transmission.cos1": 1.0, "j.compliance.k": torque})
    assert status["j.transmission.cos1"] == status["j.compliance.k"] == "coupled"
    assert status["j.transmission.sin1"] == "identifiable"
    found = calib_pin.identify(
        chain, "pose", replace(SETUP, parameters=("transmission", "compliance"))
    )
    (group,) = (g for g in found.groups if "j.compliance.k" in dict(g.terms))
    assert group.unit == "rad"
    # Turned by an eighth it is both waves at once.
    _, sums = identified(
        chain,
        parameters=("transmission", "compliance"),
        gravity=(G * np.sqrt(0.5), 0.0, -G * np.sqrt(0.5)),
    )
    part = torque * np.sqrt(0.5)
    assert_sums(
        sums,
        {"j.transmission.sin1": 1.0, "j.compliance.k": -part},
        {"j.transmission.cos1": 1.0, "j.compliance.k": part},
    )


def test_in_a_planar_arm_only_the_first_joint_is_a_harmonic(
    urdf_of: UrdfOf, chain_of: ChainOf
) -> None:
    """The torque of the second depends on where the first one stands."""
    elbow = pin.SE3(np.eye(3), np.array([0.5, 0.0, 0.0]))
    joints = [
        {
            "name": f"j{k}",
            "parent": f"l{k}",
            "child": f"l{k + 1}",
            "axis": (0, 1, 0),
            "placement": elbow if k else pin.SE3.Identity(),
            "mass": (2.0, (0.25, 0.0, 0.0)),
        }
        for k in range(2)
    ]
    chain = chain_of(urdf_of(*joints))
    status, sums = identified(chain, parameters=("transmission", "compliance"))
    assert not sums
    assert set(status.values()) == {"identifiable"}
    # With the first joint held there is but one lever again.
    status, sums = identified(
        chain_of(urdf_of(*joints), base="l1"),
        parameters=("transmission", "compliance"),
    )
    torque = 2.0 * G * 0.25
    assert_sums(sums, {"j1.transmission.cos1": 1.0, "j1.compliance.k": torque})


def test_a_lift_gives_way_like_a_frame(urdf_of: UrdfOf, chain_of: ChainOf) -> None:
    """A constant deflection cannot be told from where the base stands."""
    lift = {
        "name": "lift",
        "parent": "base",
        "child": "cage",
        "type": "prismatic",
        "mass": (10.0, (0.0, 0.0, 0.0)),
    }
    turn = {
        "name": "turn",
        "parent": "cage",
        "child": "tool",
        "axis": (0, 1, 0),
        "mass": (1.0, (0.4, 0.0, 0.0)),
    }
    chain = chain_of(urdf_of(lift, turn))
    status, sums = identified(chain, parameters=("joint-offset", "compliance"))
    assert status["lift.compliance.k"] == "coupled"
    assert any({"lift.compliance.k", "base.frame.z"} <= set(terms) for terms in sums)
    assert status["turn.compliance.k"] == "identifiable"
    known = FrameSetup(estimate=False)
    status, sums = identified(
        chain, parameters=("joint-offset", "compliance"), base_frame=known
    )
    weight = 11.0 * G
    assert_sums(sums, {"lift.joint-offset.q": 1.0, "lift.compliance.k": -weight})
