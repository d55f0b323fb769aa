"""A result of version 0.1 with several measurement models reads as one of blocks."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.estimation.problem import error_table
from calib_pin.io.calibration_document import calibration_document
from calib_pin.io.json_text import encode
from calib_pin.io.result_file import read_result
from calib_pin.io.results import read_calibration
from calib_pin.observations import BlockKey
from calib_pin.validation.result import CalibrationResult

FOLDER = Path(__file__).parents[1] / "data" / "calibration-0.1-mixed"
TRACKER, CAMERA = BlockKey("position"), BlockKey("camera")
PIXELS = 1e-10
"""Frames are written as angles; 800 px stand a few meters before the camera."""


@pytest.fixture(scope="module")
def found() -> CalibrationResult:
    return read_result(FOLDER)


def test_measurements_are_blocks_with_plain_targets(found: CalibrationResult) -> None:
    assert found.held_out is not None
    assert set(found.fitted.rows.keys) == set(found.held_out.rows.keys)
    by_key = {block.key: block for block in found.fitted.rows.blocks}
    assert {k: len(b) for k, b in by_key.items()} == {TRACKER: 24, CAMERA: 48}
    assert set(by_key[TRACKER].target) == {"", "ball"}
    assert set(by_key[CAMERA].target) == {"m0", "m1", "m2", "m3"}
    assert by_key[CAMERA].values.shape == (48, 2)
    sigma = by_key[CAMERA].sigma
    assert sigma is not None and (sigma == 0.5).all()


def test_predictions_are_those_that_it_was_written_with(
    found: CalibrationResult, tmp_path: Path
) -> None:
    """Also when it was written again, as results are today."""
    for errors in (found.fitted, found.held_out):
        assert errors is not None
        here = error_table(found.model.problem(errors.rows), found.model.theta)
        np.testing.assert_allclose(here, errors.after, rtol=0.0, atol=PIXELS)
        np.testing.assert_array_equal(np.isnan(errors.after), np.isnan(errors.sigma))
    file = tmp_path / "calibration.json"
    file.write_bytes(encode(calibration_document(found)))
    again, rows = read_calibration(file), found.fitted.rows
    assert again.given.names == found.model.given.names
    there, here = (m.problem(rows).errors(m.theta) for m in (again, found.model))
    np.testing.assert_allclose(there, here, rtol=0.0, atol=PIXELS)


def test_the_camera_has_a_station_and_a_tool_of_its_own(
    found: CalibrationResult,
) -> None:
    stated = json.loads((FOLDER / "calibration.json").read_text())["frames"]

    def pose(name: str) -> pin.SE3:
        frame = stated[name]
        return pin.SE3(pin.rpy.rpyToMatrix(*frame["rpy"]), np.array(frame["xyz"]))

    camera = found.model.parts[CAMERA].error
    assert camera.base.isApprox(pose("camera.base") * pose("base"), 1e-12)
    assert camera.tool.isApprox(pose("tool") * pose("camera.tool"), 1e-12)
    names = tuple(p.name for p in found.parameters)
    assert names == found.model.given.names == tuple(found.covariance.rows)
    assert "camera.station.rz" in names and "camera.base.rz" not in names
