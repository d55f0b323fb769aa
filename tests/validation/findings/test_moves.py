"""Moves are found with their lines, in the order of the files, and told with sizes."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.observations import Observations
from calib_pin.parameterizations import frame_pose


def findings(job, *blocks):
    """What a calibration of some blocks tells."""
    data = Observations.of(*blocks)
    return calib_pin.calibrate(job.chain, data, validate=False).findings


def test_a_moved_job_is_untrusted_with_the_lines(moved_job) -> None:
    job = moved_job((30, 60), (45,))
    result = calib_pin.calibrate(job.chain, job.plain, validate=False)
    assert result.verdict == "untrusted"
    first, tool, second = result.findings
    assert [(f.code, f.evidence["line"]) for f in result.findings] == [
        # Thirty measurements behind a line of titles.
        ("instrument-moved", 31),
        ("tool-remounted", 46),
        ("instrument-moved", 61),
    ]
    places = [frame_pose(job.truth.stations[f"s{k}"]).inverse() for k in range(3)]
    for finding, A, B in ((first, *places[:2]), (second, *places[1:])):
        distance = np.linalg.norm(B.translation - A.translation)
        angle = np.linalg.norm(pin.log3(A.rotation.T @ B.rotation))
        assert finding.evidence["distance"] == pytest.approx(distance, abs=0.02)
        assert finding.evidence["angle"] == pytest.approx(angle, abs=0.02)
        apart = [finding.evidence[axis] for axis in "xyz"]
        assert np.linalg.norm(apart) == pytest.approx(finding.evidence["distance"])
    # Nobody knows how a single point is turned.
    assert "angle" not in tool.evidence
    assert tool.evidence["rms_before"] > 0.1 > 1e-3 > tool.evidence["rms_after"]
    # All three divide the measurements as their names would have done.
    lines = {"reading": {"moved": [32, 62], "remounted": [47]}}
    assert [finding.setup for finding in result.findings] == [lines] * 3
    named = calib_pin.calibrate(job.chain, job.named, validate=False)
    assert named.verdict == "good" and named.findings == ()


def test_two_tools_in_turn(moved_job) -> None:
    """No single one of their changes explains much."""
    job = moved_job((), (20, 40, 60), 80, step=0.02)
    found = [(f.code, f.evidence["line"]) for f in findings(job, job.plain)]
    assert found == [("tool-remounted", line) for line in (21, 41, 61)]


def test_a_move_within_a_station_that_is_named(moved_job) -> None:
    job = moved_job((20, 40), (), 60)
    blocks = [
        replace(block, station={"s0": "day1"}.get(block.station, "day2"), tool="")
        for block in job.named.blocks
    ]
    (finding,) = findings(job, *blocks)
    assert finding.evidence["line"] == 41 and "'day2'" in finding.message


def test_the_order_is_that_of_the_files(moved_job) -> None:
    job = moved_job((40,), ())
    order = np.random.default_rng(0).permutation(90)
    block = replace(job.plain.only, files=["a.csv"] * 40 + ["b.csv"] * 50)
    (finding,) = findings(job, block.rows(order))
    assert "a.csv:" in finding.message and finding.setup["reading"]["moved"]
    assert "b.csv:" in finding.setup["reading"]["moved"][0]


def test_a_small_move_stands_out_from_noise(moved_job) -> None:
    """Noise is 0.05 mm."""
    job = moved_job((), ())
    block = job.plain.only
    moved = (np.arange(90) >= 40)[:, None] * np.array([3e-4, 0.0, -4e-4])
    (finding,) = findings(job, replace(block, values=block.values + moved))
    assert (finding.code, finding.evidence["line"]) == ("instrument-moved", 41)
