"""A result of version 0.1 with several measurement models reads as one of blocks."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.estimation.problem import error_table
from calib_pin.io.calibration_document import calibration_document
from calib_pin.io.json_text import encode
from calib_pin.io.result_file import read_result
from calib_pin.io.results import read_calibration
from calib_pin.observations import BlockKey
from calib_pin.validation.result import CalibrationResult

FOLDER = Path(__file__).parents[1] / "data" / "calibration-0.1-mixed"
TRACKER, CAMERA = BlockKey("position"), BlockKey("camera")


@pytest.fixture(scope="module")
def found() -> CalibrationResult:
    return read_result(FOLDER)


def test_measurements_are_blocks_with_plain_targets(found: CalibrationResult) -> None:
    assert found.held_out is not None
    assert set(found.fitted.rows.keys) == set(found.held_out.rows.keys)
    by_key = {block.key: block for block in found.fitted.rows.blocks}
    assert {key: len(block) for key, block in by_key.items()} == {
        TRACKER: 24,
        CAMERA: 48,
    }
    assert set(by_key[TRACKER].target) == {"", "ball"}
    assert set(by_key[CAMERA].target) == {"m0", "m1", "m2", "m3"}
    assert by_key[CAMERA].values.shape == (48, 2)
    sigma = by_key[CAMERA].sigma
    assert sigma is not None and (sigma == 0.5).all()


def test_predictions_are_those_that_it_was_written_with(
    found: CalibrationResult,
) -> None:
    """Frames are written as angles; 800 px stand a few meters before the camera."""
    for errors in (found.fitted, found.held_out):
        assert errors is not None
        here = error_table(found.model.problem(errors.rows), found.model.theta)
        np.testing.assert_allclose(here, errors.after, rtol=0.0, atol=1e-10)
        np.testing.assert_array_equal(np.isnan(errors.after), np.isnan(errors.sigma))


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
    assert names == found.model.given.names
    assert names == tuple(found.covariance.rows)
    assert "camera.station.rz" in names and "camera.base.rz" not in names


def test_numbers_are_those_of_a_fit_of_today(found: CalibrationResult) -> None:
    model = found.model
    today = calib_pin.calibrate(
        model.chains, found.fitted.rows, model.setup, validate=False
    )
    assert today.model.given.names == model.given.names
    known = 0
    for then, now in zip(found.parameters, today.parameters, strict=True):
        if then.sigma is None:
            continue
        known += 1
        # Frames relative to others were coupled with these; never the reverse.
        assert now.status == then.status == "identifiable"
        # Both iterations end where a step is small against the noise, and the
        # covariance belongs to slightly other references.
        assert abs(now.value - then.value) <= 1e-3 * then.sigma
        assert now.sigma == pytest.approx(then.sigma, rel=1e-2)
    assert known > 20


def test_one_with_several_models_can_be_written_again(
    found: CalibrationResult, tmp_path: Path
) -> None:
    file = tmp_path / "calibration.json"
    file.write_bytes(encode(calibration_document(found)))
    again = read_calibration(file)
    assert again.given.names == found.model.given.names
    rows = found.fitted.rows
    there, here = (m.problem(rows).errors(m.theta) for m in (again, found.model))
    np.testing.assert_allclose(there, here, rtol=0.0, atol=1e-10)
