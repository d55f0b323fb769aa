"""Records of a study: conditions, tables, and the document."""

from __future__ import annotations

import math

import numpy as np
import pytest

from studies.records import Condition, Record, Report, Table, Values
from studies.shared import plain


@pytest.mark.parametrize(
    ("relation", "limit", "met"),
    [
        ("above", 1.0, True),
        ("at least", 2.0, False),
        ("at least", {"a": 2.0}, True),
        ("at most", 2.0, True),
        ("below", {"a": 2.0}, False),
        ("equal to", {"a": 2.0, "b": 1.5}, True),
    ],
)
def test_conditions(relation: str, limit: float | Values, met: bool) -> None:
    assert Condition("", relation, limit).met({"a": 2.0, "b": 1.5}) is met
    assert not Condition("", relation, 1.0).met({"a": math.nan})


def test_within_a_tolerance() -> None:
    near = Condition("as published", "within", 354.8, 0.1)
    assert near.met({"": 354.85}) and not near.met({"": 354.95})
    (line,) = Record("condition", {"": 354.85}, "", conditions=(near,)).verdicts()
    assert line == "met      as published: condition, 354.9 (within 0.1 of 354.8)"


def report() -> Report:
    table = Table("Errors", "A note.")
    small = Condition("low", "below", {"35": 0.2e-3, "100": 0.2e-3})
    bounds = {"35": 0.2e-3}
    ours = {"35": 0.123e-3, "100": 0.5e-3}
    table.add("largest", ours, "mm", small, published=bounds, bound="<")
    table.add("rank", {"35": 27})
    results = {"seeds": [np.array([math.nan, 1.0])]}
    return Report("study", "Somebody 1999", ["About."], {}, [table], results)


def test_the_terminal_has_units_published_values_and_conditions() -> None:
    assert report().text().splitlines() == [
        "Somebody 1999",
        "About.",
        "",
        "Errors",
        "                      35       100",
        "  largest [mm]     0.123       0.5",
        "    published      < 0.2",
        "  rank                27",
        "A note.",
        "",
        "NOT MET  low: largest, 35 0.123 mm (below 0.2 mm), 100 0.5 mm (below 0.2 mm)",
    ]
    assert report().met() == {"low": False}


def test_the_document_is_in_si_units() -> None:
    document = plain(report().document())
    assert isinstance(document, dict)
    largest, rank = document["tables"][0]["records"]
    assert (largest["unit"], largest["ours"]["35"]) == ("m", 0.123e-3)
    assert largest["published"] == {"35": 0.2e-3} and largest["published_bound"] == "<"
    assert largest["conditions"][0]["met"] is False
    assert rank["ours"] == {"35": 27} and "published" not in rank
    assert document["seeds"] == [[None, 1.0]]
