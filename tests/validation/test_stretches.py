"""Stretches of a path."""

from __future__ import annotations

from itertools import pairwise

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements, Observations
from calib_pin.validation.splits import stretches


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
