"""Errors of the tool frame between two sets of poses."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.errors import OptionError
from calib_pin.kinematics.spatial import so3_exp
from studies.tip_errors import tip_errors


def poses(count: int, seed: int) -> np.ndarray:
    rng = np.random.default_rng(seed)
    T = np.tile(np.eye(4), (count, 1, 1))
    T[:, :3, :3] = so3_exp(rng.normal(size=(count, 3)))
    T[:, :3, 3] = rng.normal(size=(count, 3))
    return T


def test_errors_are_those_in_the_base_frame() -> None:
    rng = np.random.default_rng(0)
    shifts, turns = rng.normal(scale=0.1, size=(2, 20, 3))
    true = poses(20, seed=1)
    predicted = true.copy()
    predicted[:, :3, 3] += shifts
    predicted[:, :3, :3] = so3_exp(turns) @ true[:, :3, :3]
    found = tip_errors(true, predicted)
    np.testing.assert_allclose(found.position, shifts, atol=1e-12)
    np.testing.assert_allclose(found.orientation, turns, atol=1e-12)
    np.testing.assert_allclose(found.distances, np.linalg.norm(shifts, axis=1))
    np.testing.assert_allclose(found.angles, np.linalg.norm(turns, axis=1))
    assert found.largest == pytest.approx((np.abs(shifts).max(), np.abs(turns).max()))


def test_equal_poses_have_no_errors() -> None:
    assert tip_errors(poses(3, 0), poses(3, 0)).largest == pytest.approx((0.0, 0.0))
    assert tip_errors(np.zeros((0, 4, 4)), np.zeros((0, 4, 4))).largest == (0.0, 0.0)


@pytest.mark.parametrize(
    ("true", "predicted"), [((2, 4, 4), (3, 4, 4)), ((4, 4), (4, 4)), ((2, 3), (2, 3))]
)
def test_poses_must_match(true: tuple[int, ...], predicted: tuple[int, ...]) -> None:
    with pytest.raises(OptionError, match="true poses have shape"):
        tip_errors(np.zeros(true), np.zeros(predicted))
