"""Folds, places, and errors of held-out measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import calib_pin
from calib_pin.errors import InputError
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import error_table
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import BlockKey, Measurements, Observations
from calib_pin.progress import portion
from calib_pin.setup import DistanceSetup, FrameSetup, PointSetup, Setup
from calib_pin.validation import splits
from calib_pin.validation.held_out import cross_validate
from calib_pin.validation.model_errors import fitted_errors, model_errors
from calib_pin.validation.splits import FOLDS, Grouping, places, split

SETUP = Setup(parameters=("joint-offset",), tool_frame=FrameSetup((0.05, 0.08, 0.1)))


def measured_rows(
    setup: Setup = SETUP, *, count: int = 40, repeats: int = 1
) -> tuple[Chain, Observations]:
    """Positions of `space6`; the readings of a configuration differ by noise."""
    chain = calib_pin.load_chain("space6")
    problem = nominal_problem(chain, "position", setup)
    rng = np.random.default_rng(1)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(
        problem, truth, rng, count=count, noise=5e-5, repeats=repeats
    )
    # Readings of one configuration need not stand side by side.
    return chain, Observations.of(rows.only.rows(rng.permutation(len(rows))))


# Folds.


def folds(rows: Observations, fitted: Fit, seed: int) -> list[NDArray[np.bool_]]:
    return splits.folds(Grouping.of(rows, fitted.problem.setup), fitted, seed)


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("repeats", [1, 4])
def test_repetitions_stay_together(repeats: int, seed: int) -> None:
    chain, rows = measured_rows(repeats=repeats, count=43)
    masks = folds(rows, fit_model(chain, rows, SETUP, 0).fit, seed)
    assert len(masks) == FOLDS
    np.testing.assert_array_equal(np.sum(masks, axis=0), 1)
    configurations = [
        ({tuple(q) for q in rows.q[mask]}, {tuple(q) for q in rows.q[~mask]})
        for mask in masks
    ]
    assert all(left.isdisjoint(kept) for left, kept in configurations)
    assert sorted(len(left) for left, _ in configurations) == [8, 8, 9, 9, 9]


def test_folds_are_drawn_by_the_seed() -> None:
    chain, rows = measured_rows()
    fitted = fit_model(chain, rows, SETUP, 0).fit
    first, again, other = (np.array(folds(rows, fitted, seed)) for seed in (3, 3, 4))
    assert np.array_equal(first, again)
    assert not np.array_equal(first, other)


def test_few_configurations_have_no_folds() -> None:
    """What is fitted without a part must still determine the robot."""
    chain, rows = measured_rows()
    labels = rows.groups()
    rank = fit_model(chain, rows, SETUP, 0).fit.structure.rank
    # So many configurations that four parts of five hold more values than that.
    enough = next(n for n in range(5, 40) if 3 * (n - -(-n // 5)) > rank)
    for count, expected in ((enough - 1, 0), (enough, FOLDS), (4, 0)):
        some = rows.rows(labels < count)
        assert len(folds(some, fit_model(chain, some, SETUP, 0).fit, 0)) == expected
    # Repetitions do not help.
    thrice = rows.rows(np.repeat(np.flatnonzero(labels < enough - 1), 3))
    assert not folds(thrice, fit_model(chain, thrice, SETUP, 0).fit, 0)


def at_stations(*counts: int, tools: Sequence[str] = ("",)) -> Observations:
    """Positions of random configurations, so many of each station and tool."""
    keys = [BlockKey("position", "", s, t) for s in "abc" for t in tools]
    rng = np.random.default_rng(0)
    return Observations.of(
        *(
            Measurements(
                tuple("jklmno"),
                rng.uniform(-2.0, 2.0, (count, 6)),
                values=np.zeros((count, 3)),
                **key._asdict(),
            )
            for key, count in zip(keys, counts, strict=False)
        )
    )


def test_every_fold_has_its_share_of_every_station() -> None:
    chain = calib_pin.load_chain("space6")
    keys = [BlockKey("position", "", s) for s in "abc"]
    stations = {s: FrameSetup((k, 1.0, 0.3)) for k, s in enumerate("abc")}
    problem = nominal_problem(chain, keys, replace(SETUP, stations=stations))
    rng, still = np.random.default_rng(0), np.zeros(len(problem.parameters))
    rows = Observations.of(
        *(
            calib_pin.simulate(problem, still, rng, key=key, count=count, noise=5e-5)
            for key, count in zip(keys, (40, 12, 3), strict=True)
        )
    )
    masks = folds(rows, fit_model(chain, rows, SETUP, 0).fit, 0)
    assert len(masks) == FOLDS
    sizes = np.array([np.bincount(rows.block_of[mask], minlength=3) for mask in masks])
    # Without one of its three configurations nobody knew where the last one is.
    assert sizes[:, 2].tolist() == [0] * FOLDS
    assert sizes[:, 0].tolist() == [8] * FOLDS
    assert sorted(sizes[:, 1]) == [2, 2, 2, 3, 3]


@pytest.mark.parametrize("seed", range(5))
def test_a_holdout_has_its_share_of_every_tool(seed: int) -> None:
    rows = at_stations(40, 20, 10, 4, tools=("p", "q"))
    left, held, method = split(rows, SETUP, None, 0.25, seed)
    assert held is not None and method == "holdout"
    assert list(map(len, held.blocks)) == [10, 5, 2, 1]
    assert len(left) + len(held) == len(rows)


def test_validation_of_what_is_not_fitted_is_refused() -> None:
    rows = at_stations(9, 9, 9, 9, tools=("p", "q"))
    of_q = np.array([key.tool == "q" for key in rows.keys])[rows.block_of]
    of_b = rows.block_of >= 2
    blocks = [
        replace(block, validate=mask[part])
        for mask in (of_q, of_b)
        for block, part in zip(rows.blocks, rows.slices, strict=True)
    ]
    with pytest.raises(InputError, match="with the tool 'q' is left to fit: all are"):
        split(Observations(tuple(blocks[:4])), SETUP, None, None, 0)
    _, held, method = split(Observations(tuple(blocks[4:])), SETUP, None, None, 0)
    assert held is not None and (len(held), method) == (18, "set")
    with pytest.raises(InputError, match="cannot be checked: no 'position' measure"):
        split(rows.rows(~of_q), SETUP, rows.rows(of_q), None, 0)


# Places.


def at_places(*names: str, positions: int = 0, station: str = "") -> Observations:
    """One row for each socket, which nobody looks at closer, and some positions."""
    q = np.arange(len(names) + positions, dtype=float)[:, None]
    count = len(names)
    none = np.zeros((count, 0))
    return Observations.of(
        Measurements(
            ("j",), q[:count], "fixed-point", none, target=names, station=station
        ),
        Measurements(("j",), q[count:], "position", np.zeros((positions, 3))),
    )


def labels(*names: str, apart: Any = ()) -> list[int]:
    return labels_of(at_places(*names), apart)


def labels_of(rows: Observations, apart: Any = ()) -> list[int]:
    distances = tuple(DistanceSetup(pair, 0.1, 1e-5) for pair in apart)
    return places(rows, Setup(distances=distances)).tolist()


def test_sockets_of_one_place_share_what_stands_before_the_slash() -> None:
    names = ("front/0", "left/0", "front/1", "back", "left/1", "back")
    assert labels(*names) == [0, 1, 0, 2, 1, 2]
    assert labels("hall/a/0", "hall/b/0", "hall/a/1", "c") == [0, 1, 0, 2]
    # Whichever ball is in them.
    assert labels("red@a/0", "blue@b/0", "blue@a/1", "c/0") == [0, 1, 0, 2]


def test_a_known_distance_makes_one_place() -> None:
    names = ("a", "b", "c", "d", "e")
    assert labels(*names) == [0, 1, 2, 3, 4]
    assert labels(*names, apart=[("a", "c")]) == [0, 1, 0, 2, 3]
    # One after the other, and with sockets that no row names.
    chained = [("e", "a"), ("c", "a"), ("b", "nowhere")]
    found = labels(*names, apart=chained)
    assert found[0] == found[2] == found[4] and len(set(found)) == 3
    assert labels("a/0", "b/0", "c/0", "d/0", apart=[("a/0", "d/0")]) == [0, 1, 2, 0]


def test_too_few_places_are_none() -> None:
    assert labels("front/0", "front/1", "left/0") == [-1, -1, -1]
    assert labels("a", "b", "c", apart=[("a", "b")]) == [-1, -1, -1]
    assert labels() == []


def test_sockets_of_two_stations_are_at_other_places() -> None:
    names = ("a/0", "a/1", "back", "back")
    rows = Observations.of(at_places(*names), at_places(*names, station="hall"))
    assert labels_of(rows) == [0, 0, 1, 1, 2, 2, 3, 3]
    assert labels_of(rows, [("hall/a/0", "hall/back")]) == [0, 0, 1, 1, 2, 2, 2, 2]


AT = {
    "front": ((0.6, 0.3, 0.4), (0.65, 0.3, 0.4)),
    "left": ((0.5, -0.2, 0.6), (0.5, -0.15, 0.6)),
    "back": ((-0.4, 0.4, 0.5), (-0.4, 0.4, 0.55)),
}
SOCKETS = {
    f"{place}/{k}": PointSetup(xyz)
    for place, both in AT.items()
    for k, xyz in enumerate(both)
}
BALL = FrameSetup((0.05, 0.08, 0.1), (0.0, 0.0, 0.0), estimate=True)
FIFTY = tuple(DistanceSetup((f"{place}/0", f"{place}/1"), 0.05, 1e-5) for place in AT)
IN_SOCKETS = Setup(parameters=("joint-offset",), distances=FIFTY)


@pytest.fixture(scope="module")
def in_sockets() -> tuple[Chain, Observations]:
    """A ball in two sockets at each of three places, 50 mm apart."""
    chain = calib_pin.load_chain("space6")
    setup = replace(IN_SOCKETS, sockets=SOCKETS, tool_frame=BALL)
    problem = nominal_problem(chain, "fixed-point", setup)
    rng = np.random.default_rng(1)
    truth = 3.0 * calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, truth, rng, count=90, noise=5e-5)
    return chain, rows


def test_places_are_left_out_as_a_whole(in_sockets: tuple[Chain, Observations]) -> None:
    chain, rows = in_sockets
    fitted = fit_model(chain, rows, IN_SOCKETS, 0).fit
    masks = folds(rows, fitted, 0)
    name = Grouping.of(rows, IN_SOCKETS).validation_name(len(masks))
    assert name == "leave-one-place-out"
    left_out = [
        {name[:-2] for name, left in zip(rows.target, mask, strict=True) if left}
        for mask in masks
    ]
    assert sorted(left_out, key=min) == [{"back"}, {"front"}, {"left"}]
    np.testing.assert_array_equal(np.sum(masks, axis=0), 1)
    # Repetitions or not: one place is one part.
    again = rows.rows(np.repeat(np.arange(90), 2))
    assert len(folds(again, fitted, 0)) == 3


def test_sockets_that_were_not_fitted(in_sockets: tuple[Chain, Observations]) -> None:
    """They are where their rows put them, and their distance is there to be found."""
    chain, rows = in_sockets
    of_back = np.array([name.startswith("back") for name in rows.target])
    trained = fit_model(chain, rows.rows(~of_back), IN_SOCKETS, 0)
    known = {name for _, name in trained.problem.references}
    assert known == set(SOCKETS) - {"back/0", "back/1"}
    unseen = model_errors(trained, rows.rows(of_back), np.flatnonzero(of_back))
    np.testing.assert_array_equal(unseen.positions, np.flatnonzero(of_back))
    sizes = [np.linalg.norm(e, axis=1).mean() for e in (unseen.before, unseen.after)]
    # The noise of 50 um in three directions, against offsets of 3 mrad.
    assert sizes[1] < 1.2e-4 and sizes[0] > 2e-3
    back = np.array(rows.target)[of_back]
    for name in ("back/0", "back/1"):
        np.testing.assert_allclose(
            unseen.after[back == name].mean(axis=0), 0.0, atol=1e-9
        )
    (distance,) = unseen.distances
    assert distance.between == ("back/0", "back/1") and not distance.fitted
    assert (distance.value, distance.sigma) == (0.05, 1e-5)
    assert abs(distance.found - 0.05) < 1e-4 < abs(distance.nominal - 0.05)
    # Those that were fitted are told of with the fit.
    fitted = {
        d.between[0]: d for d in fitted_errors(trained, rows.rows(~of_back)).distances
    }
    assert set(fitted) == {"front/0", "left/0"}
    for d in fitted.values():
        assert d.fitted and abs(d.found - 0.05) < 3e-5
    # A row of a fitted socket has its place, whatever it says.
    of_others = np.flatnonzero(~of_back)
    seen = model_errors(trained, rows.rows(~of_back), of_others)
    assert seen.distances == ()
    errors = error_table(trained.fit.problem, trained.fit.theta)
    np.testing.assert_allclose(seen.after, errors, rtol=0, atol=1e-9)


# Cross-validation.


def test_unseen_rows_are_not_fitted() -> None:
    chain, rows = measured_rows(repeats=2)
    alike = fit_model(chain, rows, SETUP, 0)
    masks = folds(rows, alike.fit, 0)
    parts = list(cross_validate(chain, rows, SETUP, masks, 0, alike))
    positions = np.concatenate([part.positions for part in parts])
    assert sorted(positions) == list(range(len(rows)))
    for part, mask in zip(parts, masks, strict=True):
        np.testing.assert_array_equal(part.positions, np.flatnonzero(mask))
        assert part.before.shape == part.after.shape == (mask.sum(), 3)
        assert np.abs(part.after).max() < 3e-4 < np.abs(part.before).max()
    # Whatever the left-out values are, the model that meets them is the same.
    values = rows.only.values.copy()
    values[masks[2]] += 0.01
    spoiled = Observations.of(replace(rows.only, values=values))
    (_, _, third, *_) = cross_validate(chain, spoiled, SETUP, masks, 0, alike)
    np.testing.assert_allclose(third.after, parts[2].after - 0.01, rtol=0, atol=1e-12)


def test_a_portion_never_goes_back() -> None:
    told: list[float] = []
    part = portion(told.append, 0.2, 0.4)
    assert part is not None
    for done in (0.5, 0.1, 1.0, 0.0):
        part(done)
    np.testing.assert_allclose(told, [0.2, 0.4, 0.4, 0.6, 0.6])
    assert portion(None, 0.0, 1.0) is None
