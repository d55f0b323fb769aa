"""The predicted error of the tip against the true one, and against refits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import calib_pin
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats, so3_log
from calib_pin.observations import Measurements
from calib_pin.setup import BoardSetup, CameraSetup, FrameSetup, Setup
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.tip_drift import absorbed
from tests.shared import simulated

TOOL = FrameSetup((0.05, 0.1, 0.1), (0.3, 0.2, 0.1))
CHAIN = calib_pin.load_chain("space6")


def measured(
    seed: int, count: int, model: str = "pose"
) -> tuple[Problem, Floats, Measurements]:
    """One robot, measured again with other noise."""
    setup = Setup(tool_frame=TOOL)
    problem, truth = simulated(model, setup, count, 1.0, noise=1e-4, again=seed)
    return problem, truth, problem.data.only


def fit(rows: Measurements, setup: Setup | None = None) -> CalibrationResult:
    return calib_pin.calibrate(CHAIN, rows, setup or Setup(), validate=False)


def test_it_is_the_error_that_fits_have() -> None:
    """Over independent noise, true errors at the same configurations.

    Of the robot alone, without what frames absorb, the error is smaller.
    """
    squares, predicted = [], []
    for seed in range(4):
        problem, truth, rows = measured(seed, 30)
        result = fit(rows)
        tip = result.accuracy.tip
        assert tip is not None and tip.of_robot[0] < tip.rms[0]
        true = problem.only.error.poses(tip.q, problem.only.values(truth)[0])
        found = result.model.of().poses(tip.q)
        turned = so3_log(np.swapaxes(true[:, :3, :3], 1, 2) @ found[:, :3, :3])
        moved = absorbed(true, found)
        off = [T[:, :3, 3] - true[:, :3, 3] for T in (found, moved)]
        squares.append([np.sum(v**2, axis=1).mean() for v in (*off, turned)])
        predicted.append([tip.rms[0], tip.of_robot[0], tip.rms[1]])
    expected = np.sqrt(np.mean(np.square(predicted), axis=0))
    np.testing.assert_allclose(np.sqrt(np.mean(squares, axis=0)), expected, rtol=0.25)


def test_points_are_those_of_the_tool_in_the_base_link() -> None:
    *_, rows = measured(3, 30)
    result = fit(rows)
    tip, model = result.accuracy.tip, result.model.of()
    assert tip is not None
    T = model.error.base.inverse().homogeneous @ model.poses(tip.q)
    np.testing.assert_allclose(tip.points, T[:, :3, 3], atol=1e-12)
    assert (tip.q >= CHAIN.lower).all() and (tip.q <= CHAIN.upper).all()


def test_without_redundancy_nothing_is_predicted() -> None:
    *_, rows = measured(4, 5)
    assert fit(rows).accuracy.tip is None
    assert fit(replace(rows, sigma=None)).accuracy.tip is None


def test_images_of_many_corners_count_as_one_configuration_each() -> None:
    """A hundred corners are three images, where frames absorb all errors."""
    camera = CameraSetup("world", (900.0, 900.0), (640.0, 480.0))
    board = BoardSetup("chessboard", 8, 6, 0.02)
    far = FrameSetup((0.0, 0.0, 4.0), (0.3, 0.2, 0.1))
    setup = Setup(base_frame=far, tool_frame=TOOL, camera=camera, board=board)
    how = {"again": 1, "per_configuration": True, "noise": 0.1}
    rows = simulated("camera", setup, 20, 1.0, **how)[0].data
    assert rows.configurations == 20 and len(rows) > 400
    found = fit(rows.only, setup).accuracy
    assert found.measured is not None and found.workspace is not None
    least = 0.2 * found.workspace.calibrated.position
    assert found.measured.calibrated.position > least
