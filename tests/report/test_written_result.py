"""A result that was read from its files is the one that was written, byte for byte."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.cli.results import Run, result_contents, result_files
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.result_file import read_suggestions, read_written
from calib_pin.planning.suggestions import calibrated_setup, suggestions
from calib_pin.report.figures import calibration_figures
from calib_pin.report.html import html_report
from calib_pin.report.terminal import plain_text
from calib_pin.report.text import report
from calib_pin.setup import (
    Payload,
    Setup,
    SolverSetup,
)
from calib_pin.validation.result import CalibrationResult

OFFSETS = ("joint-offset",)


def measured(model: str, setup: Setup, count: int, robot: str = "space6") -> tuple:
    chain = calib_pin.load_chain(robot)
    problem = nominal_problem(chain, model, setup)
    rng = np.random.default_rng(3)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    return chain, calib_pin.simulate(problem, theta, rng, count=count)


def position_held_out() -> CalibrationResult:
    chain, rows = measured("position", Setup(), 60)
    return calib_pin.calibrate(chain, rows, holdout=0.25)


def pose_cross_validated() -> CalibrationResult:
    chain, rows = measured("pose", Setup(), 40)
    return calib_pin.calibrate(chain, rows)


def with_findings() -> CalibrationResult:
    chain = calib_pin.load_chain("space7")
    setup = calib_pin.read_setup(calib_pin.robot_file("space7", "setup.yaml"))
    file = calib_pin.robot_file("space7", "measurements.csv")
    result = calib_pin.calibrate(chain, calib_pin.read_measurements(file, chain), setup)
    assert result.findings
    return result


def evolution() -> CalibrationResult:
    chain, rows = measured("position", Setup(), 40)
    setup = Setup(parameters=OFFSETS, solver=SolverSetup(name="hybrid"))
    return calib_pin.calibrate(chain, rows, setup)


def corrections() -> CalibrationResult:
    setup = Setup(
        parameters=("placement", "transmission", "compliance"),
        payloads={"p": Payload(6.0, (0.0, 0.0, 0.1))},
    )
    chain, rows = measured("pose", setup, 60, "pa10")
    return calib_pin.calibrate(chain, rows, setup)


def learned() -> CalibrationResult:
    chain, rows = measured("pose", Setup(parameters=("placement",)), 60)
    q = rows.q.copy()
    values = rows.values.copy()
    values[:, :3] += 2e-3 * np.sin(3.0 * q[:, 1:4])
    setup = Setup(parameters=OFFSETS, learned="gaussian-process")
    return calib_pin.calibrate(chain, replace(rows, values=values), setup)


def ladder() -> CalibrationResult:
    chain, rows = measured("position", Setup(), 40)
    return calib_pin.calibrate(chain, rows, ladder=True)


def untrusted() -> CalibrationResult:
    chain, rows = measured("position", Setup(), 12)
    return calib_pin.calibrate(chain, rows)


CASES = {
    "position": position_held_out,
    "pose": pose_cross_validated,
    "findings": with_findings,
    "evolution": evolution,
    "corrections": corrections,
    "learned": learned,
    "untrusted": untrusted,
    "ladder": ladder,
}
SLOW = ("ladder", "evolution")


@pytest.mark.parametrize(
    "name",
    [pytest.param(n, marks=[pytest.mark.slow] if n in SLOW else []) for n in CASES],
)
def test_page_and_figures_from_files_are_the_same_bytes(
    name: str, tmp_path: Path
) -> None:
    result = CASES[name]()
    better = suggestions(
        result.model.chain,
        result.model.measurement.name,
        calibrated_setup(result.model),
        result,
    )
    drawn = list(calibration_figures(result))
    files = result_files(tmp_path / "out", result.model.chain.robot.name)
    run = Run(("calib-pin", "calibrate", "a b.csv"), 1.25)
    for path, data in result_contents(result, files, run, drawn, {}, better).items():
        path.parent.mkdir(exist_ok=True)
        path.write_bytes(data)

    found, document = read_written(tmp_path / "out")
    again = list(calibration_figures(found))
    assert [f.name for f in again] == [f.name for f in drawn]
    for one, other in zip(again, drawn, strict=True):
        assert one.svg() == other.svg(), one.name
    stated = read_suggestions(document)
    assert stated == better
    page = html_report(found, document, figures=again, suggestions=stated)
    assert page == files.report.read_bytes()
    assert plain_text(report(found, stated)) == plain_text(report(result, better))
