"""The page of a calibration: complete, alone, escaped, and alive in a browser."""

from __future__ import annotations

import json
import re
from dataclasses import replace
from html.parser import HTMLParser
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.evidence import Outlier
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.calibration_document import calibration_document
from calib_pin.io.json_text import encode
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.planning.suggestions import calibrated_setup, suggestions
from calib_pin.report.blocks import Block, Cell, Table
from calib_pin.report.figures import NAMES, calibration_figures
from calib_pin.report.html import FIRST, LISTED, SECTIONS, html_report
from calib_pin.report.robot_errors import error_table
from calib_pin.report.tables import accuracy_table, parameter_overview
from calib_pin.report.terminal import plain_text
from calib_pin.report.text import report
from calib_pin.setup import Setup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.validation.measurement_errors import MeasurementErrors
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.summaries import Provenance

ARM = """<robot name="{0}">
  <link name="base"/><link name="a"/><link name="b"/><link name="c"/>
  <joint name="{1}" type="revolute">
    <origin xyz="0 0 0.4"/><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
    <limit lower="-2.5" upper="2.5" effort="1" velocity="1"/>
  </joint>
  <joint name="lift" type="revolute">
    <origin xyz="0.1 0.3 0"/><parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="slide" type="prismatic">
    <origin xyz="0.5 0 0.05" rpy="0.5 0.1 0"/>
    <parent link="b"/><child link="c"/><axis xyz="0 0 1"/>
    <limit lower="0" upper="0.4" effort="1" velocity="1"/>
  </joint>
</robot>
"""
HOSTILE = "&lt;script&gt;alert(1)&lt;/script&gt;"
"""A name as it stands in the XML of a URDF."""

PROVENANCE = Provenance(
    ("calib-pin", "calibrate", "<img src=x onerror=alert(2)>.urdf", "a b.csv"),
    "2026-01-01T00:00:00+00:00",
    1.25,
    {"calib_pin": "0.1.0", "pinocchio": "4.1", "numpy": "2.4"},
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


def solved(
    robot: str = "arm", joint: str = "turn", count: int = 30, **options: Any
) -> tuple[Chain, CalibrationResult]:
    chain = Chain(parse_robot(ARM.format(robot, joint).encode(), "arm.urdf"))
    setup = options.pop("setup", Setup())
    problem = nominal_problem(chain, "pose", setup)
    rng = np.random.default_rng(1)
    theta = draw_errors(problem.parameters, rng)
    rows = simulate(problem, theta, rng, count=count)
    return chain, calib_pin.calibrate(chain, rows, setup, **options)


def page_of(
    chain: Chain, result: CalibrationResult, *, figures: bool = True
) -> tuple[bytes, dict[str, Any]]:
    better = suggestions(chain, "pose", calibrated_setup(result.model), result)
    document = calibration_document(result, PROVENANCE, suggestions=better)
    drawn = list(calibration_figures(result)) if figures else []
    page = html_report(result, document, figures=drawn, suggestions=better)
    return page, json.loads(encode(document))


@pytest.fixture(scope="module")
def arm() -> tuple[Chain, CalibrationResult]:
    return solved()


@pytest.fixture(scope="module")
def page(arm: tuple[Chain, CalibrationResult]) -> tuple[bytes, dict[str, Any]]:
    return page_of(*arm)


# --- content -----------------------------------------------------------------------


FIRST_SCREEN = ("verdict", "figure-cumulative-errors")
"""Ids before the sections."""


def test_sections_in_order(page: tuple[bytes, dict[str, Any]]) -> None:
    found = [
        attributes["id"]
        for tag, attributes in Page(page[0]).tags
        if tag == "section" or attributes.get("id") in FIRST_SCREEN
    ]
    assert found == [
        *FIRST_SCREEN,
        *("frames", "measured", "findings", "accuracy"),
        *("identifiability", "parameters", "residuals", "provenance"),
    ]


def test_the_verdict_comes_with_its_reason(
    arm: tuple[Chain, CalibrationResult], page: tuple[bytes, dict[str, Any]]
) -> None:
    chain, result = arm
    bad = replace(result, verdict="untrusted", reason="it did not converge")
    text = Page(page_of(chain, bad, figures=False)[0]).text
    assert "UNTRUSTED: it did not converge." in text
    assert f"GOOD: {result.reason}." in Page(page[0]).text


def cells(blocks: list[Block]) -> list[Cell]:
    tables = [block for block in blocks if isinstance(block, Table)]
    return [cell for table in tables for row in table.rows for cell in row]


def test_numbers_are_those_of_the_terminal_and_of_the_file(
    arm: tuple[Chain, CalibrationResult], page: tuple[bytes, dict[str, Any]]
) -> None:
    """One builder makes the tables; behind every cell is the number of the file."""
    _, result = arm
    content, document = page
    values = set(Page(content).values)
    for error in document["errors"].values():
        for rows in ("training", "validation"):
            for stage in ("before", "after"):
                assert set(error[rows][stage].values()) <= values
    for entry in document["parameters"]:
        if entry["status"] not in ("fixed", "unidentifiable"):
            assert entry["value"] in values
        if entry["sigma"] is not None:
            assert entry["sigma"] in values
    for error in document["identifiability"]["robot_errors"]:
        if error["status"] == "identifiable":
            assert {error["value"], error["sigma"]} <= values
    text, shown = Page(content).text, plain_text(report(result, details=True))
    known = [e for e in result.robot_errors if e.status == "identifiable"]
    named = error_table(known, "", ("value", "std. dev.", "unit"))
    for table in (accuracy_table(result.errors), named):
        for cell in cells([table]):
            assert cell.text in text
            if cell.value is not None:
                assert cell.text in shown
    # What a cell says is its number in the unit beside it.
    for row in parameter_overview(result.parameters).rows:
        value, unit = row[1], row[3].text
        if value.value is not None:
            factor = {"mm": 1e3, "deg": np.degrees(1.0)}[unit]
            last = 0.51 * 10.0 ** -len(value.text.partition(".")[2])
            assert float(value.text) == pytest.approx(factor * value.value, abs=last)


def test_every_parameter_has_a_row(
    arm: tuple[Chain, CalibrationResult], page: tuple[bytes, dict[str, Any]]
) -> None:
    text = Page(page[0]).text
    for parameter in arm[1].parameters:
        assert parameter.name in text
    for status in {p.status for p in arm[1].parameters}:
        assert status in text


def test_what_was_done(page: tuple[bytes, dict[str, Any]]) -> None:
    content, document = page
    text = Page(content).text
    assert "calib-pin calibrate '<img src=x onerror=alert(2)>.urdf' 'a b.csv'" in text
    assert document["robot"]["sha256"] in text
    for words in ("2026-01-01T00:00:00+00:00", "pinocchio 4.1", "1.25 s", "converged"):
        assert words in text


def test_outliers_by_row(arm: tuple[Chain, CalibrationResult]) -> None:
    chain, result = arm
    rows = tuple(Outlier(f"rows.csv:{k}", k % 30, 90.0 - 0.1 * k) for k in range(250))
    many = replace(result, statistics=replace(result.statistics, outliers=rows))
    text = Page(page_of(chain, many, figures=False)[0]).text
    assert "250 of 30 measurements are outliers." in text
    assert "rows.csv:199" in text and "rows.csv:200" not in text
    assert f"{len(rows) - LISTED} more are in calibration.json." in text


def test_the_same_bytes_again(arm: tuple[Chain, CalibrationResult]) -> None:
    """Those of the figures have a test of their own."""
    first, again = (page_of(*arm, figures=False)[0] for _ in range(2))
    assert first == again


# --- alone and escaped -------------------------------------------------------------


def test_no_reference_to_anything_else(page: tuple[bytes, dict[str, Any]]) -> None:
    for tag, attributes in Page(page[0]).tags:
        assert tag not in ("iframe", "object", "embed", "base")
        for key in ("src", "href", "xlink:href", "data", "poster", "action"):
            value = attributes.get(key)
            assert value is None or value.startswith(("#", "data:")), (tag, value)
        assert not re.search(r"url\((?!#)", attributes.get("style") or "")
    assert b"@import" not in page[0]
    assert b'http-equiv="Content-Security-Policy"' in page[0]


def test_names_from_files_are_text() -> None:
    """A joint named like markup, a robot as well, and a file in the command."""
    chain, result = solved(HOSTILE, HOSTILE)
    content, _ = page_of(chain, result)
    found = Page(content)
    assert sum(tag == "script" for tag, _ in found.tags) == 1
    assert not any(tag == "img" for tag, _ in found.tags)
    assert not any(key.startswith("on") for _, a in found.tags for key in a)
    assert "<script>alert(1)</script>.placement.x" in found.text
    assert "Calibration of <script>alert(1)</script>" in found.text


def test_results_that_say_little() -> None:
    """Too few rows for any statistics: a page all the same, with the reason."""
    chain, result = solved(count=2)
    assert result.verdict == "unchecked"
    text = Page(page_of(chain, result)[0]).text
    assert "UNCHECKED" in text and "cannot determine" in text


def section(page: bytes, name: str) -> str:
    """The words below a figure."""
    found = re.search(
        rf'<figure id="figure-{name}">.*?<figcaption>(.*?)</figcaption>'.encode(),
        page,
        re.DOTALL,
    )
    assert found is not None
    return found[1].decode()


# --- many rows ---------------------------------------------------------------------


def repeated(errors: MeasurementErrors, count: int) -> MeasurementErrors:
    """As many rows, made of a few and scattered."""
    order = np.arange(count) % len(errors)
    rng = np.random.default_rng(2)
    return replace(
        errors,
        rows=errors.rows.rows(order),
        before=errors.before[order] * rng.uniform(0.5, 1.5, (count, 1)),
        after=errors.after[order] * rng.uniform(0.5, 1.5, (count, 1)),
        sigma=errors.sigma[order],
        leverage=errors.leverage[order],
        points=errors.points[order] + rng.normal(0.0, 0.3, (count, 3)),
    )


SLOW = pytest.mark.slow


@pytest.mark.parametrize(
    "count",
    [pytest.param(10_000, marks=SLOW), 25_000, pytest.param(100_000, marks=SLOW)],
)
def test_many_rows_make_a_small_page(
    count: int, arm: tuple[Chain, CalibrationResult]
) -> None:
    chain, result = arm
    assert result.held_out is not None
    many = replace(
        result,
        fitted=repeated(result.fitted, count),
        held_out=repeated(result.held_out, count),
    )
    content, _ = page_of(chain, many)
    assert len(content) < 3e6
    said = re.search(r"[^.]*are drawn[^.]*", section(content, "errors-per-measurement"))
    assert (said is not None) == (count > 20_000)
    assert said is None or f"of {count} measurements" in said[0]


def test_every_figure_has_a_section() -> None:
    placed = [*FIRST, *(name for _, names in SECTIONS.values() for name in names)]
    assert len(set(placed)) == len(placed)
    assert set(NAMES["calibration"]) <= set(placed)
