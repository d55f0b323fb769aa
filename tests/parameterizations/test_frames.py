"""Base and tool: six screws behind the reference poses at the ends of the chain."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.io.urdf import load_chain
from calib_pin.parameterizations import frame_screws
from calib_pin.parameterizations.error_model import ErrorModel

COMPONENTS = ("x", "y", "z", "rx", "ry", "rz")


@pytest.mark.parametrize("free", [True, False])
def test_screws(free: bool) -> None:
    screws = frame_screws("tool", 8, free=free)
    names = [f"tool.frame.{component}" for component in COMPONENTS]
    assert [screw.parameter.name for screw in screws] == names
    assert [screw.parameter.unit for screw in screws] == 3 * ["m"] + 3 * ["rad"]
    np.testing.assert_array_equal([screw.twist for screw in screws], np.eye(6))
    for screw in screws:
        assert screw.frame == 8
        assert screw.parameter.nuisance
        assert screw.parameter.free == free
        assert screw.parameter.scale == 1.0


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
