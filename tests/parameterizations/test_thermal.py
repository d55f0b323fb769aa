"""Links that grow: lengths by hand, what must be stated."""

from __future__ import annotations

from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.errors import InputError
from calib_pin.estimation.formulation import make_problem
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import Conditions, Measurements
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.setup import Setup, ThermalSetup
from tests.shared import chain_of, joint, urdf_of

GROWTH = 2e-5


def model_of(chain: Chain, **stated: Any) -> ErrorModel:
    setup = Setup(parameters=("thermal",), thermal=ThermalSetup(**stated))
    return ErrorModel.create(chain, setup.parameters, setup=setup)


@pytest.mark.parametrize("robot", ["space6", "example:panda"])
def test_links_that_grow_alike_are_a_robot_that_grows_as_a_whole(robot: str) -> None:
    """Every length from base to tip, and no angle."""
    tip = "panda_hand" if robot == "example:panda" else None
    chain = load_chain(robot, tip=tip)
    model = model_of(chain)
    names = model.parameters.names[6:-6]
    q = chain.random_configurations(4, np.random.default_rng(0))
    warmth = np.array([20.0, 25.0, 45.0, 5.0])
    basis = model.basis(q, Conditions(temperature=warmth))
    theta = model.parameters.vector(dict.fromkeys(names, GROWTH))
    T, cold = model.poses(q, theta, basis), chain.poses(q)
    grown = 1.0 + GROWTH * (warmth - 20.0)
    np.testing.assert_allclose(T[:, :3, 3], grown[:, None] * cold[:, :3, 3], atol=1e-12)
    np.testing.assert_allclose(T[:, :3, :3], cold[:, :3, :3], atol=1e-12)
    # Where no temperature is stated the robot has that of the reference.
    np.testing.assert_array_equal(model.poses(q, theta), cold)


def test_one_link_grows() -> None:
    way = pin.SE3(pin.exp3(np.array([0.3, -0.5, 1.0])), np.array([0.4, 0.1, 0.2]))
    end = pin.SE3(pin.exp3(np.array([0.1, 0.7, 0.0])), np.array([0.0, 0.3, 0.1]))
    joints = joint("first", "a b"), joint("second", "b c", way)
    chain = chain_of(urdf_of(*joints, joint("flange", "c d", end, kind="fixed")))
    model = model_of(chain, reference=30.0)
    # The first joint is where the base is: no link is between them.
    names = model.parameters.names[6:-6]
    assert names == ("second.thermal.growth", "flange.thermal.growth")
    q, held = np.zeros((1, 2)), Conditions(temperature=np.array([40.0]))
    (cold,) = chain.poses(q)
    for name, moved in (
        (names[0], way.translation),
        (names[1], way.rotation @ end.translation),
    ):
        theta = model.parameters.vector({name: 1e-3})
        (T,) = model.poses(q, theta, model.basis(q, held))
        np.testing.assert_allclose(T[:3, 3] - cold[:3, 3], 1e-2 * moved, atol=1e-12)


def measured(chain: Chain, temperature: np.ndarray[Any, Any]) -> Measurements:
    q = chain.random_configurations(4, np.random.default_rng(0))
    held = Conditions(temperature=temperature)
    values = chain.poses(q)[:, :3, 3]
    return Measurements(chain.joints, q, "position", values, conditions=held)


def test_the_reference_is_that_of_the_measurements() -> None:
    chain, setup = load_chain("space6"), Setup(parameters=("thermal",))
    data = measured(chain, np.array([20.0, 21.0, 22.0, 24.12]))
    assert make_problem(chain, data, setup).setup.thermal.reference == 21.8
    stated = Setup(parameters=("thermal",), thermal=ThermalSetup(20.0))
    assert make_problem(chain, data, stated).setup.thermal.reference == 20.0
    with pytest.raises(InputError, match="temperature"):
        make_problem(chain, measured(chain, np.zeros(0)), setup)
