from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib_pin.errors import InputError
from calib_pin.residual_models import restore
from calib_pin.residual_models.network import Network, NetworkOptions, fit_network

NOISE = 5e-6
QUICK = NetworkOptions(units=4, members=3)


def train(rows: Any, seed: int = 0, **options: Any) -> Network:
    return fit_network(
        rows, np.random.default_rng(seed), options=replace(QUICK, **options)
    )


@pytest.fixture(scope="module")
def network(study: Callable[..., Any]) -> Network:
    return train(study().rows(120, NOISE, 0))


def test_learns_through_the_kinematics(
    study: Callable[..., Any], network: Network
) -> None:
    arm = study()
    assert arm.errors(network).mean() < 0.15 * arm.errors(None).mean()
    assert network.held_out[1] < 0.2 * network.held_out[0]
    assert network.space == "joint"


def test_more_rows_help(study: Callable[..., Any], network: Network) -> None:
    arm = study()
    few = train(arm.rows(60, NOISE, 0))
    assert arm.errors(network).mean() < 0.6 * arm.errors(few).mean()
    # Few rows do not harm, either.
    assert arm.errors(few).mean() < arm.errors(None).mean()


def test_of_very_many_measurements_some_are_enough(
    study: Callable[..., Any], network: Network
) -> None:
    arm = study()
    found = train(arm.rows(200, NOISE, 0), largest=120)
    assert arm.errors(found).mean() < 0.3 * arm.errors(None).mean()
    # Nothing is lost of the region.
    assert len(found.region.anchors) == 200
    assert train(arm.rows(120, NOISE, 0), largest=120).document() == network.document()


def test_noise_alone_teaches_nothing(study: Callable[..., Any]) -> None:
    arm = study(sag=0.0, gear=0.0)
    found = train(arm.rows(60, 1e-4, 0))
    assert arm.errors(found).mean() < 0.2e-4


def test_a_shift_belongs_to_the_correction(study: Callable[..., Any]) -> None:
    arm = study(shifts=4)
    rows = arm.rows(120, NOISE, 0)
    found = train(rows)
    # The rows hold parameters at zero that are really 1 mm or 1 mrad.
    np.testing.assert_allclose(found.shift, 1.0, atol=0.1)
    assert arm.errors(found).mean() < 0.15 * arm.errors(None).mean()
    # Errors of shift and correction cancel; only together they tell the pose's.
    unseen = arm.rows(200, 0.0, 5)
    at = unseen.by_joint(found(unseen.q), found.shift)
    deviation = found.deviation(unseen.q, at.by_correction, at.by_shift)
    assert 0.3 < np.sqrt((at.residual**2).mean() / (deviation**2).mean()) < 3.0


def test_the_same_seed_gives_the_same_bytes(study: Callable[..., Any]) -> None:
    rows = study().rows(40, NOISE, 0)
    text = [
        json.dumps(train(rows, seed, steps=(8, 2)).document()) for seed in (3, 3, 4)
    ]
    assert text[0] == text[1] != text[2]


def test_repetitions_stay_together(study: Callable[..., Any]) -> None:
    rows = study().rows(60, NOISE, 0)
    rows = replace(rows, groups=np.arange(60) // 3 * 7)
    part = rows.folds(5, np.random.default_rng(0))
    assert all(len(set(part[k : k + 3])) == 1 for k in range(0, 60, 3))
    assert sorted(np.bincount(part)) == [12] * 5


def test_too_few_rows_are_refused(study: Callable[..., Any]) -> None:
    rows = study().rows(30, NOISE, 0)
    with pytest.raises(InputError, match=r"needs at least 20 .* there are 10"):
        fit_network(replace(rows, groups=np.arange(30) // 3), np.random.default_rng(0))


def test_progress_grows_to_one(study: Callable[..., Any]) -> None:
    told: list[float] = []
    fit_network(
        study().rows(40, NOISE, 0),
        np.random.default_rng(0),
        options=replace(QUICK, steps=(4, 2)),
        progress=told.append,
    )
    assert told == sorted(told) and told[-1] == 1.0


def test_deviation_is_of_the_size_of_the_errors(
    study: Callable[..., Any], network: Network
) -> None:
    rows = study().rows(300, 0.0, 5)
    at = rows.by_joint(network(rows.q), np.zeros(0))
    deviation = network.deviation(rows.q, at.by_correction)
    ratio = np.sqrt((at.residual**2).mean() / (deviation**2).mean())
    assert 0.3 < ratio < 3.0
    one = np.tile(np.eye(6)[[2]], (300, 1, 1))
    np.testing.assert_allclose(
        network.deviation(rows.q, one)[:, 0], network.deviation(rows.q)[:, 2]
    )


def test_nothing_far_outside(network: Network) -> None:
    q = network.region.anchors
    near = replace(network.region, anchors=q[:1], reach=0.01)
    far = replace(network, region=near)
    assert not far(q[1:]).any()
    assert not near.inside(q[1:]).any()
    typical = np.tile(network.typical, (len(q) - 1, 1))
    np.testing.assert_array_equal(far.deviation(q[1:]), typical)


def test_without_any_residual(study: Callable[..., Any]) -> None:
    arm = study(sag=0.0, gear=0.0)
    found = train(arm.rows(40, 0.0, 0))
    assert not found(np.zeros((3, 6))).any()
    assert restore(found.document(), 6).document() == found.document()
