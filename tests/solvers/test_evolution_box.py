"""Bounds: checks, first population, and the way back into the box."""

from __future__ import annotations

import numpy as np
import pytest

from calib_pin.errors import OptionError
from calib_pin.solvers.evolution import Box
from tests.shared import refused

UNEVEN = np.array([[-1.0, 2.0], [0.3, 0.3], [1e-9, 3e-9]])


def test_latin_hypercube_has_one_member_in_each_slice() -> None:
    bounds = np.array([[-1.0, 3.0], [10.0, 11.0]])
    members = Box.of(bounds).populate(
        40, "latinhypercube", None, np.random.default_rng(0)
    )
    place = (members - bounds[:, 0]) / (bounds[:, 1] - bounds[:, 0])
    slices = np.floor(np.sort(place, axis=0) * 40)
    assert np.array_equal(slices, np.tile(np.arange(40.0)[:, None], 2))
    # The slices of two components are paired by chance.
    assert abs(np.corrcoef(place.T)[0, 1]) < 0.4
    chance = Box.of(bounds).populate(40, "random", None, np.random.default_rng(0))
    place = (chance - bounds[:, 0]) / (bounds[:, 1] - bounds[:, 0])
    assert len(np.unique(np.floor(place * 40)[:, 0])) < 35
    assert place.mean(axis=0) == pytest.approx(0.5, abs=0.15)


def test_repair_leads_between_the_parent_and_the_bound_that_was_crossed() -> None:
    box = Box.of(np.array([[-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0]]))
    parents = np.tile([0.5, -0.2, 0.1], (4000, 1))
    trials = np.tile([1.5, -7.0, 0.9], (4000, 1))
    on_bounds = np.array([[-1.0, 1.0, 0.5]])
    box.repair(on_bounds, parents[:1], np.random.default_rng(0))
    assert on_bounds.tolist() == [[-1.0, 1.0, 0.5]]
    box.repair(trials, parents, np.random.default_rng(0))
    for column, lower, upper in ((0, 0.5, 1.0), (1, -1.0, -0.2)):
        places = trials[:, column]
        assert lower <= places.min() and places.max() <= upper
        # Uniform: each tenth of the way gets its tenth, the one at the bound too.
        counts, _ = np.histogram(places, bins=10, range=(lower, upper))
        assert (np.abs(counts - 400) < 100).all()
    assert (trials[:, 2] == 0.9).all()
    assert not (np.abs(trials) == 1.0).any()


def test_bounds_that_cannot_be_used() -> None:
    for bounds, value in (
        ([[0.0, 1.0], [2.0, 1.5]], (2.0, 1.5)),
        ([[0.0, np.inf]], (0.0, np.inf)),
    ):
        with refused(OptionError, value=value):
            Box.of(bounds)
