"""Regions of joint space that are held out whole."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import Setup
from calib_pin.validation.splits import REGIONS as OPTIONS
from calib_pin.validation.splits import Grouping, regions


def grouping(q: Floats) -> Grouping:
    joints = tuple(f"joint_{k}" for k in range(q.shape[1]))
    values = np.zeros((len(q), 3))
    rows = Measurements(joints=joints, q=q, values=values, model="position")
    return Grouping.of(Observations.of(rows), Setup())


@pytest.fixture
def q() -> Floats:
    return np.random.default_rng(3).uniform(-1.0, 1.0, (80, 3)) * [1.0, 2.0, 0.5]


def test_outer_parts_of_joints_then_clusters(q: Floats) -> None:
    found = regions(grouping(q), 0)
    assert len(found) == 3 + OPTIONS.clusters
    # The joint that moved most comes first, at its lower end.
    for mask, joint, sign in zip(found[:3], (1, 0, 2), (-1, 1, -1), strict=True):
        assert mask.sum() == round(OPTIONS.part * len(q))
        assert (sign * q[mask, joint]).min() > (sign * q[~mask, joint]).max()
    np.testing.assert_array_equal(np.sum(found[3:], axis=0), 1)
    points = np.concatenate([np.sin(q), np.cos(q)], axis=1)
    inside = sum(points[mask].var(axis=0).sum() * mask.mean() for mask in found[3:])
    assert inside < 0.8 * points.var(axis=0).sum()


def test_repetitions_stay_together_and_still_joints_have_no_part(q: Floats) -> None:
    q[:, 2] = 0.3
    twice = np.concatenate([q, q])
    found = regions(grouping(twice), 0)
    assert len(found) == 2 + OPTIONS.clusters
    for mask in found:
        np.testing.assert_array_equal(mask[:80], mask[80:])


def test_few_configurations_have_no_regions(q: Floats) -> None:
    assert regions(grouping(q[:4]), 0) == []
    assert regions(grouping(np.tile(q[:1], (50, 1))), 0) == []


def test_the_seed_moves_clusters_alone(q: Floats) -> None:
    first, again, other = (regions(grouping(q), seed) for seed in (0, 0, 1))
    np.testing.assert_array_equal(first, again)
    np.testing.assert_array_equal(first[:3], other[:3])
