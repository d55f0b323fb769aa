"""Conditions of measurements: directions of approach, and what rows keep."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib_pin.observations import (
    Conditions,
    Measurements,
    Observations,
    approached,
    with_directions,
)
from calib_pin.observations.measurements import with_joints

Q = np.array([[0.0, 1.0], [0.2, 1.0], [0.2, 0.5], [0.2, 0.5], [0.1, 0.7]])
SIGNS = [[0, 0], [1, 0], [1, -1], [1, -1], [-1, 1]]


def rows(q: np.ndarray = Q, **changes: object) -> Measurements:
    plain = Measurements(("a", "b"), q, "position", np.zeros((len(q), 3)))
    return replace(plain, **changes)


def test_a_joint_that_stands_still_keeps_its_direction() -> None:
    assert approached(Q).tolist() == SIGNS
    assert approached(Q[:0]).shape == (0, 2)
    # What is one configuration is no motion.
    assert not approached(Q[:1] + 1e-7 * np.arange(4.0)[:, None]).any()


def test_what_nothing_states_comes_from_the_order_of_each_file() -> None:
    files = ("1.csv",) * 2 + ("2.csv",) * 3
    lines = np.array([3, 2, 4, 5, 6])
    found = with_directions(Observations.of(rows(files=files, lines=lines)))
    held = found.conditions
    assert held.source == "order"
    # The line before counts, wherever its measurement stands, and only of its file.
    assert held.direction.tolist() == [[-1, 0], [0, 0], [0, 0], [0, 0], [-1, 1]]
    # Of some measurements it is what it was of all.
    assert found.rows(np.array([0, 4])).conditions.direction.tolist() == [
        [-1, 0],
        [-1, 1],
    ]


def test_time_goes_before_lines() -> None:
    held = Conditions(time=np.array([5.0, 4, 3, 2, 1]))
    found = with_directions(Observations.of(rows(conditions=held))).conditions
    assert found.source == "time"
    np.testing.assert_array_equal(found.direction, approached(Q[::-1])[::-1])


def test_stated_directions_are_kept() -> None:
    stated = np.array([[1, 0], [-1, 0], [0, 0], [1, 0], [1, 0]], np.int8)
    held = Conditions(direction=stated, source="columns")
    found = with_directions(Observations.of(rows(conditions=held))).conditions
    # Nothing states those of the second joint.
    np.testing.assert_array_equal(found.direction[:, 0], stated[:, 0])
    assert found.direction[:, 1].tolist() == [0, 0, -1, -1, 1]
    assert found.source == "order"
    both = replace(held, direction=np.where(stated == 0, 1, stated).astype(np.int8))
    kept = with_directions(Observations.of(rows(conditions=both))).conditions
    assert kept.source == "columns"
    np.testing.assert_array_equal(kept.direction, both.direction)


def test_nothing_is_known_of_relative_measurements() -> None:
    found = with_directions(Observations.of(rows(start=Q + 1.0))).conditions
    assert not found.direction.size


def test_chains_have_orders_of_their_own() -> None:
    arms = [rows(Q[[0, 2]], chain="left"), rows(Q[[1, 4]], chain="right")]
    lined = [replace(arm, lines=np.array([k, k + 2])) for k, arm in enumerate(arms)]
    found = with_directions(Observations.of(*lined)).conditions
    assert found.direction.tolist() == [[0, 0], [1, -1], [0, 0], [-1, -1]]


def test_conditions_behind_one_another() -> None:
    signs = np.ones((5, 2), np.int8)
    warm = rows(
        conditions=Conditions(("p",) * 5, signs, np.full(5, 30.0), np.arange(5.0))
    )
    both = Measurements.concatenate([warm, warm.rows(np.array([4]))])
    joined = both.conditions
    assert (joined.temperature.tolist(), joined.time[-1]) == ([30.0] * 6, 4.0)
    assert joined.direction.tolist() == [[1, 1]] * 6
    other = Measurements.concatenate([warm, rows()]).conditions
    assert other.payload == ("p",) * 5 + ("",) * 5
    assert other.direction.tolist() == [[1, 1]] * 5 + [[0, 0]] * 5
    assert (other.temperature.size, other.time.size) == (0, 0)
    some = with_joints(both, ("b", "c"))
    assert some.conditions.direction.tolist() == [[1, 0]] * 6
    np.testing.assert_array_equal(some.q[:, 0], both.q[:, 1])
    assert not some.q[:, 1].any()
