"""The size of errors, kind by kind, as measurements tell it."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.stats import multivariate_normal

from calib_pin.estimation.shrinkage import expected_size, expected_sizes

SIZES = np.array([0.5, 5.0])


def estimates(seed: int, count: int) -> tuple[NDArray[np.float64], ...]:
    """Estimates of errors of two kinds that show together, and their variances."""
    rng = np.random.default_rng(seed)
    halves = rng.normal(size=(2, count, count // 2)) / np.sqrt(count)
    variances = rng.uniform(1e-4, 1e-3, count)
    values = np.sqrt(variances) * rng.normal(size=count)
    for size, half in zip(SIZES, halves, strict=True):
        values += size * half @ rng.normal(size=half.shape[1])
    return values, variances, halves


def test_one_kind_is_told_as_if_there_were_no_kinds() -> None:
    values, variances, _ = estimates(0, 30)
    sizes, parts = expected_sizes(values, variances, [np.eye(30)])
    size, part = expected_size(values, variances)
    assert sizes[0] == pytest.approx(size)
    np.testing.assert_allclose(parts[0], part)


def test_kinds_of_errors_have_sizes_of_their_own() -> None:
    sizes, parts = expected_sizes(*estimates(0, 80))
    np.testing.assert_allclose(sizes, SIZES, rtol=0.5)
    assert (parts[:, 0] < sizes).all() and (sizes < parts[:, -1]).all()


def test_sizes_are_those_of_the_highest_evidence() -> None:
    """None of both can be changed alone, or with the other, for a higher one."""
    values, variances, halves = estimates(3, 40)
    sizes, _ = expected_sizes(values, variances, halves)

    def evidence(sizes: NDArray[np.float64]) -> float:
        cov = np.diag(variances)
        for size, half in zip(sizes, halves, strict=True):
            cov = cov + size**2 * half @ half.T
        told = multivariate_normal(cov=cov).logpdf(values)
        return float(told - np.sum(np.log(sizes**2) + sizes**-2.0))

    best = evidence(sizes)
    for factors in product((0.9, 1.0, 1.1), repeat=2):
        assert factors == (1.0, 1.0) or evidence(sizes * factors) < best


def test_nothing_measured_is_expected_as_stated() -> None:
    sizes, parts = expected_sizes(np.zeros(0), np.zeros(0), [np.zeros((0, 3))] * 2)
    np.testing.assert_allclose(sizes, 1.0)
    assert (parts[:, 0] < 1.0).all() and (parts[:, -1] > 1.0).all()


def test_exact_estimates_beside_large_errors_of_another_kind() -> None:
    """The covariance of both cannot be told from a singular one."""
    half = np.zeros((4, 2))
    half[:2, 0] = half[2:, 1] = 1.0
    values = 1e3 * half[:, 0] + 1e-5 * np.array([1.0, -1.0, 2.0, -1.0])
    sizes, _ = expected_sizes(values, np.full(4, 1e-20), [half, 1e-5 * np.eye(4)])
    assert sizes[0] > 100.0 and 0.3 < sizes[1] < 3.0
