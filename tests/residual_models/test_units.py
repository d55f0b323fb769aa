from __future__ import annotations

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models.network import Weights, combined, unit_columns

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
