"""Information matrices against dense linear algebra."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.criteria import Information
from tests.planning.test_criteria import factored, gram

COLUMNS = 9


def table(d: int, count: int, seed: int = 0) -> Floats:
    """Rows of configurations whose columns differ by 1e4, shape (count, d, m)."""
    rng = np.random.default_rng(seed)
    return rng.normal(size=(count, d, COLUMNS)) * np.logspace(-2, 2, COLUMNS)


def schur(M: Floats, f: int) -> Floats:
    """What is left of M about the robot, by its definition."""
    if f == 0:
        return M
    return M[f:, f:] - M[f:, :f] @ np.linalg.solve(M[:f, :f], M[:f, f:])


@pytest.mark.parametrize("f", [0, 4, COLUMNS - 1])
def test_factor_holds_the_matrix_and_its_schur_complement(f: int) -> None:
    M = gram(table(3, 20))
    found = factored(M, f)
    assert (np.tril(found.factor, -1) == 0.0).all()
    np.testing.assert_allclose(found.factor.T @ found.factor, M, rtol=1e-9)
    np.testing.assert_allclose(found.inverse @ found.factor, np.eye(COLUMNS), atol=1e-8)
    S = schur(M, f)
    # The least of S is known to some eps of the largest.
    noise = 1e-14 * np.linalg.norm(S)
    np.testing.assert_allclose(
        found.singular_values**2, np.linalg.svd(S)[1], rtol=1e-7, atol=noise
    )
    s, right = found.singular_values, found.right_vectors
    assert (np.diff(s) <= 0.0).all()
    np.testing.assert_allclose(
        right.T @ S @ right, np.diag(s**2), atol=1e-9 * s[0] ** 2
    )


@pytest.mark.parametrize(
    "kind", ["null column", "equal columns", "sum of columns", "few rows", "nuisances"]
)
@pytest.mark.parametrize("scale", [1e-6, 1e6])
def test_singular_matrices_have_no_factor(kind: str, scale: float) -> None:
    rows = scale * table(3, 20)
    if kind == "null column":
        rows[:, :, 5] = 0.0
    elif kind == "equal columns":
        rows[:, :, 7] = 1e3 * rows[:, :, 1]
    elif kind == "sum of columns":
        rows[:, :, 8] = rows[:, :, :8] @ np.random.default_rng(1).normal(size=8)
    elif kind == "few rows":
        rows = rows[:2]
    else:
        rows[:, :, 2] = rows[:, :, 0] - rows[:, :, 1]
    assert Information.of(gram(rows), 4) is None
    # Columns that are nearly equal are not.
    almost = table(3, 20)
    noise = np.random.default_rng(3).normal(size=(20, 3))
    largest = np.abs(almost[:, :, 1]).max()
    almost[:, :, 7] = almost[:, :, 1] + 1e-5 * noise * largest
    assert Information.of(gram(almost), 2) is not None
