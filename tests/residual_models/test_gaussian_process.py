from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib_pin.errors import InputError
from calib_pin.residual_models import restore
from calib_pin.residual_models.covariance import FORMS
from calib_pin.residual_models.gaussian_process import GaussianProcess
from calib_pin.residual_models.harmonic_process import HarmonicProcess
from calib_pin.residual_models.process_fit import (
    GaussianProcessOptions,
    fit_gaussian_process,
)

NOISE = 5e-6


def learn(rows: Any, **options: Any) -> Any:
    return fit_gaussian_process(
        rows,
        np.random.default_rng(0),
        options=GaussianProcessOptions(**{"searched": 150, **options}),
    )


@pytest.fixture(scope="module")
def process(study: Callable[..., Any]) -> GaussianProcess:
    return learn(study().rows(120, NOISE, 0), forms=FORMS[:2], searched=300)


@pytest.fixture(scope="module")
def tip(study: Callable[..., Any]) -> GaussianProcess:
    return learn(study(sag=0.0, gear=0.0, flex=1e-3).rows(80, NOISE, 0))


def test_learns_through_the_kinematics(
    study: Callable[..., Any], process: GaussianProcess
) -> None:
    arm = study()
    after = arm.errors(process).mean()
    assert after < 0.25 * arm.errors(None).mean()
    few = learn(arm.rows(50, NOISE, 0), forms=FORMS[:2])
    assert after < 0.8 * arm.errors(few).mean()


def test_takes_the_tip_where_that_predicts_better(
    study: Callable[..., Any], tip: GaussianProcess
) -> None:
    arm = study(sag=0.0, gear=0.0, flex=1e-3)
    assert tip.space == "tip"
    assert arm.errors(tip).mean() < 0.1 * arm.errors(None).mean()
    # Positions say nothing of the tool's orientation.
    q = arm.rows(10, NOISE, 1).q
    assert np.abs(tip(q)[:, 3:]).max() < 1e-9


def test_a_shift_belongs_to_the_correction(study: Callable[..., Any]) -> None:
    arm = study(shifts=4)
    found = learn(arm.rows(120, NOISE, 0), forms=FORMS[:2], searched=300)
    np.testing.assert_allclose(found.shift, 1.0, atol=0.4)
    assert arm.errors(found).mean() < 0.2 * arm.errors(None).mean()
    # Errors of shift and correction cancel; only together they tell the pose's.
    unseen = arm.rows(200, 0.0, 5)
    at = unseen.by_joint(found(unseen.q), found.shift)
    pull = at.residual / found.deviation(unseen.q, at.by_correction, at.by_shift)
    assert 0.3 < pull.std() < 3.0


def test_noise_alone_does_little_harm(study: Callable[..., Any]) -> None:
    arm = study(sag=0.0, gear=0.0)
    found = learn(arm.rows(80, 1e-4, 0))
    assert arm.errors(found).mean() < 0.5e-4


def test_deviation_is_calibrated(
    study: Callable[..., Any], tip: GaussianProcess
) -> None:
    arm = study(sag=0.0, gear=0.0, flex=1e-3)
    q = arm.error.chain.random_configurations(300, np.random.default_rng(5))
    pull = (tip(q) - arm.xi(q))[:, :3] / tip.deviation(q)[:, :3]
    assert 0.4 < pull.std() < 2.0
    assert (np.abs(pull) < 3.0).mean() > 0.9


def test_deviation_of_what_depends_on_the_corrections(
    study: Callable[..., Any], process: GaussianProcess
) -> None:
    arm = study()
    rows = arm.rows(200, 0.0, 5)
    at = rows.by_joint(process(rows.q), np.zeros(0))
    pull = at.residual / process.deviation(rows.q, at.by_correction)
    assert 0.3 < pull.std() < 3.0
    # One component at a time is what stands without a derivative.
    one = np.tile(np.eye(6)[[2]], (200, 1, 1))
    np.testing.assert_allclose(
        process.deviation(rows.q, one)[:, 0], process.deviation(rows.q)[:, 2]
    )


def test_left_out_rows_are_predicted_from_the_others(
    study: Callable[..., Any], tip: GaussianProcess
) -> None:
    arm = study(sag=0.0, gear=0.0, flex=1e-3)
    fresh = (arm.errors(tip) ** 2).mean() / 3.0 + NOISE**2
    assert tip.held_out[1] == pytest.approx(np.sqrt(fresh) / 1e-4, rel=0.5)


def test_nothing_where_nothing_was_measured(process: GaussianProcess) -> None:
    """It is gone there by itself, and as unsure as before any measurement."""
    short, long = np.full(6, 1e-3), np.full(6, 1e-3)
    covariance = replace(process.covariance, short=short, long=long)
    sharp, turned = replace(process, covariance=covariance), np.sort(process.q, axis=0)
    widest = np.diff(turned, axis=0).argmax(axis=0), np.arange(6)
    between = turned[widest] + 0.5 * np.diff(turned, axis=0)[widest]
    assert np.abs(sharp(between[None])).max() < 1e-6 * np.abs(sharp(process.q)).max()
    prior = np.sqrt(process.covariance.total) * process.unit
    np.testing.assert_allclose(sharp.deviation(between[None])[0], prior)
    # Those of before, whose shift was free, fade.
    near = replace(process.region, anchors=process.q[:1], reach=0.01)
    far, q = replace(process, region=near, fades=True), process.q[1:]
    assert not far(q).any()
    np.testing.assert_allclose(far.deviation(q), np.tile(prior, (len(q), 1)))


def test_learns_and_predicts_without_scikit_learn(
    monkeypatch: pytest.MonkeyPatch,
    study: Callable[..., Any],
    process: GaussianProcess,
) -> None:
    rows = study().rows(30, NOISE, 1)
    for name in [m for m in sys.modules if m.split(".")[0] == "sklearn"]:
        monkeypatch.setitem(sys.modules, name, None)
    found = restore(json.loads(json.dumps(process.document())), 6)
    np.testing.assert_allclose(found(rows.q), process(rows.q), rtol=1e-12)
    assert (found.deviation(rows.q) > 0.0).all()
    assert learn(rows).name == process.name


def test_too_few_rows_are_refused(study: Callable[..., Any]) -> None:
    with pytest.raises(InputError, match=r"needs at least 20 .* there are 12"):
        learn(study().rows(12, NOISE, 0))


def test_of_more_measurements_it_is_made_of_harmonics(
    study: Callable[..., Any],
) -> None:
    rows = study().rows(30, NOISE, 0)
    assert isinstance(learn(rows, largest=90), GaussianProcess)
    assert isinstance(learn(rows, largest=89), HarmonicProcess)


def test_without_any_residual(study: Callable[..., Any]) -> None:
    rows = study(sag=0.0, gear=0.0).rows(40, 0.0, 0)
    found = learn(rows)
    assert not found(rows.q).any()
    assert restore(found.document(), 6).document() == found.document()
