"""Folds, places, and errors of held-out measurements."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.fitted import Fit
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Measurements, Observations
from calib_pin.setup import DistanceSetup, FrameSetup, Setup
from calib_pin.validation import splits
from calib_pin.validation.held_out import left_out
from calib_pin.validation.splits import (
    CLUSTERS,
    FOLDS,
    OUTER,
    Grouping,
    places,
    regions,
    split,
    stretches,
)
from tests.shared import simulated

SETUP = Setup(parameters=("joint-offset",), tool_frame=FrameSetup((0.05, 0.08, 0.1)))


def measured_rows(
    setup: Setup = SETUP, *, count: int = 40, repeats: int = 1
) -> tuple[Chain, Observations]:
    """Positions of `space6`; the readings of a configuration differ by noise."""
    problem, _ = simulated(
        "position", setup, count, 1.0, 1, noise=5e-5, repeats=repeats
    )
    # Readings of one configuration need not stand side by side.
    order = np.random.default_rng(1).permutation(len(problem.data))
    return problem.chains[""], problem.data.rows(order)


# Folds.


def folds(rows: Observations, fitted: Fit, seed: int) -> list[NDArray[np.bool_]]:
    return splits.folds(Grouping.of(rows, fitted.problem.setup), fitted, seed)


def test_of_very_many_some_are_held_out(monkeypatch: pytest.MonkeyPatch) -> None:
    """In whole groups, of every part."""
    chain, rows = measured_rows(repeats=2)
    every = folds(rows, fit_model(chain, rows, SETUP, 0), 0)
    monkeypatch.setattr("calib_pin.estimation.problem.MANY", 1)
    monkeypatch.setattr("calib_pin.validation.splits.MOST", 4)
    model = fit_model(chain, rows, SETUP, 0)
    masks, groups = folds(rows, model, 0), rows.groups()
    assert model.problem.many and len(masks) == len(every)
    for mask, whole in zip(masks, every, strict=True):
        assert 2 <= mask.sum() < whole.sum() and not (mask & ~whole).any()
        np.testing.assert_array_equal(mask, np.isin(groups, groups[mask]))
    for part in left_out(model, masks):
        assert part is not None
        assert np.abs(part.after).max() < 3e-4 < np.abs(part.before).max()


@pytest.mark.parametrize("seed", [0, 1])
@pytest.mark.parametrize("repeats", [1, 4])
def test_repetitions_stay_together(repeats: int, seed: int) -> None:
    chain, rows = measured_rows(repeats=repeats, count=43)
    masks = folds(rows, fit_model(chain, rows, SETUP, 0), seed)
    assert len(masks) == FOLDS
    np.testing.assert_array_equal(np.sum(masks, axis=0), 1)
    configurations = [
        ({tuple(q) for q in rows.q[mask]}, {tuple(q) for q in rows.q[~mask]})
        for mask in masks
    ]
    assert all(left.isdisjoint(kept) for left, kept in configurations)
    assert sorted(len(left) for left, _ in configurations) == [8, 8, 9, 9, 9]


def test_few_configurations_have_no_folds() -> None:
    """What is fitted without a part must still determine the robot."""
    chain, rows = measured_rows()
    labels = rows.groups()
    rank = fit_model(chain, rows, SETUP, 0).structure.rank
    # So many configurations that four parts of five hold more values than that.
    enough = next(n for n in range(5, 40) if 3 * (n - -(-n // 5)) > rank)
    for count, expected in ((enough - 1, 0), (enough, FOLDS), (4, 0)):
        some = rows.rows(labels < count)
        assert len(folds(some, fit_model(chain, some, SETUP, 0), 0)) == expected
    # Repetitions do not help.
    thrice = rows.rows(np.repeat(np.flatnonzero(labels < enough - 1), 3))
    assert not folds(thrice, fit_model(chain, thrice, SETUP, 0), 0)


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
    keys = [BlockKey("position", "", s) for s in "abc"]
    stations = {s: FrameSetup((k, 1.0, 0.3)) for k, s in enumerate("abc")}
    setup, counts = replace(SETUP, stations=stations), (40, 12, 3)
    jobs = [
        simulated(keys, setup, count, again=count, key=key, noise=5e-5)[0]
        for key, count in zip(keys, counts, strict=True)
    ]
    rows = Observations.of(*(job.data for job in jobs))
    masks = folds(rows, fit_model(jobs[0].chains, rows, SETUP, 0), 0)
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
    # Neither a file nor a holdout makes up for it.
    for file, holdout in ((rows.rows(~of_q), None), (None, 0.2)):
        with pytest.raises(InputError, match="with the tool 'q' is left to fit"):
            split(Observations(tuple(blocks[:4])), SETUP, file, holdout, 0)
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


# Stretches of a path.


def measured(q: Floats, files: tuple[str, ...] = ()) -> Observations:
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
        assert (stretches(measured(q)) == -1).all()


def test_a_jogged_file_is_cut_into_blocks() -> None:
    rng = np.random.default_rng(1)
    q = jogged(rng)
    label = stretches(measured(q))
    sizes = np.bincount(label)
    assert 10 <= len(sizes) <= 40 and sizes.min() >= 2
    # They are contiguous.
    assert (np.diff(label) >= 0).all()
    # In random order the same configurations are as any others.
    assert (stretches(measured(q[rng.permutation(len(q))])) == -1).all()


def test_a_joint_that_stands_still_and_units_do_not_matter() -> None:
    q = jogged(np.random.default_rng(1))
    label = stretches(measured(q))
    still = np.column_stack([q * [1.0, 1.0, 1e-3, 1.0, 1.0, 5.0], np.ones(len(q))])
    np.testing.assert_array_equal(stretches(measured(still)), label)
    assert (stretches(measured(np.ones((30, 6)))) == -1).all()


def test_repetitions_belong_to_the_first() -> None:
    q = jogged(np.random.default_rng(1))
    label = stretches(measured(q))
    home = np.concatenate([q, q[:5], q[100:103]])
    again = stretches(measured(home))
    np.testing.assert_array_equal(again[: len(q)], label)
    np.testing.assert_array_equal(
        again[len(q) :], label[[0, 1, 2, 3, 4, 100, 101, 102]]
    )


def test_files_and_chains_have_paths_of_their_own() -> None:
    rng = np.random.default_rng(2)
    q = jogged(rng, 10)
    label = stretches(measured(q, ("a",) * 37 + ("b",) * 63))
    assert not set(label[:37]) & set(label[37:])
    first, second = jogged(rng), jogged(rng)
    blocks = [
        replace(
            measured(q, ("both.csv",) * len(q)).only,
            chain=chain,
            lines=2 * np.arange(len(q)) + begin,
        )
        for chain, q, begin in (("left", first, 1), ("right", second, 2))
    ]
    label = stretches(Observations(tuple(blocks)))
    left, right = np.split(label, 2)
    assert not set(left) & set(right)
    assert (np.diff(left) >= 0).all() and (np.diff(right) >= 0).all()


# Regions of joint space.


def grouping(q: Floats) -> Grouping:
    return Grouping.of(measured(q), Setup())


@pytest.fixture
def q() -> Floats:
    return np.random.default_rng(3).uniform(-1.0, 1.0, (80, 3)) * [1.0, 2.0, 0.5]


def test_outer_parts_of_joints_then_clusters(q: Floats) -> None:
    found = regions(grouping(q), 0)
    assert len(found) == 3 + CLUSTERS
    # The joint that moved most comes first, at its lower end.
    for mask, joint, sign in zip(found[:3], (1, 0, 2), (-1, 1, -1), strict=True):
        assert mask.sum() == round(OUTER * len(q))
        assert (sign * q[mask, joint]).min() > (sign * q[~mask, joint]).max()
    np.testing.assert_array_equal(np.sum(found[3:], axis=0), 1)
    points = np.concatenate([np.sin(q), np.cos(q)], axis=1)
    inside = sum(points[mask].var(axis=0).sum() * mask.mean() for mask in found[3:])
    assert inside < 0.8 * points.var(axis=0).sum()


def test_repetitions_stay_together_and_still_joints_have_no_part(q: Floats) -> None:
    q[:, 2] = 0.3
    twice = np.concatenate([q, q])
    found = regions(grouping(twice), 0)
    assert len(found) == 2 + CLUSTERS
    for mask in found:
        np.testing.assert_array_equal(mask[:80], mask[80:])


def test_few_configurations_have_no_regions(q: Floats) -> None:
    assert regions(grouping(q[:4]), 0) == []
    assert regions(grouping(np.tile(q[:1], (50, 1))), 0) == []
