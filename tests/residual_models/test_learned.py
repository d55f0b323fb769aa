"""What is learned of the joints or the tip, by every kind of model."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib_pin.errors import InputError
from calib_pin.residual_models import TrainingRows, restore
from calib_pin.residual_models.base import ResidualModel
from calib_pin.residual_models.gaussian_process import (
    FORMS,
    Conditioned,
    GaussianProcess,
    GaussianProcessOptions,
    fit_gaussian_process,
)
from calib_pin.residual_models.network import NetworkOptions, fit_network
from tests.shared import refused

Arm = Callable[..., Any]

NOISE = 5e-6
ROWS = {"gaussian-process": 140, "network": 120}
KINDS = tuple(ROWS)
QUICK = NetworkOptions(units=4, members=2)


def process(rows: TrainingRows, **options: Any) -> Any:
    few = GaussianProcessOptions(**{"searched": 250, "forms": FORMS[:2], **options})
    return fit_gaussian_process(rows, np.random.default_rng(0), options=few)


def network(rows: TrainingRows, **options: Any) -> Any:
    few = replace(QUICK, **options)
    return fit_network(rows, np.random.default_rng(0), options=few)


FITS = dict(zip(KINDS, (process, network), strict=True))


@pytest.fixture(scope="module", params=KINDS)
def learned(request: pytest.FixtureRequest, study: Arm) -> ResidualModel:
    """What rows tell of a robot of which some parameters are off as well."""
    kind = request.param
    found: ResidualModel = FITS[kind](study(shifts=3).rows(ROWS[kind], NOISE, 0))
    return found


def test_learns_through_the_kinematics(study: Arm, learned: ResidualModel) -> None:
    arm = study(shifts=3)
    assert learned.space == "joint"
    assert arm.errors(learned).mean() < 0.2 * arm.errors(None).mean()
    assert learned.held_out[1] < 0.5 * learned.held_out[0]
    # The rows hold parameters at zero that are really 1 mm or 1 mrad.
    np.testing.assert_allclose(learned.shift, 1.0, atol=0.5)


def test_where_nothing_was_learned(study: Arm, learned: ResidualModel) -> None:
    """A network ends at its region; a process holds, and counts what is outside."""
    q = study().rows(40, NOISE, 3).q
    near = replace(learned.region, anchors=q[:1], reach=0.01)
    far = replace(learned, region=near)
    assert not near.inside(q[1:]).any()
    assert far(q[1:]).any() == isinstance(learned, GaussianProcess)


def test_takes_the_tip_where_that_predicts_better(study: Arm) -> None:
    arm = study(sag=0.0, gear=0.0, flex=1e-3)
    tip = process(arm.rows(100, NOISE, 0), forms=FORMS[1:])
    assert tip.space == "tip"
    assert arm.errors(tip).mean() < 0.2 * arm.errors(None).mean()
    # Positions say nothing of the tool's orientation.
    q = arm.error.chain.random_configurations(300, np.random.default_rng(5))
    assert np.abs(tip(q)[:, 3:]).max() < 1e-9
    fresh = (arm.errors(tip) ** 2).mean() / 3.0 + NOISE**2
    assert tip.held_out[1] == pytest.approx(np.sqrt(fresh) / 1e-4, rel=0.5)


@pytest.mark.parametrize(("kind", "harm"), [*zip(KINDS, (5e-5, 2e-5), strict=True)])
def test_noise_alone_does_little_harm(study: Arm, kind: str, harm: float) -> None:
    arm = study(sag=0.0, gear=0.0)
    assert arm.errors(FITS[kind](arm.rows(60, 1e-4, 0))).mean() < harm


@pytest.mark.parametrize("kind", KINDS)
def test_without_any_residual(study: Arm, kind: str) -> None:
    rows = study(sag=0.0, gear=0.0).rows(40, 0.0, 0)
    found = FITS[kind](rows)
    assert not found(rows.q).any()
    assert restore(found.document(), 6).document() == found.document()


@pytest.mark.parametrize("kind", KINDS)
def test_too_few_configurations_are_refused(study: Arm, kind: str) -> None:
    rows = study().rows(30, NOISE, 0)
    with refused(InputError, reason="5"):
        FITS[kind](replace(rows, groups=np.arange(30) // 6))


# Left-out measurements.


def test_left_out_rows_of_a_process_have_no_part(study: Arm) -> None:
    """With the covariance of all, it is what the others alone make of it."""
    rows = study(shifts=3).rows(60, NOISE, 0)
    whole, mask = process(rows, forms=FORMS[:1]), np.arange(60) % 5 == 0
    (found,) = whole.left_out(rows, [mask], np.random.default_rng(0))
    kept = np.flatnonzero(~mask)
    some, f, z = rows.subset(kept), whole(rows.q)[kept], whole.shift
    known = Conditioned.of(whole, some, f, z)
    expected = known.posterior(known.alpha)
    q = study().rows(20, NOISE, 3).q
    # The noise makes up for a condition of the covariance of some 1e8.
    size = np.abs(whole(q)).max()
    np.testing.assert_allclose(found(q), expected(q), rtol=0, atol=1e-6 * size)
    np.testing.assert_allclose(found.shift, expected.shift, rtol=0, atol=1e-6)
    assert np.abs(found(q) - whole(q)).max() > 1e-3 * size


def test_left_out_rows_of_a_network_have_no_part(study: Arm) -> None:
    rows, mask = study().rows(60, NOISE, 0), np.arange(60) < 12
    whole = network(rows, steps=(4, 2))
    (found,) = whole.left_out(rows, [mask], np.random.default_rng(0))
    assert len(found.factors) == 1
    assert set(map(tuple, found.region.anchors)) == set(map(tuple, rows.q[~mask]))


# Gaussian processes.


def test_of_more_measurements_it_is_made_of_some(study: Arm) -> None:
    rows = study().rows(60, NOISE, 0)
    found, again = (process(rows, searched=120, largest=120) for _ in range(2))
    assert len(found.q) == 40 and len(found.region.anchors) == 60
    assert json.dumps(found.document()) == json.dumps(again.document())
    # What was left out has no part where it had none before.
    unused = ~np.isin(rows.q[:, 0], found.q[:, 0])
    (same,) = found.left_out(rows, [unused], np.random.default_rng(0))
    size = np.abs(found(rows.q)).max()
    np.testing.assert_allclose(same(rows.q), found(rows.q), atol=1e-2 * size)


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
    part = rows.folds(np.random.default_rng(0))
    assert all(len(set(part[k : k + 3])) == 1 for k in range(0, 60, 3))
    assert sorted(np.bincount(part)) == [12] * 5


@pytest.mark.parametrize("fit", [fit_gaussian_process, fit_network])
def test_progress_grows_to_one(study: Arm, fit: Callable[..., Any]) -> None:
    told: list[float] = []
    quick = replace(QUICK, steps=(4, 2))
    if fit is fit_gaussian_process:
        quick = GaussianProcessOptions(searched=60)
    rows, rng = study().rows(40, NOISE, 0), np.random.default_rng(0)
    fit(rows, rng, options=quick, progress=told.append)
    assert told == sorted(told) and told[-1] == 1.0
