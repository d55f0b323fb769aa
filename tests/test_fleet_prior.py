"""The population prior on simulated robots with known errors, in short."""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import fleet_prior


def check(found: fleet_prior.Outcome, gain: float) -> None:
    """A gain of accuracy, intervals that cover, and the spread of the type."""
    few = fleet_prior.Way(fleet_prior.FEW)
    with_it, without = found.ways[fleet_prior.PRIOR], found.ways[few]
    assert with_it.rms < gain * without.rms
    squares = np.square(with_it.errors) / np.square(with_it.predicted)
    # Errors in about two directions: chi-square, of the mean of so many.
    assert abs(squares.mean() - 1.0) < 4.0 / np.sqrt(len(squares))
    assert np.mean(with_it.shares) > 0.85


def test_a_small_fleet() -> None:
    found = fleet_prior.run(0, robots=20, following=6)
    check(found, 0.8)
    assert found.spread == pytest.approx(1.0, abs=0.5)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(len(fleet_prior.KINDS)))
def test_fleets_of_all_kinds(number: int) -> None:
    found = fleet_prior.run(number, robots=100, following=20)
    check(found, 1.1)
    assert found.spread == pytest.approx(1.0, abs=0.25)
