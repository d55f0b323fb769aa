"""The 3-D position of a point on the tool."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.position import Position
from calib_pin.observations import Measurements

BASE = pin.exp6(np.array([1.0, -2.0, 0.5, 0.3, 2.0, -1.0]))
POINT = np.array([0.02, -0.05, 0.12])


def tips() -> Floats:
    chain = load_chain("space6")
    return chain.poses(chain.random_configurations(12, np.random.default_rng(0)))


def data_of(values: Floats) -> Measurements:
    return Measurements(("j",), np.zeros((len(values), 1)), "position", values)


def test_a_point_has_no_orientation() -> None:
    model, F = Position(), tips()
    data = data_of(F[:, :3, 3] + 1.0)
    linear = model.linearize(F, np.zeros(0), data)
    np.testing.assert_allclose(linear.residual, -1.0, atol=1e-14)
    np.testing.assert_array_equal(linear.J_pose[:, :, 3:], 0.0)
    assert model.observable(F, np.zeros(0), data.target).all()
    assert model.parameters == () and model.rebased(np.zeros(0)) == model


@pytest.mark.parametrize("base", [None, BASE])
@pytest.mark.parametrize("tool", [None, pin.SE3(np.eye(3), POINT)])
def test_registration(base: pin.SE3 | None, tool: pin.SE3 | None) -> None:
    F = tips()
    T = BASE.homogeneous @ F @ pin.SE3(np.eye(3), POINT).homogeneous
    data = data_of(T[:, :3, 3])
    model, found_base, found_tool = Position().register(F, data, base, tool)
    np.testing.assert_allclose(found_base.homogeneous, BASE.homogeneous, atol=1e-12)
    np.testing.assert_allclose(found_tool.translation, POINT, atol=1e-12)
    np.testing.assert_array_equal(found_tool.rotation, np.eye(3))
    assert model == Position()


def test_known_tool_keeps_its_orientation() -> None:
    F = tips()
    tool = pin.SE3(pin.exp3(np.array([0.3, 0.2, 0.1])), POINT)
    T = BASE.homogeneous @ F @ tool.homogeneous
    _, base, found = Position().register(F, data_of(T[:, :3, 3]), None, tool)
    assert found == tool
    np.testing.assert_allclose(base.homogeneous, BASE.homogeneous, atol=1e-12)
