"""Stretches of a path."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest

from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements, Observations
from calib_pin.validation.stretches import stretches


def rows(q: Floats, files: tuple[str, ...] = ()) -> Observations:
    joints = tuple(f"j{k}" for k in range(q.shape[1]))
    values = np.zeros((len(q), 3))
    return Observations.of(Measurements(joints, q, "position", values, files=files))


def jogged(rng: np.random.Generator, points: int = 20, steps: int = 10) -> Floats:
    """Straight lines in joint space from one random configuration to the next."""
    ends = rng.uniform(-2.0, 2.0, (points + 1, 6))
    part = np.linspace(0.0, 1.0, steps, endpoint=False)[:, None]
    lines = [a + part * (b - a) for a, b in pairwise(ends)]
    return np.concatenate(lines)


def test_random_order_is_no_path() -> None:
    rng = np.random.default_rng(0)
    for _ in range(300):
        count, joints = int(rng.integers(2, 80)), int(rng.integers(1, 8))
        q = rng.uniform(-2.0, 2.0, (count, joints))
        assert (stretches(rows(q)) == -1).all()


def test_a_jogged_file_is_cut_into_blocks() -> None:
    rng = np.random.default_rng(1)
    q = jogged(rng)
    label = stretches(rows(q))
    sizes = np.bincount(label)
    assert 10 <= len(sizes) <= 40 and sizes.min() >= 2
    # They are contiguous.
    assert (np.diff(label) >= 0).all()
    # In random order the same configurations are as any others.
    assert (stretches(rows(q[rng.permutation(len(q))])) == -1).all()


def test_a_joint_that_stands_still_and_units_do_not_matter() -> None:
    q = jogged(np.random.default_rng(1))
    label = stretches(rows(q))
    still = np.column_stack([q * [1.0, 1.0, 1e-3, 1.0, 1.0, 5.0], np.ones(len(q))])
    np.testing.assert_array_equal(stretches(rows(still)), label)
    assert (stretches(rows(np.ones((30, 6)))) == -1).all()


def test_a_slow_sweep_is_cut_into_few_blocks() -> None:
    t = np.linspace(0.0, 1.0, 120)[:, None]
    q = np.sin(2.0 * np.pi * t * np.linspace(0.5, 1.0, 6))
    assert 5 <= stretches(rows(q)).max() + 1 <= 10


def test_clusters_are_cut_at_their_jumps() -> None:
    rng = np.random.default_rng(3)
    q = np.repeat(rng.uniform(-2.0, 2.0, (30, 6)), 8, axis=0)
    q += 0.05 * rng.normal(size=q.shape)
    label = stretches(rows(q)).reshape(30, 8)
    whole = (label == label[:, :1]).all(axis=1)
    assert whole.mean() > 0.8


def test_repetitions_belong_to_the_first() -> None:
    q = jogged(np.random.default_rng(1))
    label = stretches(rows(q))
    home = np.concatenate([q, q[:5], q[100:103]])
    again = stretches(rows(home))
    np.testing.assert_array_equal(again[: len(q)], label)
    np.testing.assert_array_equal(
        again[len(q) :], label[[0, 1, 2, 3, 4, 100, 101, 102]]
    )


def test_files_are_cut_apart() -> None:
    rng = np.random.default_rng(2)
    q = jogged(rng, 10)
    names = ("a",) * 37 + ("b",) * 63
    label = stretches(rows(q, names))
    assert not set(label[:37]) & set(label[37:])


@pytest.mark.parametrize("count", [0, 1, 5, 9])
def test_few_rows_tell_nothing(count: int) -> None:
    q = np.linspace(0.0, 1.0, max(count, 1))[:count, None] * np.ones(6)
    assert stretches(rows(q)).tolist() == [-1] * count


def test_chains_that_are_measured_in_turn_have_a_path_each() -> None:
    rng = np.random.default_rng(1)
    left, right = jogged(rng), jogged(rng)
    blocks = [
        Measurements(
            tuple("abcdef"),
            q,
            "position",
            np.zeros((len(q), 3)),
            chain=chain,
            lines=2 * np.arange(len(q)) + first,
            files=("both.csv",) * len(q),
        )
        for chain, q, first in (("left", left, 1), ("right", right, 2))
    ]
    label = stretches(Observations(tuple(blocks)))
    count = len(left)
    assert not set(label[:count]) & set(label[count:])
    assert (np.diff(label[:count]) >= 0).all() and (np.diff(label[count:]) >= 0).all()


def test_stations_in_turn_see_one_path() -> None:
    q = jogged(np.random.default_rng(1))
    files = ("day.csv",) * len(q)
    whole = Measurements(
        tuple("abcdef"),
        q,
        "position",
        np.zeros((len(q), 3)),
        lines=np.arange(len(q)) + 2,
        files=files,
    )
    even = np.arange(len(q)) % 2 == 0
    parts = [replace(whole.rows(even == (s == "a")), station=s) for s in "ab"]
    label = np.empty(len(q), int)
    label[np.concatenate([np.flatnonzero(even), np.flatnonzero(~even)])] = stretches(
        Observations(tuple(parts))
    )
    np.testing.assert_array_equal(label, stretches(Observations.of(whole)))
