"""Gains, harmonics of joints and motors: what they do to q, and what can be known."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.errors import OptionError
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.parameterizations.transmission import (
    AMPLITUDE_SCALES,
    GAIN_SCALE,
    Transmission,
)
from calib_pin.setup import Setup
from tests.shared import chain_of, joint, refused, urdf_of

RATIOS = {"j*": 50.0, "j2": -31.5, "j1": 400.0}
HARMONICS = ["gain", "sin1", "cos1", "sin2", "cos2"]
MOTOR = ["motor_sin", "motor_cos", "motor_sin2", "motor_cos2"]


@pytest.fixture
def arm() -> str:
    """Skew joints of all kinds."""
    rng = np.random.default_rng(2)
    kinds = ["revolute", "prismatic", "continuous", "prismatic"]
    axes = [(1, 2, 3), (-3, 0.5, 1), (0, 0, -1), (0, -1, 0)]
    return urdf_of(
        *(
            joint(f"j{k}", f"l{k} l{k + 1}", pin.exp6(rng.normal(size=6)), axis, kind)
            for k, (kind, axis) in enumerate(zip(kinds, axes, strict=True))
        )
    )


def model_of(chain: Chain, ratios: Mapping[str, float]) -> ErrorModel:
    return ErrorModel.create(chain, ["transmission"], setup=Setup(gear_ratios=ratios))


def moved(chain: Chain, q: Floats, values: Mapping[str, float]) -> Floats:
    """Joint positions by the formula, joint by joint."""
    result = q.copy()
    ratio = {"j0": 50.0, "j1": 400.0, "j2": -31.5, "j3": 50.0}
    for k, name in enumerate(chain.joints):
        x = q[:, k]

        def value(component: str, name: str = name) -> float:
            return values.get(f"{name}.transmission.{component}", 0.0)

        result[:, k] += value("gain") * x
        for n in (1, 2):
            result[:, k] += value(f"sin{n}") * np.sin(n * x)
            result[:, k] += value(f"cos{n}") * np.cos(n * x)
        for n, twice in ((1, ""), (2, "2")):
            angle = n * ratio[name] * x
            result[:, k] += value(f"motor_sin{twice}") * np.sin(angle)
            result[:, k] += value(f"motor_cos{twice}") * np.cos(angle)
    return result


def test_components_units_and_scales(arm: str) -> None:
    """A joint that slides has no turn; motors only where a gear ratio is given."""
    chain = chain_of(arm)
    screws = Transmission({"j1": 400.0, "j2": 80.0}).screws(chain)
    components = {f"j{k}": [] for k in range(4)}
    for screw in screws:
        joint, _, component = screw.parameter.name.split(".")
        components[joint].append(component)
        turns = joint in ("j0", "j2")
        unit = "rad" if turns else "m"
        if component == "gain":
            expected = (f"{unit}/{unit}", GAIN_SCALE)
        else:
            expected = (unit, AMPLITUDE_SCALES[unit])
        assert (screw.parameter.unit, screw.parameter.scale) == expected
        motion = np.zeros(6)
        axis = chain.axes[screw.frame - 1]
        motion[3:] = axis if turns else 0.0
        motion[:3] = 0.0 if turns else axis
        np.testing.assert_array_equal(screw.twist, motion)
    assert components == {
        "j0": HARMONICS,
        "j1": ["gain", *MOTOR],
        "j2": [*HARMONICS, *MOTOR],
        "j3": ["gain"],
    }


@pytest.mark.parametrize("ends", [("l0", "l4"), ("l4", "l0"), ("l3", "l1")])
def test_joints_move_by_the_formula(ends: tuple[str, str], arm: str) -> None:
    """Each column of the factors is its own function, and all add up."""
    chain = chain_of(arm, *ends)
    model = model_of(chain, {k: v for k, v in RATIOS.items() if k != "j0"})
    rng = np.random.default_rng(1)
    q = chain.random_configurations(5, rng)
    theta = rng.normal(size=len(model.parameters)) * 0.1
    theta[model.parameters.nuisance] = 0.0
    for k in (None, *model.joint_corrections):
        chosen = theta if k is None else 0.3 * np.eye(len(theta))[k]
        values = dict(zip(model.parameters.names, chosen, strict=True))
        expected = moved(chain, q, values)
        assert np.abs(expected - q).max() > 1e-3
        found = model.joint_positions(q, chosen)
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-12)
    values = dict(zip(model.parameters.names, theta, strict=True))
    expected = chain.poses(moved(chain, q, values))
    np.testing.assert_allclose(model.poses(q, theta), expected, rtol=0, atol=1e-12)


# Gear ratios.


@pytest.mark.parametrize(
    ("ratios", "expected"),
    [
        ({}, {}),
        # The last one that matches wins.
        ({"j*": 80.0, "j1": 5.0}, {"j0": 80.0, "j1": 5.0, "j2": 80.0, "j3": 80.0}),
        ({"j1": 5.0, "j[12]": 7.0}, {"j1": 7.0, "j2": 7.0}),
        ({"j3": -0.5}, {"j3": -0.5}),
    ],
)
def test_globs(ratios: dict[str, float], expected: dict[str, float], arm: str) -> None:
    chain = chain_of(arm)
    model = model_of(chain, ratios)
    names = [n for n in model.parameters.names if n.endswith(".motor_sin")]
    assert names == [f"{joint}.transmission.motor_sin" for joint in expected]
    q = np.full((1, 4), 0.013)
    theta = model.parameters.vector(dict.fromkeys(names, 1.0))
    found = (model.joint_positions(q, theta) - q)[0]
    waves = [np.sin(0.013 * expected.get(joint, 0.0)) for joint in chain.joints]
    np.testing.assert_allclose(found, waves, rtol=0, atol=1e-12)


def test_names_of_gear_ratios(arm: str) -> None:
    """A name with brackets is a name, and one of no joint a mistake."""
    bracket = {"name": "j[1]", "parent": "a", "child": "b"}
    plain = {"name": "j1", "parent": "b", "child": "c"}
    chain = chain_of(urdf_of(bracket, plain))
    names = [s.parameter.name for s in Transmission({"j[1]": 9.0}).screws(chain)]
    assert [n for n in names if "motor" in n] == [
        f"j[1].transmission.{component}" for component in MOTOR
    ]
    with refused(OptionError, "'j4'", column="gear_ratios"):
        Transmission({"j1": 5.0, "j4": 80.0}).screws(chain_of(arm, "l1", "l3"))


# What can be known.


def test_a_motor_that_turns_as_its_joint_is_the_same_wave(arm: str) -> None:
    setup = Setup(parameters=("transmission",), gear_ratios={"j0": 1.0, "j2": -2.0})
    found = calib_pin.identify(chain_of(arm), "pose", setup)
    assert {group.expression for group in found.groups} == {
        "j0.transmission.sin1 + j0.transmission.motor_sin",
        "j0.transmission.cos1 + j0.transmission.motor_cos",
        "j0.transmission.sin2 + j0.transmission.motor_sin2",
        "j0.transmission.cos2 + j0.transmission.motor_cos2",
        "j2.transmission.sin2 - j2.transmission.motor_sin",
        "j2.transmission.cos2 + j2.transmission.motor_cos",
    }
    status = {p.name: p.status for p in found.parameters}
    assert status["j0.transmission.motor_sin"] == "coupled"
    assert status["j2.transmission.motor_sin2"] == "identifiable"
