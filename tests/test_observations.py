"""Blocks of measurements: their checks, and how rows are picked and joined."""

from __future__ import annotations

from dataclasses import replace
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


@pytest.mark.parametrize(
    "changes",
    [
        {"q": Q[:, :1]},
        {"q": Q[:4]},
        {"values": VALUES[:4]},
        {"target": ("u", "v")},
        {"conditions": Conditions(("a",))},
        {"conditions": Conditions(direction=np.ones((5, 3), np.int8))},
        {"conditions": Conditions(time=np.zeros(4))},
        {"conditions": Conditions(temperature=np.full(5, np.nan))},
        {"start": Q[:4]},
        {"validate": np.zeros(4, bool)},
        {"lines": np.arange(6)},
        {"files": ("m.csv",)},
        {"q": np.where(Q == 3.0, np.nan, Q)},
        {"values": np.where(VALUES == 3.0, np.inf, VALUES)},
        # Standard deviations are positive, finite, and have a row for each.
        *(
            {"sigma": sigma}
            for sigma in (
                VALUES,
                -1.0 - VALUES,
                np.where(VALUES == 3.0, np.inf, 1.0),
                np.where(VALUES == 3.0, np.nan, 1.0),
                np.ones((1, 3)),
                np.ones(3),
            )
        ),
    ],
)
def test_bad_fields(changes: dict[str, Any]) -> None:
    with pytest.raises(InputError):
        measurements(**changes)


@pytest.mark.parametrize(
    "index",
    [
        np.array([False, True, True, False, False]),
        np.array([4, 4, 0]),
        np.array([], int),
        np.array([-1]),
    ],
)
def test_rows_keep_together(index: Any) -> None:
    data = measurements()
    order = np.arange(5)[index]
    part = data.rows(index)
    assert len(part) == len(part.files) == len(order)
    assert (part.joints, part.model) == (data.joints, data.model)
    for name in ("q", "values", "sigma", "start", "validate", "lines"):
        np.testing.assert_array_equal(getattr(part, name), getattr(data, name)[order])
    assert part.target == tuple("uvwxy"[i] for i in order)
    assert part.payload == tuple("aabbc"[i] for i in order)
    assert [part.source(k) for k in range(len(part))] == [
        f"m.csv:{i + 2}" for i in order
    ]
    assert measurements(sigma=None).rows(index).sigma is None


def test_marked_rows_are_held_out() -> None:
    training, validation = fitted_and_held_out(Observations.of(measurements()))
    assert (training.target, validation.target) == (("u", "w", "x"), ("v", "y"))
    assert not training.validate.any() and validation.validate.all()


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
    assert data.sample(300) is data
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


def test_a_sample_keeps_images_whole() -> None:
    """What one image shows follows one another at one configuration."""
    q, pixels = np.repeat(np.arange(100.0), 4)[:, None], np.zeros((400, 2))
    corners = ("a", "b", "c", "d")
    data = Measurements(("j",), q, "camera", pixels, target=corners * 100)
    some = data.sample(40)
    assert some.target == corners * 10
    assert len(np.unique(some.q)) == 10 and some.q[-1, 0] == 99.0
    # Repetitions of one configuration are not an image.
    repeated = Measurements(("j",), np.zeros((100, 1)), "position", np.zeros((100, 3)))
    assert len(repeated.sample(10)) == 10


def test_groups_are_what_gaps_leave() -> None:
    """Gaps of more than a micrometer; jitter across a rounding edge is none."""
    q = np.array(
        [
            [0.1234565 - 2e-9, -0.7654325],
            [0.1234565 + 2e-9, -0.7654325 + 3e-9],
            [0.5, 0.5],
            # Close positions in a chain, which the other joint splits.
            [1.0, 0.0],
            [1.0 + 0.9e-6, 0.0],
            [1.0 + 1.8e-6, 0.3],
            [1.0 + 2.7e-6, 0.0],
            [0.0, 1e-9],
            [-0.0, -1e-9],
        ]
    )
    data = Measurements(("a", "b"), q, "position", np.zeros((9, 3)))
    label = data.groups()
    assert label.dtype == np.int64
    assert data.configurations == len(set(label)) == 6
    groups = {frozenset(np.flatnonzero(label == k).tolist()) for k in set(label)}
    assert groups == {
        frozenset(rows) for rows in ([0, 1], [2], [3, 4], [5], [6], [7, 8])
    }


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
    joined = Labels.concatenate([Labels.of("ab"), Labels.of("ca"), Labels.none()])
    assert joined == ("a", "b", "c", "a") and joined.names == ("a", "b", "c")
    # Changed names may coincide.
    labels = Labels.of(["ball@1", "rod@1", "ball@2"])[np.array([0, 2, 0])]
    changed = labels.map(lambda name: name.partition("@")[0])
    assert changed == ("ball",) * 3 and changed.names == ("ball",)


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
    bare = replace(data.rows(np.array([], int)), sigma=None)
    for pair in ([data, bare], [bare, data]):
        assert Measurements.concatenate(pair).sigma is not None
    for change in (
        {"joints": ("a", "c")},
        {"sigma": None},
        {"station": "north"},
        {"model": "camera"},
    ):
        with pytest.raises(InputError):
            Measurements.concatenate([data, measurements(**change)])


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
    seen = Observations.of(SOCKETS, rows_of("camera", 2, q=SOCKETS.q))
    assert seen.configurations == 2
    again = Observations.of(MIXED, SOCKETS)
    assert again.keys == MIXED.keys and len(again) == 8
    assert Observations.of(MIXED) is MIXED
    empty = IMAGE.rows(np.array([], int))
    assert Observations.of(empty, SOCKETS).keys == (SOCKETS.key,)
    assert Observations.of(SOCKETS).only is SOCKETS
    assert states_sigmas(MIXED)
    assert not states_sigmas(Observations.of(SOCKETS, replace(IMAGE, sigma=None)))
    for refused in (
        lambda: MIXED.only,
        lambda: Observations.of(),
        lambda: Observations.of(SOCKETS, replace(IMAGE, joints=("a", "c"))),
    ):
        with pytest.raises(InputError):
            refused()


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
    found = MIXED.weighted(weight)
    assert found.weight.tolist() == weight.tolist()
    assert found.blocks[1].weight.tolist() == [5.0]
    assert MIXED.weight.tolist() == [1.0] * 6


def test_one_target_of_two_instruments_is_two_things() -> None:
    twice = Observations.of(
        rows_of("position", 2, target=("a", "a")),
        rows_of("camera", 2, target=("a", "b")),
    )
    first, second, third, fourth = twice.things.tolist()
    assert first == second and len({second, third, fourth}) == 3


def test_rows_in_the_order_of_their_files() -> None:
    assert MIXED.in_order.tolist() == [0, 1, 4, 3, 5, 2]
    assert MIXED.source(5) == "c.csv:7" and MIXED.source(1) == "row 1"
    error = MIXED.error(3, "no", column="target", allowed="yes")
    assert (error.file, error.line, error.column) == ("c.csv", 4, "target")


def test_a_sample_of_several_blocks() -> None:
    many = Observations.of(
        rows_of("position", 4000, target=()), rows_of("camera", 100, target=())
    )
    few = many.sample(400)
    assert few.keys == many.keys
    assert [len(block) for block in few.blocks] == [390, 20]
    assert many.sample(5000) is many
