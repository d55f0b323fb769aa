"""The 6-D pose of the tool."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.spatial import Floats, so3_exp
from calib_pin.measurement_models.pose import Pose
from calib_pin.measurement_models.position import Position
from calib_pin.observations import Measurements
from tests.shared import rows_of


def tips(count: int = 12) -> Floats:
    chain = load_chain("space6")
    return chain.poses(chain.random_configurations(count, np.random.default_rng(0)))


def data_of(T: Floats) -> Measurements:
    return rows_of("pose", Pose().predict(T, np.zeros(0), ()))


def test_values_are_position_and_quaternion() -> None:
    T = np.eye(4)[None].copy()
    T[0, :3, 3] = [1, 2, 3]
    T[0, :3, :3] = so3_exp(np.array([0.0, 0.0, np.pi / 2]))
    values = Pose().predict(T, np.zeros(0), ("",))
    half = np.sqrt(0.5)
    np.testing.assert_allclose(values, [[1, 2, 3, 0, 0, half, half]], atol=1e-13)


def test_residual_is_in_the_measuring_frame_and_in_the_tool() -> None:
    T = tips()
    data = data_of(T)
    shift, turn = np.array([0.01, -0.02, 0.03]), np.array([0.1, 0.2, -0.3])
    moved = T.copy()
    moved[:, :3, 3] += shift
    moved[:, :3, :3] = T[:, :3, :3] @ so3_exp(turn)
    residual = Pose().residual(moved, np.zeros(0), data)
    np.testing.assert_allclose(residual[:, :3], np.tile(shift, (12, 1)), atol=1e-12)
    np.testing.assert_allclose(residual[:, 3:], np.tile(turn, (12, 1)), atol=1e-12)

    # Either sign of a quaternion is one.
    data.values[:, 3:] *= -1.0
    np.testing.assert_allclose(Pose().residual(T, np.zeros(0), data), 0.0, atol=1e-12)


BASE = pin.exp6(np.array([1.0, -2.0, 0.5, 0.3, 2.0, -1.0]))
TOOL = pin.exp6(np.array([0.1, 0.0, 0.2, -2.0, 0.4, 1.0]))


@pytest.mark.parametrize("model", [Pose(), Position()], ids=["pose", "position"])
@pytest.mark.parametrize(
    ("base", "tool"), [(None, None), (BASE, None), (None, TOOL), (BASE, TOOL)]
)
def test_registration(
    model: Pose | Position, base: pin.SE3 | None, tool: pin.SE3 | None
) -> None:
    """A point has no orientation, but a tool that is known keeps its own."""
    F = tips()
    T = BASE.homogeneous @ F @ TOOL.homogeneous
    data = rows_of(model.name, model.predict(T, np.zeros(0), ("",) * len(T)))
    found, found_base, found_tool = model.register(F, data, base, tool)
    np.testing.assert_allclose(found_base.homogeneous, BASE.homogeneous, atol=1e-11)
    np.testing.assert_allclose(found_tool.translation, TOOL.translation, atol=1e-11)
    turned = TOOL if tool is not None or isinstance(model, Pose) else pin.SE3.Identity()
    np.testing.assert_allclose(found_tool.rotation, turned.rotation, atol=1e-11)
    assert found == model
