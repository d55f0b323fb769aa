from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from calib_pin.residual_models.covariance import FORMS
from calib_pin.residual_models.harmonics import (
    CANDIDATES,
    HIGHEST,
    Harmonics,
    Spectrum,
    candidates,
)


@pytest.mark.parametrize("length", [0.1, 0.5, 1.5, 30.0])
def test_a_spectrum_adds_up_to_the_kernel(length: float) -> None:
    turn = np.linspace(0.0, np.pi, 7)
    value = Spectrum.of(length, HIGHEST).value
    weights = 2.0 * value
    weights[0] = value[0]
    found = np.cos(np.multiply.outer(turn, np.arange(HIGHEST + 1))) @ weights
    # The highest harmonic of the shortest length is a ten-thousandth.
    exact = np.exp((np.cos(turn) - 1.0) / length**2)
    np.testing.assert_allclose(found, exact, atol=3e-3 if length < 0.2 else 1e-12)


@pytest.mark.parametrize("length", [0.02, 0.3, 3.0])
def test_slopes_of_a_spectrum(length: float) -> None:
    step = 1e-5
    above, below = (
        np.log(Spectrum.of(length * np.exp(way * step), 8).value) for way in (1, -1)
    )
    np.testing.assert_allclose(
        Spectrum.of(length, 8).slope, (above - below) / (2.0 * step), rtol=1e-5
    )


def test_candidates_have_all_phases_and_the_harmonics_of_their_own_joint() -> None:
    found = candidates(3, 3, FORMS[1])
    assert (np.diff(found.component) >= 0).all()
    assert len(np.unique(np.column_stack([found.component, found.modes]), axis=0)) == (
        len(found)
    )
    angle = np.random.default_rng(0).uniform(-9.0, 9.0, (50, 3))
    values, (own, *_) = found.values(angle), found.of_components(3)
    # sin^2 + cos^2 of every product: the variance is the same everywhere.
    total = (values[:, own] ** 2).sum(axis=1)
    np.testing.assert_allclose(total, total[0])
    assert found.orders[found.alone].max() == HIGHEST
    assert not candidates(3, 6, FORMS[2]).alone[-1]


def test_robots_of_many_joints_have_products_of_fewer() -> None:
    few, many = candidates(6, 1, FORMS[2]), candidates(12, 1, FORMS[2])
    assert few.orders.sum(axis=1).max() > many.orders.sum(axis=1).max() > 1
    assert max(len(few), len(many)) <= CANDIDATES


def test_sums_of_components() -> None:
    every = candidates(2, 2, FORMS[2])
    angle = np.random.default_rng(1).uniform(-3.0, 3.0, (5, 2))
    amplitudes = np.arange(len(every), dtype=float)
    found = every.combined(angle, amplitudes, 2)
    values = every.values(angle) * amplitudes
    np.testing.assert_allclose(found[:, 1], values[:, every.component == 1].sum(axis=1))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"modes": [[0, 129], [0, 1]]}, "other numbers than 0 to 128"),
        ({"modes": [[0, 0.5], [0, 1]]}, "other numbers than 0 to 128"),
        ({"component": [0, 2]}, "other numbers than 0 to 1"),
        ({"component": [1, 0]}, "not in ascending order"),
        ({"component": [0]}, "has the shape"),
    ],
)
def test_a_document_of_other_harmonics(change: dict[str, Any], reason: str) -> None:
    document = {"modes": [[0, 1], [0, 1]], "component": [0, 1]}
    assert len(Harmonics.restore(document, 2, 2)) == 2
    with pytest.raises(ValueError, match=reason):
        Harmonics.restore({**document, **change}, 2, 2)
