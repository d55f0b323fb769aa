"""The page of a calibration: complete, alone, and escaped."""

from __future__ import annotations

import json
import re
from collections.abc import Sequence
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

from calib_pin.estimation.evidence import Outlier
from calib_pin.io.json_text import encode
from calib_pin.io.results import calibration_document
from calib_pin.planning.suggestions import with_suggestions
from calib_pin.report.figures import NAMES, Drawn
from calib_pin.report.figures import drawn as draw_all
from calib_pin.report.html import FRONT, html_report
from calib_pin.report.tables import accuracy_table, parameter_overview
from calib_pin.report.terminal import plain_text
from calib_pin.report.text import LISTED, report, sections
from calib_pin.validation.result import CalibrationResult, Provenance
from tests.report.results import changed, solve

HOSTILE = "&lt;script&gt;alert(1)&lt;/script&gt;"
"""A name as it stands in the XML of a URDF."""

PROVENANCE = Provenance(
    ("calib-pin", "calibrate", "<img src=x onerror=alert(2)>.urdf", "a b.csv"),
    "2026-01-01T00:00:00+00:00",
    1.25,
    *("0.1.0", "4.1", "2.4"),
)


class Page(HTMLParser):
    """What a browser would see: text, tags, and the numbers behind cells."""

    VOID = ("meta", "link", "input", "br", "img")

    def __init__(self, page: bytes) -> None:
        super().__init__()
        self.open: list[str] = []
        self.values: list[float] = []
        self.tags: list[tuple[str, dict[str, str | None]]] = []
        self.text = ""
        self.feed(page.decode())
        assert self.open == []

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        found = dict(attrs)
        self.tags.append((tag, found))
        if tag not in self.VOID:
            self.open.append(tag)
        if "data-value" in found:
            self.values.append(float(found["data-value"] or "nan"))

    def handle_endtag(self, tag: str) -> None:
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if "style" not in self.open and "script" not in self.open:
            self.text += data


def page_of(
    result: CalibrationResult, figures: Sequence[Drawn] = ()
) -> tuple[bytes, dict[str, Any]]:
    result = with_suggestions(result)
    document = calibration_document(result, PROVENANCE)
    page = html_report(result, document, figures=figures)
    return page, json.loads(encode(document))


@pytest.fixture(scope="module")
def page(
    calibrated: CalibrationResult, drawn: list[Drawn]
) -> tuple[bytes, dict[str, Any]]:
    return page_of(calibrated, [f for f in drawn if f.name in NAMES["calibration"]])


@pytest.fixture(scope="module")
def seen(page: tuple[bytes, dict[str, Any]]) -> Page:
    return Page(page[0])


# --- content -----------------------------------------------------------------------


FIRST_SCREEN = ("verdict", *(f"figure-{name}" for name in FRONT))
"""Ids before the sections."""


def test_sections_in_order_and_every_figure_has_one(calibrated, seen):
    found = [
        attributes["id"]
        for tag, attributes in seen.tags
        if tag == "section" or attributes.get("id") in FIRST_SCREEN
    ]
    parts = list(sections(calibrated))
    assert found == [*FIRST_SCREEN, *(part.key for part in parts), "provenance"]
    placed = [*FRONT, *(name for part in parts for name in part.figures)]
    assert sorted(placed) == sorted(NAMES["calibration"])


def test_the_verdict_comes_with_its_reason(calibrated, seen):
    bad = changed(calibrated, verdict="untrusted", reason="it did not converge")
    text = Page(page_of(bad)[0]).text
    assert text.index("UNTRUSTED: it did not converge.") < text.index("Next: ")
    assert f"GOOD: {calibrated.reason}." in seen.text and "Next: " not in seen.text
    # Too few rows for any statistics: a page all the same.
    assert "UNCHECKED" in Page(page_of(solve(count=2))[0]).text


def test_numbers_are_those_of_the_terminal_and_of_the_file(calibrated, page, seen):
    """One builder makes the tables; behind every cell is the number of the file."""
    _, document = page
    values = set(seen.values)
    for error in document["errors"].values():
        for rows in ("training", "validation"):
            for stage in ("before", "after"):
                assert set(error[rows][stage].values()) <= values
    for entry in document["parameters"]:
        assert entry["name"] in seen.text and entry["status"] in seen.text
        if entry["status"] not in ("fixed", "unidentifiable"):
            assert entry["value"] in values
        if entry["sigma"] is not None:
            assert entry["sigma"] in values
    shown = plain_text(report(calibrated, details=True))
    for cell in (c for row in accuracy_table(calibrated.errors).rows for c in row):
        assert cell.text in seen.text
        assert cell.value is None or cell.text in shown
    # What a cell says is its number in the unit beside it.
    for row in parameter_overview(calibrated.parameters).rows:
        value, unit = row[1], row[3].text
        if value.value is not None:
            factor = {"mm": 1e3, "deg": np.degrees(1.0)}[unit]
            last = 0.51 * 10.0 ** -len(value.text.partition(".")[2])
            assert float(value.text) == pytest.approx(factor * value.value, abs=last)


def test_what_was_done(page, seen):
    command = "calib-pin calibrate '<img src=x onerror=alert(2)>.urdf' 'a b.csv'"
    for words in (
        *(command, page[1]["robot"]["sha256"]),
        *("2026-01-01T00:00:00+00:00", "pinocchio 4.1", "1.25 s"),
    ):
        assert words in seen.text


def test_outliers_by_row_and_the_same_bytes_again(calibrated):
    rows = tuple(Outlier(f"rows.csv:{k}", k % 30, 90.0 - 0.1 * k) for k in range(250))
    many = changed(calibrated, outliers=rows)
    content, _ = page_of(many)
    text = Page(content).text
    assert f"rows.csv:{LISTED[1] - 1}" in text and f"rows.csv:{LISTED[1]}" not in text
    assert f"{len(rows) - LISTED[1]} more" in text
    assert page_of(many)[0] == content


# --- alone and escaped -------------------------------------------------------------


def test_no_reference_to_anything_else(page, seen):
    for tag, attributes in seen.tags:
        assert tag not in ("iframe", "object", "embed", "base")
        for key in ("src", "href", "xlink:href", "data", "poster", "action"):
            value = attributes.get(key)
            assert value is None or value.startswith(("#", "data:")), (tag, value)
        assert not re.search(r"url\((?!#)", attributes.get("style") or "")
    assert b"@import" not in page[0]
    assert b'http-equiv="Content-Security-Policy"' in page[0]


def test_names_from_files_are_text():
    """A joint named like markup, a robot as well, and a file in the command."""
    result = solve((HOSTILE, HOSTILE, "lift", "slide"))
    found = Page(page_of(result)[0])
    assert sum(tag == "script" for tag, _ in found.tags) == 1
    assert not any(tag == "img" for tag, _ in found.tags)
    assert not any(key.startswith("on") for _, a in found.tags for key in a)
    assert "<script>alert(1)</script>.placement.x" in found.text
    assert "Calibration of <script>alert(1)</script>" in found.text


@pytest.mark.slow
def test_many_rows_make_a_small_page(many):
    result = many(25_000)
    page, _ = page_of(result, [*draw_all("calibration", result)])
    assert len(page) < 3e6
