"""A job whose instrument was moved is not trusted, and the line of the move is told."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.estimation.fit import fit_model
from calib_pin.measurement_models.readings import read_otherwise
from calib_pin.observations import Observations
from calib_pin.parameterizations import frame_pose
from calib_pin.setup import ReadingSetup, Setup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.moved_frames import move_findings


def test_a_moved_job_is_untrusted_with_the_lines(moved_job) -> None:
    job = moved_job((30, 60), (45,))
    result = calib_pin.calibrate(job.chain, job.plain)
    assert result.verdict == "untrusted"
    first, tool, second = result.findings
    assert [f.code for f in result.findings] == [
        "instrument-moved",
        "tool-remounted",
        "instrument-moved",
    ]
    # Thirty measurements behind a line of titles.
    assert [f.evidence["line"] for f in result.findings] == [31, 46, 61]
    places = [frame_pose(job.truth.stations[f"s{k}"]).inverse() for k in range(3)]
    for finding, A, B in ((first, *places[:2]), (second, *places[1:])):
        distance = np.linalg.norm(B.translation - A.translation)
        angle = np.linalg.norm(pin.log3(A.rotation.T @ B.rotation))
        assert finding.evidence["distance"] == pytest.approx(distance, abs=0.02)
        assert finding.evidence["angle"] == pytest.approx(angle, abs=0.02)
        assert finding.message.startswith("the instrument moved after line")
        assert " m, " in finding.message and "station" in finding.remedy
    # Nobody knows how a single point is turned.
    assert "angle" not in tool.evidence and "tool" in tool.remedy
    assert tool.evidence["rms_before"] > 0.1 > 1e-3 > tool.evidence["rms_after"]
    assert result.reason.startswith(f"{first.message}; {tool.message}")
    assert first.remedy in result.reason


def test_the_same_with_its_names_is_good(moved_job) -> None:
    job = moved_job((30, 60), (45,))
    result = calib_pin.calibrate(job.chain, job.named)
    assert result.verdict == "good" and result.findings == ()


def test_the_setup_lines_of_a_move(moved_job) -> None:
    """They divide the measurements as their names would have done."""
    job = moved_job((30, 60), (45,))
    fitted = fit_model(job.chain, job.plain, Setup(), 0).fit
    findings = move_findings(Case.of(fitted, fitted.problem.chains))
    lines = {"reading": {"moved": [32, 62], "remounted": [47]}}
    assert [dict(finding.setup) for finding in findings] == [lines] * 3
    assert "moved: [32, 62], remounted: [47]" in findings[0].remedy
    apart = [findings[0].evidence[axis] for axis in "xyz"]
    assert np.linalg.norm(apart) == pytest.approx(findings[0].evidence["distance"])
    reading = ReadingSetup(moved=("32", "62"), remounted=("47",))
    read = read_otherwise(job.plain, reading)
    assert calib_pin.calibrate(job.chain, read, validate=False).findings == ()


def test_a_small_move_stands_out_from_drift_and_noise(moved_job) -> None:
    """Noise is 0.05 mm."""
    job = moved_job((40,), (), step=0.0)
    block = job.plain.only
    for shape, moves in ((np.arange(90) >= 40, 1), (np.linspace(0.0, 1.0, 90), 0)):
        values = block.values + 2.5e-4 * shape[:, None] * np.array([0.6, 0.0, -0.8])
        data = Observations.of(replace(block, values=values))
        fitted = fit_model(job.chain, data, Setup(), 0).fit
        found = move_findings(Case.of(fitted, fitted.problem.chains))
        assert [f.evidence["line"] for f in found] == [41] * moves


def test_the_line_is_found_among_very_many(moved_job) -> None:
    job = moved_job((1234,), (), 3000, step=0.02)
    fitted = fit_model(job.chain, job.plain, Setup(), 0).fit
    (finding,) = move_findings(Case.of(fitted, fitted.problem.chains))
    assert finding.evidence["line"] == 1235


def test_a_move_between_two_files(moved_job) -> None:
    job = moved_job((40,), ())
    files = ["a.csv"] * 40 + ["b.csv"] * 50
    block = replace(job.plain.only, files=files, station="hall")
    fitted = fit_model(job.chain, Observations.of(block), Setup(), 0).fit
    (finding,) = move_findings(Case.of(fitted, fitted.problem.chains))
    start = "the instrument of the station 'hall' moved between a.csv and b.csv ("
    assert finding.message.startswith(start)


def test_measurements_without_a_file_are_counted(moved_job) -> None:
    job = moved_job((40,), ())
    block = replace(job.plain.only, files=(), lines=np.zeros(90, np.int64))
    fitted = fit_model(job.chain, Observations.of(block), Setup(), 0).fit
    (finding,) = move_findings(Case.of(fitted, fitted.problem.chains))
    assert "after measurement 40 (" in finding.message
