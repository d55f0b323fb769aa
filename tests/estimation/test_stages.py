"""The size of errors, kind by kind, as measurements tell it."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from calib_pin.estimation.fitted import PARTS, expected_sizes
from calib_pin.kinematics.spatial import Floats

SIZES = np.array([0.5, 5.0])


def estimates(seed: int, count: int) -> tuple[Floats, Floats, Floats]:
    """Estimates of errors of two kinds that show together, and their variances."""
    rng = np.random.default_rng(seed)
    half = rng.normal(size=(count, 2 * (count // 2))) / np.sqrt(count)
    variances = rng.uniform(1e-4, 1e-3, count)
    errors = np.repeat(SIZES, count // 2) * rng.normal(size=half.shape[1])
    noise = np.sqrt(variances) * rng.normal(size=count)
    return half @ errors + noise, variances, half


def kinds(half: Floats) -> np.ndarray:
    return np.repeat([0, 1], half.shape[1] // 2)


@pytest.mark.parametrize("count", [2, 30])
def test_one_kind_against_a_grid(count: int) -> None:
    """The likeliest size, and the distribution of sizes that its parts stand for."""
    rng = np.random.default_rng(count)
    variances = 10.0 ** rng.uniform(-4.0, 0.0, count)
    values = np.sqrt(4.0 + variances) * rng.normal(size=count)
    sizes, parts = expected_sizes(
        values, variances, np.eye(count), 0 * np.arange(count)
    )
    grid = np.geomspace(1e-3, 1e3, 601)
    total = grid[:, None] ** 2 + variances
    terms = np.sum(np.log(total) + values**2 / total, axis=1)
    terms += 2.0 * (np.log(grid**2) + grid**-2.0)
    assert sizes[0] == pytest.approx(grid[np.argmin(terms)])
    below = np.cumsum(np.exp(0.5 * (terms.min() - terms)))
    middles = (np.arange(PARTS) + 0.5) / PARTS
    expected = grid[np.searchsorted(below, middles * below[-1])]
    # Chi-square has the curvature of the likelihood, not all of its shape.
    np.testing.assert_allclose(parts[0], expected, rtol=0.15)


def test_kinds_of_errors_have_sizes_of_their_own() -> None:
    """None of both can be changed alone, or with the other, for a higher evidence."""
    values, variances, half = estimates(3, 40)
    sizes, parts = expected_sizes(values, variances, half, kinds(half))
    np.testing.assert_allclose(sizes, SIZES, rtol=0.5)
    assert (parts[:, 0] < sizes).all() and (sizes < parts[:, -1]).all()

    def evidence(sizes: Floats) -> float:
        scaled = half * sizes[kinds(half)]
        cov = np.diag(variances) + scaled @ scaled.T
        told = multivariate_normal(cov=cov).logpdf(values)
        return float(told - np.sum(np.log(sizes**2) + sizes**-2.0))

    best = evidence(sizes)
    for factors in product((0.9, 1.0, 1.1), repeat=2):
        assert factors == (1.0, 1.0) or evidence(sizes * factors) < best


def test_nothing_measured_is_expected_as_stated() -> None:
    none = np.zeros(0)
    sizes, parts = expected_sizes(none, none, np.zeros((0, 6)), kinds(np.zeros((0, 6))))
    np.testing.assert_allclose(sizes, 1.0)
    assert (parts[:, 0] < 1.0).all() and (parts[:, -1] > 1.0).all()


def test_exact_estimates_beside_large_errors_of_another_kind() -> None:
    """The covariance of both cannot be told from a singular one."""
    half = np.zeros((4, 2))
    half[:2, 0] = half[2:, 1] = 1.0
    values = 1e3 * half[:, 0] + 1e-5 * np.array([1.0, -1.0, 2.0, -1.0])
    every = np.hstack([half, 1e-5 * np.eye(4)])
    sizes, _ = expected_sizes(
        values, np.full(4, 1e-20), every, np.array([0, 0, 1, 1, 1, 1])
    )
    assert sizes[0] > 100.0 and 0.3 < sizes[1] < 3.0
