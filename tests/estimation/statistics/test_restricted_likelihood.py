"""Variance components against dense matrices and many simulated observations."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import chi2

from calib_pin.estimation.statistics.restricted_likelihood import (
    Groups,
    estimate_variances,
)
from calib_pin.estimation.statistics.variance_components import variance_interval
from calib_pin.kinematics.spatial import Floats


def groups_of(
    A: Floats, r: Floats, label: Floats, known: Floats | None = None
) -> Groups:
    rows = np.column_stack([A, r])
    parts = [rows[label == k] for k in range(int(label.max()) + 1)]
    none = np.zeros((rows.shape[1],) * 2)
    return Groups(
        np.array([len(part) for part in parts], float),
        np.array([part.T @ part for part in parts]),
        none if known is None else known.T @ known,
    )


def dense_likelihood(A: Floats, r: Floats, V: Floats) -> float:
    W = np.linalg.inv(V)
    H = A.T @ W @ A
    P = W - W @ A @ np.linalg.solve(H, A.T @ W)
    size = np.linalg.slogdet(V)[1] + np.linalg.slogdet(H)[1]
    return -0.5 * float(size + r @ P @ r)


def test_one_group_has_the_variance_of_its_residuals() -> None:
    rng = np.random.default_rng(0)
    A, r = rng.normal(size=(40, 6)), 3.0 * rng.normal(size=40)
    found = estimate_variances(groups_of(A, r, np.zeros(40)))
    rest = r - A @ np.linalg.lstsq(A, r, rcond=None)[0]
    assert found.values[0] == pytest.approx(rest @ rest / 34.0)
    assert found.dof[0] == pytest.approx(34.0)
    assert found.redundancies[0] == pytest.approx(34.0)


def test_the_likelihood_is_at_its_maximum() -> None:
    rng = np.random.default_rng(1)
    A, label = rng.normal(size=(60, 5)), np.arange(60.0) % 3
    r = np.array([0.2, 1.0, 5.0])[label.astype(int)] * rng.normal(size=60)
    found = estimate_variances(groups_of(A, r, label))

    def likelihood(values: Floats) -> float:
        return dense_likelihood(A, r, np.diag(values[label.astype(int)]))

    best = likelihood(found.values)
    assert found.likelihood == pytest.approx(best)
    for k in range(3):
        for factor in (0.99, 1.01):
            other = np.where(np.arange(3) == k, factor, 1.0) * found.values
            assert likelihood(other) < best


def test_random_effects_are_pseudo_observations() -> None:
    rng = np.random.default_rng(2)
    A, X = rng.normal(size=(80, 4)), rng.normal(size=(80, 10))
    r = rng.normal(size=80) + X @ (0.7 * rng.normal(size=10))
    both = np.block([[A, X], [np.zeros((10, 4)), np.eye(10)]])
    label = np.repeat([0.0, 1.0], [80, 10])
    found = estimate_variances(groups_of(both, np.append(r, np.zeros(10)), label))
    noise, effect = found.values
    best = dense_likelihood(A, r, noise * np.eye(80) + effect * X @ X.T)
    for a, b in ((0.95, 1.0), (1.05, 1.0), (1.0, 0.9), (1.0, 1.1)):
        V = a * noise * np.eye(80) + b * effect * X @ X.T
        assert dense_likelihood(A, r, V) < best


def test_an_effect_that_is_not_there_vanishes() -> None:
    rng = np.random.default_rng(3)
    A, X = rng.normal(size=(80, 4)), rng.normal(size=(80, 10))
    U = np.linalg.qr(np.column_stack([A, X]))[0]
    r = rng.normal(size=80)
    r -= U @ (U.T @ r)  # Nothing lies along the effects.
    both = np.block([[A, X], [np.zeros((10, 4)), np.eye(10)]])
    label = np.repeat([0.0, 1.0], [80, 10])
    found = estimate_variances(groups_of(both, np.append(r, np.zeros(10)), label))
    assert found.values[1] < 1e-6
    assert np.isfinite(found.values).all() and found.dof[0] > 0.0


def test_what_is_known_keeps_its_variance() -> None:
    """An exact observation does not take part, and a held group is one of them."""
    rng = np.random.default_rng(4)
    A, r = rng.normal(size=(50, 3)), 2.0 * rng.normal(size=50)
    known = np.column_stack([rng.normal(size=(5, 3)), rng.normal(size=5)])
    alone = estimate_variances(groups_of(A, r, np.zeros(50), known))
    label = np.repeat([0.0, 1.0], [50, 5])
    two = groups_of(np.vstack([A, known[:, :3]]), np.append(r, known[:, 3]), label)
    held = estimate_variances(two.given(np.array([False, True])))
    np.testing.assert_allclose(held.values, alone.values)


def test_an_interval_is_that_of_chi_square() -> None:
    low, high = variance_interval(4.0, 60.0)
    assert low == pytest.approx(4.0 * 60.0 / chi2.ppf(0.975, 60.0))
    assert high == pytest.approx(4.0 * 60.0 / chi2.ppf(0.025, 60.0))
