from __future__ import annotations

from functools import partial

import numpy as np
import pytest

from calib_pin.compiled.threads import Threads, serial_blas
from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models import sums
from calib_pin.residual_models.covariance import FORMS
from calib_pin.residual_models.harmonics import Harmonics, candidates
from calib_pin.residual_models.sums import Linear, Sums, scores


def some(harmonics: Harmonics, count: int) -> tuple[Linear, Floats]:
    """Measurements, and the derivative by amplitudes and shifts, (N, d, D + P)."""
    rng = np.random.default_rng(0)
    linear = Linear(
        rng.uniform(-3.0, 3.0, (count, 2)),
        rng.normal(size=(count, 3, 2)),
        rng.normal(size=(count, 3, 4)),
        rng.normal(size=(count, 3)),
    )
    values = harmonics.values(linear.angle)[:, None]
    columns = values * linear.A[:, :, harmonics.component]
    return linear, np.concatenate([columns, linear.G], axis=2).reshape(3 * count, -1)


def test_sums_are_those_of_the_columns(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(sums, "CHUNK", 7)
    monkeypatch.setattr(sums, "SCREENED", 5)
    harmonics = candidates(2, 2, FORMS[1])
    harmonics = harmonics.at(np.arange(0, len(harmonics), 5))
    linear, X = some(harmonics, 40)
    y = linear.target.reshape(-1)
    found = Sums.of(harmonics, linear)
    np.testing.assert_allclose(found.normal, X.T @ X, atol=1e-12)
    np.testing.assert_allclose(found.right, X.T @ y, atol=1e-12)
    assert (found.square, found.count) == (pytest.approx(y @ y), 120)
    parts = Sums.of(harmonics, linear.rows(slice(30)))
    parts += Sums.of(harmonics, linear.rows(slice(30, None)))
    np.testing.assert_allclose(parts.normal, found.normal, atol=1e-12)
    one = (X.T @ y) ** 2 / (X**2).sum(axis=0)
    np.testing.assert_allclose(scores(harmonics, linear), one[: len(harmonics)])


def test_the_number_of_threads_does_not_matter(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setattr(sums, "CHUNK", 7)
    harmonics = candidates(2, 2, FORMS[2])
    linear, _ = some(harmonics, 60)
    found = []
    for count in (1, 4):
        monkeypatch.setattr(sums, "Threads", partial(Threads, count))
        with serial_blas:
            found.append((Sums.of(harmonics, linear), scores(harmonics, linear)))
    (one, few), (other, more) = found
    np.testing.assert_array_equal(one.normal, other.normal)
    np.testing.assert_array_equal(few, more)


def test_what_nothing_shows_explains_nothing() -> None:
    harmonics = candidates(2, 2, FORMS[2])
    linear, _ = some(harmonics, 10)
    linear.A[:, :, 1] = 0.0
    found = scores(harmonics, linear)
    assert not found[harmonics.component == 1].any()
    assert found[harmonics.component == 0].all()
