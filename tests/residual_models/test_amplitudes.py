from __future__ import annotations

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models.amplitudes import Amplitudes, Variances, likeliest
from calib_pin.residual_models.covariance import FORMS, Covariance
from calib_pin.residual_models.harmonics import Harmonics, candidates
from calib_pin.residual_models.sums import Linear, Sums

COVARIANCE = Covariance(
    own=np.array([0.2, 0.1]),
    short=np.array([0.9, 0.7]),
    all=np.array([0.4, 0.3]),
    long=np.array([1.5, 1.1]),
)
NOISE = 0.05


@pytest.fixture(scope="module")
def harmonics() -> Harmonics:
    return candidates(2, 2, FORMS[1])


@pytest.fixture(scope="module")
def linear() -> Linear:
    rng = np.random.default_rng(0)
    angle, A = rng.uniform(-3.0, 3.0, (30, 2)), rng.normal(size=(30, 2, 2))
    f = np.column_stack([np.sin(angle[:, 0]), np.cos(angle).prod(axis=1)])
    noise = np.sqrt(NOISE) * rng.normal(size=(30, 2))
    return Linear(angle, A, np.zeros((30, 2, 0)), (A @ f[:, :, None])[:, :, 0] + noise)


def solved(harmonics: Harmonics, linear: Linear, covariance: Covariance) -> Amplitudes:
    variance = Variances.of(covariance, harmonics).total
    return Amplitudes.of(Sums.of(harmonics, linear), variance, NOISE)


def test_the_process_is_that_of_the_covariance(
    harmonics: Harmonics, linear: Linear
) -> None:
    found = solved(harmonics, linear, COVARIANCE)
    K = COVARIANCE.of_residuals(linear.angle, linear.A) + NOISE * np.eye(60)
    y = linear.target.reshape(-1)
    # Both but for the harmonics above the fifth order, of which little is left.
    exact = -multivariate_normal(np.zeros(60), K).logpdf(y)
    constant = 0.5 * 60 * np.log(2.0 * np.pi)
    assert found.cost + constant == pytest.approx(exact, abs=0.05)
    new = np.random.default_rng(1).uniform(-3.0, 3.0, (4, 2))
    weights = (linear.A.transpose(0, 2, 1) @ np.linalg.solve(K, y).reshape(30, 2, 1))[
        :, :, 0
    ]
    expected = COVARIANCE.predict(new, linear.angle, weights)
    np.testing.assert_allclose(
        harmonics.combined(new, found.mean, 2), expected, atol=0.01
    )
    columns = harmonics.values(new) * (harmonics.component == 0)
    across, _ = COVARIANCE.components(new, linear.angle)
    across = np.repeat(across, 2, axis=1) * linear.A[:, :, 0].reshape(-1)
    variance = 0.6 - np.einsum("ij,ji->i", across, np.linalg.solve(K, across.T))
    ours = (((columns * found.root) @ found.spread.T) ** 2).sum(axis=1)
    np.testing.assert_allclose(ours, variance, atol=0.01)


def test_slopes_of_the_likelihood(harmonics: Harmonics, linear: Linear) -> None:
    sums = Sums.of(harmonics, linear)
    variance = Variances.of(COVARIANCE, harmonics).total
    found, step = Amplitudes.of(sums, variance, NOISE), 1e-4

    def cost(values: Floats, noise: float) -> float:
        return Amplitudes.of(sums, values, noise).cost

    for k in np.argsort(variance)[-5:]:
        way = np.exp(step * (np.arange(len(variance)) == k))
        numeric = cost(variance * way, NOISE) - cost(variance / way, NOISE)
        assert found.slope[k] == pytest.approx(numeric / (2.0 * step), abs=1e-6)
    up, down = (cost(variance, NOISE * np.exp(s)) for s in (step, -step))
    assert found.by_noise == pytest.approx((up - down) / (2.0 * step), abs=1e-5)


def test_the_likeliest_covariance(harmonics: Harmonics, linear: Linear) -> None:
    sums = Sums.of(harmonics, linear)
    covariance, noise, _ = likeliest(sums, harmonics, np.zeros(0), form=FORMS[1])
    variance = Variances.of(covariance, harmonics).total
    cost = Amplitudes.of(sums, variance, noise).cost
    assert cost < solved(harmonics, linear, COVARIANCE).cost
    assert noise == pytest.approx(NOISE, rel=0.6)
    for factor in (0.9, 1.1):
        variance = Variances.of(covariance.scaled(factor), harmonics).total
        assert Amplitudes.of(sums, variance, noise).cost > cost - 1e-3
