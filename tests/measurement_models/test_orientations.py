"""Orientations as files state them, to quaternions and back."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from calib_pin.errors import InputError
from calib_pin.io.setup import read_setup
from calib_pin.measurement_models.orientations import numbers_of, quaternions
from calib_pin.setup import HELD, OrientationSetup

NUMBERS = np.random.default_rng(0).uniform(-3.0, 3.0, (50, 3))


@pytest.mark.parametrize("columns", ["rotation-vector", "roll-pitch-yaw"])
def test_numbers_of_a_rotation(columns: str) -> None:
    """One of the possible numbers is the one that was stated, and all are the same."""
    found = quaternions(NUMBERS, columns)
    possible = numbers_of(found, columns)
    apart = np.abs(possible - NUMBERS).max(axis=2).min(axis=0)
    np.testing.assert_allclose(apart, 0.0, atol=1e-9)
    for numbers in possible:
        cosine = np.abs(np.sum(quaternions(numbers, columns) * found, axis=1))
        np.testing.assert_allclose(cosine, 1.0, atol=1e-12)


@pytest.mark.parametrize("held", HELD[1:])
def test_every_convention_is_a_rotation_of_its_own(held: str) -> None:
    columns = "roll-pitch-yaw" if held == "rotation-vector" else "rotation-vector"
    reading = OrientationSetup(columns, held)
    found = quaternions(NUMBERS, columns, reading)
    np.testing.assert_allclose(np.linalg.norm(found, axis=1), 1.0, atol=1e-12)
    plain = quaternions(NUMBERS, columns)
    assert np.abs(np.sum(plain * found, axis=1)).min() < 0.9


def test_angles_in_the_order_of_their_rotations() -> None:
    reading = OrientationSetup("roll-pitch-yaw", "intrinsic-zyx")
    found = Rotation.from_quat(quaternions(NUMBERS, "roll-pitch-yaw", reading))
    z, y, x = (
        Rotation.from_rotvec(a) for a in NUMBERS.T[:, :, None] * np.eye(3)[::-1, None]
    )
    expected = (z * y * x).as_matrix()
    np.testing.assert_allclose(found.as_matrix(), expected, atol=1e-12)


def test_files_with_other_columns_are_read_as_they_are() -> None:
    reading = OrientationSetup("rotation-vector", "intrinsic-zyx", inverse=True)
    plain = quaternions(NUMBERS, "roll-pitch-yaw")
    assert (quaternions(NUMBERS, "roll-pitch-yaw", reading) == plain).all()


@pytest.mark.parametrize(
    "text",
    [
        "hold: wxyz",
        "columns: quaternion, hold: intrinsic-zyx",
        "columns: roll-pitch-yaw, hold: wxyz",
        "columns: roll-pitch-yaw, hold: intrinsic-xxy",
    ],
)
def test_readings_that_cannot_be(tmp_path, text) -> None:
    file = tmp_path / "setup.yaml"
    file.write_text(f"reading: {{orientation: {{{text}}}}}")
    with pytest.raises(InputError, match="orientation"):
        read_setup(file)
