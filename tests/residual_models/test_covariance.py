from __future__ import annotations

from dataclasses import astuple

import numpy as np
import pytest
from scipy.stats import multivariate_normal

from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models.gaussian_process import (
    FORMS,
    Covariance,
    Form,
    Likelihood,
)

RNG = np.random.default_rng(0)
ANGLE, A = RNG.uniform(-3.0, 3.0, (30, 2)), RNG.normal(size=(30, 2, 2))
FREE, KINDS = RNG.normal(size=(60, 2)), (RNG.normal(size=(60, 3)),)
NOISE = 0.05


def of(form: Form) -> Covariance:
    """Some covariance of a form."""
    own, each = slice(2 * form.own), slice(2 * form.smooth)
    return Covariance(
        own=np.array([0.2, 0.1])[own],
        short=np.array([0.9, 0.7])[own],
        all=np.array([0.4, 0.3])[each],
        long=np.array([1.5, 1.1])[each],
        kinds=np.array([0.6]),
        noise=NOISE,
    )


def by_hand(covariance: Covariance) -> Floats:
    """Covariance of the residuals, pair by pair."""
    K = FREE @ FREE.T + covariance.kinds[0] * KINDS[0] @ KINDS[0].T
    K += covariance.noise * np.eye(60)
    for a in range(30):
        for b in range(30):
            near = np.cos(ANGLE[a] - ANGLE[b]) - 1.0
            each = np.zeros(2)
            if len(covariance.own):
                each += covariance.own * np.exp(near / covariance.short**2)
            if len(covariance.all):
                each += covariance.all * np.exp((near / covariance.long**2).sum())
            K[2 * a : 2 * a + 2, 2 * b : 2 * b + 2] += A[a] * each @ A[b].T
    return K


@pytest.mark.parametrize("form", FORMS)
def test_the_likelihood_and_its_gradient(form: Form) -> None:
    target = RNG.normal(size=(30, 2))
    cost, covariance = Likelihood(ANGLE, A, target, FREE, KINDS), of(form)
    K = by_hand(covariance)
    exact = -multivariate_normal(np.zeros(60), K).logpdf(target.reshape(-1))
    found, gradient = cost(covariance)
    assert found + 30.0 * np.log(2.0 * np.pi) == pytest.approx(exact, rel=1e-8)
    parts = [np.atleast_1d(part) for part in astuple(covariance)]
    cuts = np.cumsum([len(part) for part in parts])[:-1]
    x, h = np.log(np.concatenate(parts)), 1e-5

    def at(x: Floats) -> float:
        *arrays, noise = np.split(np.exp(x), cuts)
        return cost(Covariance(*arrays, noise=float(noise[0])))[0]  # type: ignore[misc]

    slopes = [(at(x + step) - at(x - step)) / (2.0 * h) for step in h * np.eye(len(x))]
    np.testing.assert_allclose(gradient, slopes, rtol=1e-5, atol=1e-6)
