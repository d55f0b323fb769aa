from __future__ import annotations

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models.region import TrainedRegion

TURNS = np.ones(3, bool)


def region(q: Floats, revolute: Floats = TURNS) -> TrainedRegion:
    return TrainedRegion.of(q, revolute, np.random.default_rng(0))


@pytest.fixture
def cloud() -> Floats:
    return np.random.default_rng(0).uniform(-1.0, 1.0, (2000, 3))


def test_holds_what_it_was_drawn_from(cloud: Floats) -> None:
    found = region(cloud[:400])
    assert found.inside(cloud).mean() > 0.99
    assert found.weight(cloud).mean() > 0.998
    assert found.inside(cloud[:400]).mean() > 0.985


def test_fades_to_exactly_nothing(cloud: Floats) -> None:
    found = region(cloud[:400])
    way = np.linspace(0.0, 2.5, 200)[:, None] * np.eye(3)[0]
    weight = found.weight(way)
    assert weight[0] == 1.0 and weight[-1] == 0.0
    assert (np.diff(weight) <= 0.0).all()
    assert np.abs(np.diff(weight)).max() < 0.1


def test_a_joint_that_never_moved(cloud: Floats) -> None:
    fixed = cloud * [1.0, 1.0, 0.0] + [0.0, 0.0, 0.7]
    found = region(fixed[:400])
    assert found.inside(fixed).mean() > 0.99
    assert not found.weight(fixed + np.array([0.0, 0.0, 0.3])).any()


def test_angles_are_on_a_circle() -> None:
    q = np.random.default_rng(1).uniform(2.5, 3.7, (400, 3))
    found = region(q)
    np.testing.assert_allclose(found.weight(q - 2.0 * np.pi), found.weight(q))
    assert not found.weight(np.zeros((1, 3))).any()


def test_a_prismatic_joint_has_ends() -> None:
    q = np.random.default_rng(2).uniform(0.0, 0.35, (400, 3))
    found = region(q, np.array([True, True, False]))
    assert found.inside(q).mean() > 0.98
    beyond = np.array([0.0, 0.0, 0.7])
    assert not found.weight(q + beyond).any()
    assert not found.weight(q - beyond).any()


def test_of_very_many_rows_some_are_remembered(cloud: Floats) -> None:
    found = region(cloud)
    assert len(found.anchors) == 1000
    assert found.inside(cloud).mean() > 0.99
