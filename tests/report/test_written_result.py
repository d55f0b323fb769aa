"""A result that was read from its files is the one that was written, byte for byte."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.cli.results import Run, result_contents, result_files
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.measurement_errors import decode_errors, encode_errors
from calib_pin.io.result_file import read_suggestions, read_written
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import BlockKey, Observations
from calib_pin.observations.conditions import Source
from calib_pin.planning.suggestions import calibrated_setup, suggestions
from calib_pin.report.figures import calibration_figures
from calib_pin.report.html import html_report
from calib_pin.report.terminal import plain_text
from calib_pin.report.text import report
from calib_pin.setup import (
    AnchorSetup,
    CameraSetup,
    DistanceSetup,
    FrameSetup,
    Payload,
    PointSetup,
    Setup,
    SolverSetup,
    ToolSetup,
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
    values = rows.only.values.copy()
    values[:, :3] += 2e-3 * np.sin(3.0 * rows.q[:, 1:4])
    setup = Setup(parameters=OFFSETS, learned="gaussian-process")
    return calib_pin.calibrate(chain, replace(rows.only, values=values), setup)


def ladder() -> CalibrationResult:
    chain, rows = measured("position", Setup(), 40)
    return calib_pin.calibrate(chain, rows, ladder=True)


def untrusted() -> CalibrationResult:
    chain, rows = measured("position", Setup(), 12)
    return calib_pin.calibrate(chain, rows)


def camera() -> CalibrationResult:
    board = {
        f"m{k}": PointSetup((0.1 * (k % 2), 0.08 * (k // 2), 0.1)) for k in range(4)
    }
    setup = Setup(
        parameters=OFFSETS,
        base_frame=FrameSetup((0.1, -0.2, 3.0), (0.3, -0.2, 0.4), estimate=True),
        camera=CameraSetup("world", (900.0, 910.0), (640.0, 500.0), estimate=True),
        targets=board,
    )
    chain, rows = measured("camera", setup, 120)
    return calib_pin.calibrate(chain, rows, setup)


def known_distances() -> CalibrationResult:
    places = {"a": (1.4, 0.9, 0.2), "b": (1.4, -0.9, 0.2), "c": (-1.0, 0.2, 1.4)}
    setup = Setup(
        parameters=OFFSETS,
        tool_frame=FrameSetup((0.02, 0.03, 0.1)),
        anchors={
            name: AnchorSetup(xyz, estimate_bias=True) for name, xyz in places.items()
        },
        distances=(DistanceSetup(("a", "b"), 1.8001, 1e-4),),
    )
    chain, rows = measured("point-distance", setup, 120)
    result = calib_pin.calibrate(chain, rows, setup)
    assert result.distances
    return result


def several_blocks() -> CalibrationResult:
    """Two stations, two tools and a held-out third station."""
    chain = calib_pin.load_chain("space6")
    setup = Setup(
        parameters=OFFSETS,
        stations={
            "day1": FrameSetup((2.0, 1.0, 0.3), (0.1, 0.2, 1.2)),
            "day2": FrameSetup((-1.0, 0.5, 0.1), (0.0, -0.1, 0.4)),
        },
        tools={"ball": ToolSetup((0.0, 0.1, 0.05))},
    )
    keys = [
        BlockKey("position", "", "day1", "probe"),
        BlockKey("pose", "", "day2", "ball"),
        BlockKey("position", "", "day2", "probe"),
    ]
    problem = nominal_problem(chain, keys, setup)
    rng = np.random.default_rng(3)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    first, second, third = calib_pin.simulate(problem, theta, rng, count=120).blocks
    later = replace(third.rows(slice(20, None)), station="day3")
    data = Observations((first, second, third.rows(slice(20))))
    result = calib_pin.calibrate(chain, data, setup, validation=later)
    assert result.held_out is not None
    assert result.held_out.rows.keys == (later.key,)
    return result


def two_hands() -> CalibrationResult:
    chain = calib_pin.load_chain("example:talos_reduced", tip="arm_left_7_link")
    names = ("arm_left_7_link", "arm_right_7_link")
    chains = Chains(chain.robot, names=names)
    keys = [BlockKey("pose", name) for name in names]
    problem = nominal_problem(chains, keys, Setup(parameters=OFFSETS))
    rng = np.random.default_rng(3)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, theta, rng, count=80)
    return calib_pin.calibrate(chains, rows, Setup(parameters=OFFSETS))


def lost_motion(source: Source = "order") -> CalibrationResult:
    """Sides that no file states, and a warm robot."""
    chain = calib_pin.load_chain("space6")
    setup = Setup(
        parameters=("placement", "hysteresis"), tool_frame=FrameSetup((0.1, 0.05, 0.1))
    )
    problem = nominal_problem(chain, "position", setup)
    rng = np.random.default_rng(4)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, theta, rng, count=40, noise=3e-5).only
    warmth = rng.uniform(20.0, 30.0, len(rows))
    held = replace(rows.conditions, source=source, temperature=warmth)
    return calib_pin.calibrate(chain, replace(rows, conditions=held), setup)


def test_conditions_come_back(tmp_path: Path) -> None:
    result = lost_motion()
    assert "approach-by-order" in {f.code for f in result.findings}
    data = encode_errors(result, "1")
    to_base = {"train": np.eye(3), "validate": np.eye(3)}
    fitted, held_out = decode_errors(data, result.model, to_base)
    for found, there in ((fitted, result.fitted), (held_out, result.held_out)):
        assert found is not None and there is not None
        held, stated = found.rows.conditions, there.rows.conditions
        np.testing.assert_array_equal(held.direction, stated.direction)
        np.testing.assert_array_equal(held.temperature, stated.temperature)
        assert np.abs(held.direction).sum() > 0
    # With a model that does not need them they are no columns.
    plain = replace(result.model, setup=replace(result.model.setup, parameters=()))
    assert b"direction.joint_1" in data
    other = encode_errors(replace(result, model=plain), "1")
    assert b"direction.joint_1" not in other


CASES = {
    "lost motion": lost_motion,
    "blocks": several_blocks,
    "hands": two_hands,
    "position": position_held_out,
    "pose": pose_cross_validated,
    "findings": with_findings,
    "evolution": evolution,
    "corrections": corrections,
    "learned": learned,
    "untrusted": untrusted,
    "ladder": ladder,
    "camera": camera,
    "distances": known_distances,
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
        result.model.chains,
        list(result.model.parts),
        calibrated_setup(result.model),
        result,
    )
    drawn = list(calibration_figures(result))
    files = result_files(tmp_path / "out", result.model.chains.robot.name)
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
