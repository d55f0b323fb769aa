"""Joints that sag: signs and sizes by hand, payloads, gravity, what can be known."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.errors import InputError
from calib_pin.estimation.formulation import make_problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Conditions, Measurements
from calib_pin.parameterizations.compliance import DEFLECTION
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.parameterizations.loads import LEAST
from calib_pin.setup import Payload, Setup
from tests.shared import chain_of, joint, refused, urdf_of

G = 9.81
K = 1e-3
MASS, CENTER, LENGTH = 3.0, 0.25, 0.6
SETUP = Setup(parameters=("compliance",))
LIFT = joint("lift", "base cage", kind="prismatic", mass=(10.0, (0.3, 0.1, 0.0)))


def beam(axis: tuple[float, float, float] = (0, 1, 0)) -> list[dict[str, Any]]:
    """An arm along x that turns about y, with its mass on the way to the tool."""
    tool = pin.SE3(np.eye(3), np.array([LENGTH, 0.0, 0.0]))
    arm = joint("j", "base arm", axis=axis, mass=(MASS, (CENTER, 0.0, 0.0)))
    return [arm, joint("k", "arm tool", tool, kind="fixed")]


def model_of(chain: Chain, **stated: Any) -> ErrorModel:
    return ErrorModel.create(chain, ["compliance"], setup=replace(SETUP, **stated))


def deflection(chain: Chain, q: Floats, **stated: Any) -> Floats:
    """What all joints give way with a compliance of K each, shape (N, n)."""
    model = model_of(chain, **stated)
    theta = np.zeros(len(model.parameters))
    theta[model.joint_corrections] = K
    return model.joint_positions(q, theta) - q


ROUNDING = 4.0 * np.finfo(float).eps
"""Of a deflection, the difference of joint positions up to 2 rad."""

# By hand.


@pytest.mark.parametrize("axis", [(0, 1, 0), (0, -1, 0)])
def test_an_arm_sags(axis: tuple[float, float, float]) -> None:
    chain = chain_of(urdf_of(*beam(axis)))
    q = np.array([[0.0], [0.5], [-1.2], [np.pi / 2]])
    dq = deflection(chain, q)
    # A positive turn about +y lowers x; the lever is the horizontal distance.
    by_hand = axis[1] * K * MASS * G * CENTER * np.cos(q)
    np.testing.assert_allclose(dq, by_hand, rtol=0, atol=ROUNDING)
    # The tool comes down, whichever way the joint counts.
    model = model_of(chain)
    theta = model.parameters.vector({"j.compliance.k": K})
    lower = model.poses(q, theta)[:, 2, 3] - chain.poses(q)[:, 2, 3]
    assert (lower[:3] < 0.0).all()
    assert lower[0] == pytest.approx(-LENGTH * np.sin(K * MASS * G * CENTER))


def test_a_joint_that_slides() -> None:
    """A lift gives way by its weight, in meters per newton, wherever it stands."""
    chain = chain_of(urdf_of(LIFT))
    q = np.array([[0.0], [1.5]])
    for gravity in ((0.0, 0.0, -G), (3.0, 4.0, -2.0)):
        found = deflection(chain, q, gravity=gravity)
        expected = K * 10.0 * gravity[2]
        np.testing.assert_allclose(found, expected, rtol=0, atol=ROUNDING)
    (parameter,) = (p for p in model_of(chain).parameters if not p.nuisance)
    assert (parameter.name, parameter.unit) == ("lift.compliance.k", "m/N")
    assert parameter.scale == pytest.approx(DEFLECTION / (10.0 * G))


# Against models that Pinocchio builds itself.


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


def test_rows_that_name_no_payload() -> None:
    chain = calib_pin.load_chain("pa10")
    q = chain.random_configurations(2, np.random.default_rng(0))
    one = model_of(chain, payloads={"only": LOADS["heavy"]})
    # The only one is carried, unless a row says that nothing is.
    expected = one.basis(q, Conditions(("only", "only")))
    np.testing.assert_array_equal(one.basis(q), expected)
    np.testing.assert_array_equal(one.basis(q, Conditions(("", "only"))), expected)
    nothing = model_of(chain).basis(q)
    np.testing.assert_array_equal(one.basis(q, Conditions(("none", "none"))), nothing)
    for name in ("", "lihgt"):
        with refused(InputError, column="payload"):
            model_of(chain, payloads=LOADS).basis(q, Conditions(("light", name)))


def test_rows_of_an_unknown_payload() -> None:
    chain = calib_pin.load_chain("pa10")
    setup = replace(SETUP, payloads=LOADS)
    rows = Measurements(
        chain.joints,
        np.zeros((2, 7)),
        "position",
        np.zeros((2, 3)),
        lines=np.array([7, 8]),
        files=("m.csv",) * 2,
    )
    for name in ("heavi", ""):
        held = replace(rows, conditions=Conditions(("light", name)))
        with refused(InputError, file="m.csv", line=8, column="payload"):
            make_problem(chain, held, setup)


# What can be known.


Sums = list[dict[str, float]]


def identified(chain: Chain, **stated: Any) -> tuple[dict[str, str], Sums]:
    """Status of every parameter of a joint, and the sums with a compliance."""
    found = calib_pin.identify(chain, "pose", replace(SETUP, **stated))
    own = {p.name: p.status for p in found.parameters if ".frame." not in p.name}
    sums = [dict(group.terms) for group in found.groups]
    return own, [terms for terms in sums if any(".compliance." in t for t in terms)]


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
