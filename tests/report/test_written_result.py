"""A result that was read from its files is the one that was written, byte for byte."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.io.measurement_errors import decode_errors, encode_errors
from calib_pin.io.results import read_written
from calib_pin.planning.suggestions import with_suggestions
from calib_pin.report.figures import Drawn
from calib_pin.report.figures import drawn as draw_all
from calib_pin.report.figures.errors import cumulative_errors, errors_per_measurement
from calib_pin.report.folder import result_contents
from calib_pin.report.html import html_report
from calib_pin.report.terminal import plain_text
from calib_pin.report.text import report
from calib_pin.validation.result import CalibrationResult, Provenance
from tests.report.results import KINDS, changed, lost_motion

SLOW = ("hands", "learned", "search", "camera")
"""With all figures, the others with two."""


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[pytest.mark.slow] if n in SLOW else []) for n in KINDS],
)
def test_page_and_figures_from_files_are_the_same_bytes(
    name, calibrated_robot, draw, tmp_path
):
    result = KINDS[name](calibrated_robot)
    result = with_suggestions(result)

    def figures(of: CalibrationResult) -> list[Drawn]:
        if name in SLOW:
            return [*draw_all("calibration", of)]
        return [draw(f, of) for f in (cumulative_errors, errors_per_measurement)]

    drawn = figures(result)
    folder = tmp_path / "out"
    run = Provenance.at(
        "2026-01-01T00:00:00+00:00", ("calib-pin", "calibrate", "a b.csv"), 1.25
    )
    for path, data in result_contents(result, folder, run, drawn, {}).items():
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)

    found, document = read_written(tmp_path / "out")
    for side in ("fitted", "held_out"):
        one, other = getattr(found, side), getattr(result, side)
        for part in ("before", "after", "sigma", "points", "leverage"):
            np.testing.assert_array_equal(getattr(one, part), getattr(other, part))
    again = figures(found)
    assert [f.name for f in again] == [f.name for f in drawn]
    assert found.suggestions == result.suggestions
    page = html_report(found, document, figures=again)
    assert page == (folder / "report.html").read_bytes()
    assert plain_text(report(found)) == plain_text(report(result))


def test_a_program_writes_a_result_and_reads_it(calibrated_robot, tmp_path):
    result, folder = lost_motion(calibrated_robot), tmp_path / "out"
    calib_pin.write_result(result, folder)
    assert calib_pin.read_result(folder).reason == result.reason
    with pytest.raises(calib_pin.CalibPinError, match="exists already; force= "):
        calib_pin.write_result(result, folder)
    measured = replace(result, files=(str(folder / "measurements.csv"),))
    with pytest.raises(calib_pin.CalibPinError, match="never replaced"):
        calib_pin.write_result(measured, folder, force=True)


def test_conditions_come_back(calibrated_robot):
    result = lost_motion(calibrated_robot)
    assert "approach-by-order" in {f.code for f in result.findings}
    data = encode_errors(result, "1")
    fitted, held_out = decode_errors(data, result.model)
    for found, there in ((fitted, result.fitted), (held_out, result.held_out)):
        assert found is not None and there is not None
        held, stated = found.rows.conditions, there.rows.conditions
        np.testing.assert_array_equal(held.direction, stated.direction)
        np.testing.assert_array_equal(held.temperature, stated.temperature)
        assert np.abs(held.direction).sum() > 0
    # With a model that does not need them they are no columns.
    plain = replace(result.model, setup=replace(result.model.setup, parameters=()))
    assert b"direction.joint_1" in data
    other = encode_errors(changed(result, model=plain), "1")
    assert b"direction.joint_1" not in other
