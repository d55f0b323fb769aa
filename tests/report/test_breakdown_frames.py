"""Frames and cameras as absolute values, and as lines that a setup file takes."""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib_pin.report.blocks import Line
from calib_pin.report.breakdown import frame_blocks
from calib_pin.report.tables import parameter_overview
from calib_pin.report.terminal import plain_text
from calib_pin.setup import CameraSetup
from calib_pin.validation.result import CalibrationResult
from tests.report.results import SEEN
from tests.report.test_breakdown import STATIONS, TOOLS, table


@pytest.fixture(scope="module")
def tracked(calibrated_robot: Callable[..., CalibrationResult]) -> CalibrationResult:
    return calibrated_robot("position", count=40)


def test_values_with_their_deviations(tracked):
    result = replace(tracked, stations=STATIONS, tools=TOOLS)
    blocks = list(frame_blocks(result))
    rows = [[cell.text for cell in row] for row in table(blocks, "Frames").rows]
    xyz = ["1234.568 +- 0.012", "-500.000 +- 0.020", "0.000 +- 0.030"]
    rpy = ["0.00000 +- 0.00057", "5.730", "180.0000 +- 0.0057"]
    assert [row[2:] for row in rows[:2]] == [[*xyz, "mm"], [*rpy, "deg"]]
    # Of deviations that nobody knows there is nothing, and of what is known no row.
    assert rows[2][2:] == ["1234.568", "-500.000", "0.000", "mm"]
    assert [row[0] for row in rows[::2]] == ["day1", "day2", "ball"]
    assert max(map(len, plain_text(blocks).splitlines())) <= 80
    known = replace(tracked, stations=(), tools=TOOLS[1:])
    assert list(frame_blocks(known)) == []


def test_what_the_measurements_leave_open_is_no_value(tracked):
    """Of a tool whose point alone was measured the orientation is not known."""
    (tool,) = tracked.tools
    assert np.isnan(tool.sigma[3:]).all()
    blocks = list(frame_blocks(tracked))
    rows = [[cell.text for cell in row] for row in table(blocks, "Frames").rows]
    assert rows[-1][2:] == ["-", "-", "-", "deg"]


def test_no_number_of_what_is_unknown(tracked):
    """And the note says what to do."""
    (base,) = tracked.stations
    base = replace(base, sigma=(1e-3, math.nan, 2.5, *base.sigma[3:]))
    names = ("base.frame.y", "tool.frame.rx")
    result = replace(tracked, stations=(base,), unknown=names)
    blocks = list(frame_blocks(result))
    cells = table(blocks, "Frames").rows[0]
    assert (cells[3].text, cells[3].value) == ("-", None)
    said = [block.text for block in blocks if isinstance(block, Line)]
    assert "fixed: [tool.frame.z]" in said[-1]
    parameters = {
        row[0].text: row
        for row in parameter_overview(result.parameters, result.unknown).rows
    }
    assert parameters["base.frame.y"][1].text == "-"
    assert parameters["base.frame.x"][1].text != "-"


def test_a_camera_is_told(calibrated_robot):
    seen = calibrated_robot("camera", SEEN, 40, noise=None, validate=False)
    found = table(list(frame_blocks(seen)), "Intrinsics of camera")
    by_name = {p.name: p for p in seen.parameters}
    references = (found.stated() for found in seen.model.references.values())
    (stated,) = (found for found in references if isinstance(found, CameraSetup))
    for row, start, value in zip(
        found.rows[:4],
        (900.0, 910.0, 640.0, 500.0),
        (*stated.focal, *stated.center),
        strict=True,
    ):
        parameter = by_name[f"camera.intrinsics.{row[0].text}"]
        assert row[1].value == value == pytest.approx(start + parameter.value)
        assert row[1].text == f"{value:.1f} +- {parameter.sigma:.1f}"
    unknown = replace(seen, unknown=("camera.intrinsics.fx",))
    rows = table(list(frame_blocks(unknown)), "Intrinsics of camera").rows
    assert [row[1].text == "-" for row in rows] == [True] + 8 * [False]
