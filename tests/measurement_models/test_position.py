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
TURNED = pin.SE3(pin.exp3(np.array([0.3, 0.2, 0.1])), POINT)


def tips() -> Floats:
    chain = load_chain("space6")
    return chain.poses(chain.random_configurations(12, np.random.default_rng(0)))


def data_of(values: Floats) -> Measurements:
    return Measurements(("j",), np.zeros((len(values), 1)), "position", values)


@pytest.mark.parametrize("base", [None, BASE])
@pytest.mark.parametrize("tool", [None, TURNED, pin.SE3(np.eye(3), POINT)])
def test_registration(base: pin.SE3 | None, tool: pin.SE3 | None) -> None:
    """A point has no orientation, but a tool that is known keeps its own."""
    F = tips()
    T = BASE.homogeneous @ F @ pin.SE3(np.eye(3), POINT).homogeneous
    data = data_of(T[:, :3, 3])
    model, found_base, found_tool = Position().register(F, data, base, tool)
    np.testing.assert_allclose(found_base.homogeneous, BASE.homogeneous, atol=1e-11)
    np.testing.assert_allclose(found_tool.translation, POINT, atol=1e-11)
    rotation = np.eye(3) if tool is None else tool.rotation
    np.testing.assert_array_equal(found_tool.rotation, rotation)
    assert model == Position() and model.parameters == ()
