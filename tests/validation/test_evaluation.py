"""Evaluation looks for faults of the measurements, and asks for a registration."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.cli.evaluate import evaluation_document
from calib_pin.estimation.formulation import make_problem
from calib_pin.observations import BlockKey, Observations
from calib_pin.report.accuracy import evaluated
from calib_pin.report.terminal import plain_text
from calib_pin.setup import BoardSetup, CameraSetup, FrameSetup, Setup, SphereSetup
from calib_pin.validation.model_errors import registered
from tests.shared import simulated


@pytest.fixture(scope="module")
def job(moved_job):
    job = moved_job((), ())
    rows = job.plain.only
    result = calib_pin.calibrate(job.chain, rows.rows(slice(0, 60)), validate=False)
    return job.chain, result.model, rows.rows(slice(60, 90))


def test_as_calibrated(job) -> None:
    chain, model, rows = job
    for robot in (model, chain):
        found = calib_pin.evaluate(robot, rows)
        assert (found.verdict, found.findings) == ("good", ())


def test_a_finer_instrument_has_no_outliers_beside_a_coarse_one() -> None:
    """Poses to 50 mm fit any robot; a few positions show its errors."""
    keys = [BlockKey("position"), BlockKey("pose")]
    problem, _ = simulated(keys, None, 150, 4.0, seed=2, noise=1e-4)
    fine, coarse = problem.data.blocks
    coarse = replace(coarse, sigma=np.full_like(coarse.values[:, :6], 0.05))
    mixed = Observations((fine.rows(slice(0, 8)), coarse))
    found = calib_pin.evaluate(problem.chains, mixed).findings
    assert "outliers" not in {one.code for one in found}


def test_repetitions_are_no_fault_where_nothing_is_fitted(job) -> None:
    _, model, rows = job
    some = rows.rows(np.repeat(np.arange(4), 40))
    noise = 1e-4 * np.random.default_rng(0).normal(size=some.values.shape)
    found = calib_pin.evaluate(model, replace(some, values=some.values + noise))
    assert "few-configurations" not in {one.code for one in found.findings}


@pytest.mark.parametrize(
    ("shift", "severity", "verdict"),
    [(1.0, "error", "untrusted"), (1e-3, "warning", "good")],
)
def test_moved_since(job, shift, severity, verdict) -> None:
    _, model, rows = job
    moved = replace(rows, values=rows.values + shift * np.eye(3)[0])
    found = calib_pin.evaluate(model, moved)
    (finding,) = found.findings
    assert (finding.code, finding.severity) == ("frames-moved", severity)
    assert finding.evidence["rms_before"] == pytest.approx(shift, rel=0.05)
    assert "--register" in finding.remedy and found.verdict == verdict
    assert calib_pin.evaluate(model, moved, registration=True).findings == ()


@pytest.mark.parametrize("count", [4, 5])
def test_what_few_rows_tell_of_a_frame_is_no_move(job, count) -> None:
    """Base and tool use up most of their values, and leave less whatever is true."""
    _, model, rows = job
    for start in range(0, len(rows) - count, count):
        some = rows.rows(slice(start, start + count))
        assert calib_pin.evaluate(model, some).findings == ()
        moved = replace(some, values=some.values + np.eye(3)[0])
        (finding,) = calib_pin.evaluate(model, moved).findings
        assert finding.code == "frames-moved"


@pytest.mark.parametrize("moved", [0, pytest.param(1, marks=pytest.mark.slow)])
def test_one_of_two_instruments_has_moved(moved) -> None:
    """Whichever comes first in the file."""
    keys = [BlockKey("position", station="a"), BlockKey("pose", station="b")]
    problem, truth = simulated(keys, None, 60, 1.0, seed=2, noise=1e-4)
    result = calib_pin.calibrate(problem.chains, problem.data, validate=False)
    model, rng = result.model, np.random.default_rng(3)
    blocks = [*calib_pin.simulate(problem, truth, rng, count=24, noise=1e-4).blocks]
    assert calib_pin.evaluate(model, Observations.of(*blocks)).findings == ()
    values = blocks[moved].values.copy()
    values[:, 1] += 3e-3
    blocks[moved] = replace(blocks[moved], values=values)
    (finding,) = calib_pin.evaluate(model, Observations.of(*blocks)).findings
    assert finding.code == "frames-moved"
    assert finding.evidence["rms_before"] == pytest.approx(3e-3, rel=0.05)


def test_reversed_joint(job) -> None:
    _, model, rows = job
    rows = rows.rows(slice(0, 12))
    q = rows.q * np.array([1, 1, -1, 1, 1, 1])
    found = calib_pin.evaluate(model, replace(rows, q=q))
    assert found.verdict == "untrusted"
    (finding,) = found.findings
    assert finding.code == "joint-reversed" and finding.message in found.reason
    assert evaluation_document(found)["findings"][0]["setup"] == finding.setup
    text = plain_text(evaluated(found))
    assert "joints:\n    joint_3: {joint: joint_3, sign: -1}" in text


def test_an_outlier_is_named_and_moves_nothing(job) -> None:
    chain, model, rows = job
    values = rows.values.copy()
    values[13] /= 0.3048
    spoiled = replace(rows, values=values)
    for robot in (model, chain):
        found = calib_pin.evaluate(robot, spoiled)
        (finding,) = found.findings
        assert (finding.code, finding.severity) == ("outliers", "warning")
        assert finding.setup == {"reading": {"without": [75]}}


def test_corners_that_a_board_states_are_not_placed_by_measurements() -> None:
    """The fitted images show some of them, those that are evaluated all."""
    camera = CameraSetup("world", (900.0, 900.0), (640.0, 480.0), size=(1280.0, 960.0))
    board = BoardSetup("charuco", columns=7, rows=5, square=0.03)
    frames = {"base_frame": FrameSetup((0.0, 1.0, 3.0), (np.pi / 2, 0.0, 0.0))}
    setup = Setup(parameters=(), camera=camera, board=board, **frames)
    job, _ = simulated("camera", setup, 60)
    rows = job.data
    some = np.isin(np.array(rows.target), ("3", "17", "20"))
    assert some.any() and not some.all()
    problem = make_problem(job.chains, rows.rows(some), setup)
    there = registered(problem, np.zeros(len(problem.parameters)), rows)
    assert len(there.problem.references) > len(problem.references)
    assert there.located == ()


def test_a_nominal_chain_knows_no_place_of_a_sphere() -> None:
    there = Setup(spheres={"ball": SphereSetup((0.5, -0.3, 0.4), 0.15)})
    job, _ = simulated("sphere-contact", there, 40)
    nowhere = Setup(spheres={"ball": SphereSetup()})
    found = calib_pin.evaluate(job.chains, job.data, nowhere)
    assert found.registered and found.errors[0][2].rms < 1e-9
