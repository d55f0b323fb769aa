"""The `Measurements` dataclass: its checks, and how rows are picked and joined."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import FrozenInstanceError, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from calib_pin.errors import InputError
from calib_pin.measurement_models import declared
from calib_pin.measurement_models.side_by_side import concatenate, targets_of
from calib_pin.observations import Measurements, fitted_and_held_out, states_sigmas

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
        "payload": tuple("aabbc"),
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
    assert plain.parts == ("position",)
    assert not states_sigmas(plain)
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
        ({"payload": ("a",)}, "'payload' has not the 5 rows of q"),
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
    training, validation = fitted_and_held_out(measurements())
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
        payload=(),
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


def test_concatenate() -> None:
    data = measurements()
    parts = [data.rows(np.array(rows, int)) for rows in ([0], [1, 2, 3], [], [4])]
    joined = concatenate(parts)
    for name in ("q", "values", "sigma", "start", "validate", "lines"):
        np.testing.assert_array_equal(getattr(joined, name), getattr(data, name))
    for name in ("target", "payload", "files"):
        assert getattr(joined, name) == getattr(data, name)
    plain = [replace(part, sigma=None) for part in parts]
    assert concatenate(plain).sigma is None
    # Rows that are not there have no standard deviations that could be unlike others.
    empty = data.rows(np.array([], int))
    for pair in (
        [data, replace(empty, sigma=None)],
        [replace(empty, sigma=None), data],
    ):
        assert states_sigmas(concatenate(pair))
    assert concatenate([empty, empty]).sigma is not None


def rows_of(model: str, count: int, **changes: Any) -> Measurements:
    """Rows of a model with values that tell them apart."""
    stated = declared(model)
    width, components = len(stated.values), len(stated.components)
    q = np.arange(2.0 * count).reshape(count, 2) + len(model)
    fields: dict[str, Any] = {
        "joints": ("a", "b"),
        "q": q,
        "model": model,
        "values": np.arange(1.0, 1.0 + count * width).reshape(count, width),
        "sigma": np.full((count, components), 0.5),
        "target": tuple(f"{model[0]}{k}" for k in range(count)),
    }
    return Measurements(**{**fields, **changes})


def test_concatenate_models() -> None:
    sockets = rows_of("fixed-point", 2, sigma=None, payload=("p", ""))
    cameras = rows_of("camera", 1, lines=np.array([7]), files=("c.csv",))
    moved = rows_of("relative-distance", 1, start=np.array([[8.0, 9.0]]))
    data = concatenate([sockets, cameras, moved, sockets])
    assert data.model == "fixed-point+camera+relative-distance"
    assert data.parts == ("fixed-point", "camera", "relative-distance")
    assert data.target == (
        *("fixed-point:f0", "fixed-point:f1", "camera:c0", "relative-distance:r0"),
        *("fixed-point:f0", "fixed-point:f1"),
    )
    assert targets_of(data, "fixed-point") == ("f0", "f1", "", "", "f0", "f1")
    assert targets_of(data, "camera") == ("", "", "c0", "", "", "")
    assert data.payload == ("p", "", "", "", "p", "")
    assert data.values.tolist() == [
        *([[0, 0, 0]] * 2),
        [1, 2, 0],
        [0, 0, 1],
        *([[0, 0, 0]] * 2),
    ]
    nan, inf = np.nan, np.inf
    socket = [nan, nan, nan, inf, inf, inf]
    assert data.sigma is not None and not states_sigmas(data)
    np.testing.assert_array_equal(
        data.sigma,
        [
            *(socket, socket),
            [inf, inf, inf, 0.5, 0.5, inf],
            [inf, inf, inf, inf, inf, 0.5],
            *(socket, socket),
        ],
    )
    nowhere = [nan, nan]
    np.testing.assert_array_equal(
        data.start, [nowhere, nowhere, nowhere, [8, 9], nowhere, nowhere]
    )
    assert data.source(2) == "c.csv:7"
    np.testing.assert_array_equal(data.q[3:4], moved.q)
    part = data.rows(np.array([3, 2]))
    assert part.model == data.model
    np.testing.assert_array_equal(part.start, [[8, 9], nowhere])


def test_concatenate_mixtures() -> None:
    one = rows_of("position", 2)
    two = rows_of("camera", 2)
    three = rows_of("plane-contact", 1)
    at_once = concatenate([one, two, three])
    assert states_sigmas(at_once)
    for parts in (
        [concatenate([one, two]), three],
        [one, concatenate([two, three])],
        [one, two.rows(np.array([], int)), two, three.rows(np.array([], int)), three],
        # What a mixture has no rows of does not count.
        [concatenate([one, two]).rows(np.array([0, 1])), two, three],
    ):
        joined = concatenate(parts)
        assert (joined.model, joined.target) == (at_once.model, at_once.target)
        for name in ("q", "values", "sigma"):
            np.testing.assert_array_equal(getattr(joined, name), getattr(at_once, name))
    turned = concatenate([two, concatenate([one, two])])
    assert turned.model == "camera+position"
    np.testing.assert_array_equal(
        turned.values[:, :2], [[1, 2], [3, 4], [0, 0], [0, 0], [1, 2], [3, 4]]
    )
    # Without rows it still has the columns.
    empty = concatenate([one, two.rows(np.array([], int))])
    assert empty.model == "position+camera"
    assert empty.values.shape == (2, 5)


def test_some_rows_of_a_model_without_standard_deviations_cannot_be_joined() -> None:
    one, two = rows_of("position", 2), rows_of("camera", 2)
    plain = replace(two, sigma=None, files=("c.csv", "c.csv"))
    for parts in (
        [one, two, plain],
        [concatenate([one, two]), plain],
        [two, concatenate([one, plain])],
    ):
        refused = reason(lambda parts=parts: concatenate(parts))
        assert "with and without standard deviations" in refused


@pytest.mark.parametrize("wrong", [0.0, -1.0, -np.inf])
def test_standard_deviations_of_mixtures_are_positive(wrong: float) -> None:
    data = concatenate([rows_of("position", 1), rows_of("camera", 1)])
    assert data.sigma is not None
    sigma = data.sigma.copy()
    sigma[0, 0] = wrong
    assert "positive" in reason(lambda: replace(data, sigma=sigma))


@pytest.mark.parametrize(
    ("changes", "part"),
    [
        ({"joints": ("a", "c")}, "cannot join measurements of different joints"),
        ({"sigma": None}, "with and without standard deviations"),
    ],
)
def test_what_cannot_be_joined(changes: dict[str, Any], part: str) -> None:
    pair = [measurements(), measurements(**changes)]
    assert part in reason(lambda: concatenate(pair))


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
