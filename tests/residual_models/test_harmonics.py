from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from calib_pin.residual_models.covariance import FORMS
from calib_pin.residual_models.harmonics import (
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


@pytest.mark.parametrize(
    "change",
    [
        {"modes": [[0, 129], [0, 1]]},
        {"modes": [[0, 0.5], [0, 1]]},
        {"component": [0, 2]},
        {"component": [1, 0]},
        {"component": [0]},
    ],
)
def test_a_document_of_other_harmonics(change: dict[str, Any]) -> None:
    document = {"modes": [[0, 1], [0, 1]], "component": [0, 1]}
    assert len(Harmonics.restore(document, 2, 2)) == 2
    (key,) = change
    with pytest.raises(ValueError, match=key):
        Harmonics.restore({**document, **change}, 2, 2)
