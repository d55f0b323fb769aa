"""Joints that give across their axes: moments, signs and sizes by hand."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.errors import OptionError
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.parameterizations.cross_compliance import DEFLECTION, CrossCompliance
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.parameterizations.loads import LEAST
from calib_pin.setup import Payload, Setup
from tests.shared import chain_of, joint, urdf_of

G = 9.81
K = 1e-4
MASS, CENTER, LENGTH = 3.0, 0.25, 0.6


def crane() -> Chain:
    """A level arm that turns about the vertical, with its mass on the way."""
    tool = pin.SE3(np.eye(3), np.array([LENGTH, 0.0, 0.0]))
    arm = joint("j", "base arm", mass=(MASS, (CENTER, 0.0, 0.0)))
    return chain_of(urdf_of(arm, joint("k", "arm tool", tool, kind="fixed")))


def test_a_bearing_gives_towards_what_it_carries() -> None:
    chain = crane()
    setup = Setup(parameters=("cross-compliance",))
    q = np.linspace(-2.0, 2.0, 7)[:, None]
    model = ErrorModel.create(chain, setup.parameters, setup=setup)
    both = {"j.cross-compliance.kx": K, "j.cross-compliance.ky": K}
    lower = model.poses(q, model.parameters.vector(both))[:, 2, 3]
    # Alike in all directions: the arm comes down by the same wherever it points.
    np.testing.assert_allclose(
        lower, -LENGTH * np.sin(K * MASS * G * CENTER), rtol=0, atol=1e-12
    )
    stiff = {"j.cross-compliance.kx": 0.0, "j.cross-compliance.ky": K}
    lower = model.poses(q, model.parameters.vector(stiff))[:, 2, 3]
    # About y alone it does where the arm points along x.
    turn = K * MASS * G * CENTER * np.cos(q[:, 0])
    expected = -LENGTH * np.cos(q[:, 0]) * np.sin(turn)
    np.testing.assert_allclose(lower, expected, rtol=0, atol=1e-12)
    # It bends behind the errors of the geometry: turned with them it does the same.
    turned = ErrorModel.create(chain, ["placement", *setup.parameters], setup=setup)
    theta = turned.parameters.vector({**stiff, "j.placement.rz": np.pi / 2.0})
    lower = turned.poses(q, theta)[:, 2, 3]
    np.testing.assert_allclose(lower, expected, rtol=0, atol=1e-12)
    # A payload adds its moment; gravity along the arm has none.
    load = {"load": Payload(5.0, (0.2, 0.0, 0.0))}
    loaded = ErrorModel.create(
        chain, setup.parameters, setup=replace(setup, payloads=load)
    )
    lower = loaded.poses(q, loaded.parameters.vector(both))[:, 2, 3]
    moment = G * (MASS * CENTER + 5.0 * (LENGTH + 0.2))
    np.testing.assert_allclose(lower, -LENGTH * np.sin(K * moment), atol=1e-12)


def test_moments_are_the_work_of_gravity() -> None:
    """About every axis of every joint, by central differences of the energy."""
    chain = load_chain("example:tiago_no_hand", tip="arm_7_link")
    (q,) = chain.random_configurations(1, np.random.default_rng(3))
    found = chain.gravity_moments(q[None], (0.0, 0.0, -G))[0]
    model, step = chain.robot.model, 1e-4
    configuration = pin.neutral(model)
    for name, position in zip(chain.joints, q, strict=True):
        configuration[model.idx_qs[model.getJointId(name)]] = position
    for k, name in enumerate(chain.joints):
        for axis in np.eye(3):
            energies = []
            for turn in (step, -step):
                moved = model.copy()
                twist = pin.exp6(np.concatenate([np.zeros(3), turn * axis]))
                moved.jointPlacements[moved.getJointId(name)] *= twist
                data = moved.createData()
                energies.append(pin.computePotentialEnergy(moved, data, configuration))
            work = (energies[1] - energies[0]) / (2.0 * step)
            assert found[k] @ axis == pytest.approx(work, rel=1e-6, abs=1e-6)
    torques = chain.gravity_torques(q[None], (0.0, 0.0, -G))[0]
    along = np.einsum("na,na->n", found, chain.axes)
    turning = chain.revolute
    np.testing.assert_allclose(along[turning], torques[turning], rtol=1e-9, atol=1e-9)


def test_axes_and_scales() -> None:
    """At right angles to the joint's own; a usual load gives the expected size."""
    chain = load_chain("example:tiago_no_hand", tip="arm_7_link")
    screws = CrossCompliance().screws(chain)
    assert len(screws) == 2 * len(chain.joints)
    functions = screws[0].basis.functions  # type: ignore[union-attr]
    rng = np.random.default_rng(0)
    q = rng.uniform(chain.lower, chain.upper, (2000, len(chain.joints)))
    usual = np.sqrt(np.mean(functions(q) ** 2, axis=0))
    for k, screw in enumerate(screws):
        axis = chain.axes[screw.frame - 1]
        assert abs(screw.twist[3:] @ axis) < 1e-12 and not screw.twist[:3].any()
        assert np.linalg.norm(screw.twist) == pytest.approx(1.0)
        scale = DEFLECTION / max(usual[k], LEAST * usual.max())
        assert screw.parameter.scale == pytest.approx(scale, rel=0.15)
    pairs = np.array([s.twist[3:] for s in screws]).reshape(-1, 2, 3)
    assert np.abs(np.einsum("na,na->n", pairs[:, 0], pairs[:, 1])).max() < 1e-12


def test_nothing_to_bend_it() -> None:
    with pytest.raises(OptionError):
        CrossCompliance().screws(load_chain("space6"))
