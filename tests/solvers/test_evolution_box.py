"""Bounds: checks, first population, and the way back into the box."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from calib_pin.errors import OptionError
from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers.evolution import Box

UNEVEN = np.array([[-1.0, 2.0], [0.3, 0.3], [1e-9, 3e-9]])


def columns(members: Floats) -> Floats:
    return np.sort(members, axis=0)


@pytest.mark.parametrize(
    ("bounds", "fields"),
    [
        ([0.0, 1.0], {"reason": "shape", "value": (2,), "allowed": "(D, 2)"}),
        (np.zeros((2, 3)), {"reason": "shape", "value": (2, 3), "allowed": "(D, 2)"}),
        (np.zeros((0, 2)), {"reason": "shape", "value": (0, 2)}),
        (
            [[0.0, 1.0], [2.0, 1.5]],
            {
                "reason": "component 1 are reversed",
                "value": (2.0, 1.5),
                "allowed": "lower <= upper",
            },
        ),
        (
            [[0.0, np.inf]],
            {"reason": "component 0 are not finite", "value": (0.0, np.inf)},
        ),
        ([[0.0, 1.0], [np.nan, 1.0]], {"reason": "component 1 are not finite"}),
    ],
)
def test_bounds_that_cannot_be_used(
    bounds: Floats, fields: dict[str, Any], refused: Callable[..., Any]
) -> None:
    with refused(OptionError, **fields):
        Box.of(bounds)


@pytest.mark.parametrize(
    ("x0", "fields"),
    [
        ([0.0, 0.3], {"reason": "x0", "value": (2,), "allowed": "(3,)"}),
        (
            [0.0, 0.31, 2e-9],
            {"reason": "component 1", "value": 0.31, "allowed": "0.3 to 0.3"},
        ),
        (
            [-1.1, 0.3, 2e-9],
            {"reason": "component 0", "value": -1.1, "allowed": "-1.0 to 2.0"},
        ),
        ([0.0, 0.3, np.nan], {"reason": "component 2"}),
    ],
)
def test_first_members_that_cannot_be_used(
    x0: list[float], fields: dict[str, Any], refused: Callable[..., Any]
) -> None:
    with refused(OptionError, **fields):
        Box.of(UNEVEN).populate(8, "random", np.array(x0), np.random.default_rng(0))


def test_latin_hypercube_has_one_member_in_each_slice() -> None:
    bounds = np.array([[-1.0, 3.0], [10.0, 11.0]])
    members = Box.of(bounds).populate(
        40, "latinhypercube", None, np.random.default_rng(0)
    )
    place = (members - bounds[:, 0]) / (bounds[:, 1] - bounds[:, 0])
    slices = np.floor(columns(place) * 40)
    assert np.array_equal(slices, np.tile(np.arange(40.0)[:, None], 2))
    # The slices of two components are paired by chance.
    assert abs(np.corrcoef(place.T)[0, 1]) < 0.4


def test_random_population_fills_the_box_unevenly() -> None:
    bounds = np.array([[-1.0, 3.0]])
    members = Box.of(bounds).populate(400, "random", None, np.random.default_rng(0))
    assert members.mean() == pytest.approx(1.0, abs=0.2)
    assert members.std() == pytest.approx(4 / np.sqrt(12), rel=0.1)
    assert len(np.unique(np.floor(members * 100))) < 390  # No slices.


@pytest.mark.parametrize("init", ["random", "latinhypercube"])
def test_first_population_is_inside_and_begins_with_x0(init: str) -> None:
    box, x0 = Box.of(UNEVEN), np.array([2.0, 0.3, 1e-9])
    members = box.populate(500, init, x0, np.random.default_rng(0))
    assert members.shape == (500, 3)
    assert np.array_equal(members[0], x0)
    assert ((box.lower <= members) & (members <= box.upper)).all()
    assert (members[:, 1] == 0.3).all()


class Highest:
    """Chance that always draws the largest number below 1."""

    def random(self, shape: int | tuple[int, int]) -> Floats:
        return np.full(shape, np.nextafter(1.0, 0.0))

    def permuted(self, slices: Floats, axis: int) -> Floats:
        return slices


@pytest.mark.parametrize("init", ["random", "latinhypercube"])
def test_rounding_leads_nobody_out(init: str) -> None:
    highest, rng = Highest(), np.random.default_rng(0)
    box = Box.of(np.sort(rng.normal(size=(10_000, 2)), axis=1))
    members = box.populate(4, init, None, highest)  # type: ignore[arg-type]
    assert (members <= box.upper).all()
    for parent, beyond in ((box.upper, box.lower - 1), (box.lower, box.upper + 1)):
        trials = beyond[None].copy()
        box.repair(trials, parent[None], highest)  # type: ignore[arg-type]
        assert ((box.lower <= trials) & (trials <= box.upper)).all()


def test_repair_leads_between_the_parent_and_the_bound_that_was_crossed() -> None:
    box = Box.of(np.array([[-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0]]))
    parents = np.tile([0.5, -0.2, 0.1], (4000, 1))
    trials = np.tile([1.5, -7.0, 0.9], (4000, 1))
    box.repair(trials, parents, np.random.default_rng(0))
    for column, lower, upper in ((0, 0.5, 1.0), (1, -1.0, -0.2)):
        places = trials[:, column]
        assert lower <= places.min() and places.max() <= upper
        # Uniform: each tenth of the way gets its tenth, the one at the bound too.
        counts, _ = np.histogram(places, bins=10, range=(lower, upper))
        assert (np.abs(counts - 400) < 100).all()
    assert (trials[:, 2] == 0.9).all()
    assert not (np.abs(trials) == 1.0).any()


def test_repair_leaves_what_is_on_a_bound() -> None:
    box = Box.of(np.array([[0.0, 1.0]]))
    trials = np.array([[0.0], [1.0], [0.5]])
    box.repair(trials, np.full((3, 1), 0.7), np.random.default_rng(0))
    assert trials[:, 0].tolist() == [0.0, 1.0, 0.5]


def test_repair_never_rounds_out_of_the_box() -> None:
    rng = np.random.default_rng(0)
    lower = rng.normal(size=50) * 10.0 ** rng.integers(-9, 9, 50)
    box = Box(lower, np.nextafter(lower, np.inf))  # Two numbers wide.
    for side in (box.lower, box.upper):
        parents = np.tile(side, (200, 1))
        trials = parents + rng.choice([-1e9, 1e9], size=parents.shape)
        box.repair(trials, parents, rng)
        assert ((box.lower <= trials) & (trials <= box.upper)).all()


def test_bounds_are_copied() -> None:
    bounds = np.array([[0.0, 1.0]])
    box = Box.of(bounds)
    bounds[:] = 7.0
    assert (box.lower[0], box.upper[0]) == (0.0, 1.0)


def test_rows_that_the_caller_gave(refused: Callable[..., Any]) -> None:
    box = Box.of(np.array([[0.0, 1.0], [-1.0, 1.0]]))
    assert box.checked([[0, 1], [1, -1]], "K").tolist() == [[0.0, 1.0], [1.0, -1.0]]  # type: ignore[arg-type]
    with refused(OptionError, "shape", value=(2,), allowed="(K, 2)"):
        box.checked(np.zeros(2), "K")
    with refused(OptionError, "shape", value=(0, 2)):
        box.checked(np.zeros((0, 2)), "K")
    with refused(OptionError, "component 1 of row 2"):
        box.checked(np.array([[0.0, 0.0], [0.0, 0.0], [0.0, np.nan]]), "K")
