"""The population prior on simulated robots with known errors, in short.

`scripts/benchmark fleet-prior` takes all kinds of fleets.
"""

from __future__ import annotations

import numpy as np
import pytest

from benchmarks import fleet_prior


@pytest.mark.slow
def test_a_small_fleet() -> None:
    """A gain of accuracy, intervals that cover, and the spread of the type."""
    found = fleet_prior.run(0, robots=20, following=6)
    few = fleet_prior.Way(fleet_prior.FEW)
    with_it, without = found.ways[fleet_prior.PRIOR], found.ways[few]
    assert with_it.rms < 0.8 * without.rms
    squares = np.square(with_it.errors) / np.square(with_it.predicted)
    # Errors in about two directions: chi-square, of the mean of so many.
    assert abs(squares.mean() - 1.0) < 4.0 / np.sqrt(len(squares))
    assert np.mean(with_it.shares) > 0.85
    assert found.spread == pytest.approx(1.0, abs=0.5)
