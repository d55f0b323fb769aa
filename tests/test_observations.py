"""Blocks of measurements: their checks, and how rows are picked and joined."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import FrozenInstanceError, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from calib_pin.errors import InputError
from calib_pin.measurement_models import declared
from calib_pin.observations import (
    BlockKey,
    Conditions,
    Labels,
    Measurements,
    Observations,
    fitted_and_held_out,
    states_sigmas,
)

Q = np.arange(10.0).reshape(5, 2)
VALUES = np.arange(15.0).reshape(5, 3)


def measurements(**changes: Any) -> Measurements:
    fields: dict[str, Any] = {
        "joints": ("a", "b"),
        "q": Q,
        "model": "position",
        "values": VALUES,
        "sigma": 0.1 + VALUES,
        "target": tuple("uvwxy"),
        "conditions": Conditions(tuple("aabbc")),
        "start": 10.0 + Q,
        "validate": np.array([False, True, False, False, True]),
        "lines": np.arange(2, 7),
        "files": ("m.csv",) * 5,
    }
    return Measurements(**{**fields, **changes})


def reason(call: Callable[[], object]) -> str:
    with pytest.raises(InputError) as caught:
        call()
    return caught.value.reason


def test_defaults() -> None:
    plain = Measurements(("a", "b"), Q, "position", VALUES)
    assert len(plain) == 5
    assert plain.sigma is None
    assert plain.target == plain.payload == plain.files == ("",) * 5
    assert plain.start.size == 0
    assert plain.key == BlockKey("position")
    assert not states_sigmas(Observations.of(plain))
    assert plain.validate.tolist() == [False] * 5
    assert plain.lines.tolist() == [0] * 5
    assert plain.source(3) == "row 3"
    empty = Measurements(("a", "b"), Q[:0], "position", VALUES[:0])
    assert len(empty) == 0 and empty.target == ()
    assert empty.groups().shape == (0,)


def test_is_frozen() -> None:
    with pytest.raises(FrozenInstanceError):
        measurements().model = "pose"  # type: ignore[misc]


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"q": Q[:, :1]}, "q has shape (5, 1), expected (5, 2)"),
        ({"q": Q[:4]}, "'values' has not the 4 rows of q"),
        ({"values": VALUES[:4]}, "'values' has not the 5 rows of q"),
        ({"target": ("u", "v")}, "'target' has not the 5 rows of q"),
        ({"conditions": Conditions(("a",))}, "'payload' has not the 5 rows of q"),
        ({"start": Q[:4]}, "start has shape (4, 2), not that of q"),
        ({"validate": np.zeros(4, bool)}, "'validate' has not the 5 rows of q"),
        ({"lines": np.arange(6)}, "'lines' has not the 5 rows of q"),
        ({"files": ("m.csv",)}, "'files' has not the 5 rows of q"),
        ({"q": np.where(Q == 3.0, np.nan, Q)}, "finite"),
        ({"values": np.where(VALUES == 3.0, np.inf, VALUES)}, "finite"),
        ({"sigma": VALUES}, "positive"),
        ({"sigma": -1.0 - VALUES}, "positive"),
        ({"sigma": np.where(VALUES == 3.0, np.inf, 1.0)}, "positive"),
        ({"sigma": np.where(VALUES == 3.0, np.nan, 1.0)}, "positive"),
    ],
)
def test_bad_fields(changes: dict[str, Any], part: str) -> None:
    assert part in reason(lambda: measurements(**changes))


@pytest.mark.parametrize(
    "index",
    [
        np.array([False, True, True, False, False]),
        np.array([2, 1]),
        np.array([4, 4, 0]),
        np.array([], int),
        np.zeros(5, bool),
        np.array([-1]),
    ],
)
def test_rows_keep_together(index: Any) -> None:
    data = measurements()
    order = np.arange(5)[index]
    part = data.rows(index)
    assert len(part) == len(order)
    assert (part.joints, part.model) == (data.joints, data.model)
    np.testing.assert_array_equal(part.q, Q[order])
    np.testing.assert_array_equal(part.values, VALUES[order])
    assert part.sigma is not None and data.sigma is not None
    np.testing.assert_array_equal(part.sigma, data.sigma[order])
    assert part.target == tuple("uvwxy"[i] for i in order)
    assert part.payload == tuple("aabbc"[i] for i in order)
    np.testing.assert_array_equal(part.start, data.start[order])
    np.testing.assert_array_equal(part.validate, data.validate[order])
    np.testing.assert_array_equal(part.lines, data.lines[order])
    assert len(part.files) == len(order)
    assert measurements(sigma=None).rows(index).sigma is None
    assert measurements(start=np.zeros((0, 0))).rows(index).start.size == 0


def test_split() -> None:
    training, validation = fitted_and_held_out(Observations.of(measurements()))
    assert (training.target, validation.target) == (("u", "w", "x"), ("v", "y"))
    assert not training.validate.any() and validation.validate.all()


def test_few_rows_are_their_own_sample() -> None:
    data = measurements()
    assert data.sample(5) is data
    assert data.sample(6) is data


@pytest.mark.parametrize(
    ("count", "kept"),
    [(1, []), (7, []), (60, [48, 20, 10]), (150, [120, 25, 10]), (300, [240, 50, 10])],
)
def test_a_sample_has_rows_of_every_target(count: int, kept: list[int]) -> None:
    target = np.repeat(["wall", "floor", "post"], [240, 50, 10])
    target = np.random.default_rng(0).permutation(target)
    data = Measurements(
        ("j",),
        np.arange(300.0)[:, None],
        "plane-distance",
        -np.arange(300.0)[:, None],
        target=tuple(target.tolist()),
        lines=np.arange(2, 302),
    )
    part = data.sample(count)
    rows = part.q[:, 0].astype(int)
    assert (np.diff(rows) > 0).all()
    found = [part.target.count(name) for name in ("wall", "floor", "post")]
    # Shares of the rows, but twenty of a target where that is not too much.
    assert count < 60 or found == kept
    assert len(part) == count or count >= 60
    # What belongs together stays together.
    np.testing.assert_array_equal(part.values[:, 0], -rows)
    np.testing.assert_array_equal(part.lines, rows + 2)
    assert part.target == tuple(target[rows].tolist())


def test_a_sample_is_spread_over_the_rows() -> None:
    data = Measurements(
        ("j",), np.arange(1e4)[:, None], "position", np.zeros((10**4, 3))
    )
    rows = data.sample(101).q[:, 0]
    assert (rows[0], rows[-1], len(rows)) == (0, 9999, 101)
    assert set(np.diff(rows)) <= {99, 100}


def test_a_sample_keeps_images_whole() -> None:
    """What one image shows follows one another at one configuration."""
    data = Measurements(
        ("j",),
        np.repeat(np.arange(100.0), 4)[:, None],
        "camera",
        np.zeros((400, 2)),
        target=("a", "b", "c", "d") * 100,
    )
    some = data.sample(40)
    assert some.target == ("a", "b", "c", "d") * 10
    assert len(np.unique(some.q)) == 10 and some.q[-1, 0] == 99.0
    # Repetitions of one configuration are not an image.
    repeated = Measurements(("j",), np.zeros((100, 1)), "position", np.zeros((100, 3)))
    assert len(repeated.sample(10)) == 10


def test_places_are_those_of_the_file() -> None:
    assert measurements().source(1) == "m.csv:3"
    assert measurements().rows(np.array([4, 0])).source(0) == "m.csv:6"


def test_groups_are_equal_configurations() -> None:
    q = np.array([[1, 2], [3, 4], [1, 2 + 1e-9], [1, 2.1], [0, 1e-9], [-0.0, -1e-9]])
    label = measurements(
        q=q,
        values=np.zeros((6, 3)),
        sigma=None,
        target=(),
        conditions=Conditions(),
        start=np.zeros((0, 0)),
        validate=np.zeros(0, bool),
        lines=np.zeros(0, np.int64),
        files=(),
    ).groups()
    assert label.dtype == np.int64
    same = label[:, None] == label[None, :]
    expected = np.eye(6, dtype=bool)
    expected[0, 2] = expected[2, 0] = expected[4, 5] = expected[5, 4] = True
    np.testing.assert_array_equal(same, expected)


def test_groups_are_what_gaps_leave() -> None:
    """Close positions in chains: what splits by one joint may split by another."""
    rng = np.random.default_rng(0)
    steps = np.array([0.0, 0.9e-6, 1.8e-6, 2.7e-6, 1.0])
    for _ in range(200):
        q = rng.choice(steps, size=(6, 2))
        data = Measurements(("a", "b"), q, "position", np.zeros((6, 3)))
        label = data.groups()
        assert sorted(set(label)) == list(range(data.configurations))
        parts = [list(range(6))]
        while True:
            split = [piece for part in parts for piece in _cut(q, part)]
            if split == parts:
                break
            parts = split
        assert {frozenset(np.flatnonzero(label == k)) for k in set(label)} == {
            frozenset(part) for part in parts
        }


def _cut(q: np.ndarray, rows: list[int]) -> list[list[int]]:
    """Cut rows at gaps of more than a micrometer, joint by joint."""
    parts = [rows]
    for joint in range(q.shape[1]):
        cut = []
        for part in parts:
            order = sorted(part, key=lambda row: q[row, joint])
            cut.append([order[0]])
            for before, row in pairwise(order):
                if q[row, joint] - q[before, joint] > 1e-6:
                    cut.append([])
                cut[-1].append(row)
        parts = cut
    return sorted(sorted(part) for part in parts)


# Names.


def test_labels_are_a_sequence_of_names() -> None:
    labels = Labels.of(["b", "a", "b", ""])
    assert labels == ["b", "a", "b", ""] and labels != ["b", "a", "b"]
    assert (labels.names, labels.codes.tolist()) == (("b", "a", ""), [0, 1, 0, 2])
    assert labels[1] == "a" and labels[1:] == ("a", "b", "")
    some = labels[np.array([3, 1])]
    assert some == ("", "a") and some.distinct == ("", "a")
    assert labels.where("b").tolist() == [True, False, True, False]
    assert not labels.where("c").any()
    assert Labels.of(labels) is labels


def test_changed_names_may_coincide() -> None:
    labels = Labels.of(["ball@1", "rod@1", "ball@2"])[np.array([0, 2, 0])]
    changed = labels.map(lambda name: name.partition("@")[0])
    assert changed == ("ball",) * 3 and changed.names == ("ball",)


def test_labels_behind_one_another() -> None:
    joined = Labels.concatenate([Labels.of("ab"), Labels.of("ca"), Labels.none()])
    assert joined == ("a", "b", "c", "a") and joined.names == ("a", "b", "c")


# Blocks.


def test_concatenate() -> None:
    data = measurements()
    parts = [data.rows(np.array(rows, int)) for rows in ([0], [1, 2, 3], [], [4])]
    joined = Measurements.concatenate(parts)
    for name in ("q", "values", "sigma", "start", "validate", "lines"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(data, name))
    for name in ("target", "payload", "files"):
        assert getattr(joined, name) == getattr(data, name)
    plain = [replace(part, sigma=None) for part in parts]
    assert Measurements.concatenate(plain).sigma is None
    # Rows that are not there have no standard deviations that could be unlike others.
    empty = data.rows(np.array([], int))
    for pair in (
        [data, replace(empty, sigma=None)],
        [replace(empty, sigma=None), data],
    ):
        assert Measurements.concatenate(pair).sigma is not None
    assert Measurements.concatenate([empty, empty]).sigma is not None


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"joints": ("a", "c")}, "cannot join measurements of different joints"),
        ({"sigma": None}, "with and without standard deviations"),
        ({"station": "north"}, "cannot join measurements of different blocks"),
        ({"model": "camera"}, "cannot join measurements of different blocks"),
    ],
)
def test_what_cannot_be_joined(changes: dict[str, Any], part: str) -> None:
    pair = [measurements(), measurements(**changes)]
    assert part in reason(lambda: Measurements.concatenate(pair))


def rows_of(model: str, count: int, **changes: Any) -> Measurements:
    """Rows of a model with values that tell them apart."""
    stated = declared(model)
    width, components = len(stated.values), len(stated.components)
    fields: dict[str, Any] = {
        "joints": ("a", "b"),
        "q": np.arange(2.0 * count).reshape(count, 2) + len(model),
        "model": model,
        "values": np.arange(1.0, 1.0 + count * width).reshape(count, width),
        "sigma": np.full((count, components), 0.5),
        "target": tuple(f"{model[0]}{k}" for k in range(count)),
    }
    return Measurements(**{**fields, **changes})


SOCKETS = rows_of("fixed-point", 2, conditions=Conditions(("p", "")))
IMAGE = rows_of("camera", 1, lines=np.array([7]), files=("c.csv",), tool="eye")
MORE = rows_of("fixed-point", 3, lines=np.array([9, 4, 3]), files=("c.csv",) * 3)
MIXED = Observations.of(SOCKETS, IMAGE, MORE)


def test_measurements_of_one_block_are_joined() -> None:
    assert MIXED.keys == (BlockKey("fixed-point"), BlockKey("camera", tool="eye"))
    assert [str(key) for key in MIXED.keys] == ["fixed-point", "camera, tool eye"]
    assert MIXED.models == ("fixed-point", "camera")
    assert [len(block) for block in MIXED.blocks] == [5, 1] and len(MIXED) == 6
    assert MIXED.slices == (slice(0, 5), slice(5, 6))
    assert MIXED.block_of.tolist() == [0] * 5 + [1]
    assert MIXED.target == ("f0", "f1", "f0", "f1", "f2", "c0")
    assert MIXED.payload == ("p", "", "", "", "", "")
    np.testing.assert_array_equal(MIXED.q, np.vstack([SOCKETS.q, MORE.q, IMAGE.q]))
    assert MIXED.weight.tolist() == [1.0] * 6
    again = Observations.of(MIXED, SOCKETS)
    assert again.keys == MIXED.keys and len(again) == 8
    assert Observations.of(MIXED) is MIXED


def test_blocks_without_measurements_are_left_out() -> None:
    empty = IMAGE.rows(np.array([], int))
    assert Observations.of(empty, SOCKETS).keys == (SOCKETS.key,)
    assert Observations.of(empty).only is not None
    assert "no measurements" in reason(lambda: Observations.of())


def test_the_only_block() -> None:
    assert Observations.of(SOCKETS).only is SOCKETS
    assert "there are 2 blocks" in reason(lambda: MIXED.only)


def test_all_blocks_have_the_same_joints() -> None:
    other = replace(IMAGE, joints=("a", "c"))
    assert "different joints" in reason(lambda: Observations.of(SOCKETS, other))


def test_rows_of_several_blocks() -> None:
    some = MIXED.rows(np.array([1, 4, 5]))
    assert some.keys == MIXED.keys and some.target == ("f1", "f2", "c0")
    mask = np.arange(6) == 5
    assert MIXED.rows(mask).keys == (IMAGE.key,)
    np.testing.assert_array_equal(MIXED.rows(mask).only.values, IMAGE.values)
    nothing = MIXED.rows(np.zeros(6, bool))
    assert len(nothing) == 0 and nothing.keys == (SOCKETS.key,)


def test_weights_of_several_blocks() -> None:
    weight = np.arange(6.0)
    grouped = MIXED.groups()
    found = MIXED.weighted(weight)
    assert found.weight.tolist() == weight.tolist()
    assert found.blocks[1].weight.tolist() == [5.0]
    assert found.groups() is grouped and found.target == MIXED.target
    assert MIXED.weight.tolist() == [1.0] * 6


def test_one_target_of_two_instruments_is_two_things() -> None:
    twice = Observations.of(
        rows_of("position", 2, target=("a", "a")),
        rows_of("camera", 2, target=("a", "b")),
    )
    first, second, third, fourth = twice.things().tolist()
    assert first == second and len({second, third, fourth}) == 3


def test_configurations_are_those_of_all_blocks() -> None:
    seen = rows_of("camera", 2, q=SOCKETS.q)
    both = Observations.of(SOCKETS, seen)
    assert both.configurations == 2
    assert both.groups().tolist() == [*SOCKETS.groups(), *seen.groups()]


def test_rows_in_the_order_of_their_files() -> None:
    assert MIXED.in_order.tolist() == [0, 1, 4, 3, 5, 2]
    assert MIXED.source(5) == "c.csv:7" and MIXED.source(1) == "row 1"
    error = MIXED.error(3, "no", column="target", allowed="yes")
    assert (error.file, error.line, error.column) == ("c.csv", 4, "target")
    assert MIXED.error(1, "no").reason == "row 1: no"


def test_a_sample_of_several_blocks() -> None:
    many = Observations.of(
        rows_of("position", 4000, target=()), rows_of("camera", 100, target=())
    )
    few = many.sample(400)
    assert few.keys == many.keys
    assert [len(block) for block in few.blocks] == [390, 20]
    assert many.sample(5000) is many


def test_stated_standard_deviations() -> None:
    assert states_sigmas(MIXED)
    assert not states_sigmas(Observations.of(SOCKETS, replace(IMAGE, sigma=None)))


def test_repetitions_with_jitter_across_a_rounding_edge_stay_together() -> None:
    base = np.array([[0.1234565, -0.7654325], [0.5, 0.5]])
    q = np.repeat(base, 3, axis=0)
    q[:3] += np.array([[-2e-9, 2e-9], [2e-9, -2e-9], [0.0, 3e-9]])
    rows = Measurements(("a", "b"), q, "position", np.zeros((6, 3)))
    labels = rows.groups()
    assert len(set(labels[:3])) == len(set(labels[3:])) == 1
    assert labels[0] != labels[3]


@pytest.mark.parametrize("shape", [(2, 3), (1, 3), (3,)])
def test_sigma_has_a_row_for_each_measurement(shape: tuple[int, ...]) -> None:
    with pytest.raises(InputError, match="3 rows"):
        Measurements(
            ("a",), np.zeros((3, 1)), "position", np.zeros((3, 3)), np.ones(shape)
        )
