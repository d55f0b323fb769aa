from __future__ import annotations

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models.units import (
    Weights,
    combined,
    series,
    unit_columns,
)

RNG = np.random.default_rng(0)
ROWS, D, JOINTS, UNITS = 5, 3, 4, 3
ANGLE = RNG.normal(size=(ROWS, JOINTS))
CIRCLE = np.sin(ANGLE), np.cos(ANGLE)


def weights(x: Floats) -> Weights:
    out, into = np.split(x, [UNITS * JOINTS * 2])
    shape = (UNITS, JOINTS, -1)
    return Weights(into.reshape(shape), out.reshape(shape), np.zeros((JOINTS, 2, 0)))


def test_columns_are_derivatives() -> None:
    A = RNG.normal(size=(ROWS, D, JOINTS))
    x = RNG.normal(size=UNITS * JOINTS * 5)

    def effect(x: Floats) -> Floats:
        return (A @ combined(CIRCLE, weights(x))[:, :, None]).reshape(-1)

    columns = unit_columns(A, CIRCLE, weights(x))
    h = 1e-6
    for k, step in enumerate(h * np.eye(len(x))):
        difference = (effect(x + step) - effect(x - step)) / (2.0 * h)
        np.testing.assert_allclose(columns[:, k], difference, rtol=1e-6, atol=1e-7)


def test_units_are_products_and_their_slopes() -> None:
    factors = RNG.normal(size=(1, JOINTS, 3))
    sine, cosine = CIRCLE
    terms = factors[0, :, 0] + factors[0, :, 1] * sine + factors[0, :, 2] * cosine
    outputs = np.zeros((1, JOINTS, 2))
    outputs[0, 2, 0], outputs[0, 1, 1] = 2.0, 3.0
    found = combined(CIRCLE, Weights(factors, outputs, np.zeros((JOINTS, 2, 0))))
    np.testing.assert_allclose(found[:, 2], 2.0 * terms.prod(axis=1))
    turned = factors[0, 1, 1] * cosine[:, 1] - factors[0, 1, 2] * sine[:, 1]
    slope = turned * np.delete(terms, 1, axis=1).prod(axis=1)
    np.testing.assert_allclose(found[:, 1], 3.0 * slope)
    assert not found[:, [0, 3]].any()


def test_series_sums_harmonics() -> None:
    amplitudes = RNG.normal(size=(JOINTS, 2, 7))
    multiple = ANGLE[:, :, None] * np.arange(1, 8)
    expected = (
        amplitudes[:, 0] * np.sin(multiple) + amplitudes[:, 1] * np.cos(multiple)
    ).sum(axis=2)
    np.testing.assert_allclose(series(ANGLE, amplitudes), expected, atol=1e-12)
    assert not series(ANGLE, np.zeros((JOINTS, 2, 0))).any()
