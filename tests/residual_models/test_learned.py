"""What is learned of the joints or the tip, by every kind of model.

A Gaussian process is made of its points, or of harmonics where these are too many.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib_pin.errors import InputError
from calib_pin.residual_models import ResidualModel, TrainingRows, restore
from calib_pin.residual_models.covariance import FORMS
from calib_pin.residual_models.gaussian_process import GaussianProcess
from calib_pin.residual_models.harmonic_process import HarmonicProcess
from calib_pin.residual_models.network import NetworkOptions, fit_network
from calib_pin.residual_models.process_fit import (
    GaussianProcessOptions,
    fit_gaussian_process,
)

Arm = Callable[..., Any]

NOISE = 5e-6
ROWS = {"points": 140, "harmonics": 400, "network": 120}
KINDS = tuple(ROWS)
QUICK = NetworkOptions(units=4, members=2)


def process(rows: TrainingRows, **options: Any) -> Any:
    few = GaussianProcessOptions(**{"searched": 250, "functions": 300, **options})
    return fit_gaussian_process(rows, np.random.default_rng(0), options=few)


def network(rows: TrainingRows, seed: int = 0, **options: Any) -> Any:
    few = replace(QUICK, **options)
    return fit_network(rows, np.random.default_rng(seed), options=few)


def learn(kind: str, rows: TrainingRows, **options: Any) -> Any:
    if kind == "network":
        return network(rows, **options)
    if kind == "points":
        return process(rows, **{"forms": FORMS[:2], **options})
    return process(rows, **{"forms": FORMS[1:2], "largest": 90, **options})


SLOWLY = pytest.param("harmonics", marks=pytest.mark.slow)


@pytest.fixture(scope="module", params=["points", "network", SLOWLY])
def learned(request: pytest.FixtureRequest, study: Arm) -> ResidualModel:
    """What rows tell of a robot of which some parameters are off as well."""
    kind = request.param
    return learn(kind, study(shifts=3).rows(ROWS[kind], NOISE, 0))


@pytest.fixture(scope="module", params=KINDS[:2])
def tip(request: pytest.FixtureRequest, study: Arm) -> ResidualModel:
    """The same of a robot whose tip is flexible."""
    rows = study(sag=0.0, gear=0.0, flex=1e-3).rows(100, NOISE, 0)
    return learn(request.param, rows, forms=FORMS[1:], functions=150)


def test_learns_through_the_kinematics(study: Arm, learned: ResidualModel) -> None:
    arm = study(shifts=3)
    assert learned.space == "joint"
    assert arm.errors(learned).mean() < 0.2 * arm.errors(None).mean()
    assert learned.held_out[1] < 0.5 * learned.held_out[0]
    # The rows hold parameters at zero that are really 1 mm or 1 mrad.
    np.testing.assert_allclose(learned.shift, 1.0, atol=0.5)


def test_deviation_is_of_the_size_of_the_errors(
    study: Arm, learned: ResidualModel
) -> None:
    """Errors of shift and correction cancel; only together they tell the pose's."""
    rows = study(shifts=3).rows(200, 0.0, 5)
    at = rows.by_joint(learned(rows.q), learned.shift)
    deviation = learned.deviation(rows.q, at.by_correction, at.by_shift)
    assert 0.25 < np.sqrt((at.residual**2).mean() / (deviation**2).mean()) < 4.0
    # One component at a time is what stands without a derivative.
    one = np.tile(np.eye(6)[[2]], (200, 1, 1))
    alone, every = learned.deviation(rows.q, one), learned.deviation(rows.q)
    np.testing.assert_allclose(alone[:, 0], every[:, 2], rtol=1e-6)


def test_nothing_far_outside(study: Arm, learned: ResidualModel) -> None:
    """There the deviation is of the size of the corrections."""
    q = study().rows(40, NOISE, 3).q
    near = replace(learned.region, anchors=q[:1], reach=0.01)
    fades = {"fades": True} if isinstance(learned, GaussianProcess) else {}
    far = replace(learned, region=near, **fades)
    assert not far(q[1:]).any() and not near.inside(q[1:]).any()
    size = np.sqrt((learned(q) ** 2).mean(axis=0))[:5]
    ratio = far.deviation(q[1:]).mean(axis=0)[:5] / size
    assert ((ratio > 0.2) & (ratio < 6.0)).all()


def test_takes_the_tip_where_that_predicts_better(
    study: Arm, tip: ResidualModel
) -> None:
    arm = study(sag=0.0, gear=0.0, flex=1e-3)
    assert tip.space == "tip"
    assert arm.errors(tip).mean() < 0.2 * arm.errors(None).mean()
    # Positions say nothing of the tool's orientation.
    q = arm.error.chain.random_configurations(300, np.random.default_rng(5))
    assert np.abs(tip(q)[:, 3:]).max() < 1e-9
    pull = (tip(q) - arm.xi(q))[:, :3] / tip.deviation(q)[:, :3]
    assert 0.4 < pull.std() < 2.0
    fresh = (arm.errors(tip) ** 2).mean() / 3.0 + NOISE**2
    assert tip.held_out[1] == pytest.approx(np.sqrt(fresh) / 1e-4, rel=0.5)


@pytest.mark.parametrize(("kind", "harm"), [("points", 0.5e-4), ("network", 0.2e-4)])
def test_noise_alone_does_little_harm(study: Arm, kind: str, harm: float) -> None:
    arm = study(sag=0.0, gear=0.0)
    assert arm.errors(learn(kind, arm.rows(60, 1e-4, 0))).mean() < harm


@pytest.mark.parametrize("kind", KINDS)
def test_without_any_residual(study: Arm, kind: str) -> None:
    rows = study(sag=0.0, gear=0.0).rows(40, 0.0, 0)
    found = learn(kind, rows)
    assert not found(rows.q).any()
    assert restore(found.document(), 6).document() == found.document()


@pytest.mark.parametrize("fit", [process, network])
def test_too_few_configurations_are_refused(
    study: Arm, refused: Callable[..., Any], fit: Callable[..., Any]
) -> None:
    rows = study().rows(30, NOISE, 0)
    with refused(InputError, reason="5"):
        fit(replace(rows, groups=np.arange(30) // 6))


# Gaussian processes.


def test_of_more_measurements_it_is_made_of_harmonics(study: Arm) -> None:
    """The same of the same seed; a document of something else is none of them."""
    rows = study().rows(30, NOISE, 0)
    few: dict[str, Any] = {"forms": FORMS[1:2], "searched": 20, "functions": 50}
    assert isinstance(process(rows, largest=90, **few), GaussianProcess)
    found, again = (process(rows, largest=89, **few) for _ in range(2))
    assert isinstance(found, HarmonicProcess)
    document = found.document()
    assert json.dumps(document) == json.dumps(again.document())
    changes = ("made_of", "points"), ("amplitudes", [1.0]), ("spread", [1.0])
    for key, value in (*changes, ("harmonics", None)):
        with pytest.raises(ValueError, match=f"'{key}'"):
            restore({**document, key: value}, 6)


def test_learns_and_predicts_without_scikit_learn(
    monkeypatch: pytest.MonkeyPatch, study: Arm
) -> None:
    rows = study().rows(30, NOISE, 1)
    for name in [m for m in sys.modules if m.split(".")[0] == "sklearn"]:
        monkeypatch.setitem(sys.modules, name, None)
    found = process(rows, forms=FORMS[1:2])
    again = restore(json.loads(json.dumps(found.document())), 6)
    np.testing.assert_allclose(again(rows.q), found(rows.q), rtol=1e-9)


# Networks.


def test_of_very_many_measurements_some_are_enough(study: Arm) -> None:
    arm, few = study(), {"steps": (10, 4)}
    found = network(arm.rows(100, NOISE, 0), largest=60, **few)
    assert arm.errors(found).mean() < arm.errors(None).mean()
    # Nothing is lost of the region.
    assert len(found.region.anchors) == 100
    one, two = (
        json.dumps(network(arm.rows(40, NOISE, 0), **few).document()) for _ in range(2)
    )
    assert one == two  # Of the same seed.


def test_repetitions_stay_together(study: Arm) -> None:
    rows = study().rows(60, NOISE, 0)
    rows = replace(rows, groups=np.arange(60) // 3 * 7)
    part = rows.folds(5, np.random.default_rng(0))
    assert all(len(set(part[k : k + 3])) == 1 for k in range(0, 60, 3))
    assert sorted(np.bincount(part)) == [12] * 5


def test_progress_grows_to_one(study: Arm) -> None:
    told: list[float] = []
    fit_network(
        study().rows(40, NOISE, 0),
        np.random.default_rng(0),
        options=replace(QUICK, steps=(4, 2)),
        progress=told.append,
    )
    assert told == sorted(told) and told[-1] == 1.0
