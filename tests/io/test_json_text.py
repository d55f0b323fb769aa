"""Documents of declared data: whatever is declared is written, and comes back."""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum
from typing import Any, Literal, NamedTuple

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from calib_pin.io.json_text import encode, plain, typed
from calib_pin.kinematics.spatial import Floats


class Color(Enum):
    RED = "red"
    BLUE = "blue"


class Pair(NamedTuple):
    first: str
    second: float


@dataclass(frozen=True)
class Entry:
    name: str
    sizes: tuple[float, ...]
    inner: float | None = field(default=None, metadata={"key": "deep.inner"})


@dataclass(frozen=True)
class Everything:
    number: float
    count: int
    flag: bool
    text: str
    color: Color
    side: Literal["left", "right"]
    array: Floats
    table: tuple[Pair, ...]
    either: float | str
    named: Mapping[str, float | None]
    entries: tuple[Entry, ...] = field(metadata={"by": "name"})
    pair: Pair = field(metadata={"key": ""})
    nested: float = field(metadata={"key": "outer.number"})
    beside: str = field(metadata={"key": "outer.word"})
    hidden: object = field(default=None, metadata={"key": None})
    free: Any = None


words = st.text(st.characters(codec="utf-8"), max_size=5)
numbers = st.floats(allow_nan=False)
maybe = st.none() | numbers
arrays = st.lists(st.lists(st.floats(), min_size=2, max_size=2), max_size=3)
entries = st.builds(Entry, words, st.lists(st.floats(), max_size=3).map(tuple), maybe)
everything = st.builds(
    Everything,
    number=st.floats(),
    count=st.integers(),
    flag=st.booleans(),
    text=words,
    color=st.sampled_from(Color),
    side=st.sampled_from(["left", "right"]),
    array=arrays.map(lambda rows: np.array(rows, float)),
    table=st.lists(st.builds(Pair, words, numbers), max_size=2).map(tuple),
    either=numbers | words,
    named=st.dictionaries(words, maybe, max_size=3),
    entries=st.lists(entries, max_size=2, unique_by=lambda e: e.name).map(tuple),
    pair=st.builds(Pair, words, numbers),
    nested=numbers,
    beside=words,
    hidden=st.none(),
    free=st.none() | st.dictionaries(words, st.integers(), max_size=2),
)


@settings(max_examples=25, derandomize=True, deadline=None)
@given(value=everything)
def test_what_is_written_reads_back_and_is_written_the_same(value: Everything) -> None:
    text = encode(value)
    found = typed(Everything, json.loads(text))
    assert encode(found) == text
    for name in ("color", "table", "pair", "named", "either"):
        assert getattr(found, name) == getattr(value, name)
    assert [one.name for one in found.entries] == [one.name for one in value.entries]
    np.testing.assert_array_equal(found.array, value.array)


def test_numbers_that_json_does_not_know() -> None:
    there = plain({"a": math.nan, "b": np.array([1.0, -math.inf]), "c": np.float64(2)})
    assert there == {"a": None, "b": [1.0, "-Infinity"], "c": 2.0}
    assert typed(tuple[float, ...], ["Infinity", 1]) == (math.inf, 1.0)
    assert json.loads(encode({"x": "\udcff"})) == {"x": "\udcff"}


@pytest.mark.parametrize(
    ("kind", "value"),
    [
        *((float, value) for value in ("1", 10**400, True, math.nan)),
        *((int, 1.0), (bool, 1), (str, 7), (Literal["left"], "up"), (Color, "green")),
        *((tuple[float, ...], "ab"), (tuple[float, float], [1.0])),
        *((Floats, value) for value in ([[1.0], [1.0, 2.0]], ["x"])),
        *((Entry, {"name": "a"}), (Entry, []), (Mapping[str, float], [1.0])),
    ],
)
def test_what_is_not_as_declared_is_refused(kind: Any, value: Any) -> None:
    with pytest.raises((ValueError, KeyError, TypeError, AttributeError)):
        typed(kind, value)
