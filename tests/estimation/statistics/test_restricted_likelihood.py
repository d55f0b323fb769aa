"""Variance components against dense matrices, closed forms and grids."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.estimation.statistics.variance_components import (
    KNOWN,
    Block,
    Components,
    Variances,
    estimate_variances,
)
from calib_pin.kinematics.spatial import Floats

NOISE = np.zeros(80, int)
rng = np.random.default_rng(2)
A, X = rng.normal(size=(80, 4)), rng.normal(size=(80, 10))
Y = 0.8 * rng.normal(size=80) + X @ (0.7 * rng.normal(size=10))


def components(*blocks: Block, count: int, worth: float = 0.0) -> Components:
    known = np.full(count, worth)
    return Components(blocks, known, known)


def factors(y: Floats = Y) -> Components:
    """Noise and effects X, as factors of one covariance."""
    labels = np.append(NOISE, np.ones(10, int))
    block = Block(np.column_stack([A, y]), labels, np.hstack([np.eye(80), X]))
    return components(block, count=2)


def unknowns(y: Floats = Y) -> Components:
    """The same with the effects as unknowns that have errors of their own."""
    rows = np.column_stack([A, X, y])
    effects = np.hstack([np.zeros((10, 4)), np.eye(10), np.zeros((10, 1))])
    blocks = Block(rows, NOISE), Block(effects, np.ones(10, int))
    return components(*blocks, count=2)


def dense(values: Floats) -> tuple[float, Floats, tuple[Floats, ...]]:
    """Restricted likelihood, P, and derivatives of the covariance by logarithms."""
    parts = values[0] * np.eye(80), values[1] * X @ X.T
    W = np.linalg.inv(sum(parts))
    H = A.T @ W @ A
    P = W - W @ A @ np.linalg.solve(H, A.T @ W)
    size = np.linalg.slogdet(H)[1] - np.linalg.slogdet(W)[1]
    return -0.5 * float(size + Y @ P @ Y), P, parts


@pytest.mark.parametrize("model", [factors, unknowns])
def test_likelihood_gradient_and_information_are_those_of_dense_matrices(model) -> None:
    values = np.array([0.5, 0.9])
    found, (likelihood, P, parts) = Variances.at(model(), values), dense(values)
    assert found.likelihood == pytest.approx(likelihood)
    half = [P @ V @ P @ Y for V in parts]
    squares = [Y @ h for h in half]
    np.testing.assert_allclose(found.squares, squares)
    np.testing.assert_allclose(found.redundancies, [np.trace(P @ V) for V in parts])
    information = 0.5 * np.array([[g @ V @ P @ Y for V in parts] for g in half])
    np.testing.assert_allclose(found.information, information)


@pytest.mark.parametrize("model", [factors, unknowns])
def test_the_likelihood_is_at_its_maximum(model) -> None:
    found = estimate_variances(model(), np.ones(2))
    # There the rounds of MacKay stand still.
    np.testing.assert_allclose(found.squares, found.redundancies, rtol=1e-5)
    best = dense(found.values)[0]
    for factors_ in ((0.95, 1.0), (1.05, 1.0), (1.0, 0.9), (1.0, 1.1)):
        assert dense(found.values * factors_)[0] < best


def test_one_variance_is_that_of_the_residuals() -> None:
    one = components(Block(np.column_stack([A, Y]), NOISE), count=1)
    found = estimate_variances(one, np.ones(1))
    b, (squares,) = np.linalg.lstsq(-A, Y, rcond=None)[:2]
    assert found.values[0] == pytest.approx(squares / 76.0)
    assert found.dof[0] == pytest.approx(76.0) == pytest.approx(found.redundancies[0])
    np.testing.assert_allclose(found.unknowns, b)


def test_an_effect_that_is_not_there_vanishes() -> None:
    U = np.linalg.qr(np.hstack([A, X]))[0]
    rest = Y - U @ (U.T @ Y)
    found = estimate_variances(unknowns(rest), np.ones(2))
    assert found.values[1] < 1e-6 and np.isfinite(found.dof).all()
    # A bound stops it before.
    bounded = estimate_variances(factors(rest), np.ones(2), np.full(2, 0.01))
    assert bounded.values[1] == 0.01


def test_repetitions_have_the_closed_form_of_one_way_analysis() -> None:
    """Twenty configurations, four times each: mean squares within and between."""
    y = np.repeat(rng.normal(size=20), 4) + 0.3 * rng.normal(size=80)
    Z = np.repeat(np.eye(20), 4, axis=0)
    labels = np.append(NOISE, np.ones(20, int))
    rows = np.column_stack([np.ones(80), y])
    found = estimate_variances(
        components(Block(rows, labels, np.hstack([np.eye(80), Z])), count=2), np.ones(2)
    )
    means = y.reshape(20, 4).mean(axis=1)
    within = np.sum((y - np.repeat(means, 4)) ** 2) / 60.0
    between = 4.0 * means.var(ddof=1)
    np.testing.assert_allclose(found.values, [within, (between - within) / 4.0], 1e-4)


def test_what_is_known_beforehand_counts_like_further_errors() -> None:
    nothing = components(Block(np.zeros((1, 1)), np.array([KNOWN])), count=2, worth=3.0)
    found = estimate_variances(nothing, np.array([0.1, 7.0]))
    np.testing.assert_allclose(found.values, 1.0)
    np.testing.assert_allclose(found.dof, 3.0)
    more = Components(factors().blocks, np.array([0.0, 50.0]), np.array([0.0, 450.0]))
    assert estimate_variances(more, np.ones(2)).values[1] == pytest.approx(9.0, rel=0.4)


def test_variances_that_are_known_or_in_common() -> None:
    plain = components(Block(np.column_stack([A, Y]), np.arange(80) % 4), count=4)
    found = estimate_variances(plain.relabeled(np.array([0, 1, 0, KNOWN])), np.ones(2))
    labels = np.array([0, 1, 0, KNOWN])[np.arange(80) % 4]
    again = components(Block(np.column_stack([A, Y]), labels), count=2)
    np.testing.assert_allclose(
        found.values, estimate_variances(again, np.ones(2)).values
    )
    assert Variances.at(again, np.ones(2)).redundancies.sum() < 60.0
