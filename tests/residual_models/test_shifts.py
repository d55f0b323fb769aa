"""What is known beforehand of a shift of the geometry."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.residual_models.base import FREE, Shifts


@pytest.fixture
def shifts() -> Shifts:
    """One free direction, and two of the robot that mix two kinds of errors."""
    first = np.array([[0.0], [0.6], [0.8]])
    second = np.array([[0.0, 0.0], [0.8, 0.0], [-0.6, 0.5]])
    return Shifts(np.array([0.0, 0.3, -0.2]), (first, second))


def test_the_covariance_is_that_of_the_kinds(shifts: Shifts) -> None:
    by_shift = np.random.default_rng(0).normal(size=(20, 2, 3))
    root = shifts.root(by_shift, 4.0, np.array([2.0, 0.5]))
    found, (first, second) = root @ root.T, shifts.kinds
    expected = 2.0 * first @ first.T + 0.5 * second @ second.T
    np.testing.assert_allclose(found[1:, 1:], expected[1:, 1:], atol=1e-12)
    # A free direction may explain so many mean squares.
    G = by_shift.reshape(40, 3)
    assert found[0, 0] * np.mean(G[:, 0] ** 2) == pytest.approx(FREE * 4.0)
    np.testing.assert_allclose(found[0, 1:], 0.0, atol=1e-9)


def test_of_nothing_all_is_free() -> None:
    by_shift = np.ones((3, 2, 2)) * [1.0, 0.0]
    root = Shifts(np.zeros(2)).root(by_shift, 1.0, np.zeros(0))
    # What no measurement shows does not move.
    np.testing.assert_allclose(root, [[np.sqrt(FREE)], [0.0]])
    assert Shifts(np.zeros(0)).root(np.zeros((3, 2, 0)), 1.0, np.zeros(0)).shape == (
        0,
        0,
    )
