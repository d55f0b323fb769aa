"""Faults among visits: what is wrong is found, and nothing else."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.validation.pose_tests import bad_visits, moved_after


def visits(seed: int) -> tuple[np.ndarray, np.ndarray]:
    """Thirty cycles of five poses, each with a scatter of its own."""
    rng = np.random.default_rng(seed)
    pose = np.tile(np.arange(5), 30)
    scatter = 2e-5 * rng.standard_normal((5, 3, 3))
    x = rng.uniform(-0.4, 0.4, (5, 3))[pose]
    return x + np.einsum(
        "nij,nj->ni", scatter[pose], rng.standard_normal(x.shape)
    ), pose


def test_bad_and_exchanged_visits_are_found() -> None:
    x, pose = visits(0)
    assert bad_visits(x, pose) == [] and moved_after(x, pose) is None
    x[[51, 52]] = x[[52, 51]]
    x[[20, 90, 95]] += [3e-4, 0.0, 3e-4]  # Two of one pose hide each other.
    assert bad_visits(x, pose) == [20, 51, 52, 90, 95]


def test_a_moved_instrument_is_no_drift() -> None:
    x, pose = visits(1)
    turn = np.cross([0.0, 0.0, 4e-4], x)
    moved = x.copy()
    moved[77:] += turn[77:]
    assert moved_after(moved, pose) == pytest.approx(77, abs=1)
    warm = np.exp(-np.arange(150) / 40.0)[:, None]
    assert moved_after(x + warm * turn, pose) is None


def test_visits_without_scatter_have_no_faults() -> None:
    x, pose = visits(2)
    still = np.array([x[pose == k].mean(axis=0) for k in range(5)])[pose]
    assert bad_visits(still, pose) == [] and moved_after(still, pose) is None


@pytest.mark.parametrize(("away", "count"), [(1.0, 12), (10.0, 8), (10.0, 30)])
def test_a_visit_that_is_far_away_has_all_of_the_scatter(away, count):
    attained = np.zeros((2 * count, 3))
    attained[5] = away
    assert bad_visits(attained, np.repeat([0, 1], count)) == [5]
