"""Normal equations and triangular factors of rows against each other and numpy."""

from __future__ import annotations

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.compiled import blocks, row_kernels
from calib_pin.compiled.blocks import BLOCK
from calib_pin.compiled.row_kernels import Corrections

NONE = Corrections(np.zeros(0, np.int64), np.zeros((0, 0)))


@pytest.mark.parametrize("rows", [1, 2, 3])
def test_reflections_of_few_rows_stay_finite(rows: int) -> None:
    """Each leaves a rounding of the one before, until squares underflow."""
    rng = np.random.default_rng(9)
    chain = np.tile(np.eye(4)[:3].reshape(-1), (8, 1))
    motion, starts = blocks.motions(rng.normal(size=(rows, 7)), np.ones(7, bool))
    J_pose, others = rng.normal(size=(rows, 1, 6)), rng.normal(size=(rows, 1, 4))
    R, H = np.empty((52, 52)), np.empty((52, 52))
    at, given = (chain, motion, starts), (J_pose, others, np.ones((rows, 1)))
    row_kernels.triangular_factor(*at, NONE, *given, R)
    row_kernels.normal_equations(*at, NONE, *given, H)
    np.testing.assert_allclose(np.tril(R.T @ R), np.tril(H), rtol=0, atol=1e-13)


def test_householder_agrees_with_numpy() -> None:
    """Rows of one joint that stands still: the kernel's columns are plain ones."""
    rng = np.random.default_rng(8)
    rows, d, own = 2 * BLOCK + 9, 2, 3
    J_pose, others = rng.normal(size=(rows, d, 6)), rng.normal(size=(rows, d, own))
    weights = rng.uniform(0.5, 2.0, (rows, d))
    chain = np.tile(np.eye(4)[:3].reshape(-1), (2, 1))
    chain[1, 3] = 0.7  # The second link shifts along x.
    motion, starts = blocks.motions(np.zeros((rows, 1)), np.array([True]))
    at, given = (chain, motion, starts), (J_pose, others, weights)
    size = 16  # 12 + 3, and a column of padding.
    R, H = np.empty((size, size)), np.empty((size, size))
    row_kernels.triangular_factor(*at, NONE, *given, R)
    row_kernels.normal_equations(*at, NONE, *given, H)

    tool = pin.SE3(np.eye(3), np.array([0.7, 0.0, 0.0]))
    columns = [J_pose @ tool.toActionMatrixInverse(), J_pose, others]
    A = (np.concatenate(columns, axis=2) * weights[:, :, None]).reshape(-1, 15)
    np.testing.assert_allclose(np.tril(H[:15, :15]), np.tril(A.T @ A), atol=1e-10)
    assert not H[15].any() and not R[:, 15].any()
    assert not np.tril(R, -1).any()
    np.testing.assert_allclose((R.T @ R)[:15, :15], A.T @ A, atol=1e-10)
    independent = [0, 1, 2, 3, 4, 5]
    expected = np.abs(np.linalg.qr(A[:, independent], mode="r"))
    np.testing.assert_allclose(np.abs(R[:6, :6]), expected, rtol=0, atol=1e-12)


@pytest.mark.parametrize("kernel", ["normal_equations", "triangular_factor"])
def test_a_correction_is_a_multiple_of_a_twist(kernel: str) -> None:
    """By a factor of each row; columns of corrections stand before the others."""
    rng = np.random.default_rng(7)
    rows = BLOCK + 5
    chain = np.tile(np.eye(4)[:3].reshape(-1), (2, 1))
    motion, starts = blocks.motions(rng.normal(size=(rows, 1)), np.array([True]))
    J_pose, others = rng.normal(size=(rows, 2, 6)), rng.normal(size=(rows, 2, 1))
    weights = rng.uniform(0.5, 2.0, (rows, 2))
    given = Corrections(np.array([5, 2]), rng.normal(size=(2, rows)))
    found, plain = np.empty((16, 16)), np.empty((16, 16))
    reduce = getattr(row_kernels, kernel)
    reduce(chain, motion, starts, given, J_pose, others, weights, found)
    # The same columns from outside: both links are none, so that z stays z.
    columns = J_pose[:, :, [5, 2]] * given.factors.T[:, None, :]
    others = np.concatenate([columns, others], axis=2)
    reduce(chain, motion, starts, NONE, J_pose, others, weights, plain)
    assert np.abs(plain[:15, :15]).max() > 1.0
    np.testing.assert_allclose(found, plain, rtol=0, atol=1e-10)
