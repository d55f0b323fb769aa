"""Whole turns of joints: the shortest sequences, against all that there are."""

from __future__ import annotations

from itertools import product

import numpy as np
import pytest

from calib_pin.kinematics.turns import TURN, shortest_turns


def length(q: np.ndarray) -> float:
    return float(np.abs(np.diff(q, axis=0)).sum())


@pytest.mark.parametrize("seed", range(4))
def test_no_choice_of_turns_is_shorter(seed):
    rng = np.random.default_rng(seed)
    lower, upper = -rng.uniform(2.0, 8.0, 1), rng.uniform(2.0, 8.0, 1)
    q = rng.uniform(lower, upper, (5, 1))
    found = shortest_turns(q, lower, upper, np.array([True]))
    assert ((found >= lower) & (found <= upper)).all()
    whole = (found - q) / TURN
    np.testing.assert_allclose(whole, np.round(whole), atol=1e-12)
    others = [
        q + TURN * np.array(turns)[:, None] for turns in product(range(-2, 3), repeat=5)
    ]
    allowed = [o for o in others if ((o >= lower) & (o <= upper)).all()]
    assert length(found) <= min(map(length, allowed)) + 1e-9


def test_joints_without_limits_go_on_turning():
    q = np.arange(0.0, 30.0, 1.0)[:, None]
    endless = np.full(1, np.inf)
    found = shortest_turns(
        np.angle(np.exp(1j * q)), -endless, endless, np.ones(1, bool)
    )
    np.testing.assert_allclose(found, q, atol=1e-12)


def test_joints_that_shift_stay():
    q = np.array([[6.0, 5.0], [0.2, -5.0]])
    limit = np.full(2, 7.0)
    found = shortest_turns(q, -limit, limit, np.array([True, False]))
    np.testing.assert_allclose(found[:, 0], [6.0 - TURN, 0.2], atol=1e-12)
    np.testing.assert_array_equal(found[:, 1], q[:, 1])


def test_positions_beyond_the_limits_and_none_at_all_stay():
    limit = np.full(1, 1.0)
    q = np.array([[2.0], [0.5]])
    np.testing.assert_array_equal(shortest_turns(q, -limit, limit, np.ones(1, bool)), q)
    assert len(shortest_turns(q[:0], -limit, limit, np.ones(1, bool))) == 0
