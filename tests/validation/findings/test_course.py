"""Changes in the course of a job are told with line and size; noise is not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from benchmarks.findings import clean
from calib_pin.estimation.fit import fit_model
from calib_pin.measurement_models.readings import read_otherwise
from calib_pin.observations import Observations
from calib_pin.parameterizations import frame_pose
from calib_pin.setup import ReadingSetup, Setup
from calib_pin.validation.findings.alternatives import findings_of
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.course import (
    CONFIGURATIONS,
    changes_of,
    drift,
    unchanged_fit,
)

WAY = np.array([0.6, 0.0, -0.8])


def findings(job, *blocks):
    """What a calibration of some blocks tells."""
    data = Observations.of(*blocks)
    return calib_pin.calibrate(job.chain, data, validate=False).findings


def drifts(job, block):
    """The findings of a drift."""
    fitted = fit_model(job.chain, Observations.of(block), Setup(), 0)
    case = Case.of(fitted)
    return list(findings_of(case, drift(case)))


def displaced(block, size):
    """The same measurements displaced by so much, shape (N,) [m]."""
    values = block.values.copy()
    values[:, :3] += size[:, None] * WAY
    return replace(block, values=values)


def turned(block, joint, size):
    """The same with a column that reads so much more, shape (N,) [rad]."""
    q = block.q.copy()
    q[:, joint] += size
    return replace(block, q=q)


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


def test_two_tools_in_turn(moved_job, unsought) -> None:
    """No single one of their changes explains much."""
    job = moved_job((), (20, 40, 60), 80, step=0.02)
    found = [(f.code, f.evidence["line"]) for f in findings(job, job.plain)]
    assert found == [("tool-remounted", line) for line in (21, 41, 61)]


def test_a_move_within_a_station_that_is_named(moved_job, unsought) -> None:
    job = moved_job((20, 40), (), 60)
    blocks = [
        replace(block, station={"s0": "day1"}.get(block.station, "day2"), tool="")
        for block in job.named.blocks
    ]
    (finding,) = findings(job, *blocks)
    assert finding.evidence["line"] == 41 and "'day2'" in finding.message


def test_a_few_poses_tell_where_the_instrument_was(moved_job, unsought) -> None:
    """Four have twice the values that another place and another tool take together."""
    job = moved_job((4, 56), (), 60, model="pose", step=5e-3)
    found = [(f.code, f.evidence["line"]) for f in findings(job, job.plain)]
    assert found == [("instrument-moved", line) for line in (5, 57)]


@pytest.mark.parametrize(("size", "severity"), [(1e-4, "warning"), (1e-3, "error")])
def test_what_a_move_costs_decides(moved_job, size: float, severity: str) -> None:
    """A tenth of a millimeter is told, and is no reason to distrust all others."""
    job = moved_job((), ())
    block = displaced(job.plain.only, size * (np.arange(90) >= 45))
    (finding,) = findings(job, block)
    assert (finding.code, finding.severity) == ("instrument-moved", severity)


def test_a_small_move_in_the_order_of_the_files(moved_job) -> None:
    """Noise is 0.05 mm."""
    job, order = moved_job((), ()), np.random.default_rng(0).permutation(90)
    block = displaced(job.plain.only, 5e-4 * (np.arange(90) >= 40))
    block = replace(block, files=["a.csv"] * 40 + ["b.csv"] * 50)
    (finding,) = findings(job, block.rows(order))
    assert (finding.code, repr(finding.evidence["line"])) == ("instrument-moved", "41")
    assert "between a.csv and b.csv (" in finding.message
    assert finding.setup == {"reading": {"moved": ["b.csv:42"]}}


# Of a thousand rows three hundred are looked at, and the line is found among all.
@pytest.mark.parametrize(("count", "first"), [(60, 31), (1000, 522)])
def test_a_joint_that_was_homed_anew(moved_job, count: int, first: int) -> None:
    job = moved_job((), (), count)
    block = turned(job.plain.only, 2, 0.01 * (np.arange(count) >= first))
    result = calib_pin.calibrate(job.chain, block, validate=False)
    (finding,) = (f for f in result.findings if f.severity == "error")
    assert (result.verdict, finding.code) == ("untrusted", "joint-rehomed")
    assert finding.evidence["joint"] == "joint_3"
    # The last row before, behind a line of titles.
    assert finding.evidence["line"] == first + 1
    # It is the column that reads more.
    assert finding.evidence["offset"] == pytest.approx(-0.01, abs=5e-4)
    assert finding.evidence["rms_after"] < 2e-4 < finding.evidence["rms_before"]


def test_a_joint_beside_more_noise_than_is_assumed(moved_job) -> None:
    """Nobody states 0.3 mm; what a change leaves is compared with what the fit left."""
    job, rng = moved_job((), (), 90), np.random.default_rng(1)
    block = turned(job.plain.only, 2, 0.01 * (np.arange(90) >= 50))
    values = block.values + 3e-4 * rng.normal(size=block.values.shape)
    told = findings(job, replace(block, values=values, sigma=None))
    assert [f.code for f in told if f.severity == "error"] == ["joint-rehomed"]


def test_all_at_once_is_another_robot(moved_job, unsought) -> None:
    job, behind = moved_job((), (), 60), np.arange(60) >= 31
    block = turned(displaced(job.plain.only, 2e-3 * behind), 2, 0.01 * behind)
    (finding,) = findings(job, block)
    assert (finding.code, finding.evidence["line"]) == ("outlying-stretch", 32)
    assert "another robot say: with" in finding.message


@pytest.mark.slow
def test_four_things_do_not_change_in_a_day(moved_job) -> None:
    """Steps of a frame, a tool and joints make any drift; no cause is better."""
    job = moved_job((30,), (45,))
    block = turned(job.plain.only, 2, 0.01 * (np.arange(90) >= 60))
    block = turned(block, 4, 0.01 * (np.arange(90) >= 75))
    codes = {f.code for f in findings(job, block) if f.severity == "error"}
    assert codes == {"outlying-stretch"}


def test_what_comes_and_goes_at_once_is_no_change(moved_job, unsought) -> None:
    job = moved_job((30,), ())
    fitted = fit_model(job.chain, Observations.of(job.plain.only), Setup(), 0)
    case = Case.of(fitted)
    _, found = changes_of(case, unchanged_fit(case))
    (change,) = found.changes
    again = (c for _, _, c in found.candidates if c.subject == change.subject)
    assert all(abs(c.rank - change.rank) >= CONFIGURATIONS for c in again)
    wrong = displaced(job.plain.only, 0.1 * (np.arange(90) == 33))
    fitted = replace(
        fitted, problem=replace(fitted.problem, data=Observations.of(wrong))
    )
    case = Case.of(fitted)
    assert len(changes_of(case, unchanged_fit(case))[1].changes) == 1


def test_of_few_rows_as_well(moved_job) -> None:
    """Fifteen positions have as many values as there are unknowns."""
    job = moved_job((), (), 15)
    block = turned(job.plain.only, 2, 0.02 * (np.arange(15) >= 8))
    (finding,) = (f for f in findings(job, block) if f.severity == "error")
    assert (finding.code, finding.evidence["joint"]) == ("joint-rehomed", "joint_3")
    assert finding.evidence["offset"] == pytest.approx(-0.02, rel=0.2)


def test_a_robot_that_grows_warm_was_not_homed_anew(moved_job) -> None:
    job = moved_job((), (), 60)
    block = turned(job.plain.only, 2, np.linspace(0.0, 0.01, 60))
    assert [f.code for f in findings(job, block)] == ["robot-drift"]


def test_a_drift_and_its_size(moved_job) -> None:
    job, size = moved_job((), (), model="pose"), 3e-4
    block = displaced(job.plain.only, np.linspace(0.0, size, 90))
    (finding,) = drifts(job, block)
    assert (finding.code, finding.severity) == ("instrument-drift", "warning")
    vector = [finding.evidence[axis] for axis in "xyz"]
    deviation = finding.evidence["sigma"]
    np.testing.assert_allclose(vector, size * WAY, atol=4.0 * deviation)
    assert finding.evidence["rms_after"] < finding.evidence["rms_before"]
    (x, y, z) = finding.setup["reading"]["drift"]
    back = read_otherwise(Observations.of(block), ReadingSetup(drift=(x, y, z)))
    assert drifts(job, back.only) == []


@pytest.mark.parametrize("stated", [True, pytest.param(False, marks=pytest.mark.slow)])
def test_a_drift_beside_noise_is_told_where_that_is_known(moved_job, stated) -> None:
    """It leaves 0.9 of the errors, as what bends in a robot may."""
    job = moved_job((), (), 300)
    block = displaced(job.plain.only, np.linspace(0.0, 1.5e-4, 300))
    sigma = np.full(block.values.shape, 5e-5) if stated else None
    found = drifts(job, replace(block, sigma=sigma))
    assert [one.code for one in found] == ["instrument-drift"] * stated


def test_a_bent_path_is_no_drift(moved_job) -> None:
    """Errors that swing slowly, as unmodeled ones along a path, go with time, too."""
    job, time = moved_job((), ()), np.linspace(0.0, 1.0, 90)
    waves = sum(np.sin(k * np.pi * time + 0.4 * k) for k in range(1, 8))
    assert drifts(job, displaced(job.plain.only, 2e-4 * waves)) == []


def test_a_drift_of_a_joint(moved_job) -> None:
    """Few measurements have absorbed a part of it, with nearly as many parameters."""
    job, size = moved_job((), ()), 0.017
    block = job.plain.only.rows(slice(24))
    (finding,) = drifts(job, turned(block, 2, -np.linspace(0.0, size, 24)))
    assert finding.code == "robot-drift"
    assert finding.evidence["joint"] == block.joints[2]
    assert finding.evidence["drift"] == pytest.approx(size, rel=0.3)


def test_outliers_of_a_meter_are_no_changes() -> None:
    """Two lie near the ends of the file, where moves of the tool explain much."""
    assert not clean.run(20010).has("error", "warning")
