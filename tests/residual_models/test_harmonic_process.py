from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib_pin.residual_models import restore
from calib_pin.residual_models.covariance import FORMS
from calib_pin.residual_models.harmonic_process import HarmonicProcess
from calib_pin.residual_models.process_fit import (
    GaussianProcessOptions,
    fit_gaussian_process,
)

NOISE = 5e-6


def learn(rows: Any, **options: Any) -> HarmonicProcess:
    found = fit_gaussian_process(
        rows,
        np.random.default_rng(0),
        options=GaussianProcessOptions(
            **{"largest": 90, "functions": 300, "forms": FORMS[1:2], **options}
        ),
    )
    assert isinstance(found, HarmonicProcess)
    return found


@pytest.fixture(scope="module")
def process(study: Callable[..., Any]) -> HarmonicProcess:
    return learn(study().rows(600, NOISE, 0))


@pytest.fixture(scope="module")
def tip(study: Callable[..., Any]) -> HarmonicProcess:
    rows = study(sag=0.0, gear=0.0, flex=1e-3).rows(300, NOISE, 0)
    return learn(rows, forms=FORMS[1:])


def test_learns_through_the_kinematics(
    study: Callable[..., Any], process: HarmonicProcess
) -> None:
    arm = study()
    after = arm.errors(process).mean()
    assert after < 0.02 * arm.errors(None).mean()
    few = learn(arm.rows(200, NOISE, 0))
    assert after < arm.errors(few).mean()


def test_takes_the_tip_where_that_is_likelier(
    study: Callable[..., Any], tip: HarmonicProcess
) -> None:
    arm = study(sag=0.0, gear=0.0, flex=1e-3)
    assert tip.space == "tip"
    assert arm.errors(tip).mean() < 0.02 * arm.errors(None).mean()
    # Positions say nothing of the tool's orientation.
    q = arm.rows(10, NOISE, 1).q
    assert np.abs(tip(q)[:, 3:]).max() < 1e-9


def test_a_shift_belongs_to_the_correction(study: Callable[..., Any]) -> None:
    arm = study(shifts=4)
    found = learn(arm.rows(600, NOISE, 0))
    assert arm.errors(found).mean() < 0.02 * arm.errors(None).mean()
    # Errors of shift and correction cancel; only together they tell the pose's.
    unseen = arm.rows(200, 0.0, 5)
    at = unseen.by_joint(found(unseen.q), found.shift)
    pull = at.residual / found.deviation(unseen.q, at.by_correction, at.by_shift)
    assert 0.3 < pull.std() < 3.0


def test_noise_alone_does_little_harm(study: Callable[..., Any]) -> None:
    arm = study(sag=0.0, gear=0.0)
    found = learn(arm.rows(300, 1e-4, 0))
    assert arm.errors(found).mean() < 0.5e-4


def test_deviation_is_calibrated(
    study: Callable[..., Any], tip: HarmonicProcess
) -> None:
    arm = study(sag=0.0, gear=0.0, flex=1e-3)
    q = arm.error.chain.random_configurations(300, np.random.default_rng(5))
    pull = (tip(q) - arm.xi(q))[:, :3] / tip.deviation(q)[:, :3]
    assert 0.4 < pull.std() < 2.0


def test_held_out_measurements_are_predicted(
    study: Callable[..., Any], tip: HarmonicProcess
) -> None:
    arm = study(sag=0.0, gear=0.0, flex=1e-3)
    fresh = (arm.errors(tip) ** 2).mean() / 3.0 + NOISE**2
    assert tip.held_out[1] == pytest.approx(np.sqrt(fresh) / 1e-4, rel=0.5)


def test_nothing_far_outside(
    study: Callable[..., Any], process: HarmonicProcess
) -> None:
    q = study().rows(20, NOISE, 3).q
    near = replace(process.region, anchors=q[:1], reach=0.01)
    far = replace(process, region=near)
    assert not far(q[1:]).any()
    # There the deviation is of the size of the corrections.
    size = np.sqrt((process(q) ** 2).mean(axis=0))
    np.testing.assert_allclose(far.deviation(q[1:])[:, :5].mean(0), size[:5], rtol=0.6)


def test_comes_back_from_its_document(
    study: Callable[..., Any], process: HarmonicProcess
) -> None:
    q = study().rows(30, NOISE, 1).q
    found = restore(json.loads(json.dumps(process.document())), 6)
    assert found.document() == process.document()
    np.testing.assert_array_equal(found(q), process(q))
    np.testing.assert_array_equal(found.deviation(q), process.deviation(q))


@pytest.mark.parametrize(
    ("change", "reason"),
    [
        ({"made_of": "points"}, "'made_of' is not one of harmonics"),
        ({"amplitudes": [1.0]}, "'amplitudes' has the shape"),
        ({"spread": [1.0]}, "'spread' has the shape"),
        ({"harmonics": None}, "'harmonics' is not a mapping"),
    ],
)
def test_a_document_of_something_else(
    process: HarmonicProcess, change: dict[str, Any], reason: str
) -> None:
    with pytest.raises(ValueError, match=reason):
        restore({**process.document(), **change}, 6)


def test_the_same_seed_gives_the_same_process(study: Callable[..., Any]) -> None:
    rows = study().rows(100, NOISE, 0)
    assert learn(rows).document() == learn(rows).document()


def test_without_any_residual(study: Callable[..., Any]) -> None:
    rows = study(sag=0.0, gear=0.0).rows(60, 0.0, 0)
    found = learn(rows)
    assert not found(rows.q).any()
    assert restore(found.document(), 6).document() == found.document()
