"""Orientations stated in another way than their columns say."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

import calib_pin
from calib_pin.estimation.evidence import Finding
from calib_pin.io.measurements import encode_table
from calib_pin.io.setup import read_setup
from calib_pin.observations import Observations
from calib_pin.setup import STATED
from calib_pin.validation.findings.explanations import explain, finding
from calib_pin.validation.findings.readings import orientations
from calib_pin.validation.findings.sentences import written

Job = Callable[..., Any]
Stated = Callable[[Rotation], Any]


@pytest.fixture(scope="module")
def found(quick_case: Job) -> Job:
    """The findings of a job's measurements."""

    def find(job: Any, data: Observations) -> list[Finding]:
        case = quick_case(job.chain, data)
        explanation = explain(case, (orientations,))
        return [] if explanation is None else list(finding(case, explanation))

    return find


@pytest.mark.parametrize(
    ("columns", "stated", "line"),
    [
        (
            "quaternion",
            lambda R: R.inv().as_quat()[:, [3, 0, 1, 2]],
            "columns: quaternion, hold: wxyz, inverse: true",
        ),
        (
            "rotation-vector",
            lambda R: R.as_euler("ZYX"),
            "columns: rotation-vector, hold: intrinsic-zyx",
        ),
        (
            "roll-pitch-yaw",
            lambda R: R.as_euler("zxy")[:, [1, 2, 0]],
            "columns: roll-pitch-yaw, hold: rpy-zxy",
        ),
        (
            "roll-pitch-yaw",
            lambda R: R.as_euler("xyz") * np.pi / 180.0,
            "columns: roll-pitch-yaw, factor: 57.2957795",
        ),
    ],
)
def test_the_convention_and_its_lines(
    found: Job,
    moved_job: Job,
    tmp_path: Path,
    columns: str,
    stated: Stated,
    line: str,
) -> None:
    """With the lines in the setup file the reader finds the true orientations."""
    job = moved_job((), (), 30, model="pose")
    true = job.plain.only
    table = dict(zip(true.joints, true.q.T, strict=True))
    table |= dict(zip("xyz", true.values[:, :3].T, strict=True))
    numbers = stated(Rotation.from_quat(true.values[:, 3:]))
    table |= dict(zip(STATED[columns], numbers.T, strict=True))
    file, setup = tmp_path / "poses.csv", tmp_path / "setup.yaml"
    file.write_bytes(encode_table(table, ()))
    (one,) = found(job, calib_pin.read_measurements(file, job.chain))
    assert (one.code, one.severity) == ("orientation-convention", "error")
    lines = written(one.setup)
    assert lines == f"reading: {{orientation: {{{line}}}}}" and lines in one.remedy
    setup.write_text(lines)
    again = calib_pin.read_measurements(
        file, job.chain, reading=read_setup(setup).reading
    )
    cosine = np.abs(np.sum(again.only.values[:, 3:] * true.values[:, 3:], axis=1))
    np.testing.assert_allclose(cosine, 1.0, atol=1e-12)
