"""The predicted error of the tip against the true one, and against refits."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats, so3_log
from calib_pin.observations import Measurements
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.tip_drift import absorbed

TOOL = FrameSetup((0.05, 0.1, 0.1), (0.3, 0.2, 0.1))
CHAIN = calib_pin.load_chain("space6")


def measured(
    seed: int, count: int, model: str = "pose"
) -> tuple[Problem, Floats, Measurements]:
    """One robot, measured again with other noise."""
    problem = nominal_problem(CHAIN, model, Setup(tool_frame=TOOL))
    truth = calib_pin.draw_errors(problem.parameters, np.random.default_rng(0))
    rng = np.random.default_rng(seed)
    rows = calib_pin.simulate(problem, truth, rng, count=count, noise=1e-4)
    return problem, truth, rows.only


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
        moved, *_ = absorbed(true, found)
        off = [T[:, :3, 3] - true[:, :3, 3] for T in (found, moved)]
        squares.append([np.sum(v**2, axis=1).mean() for v in (*off, turned)])
        predicted.append([tip.rms[0], tip.of_robot[0], tip.rms[1]])
    expected = np.sqrt(np.mean(np.square(predicted), axis=0))
    np.testing.assert_allclose(np.sqrt(np.mean(squares, axis=0)), expected, rtol=0.25)


def test_it_falls_with_the_number_of_rows() -> None:
    """What is said of some of the rows is what a fit of as many says."""
    *_, rows = measured(1, 80)
    rows = replace(rows, sigma=None)
    tip = fit(rows).accuracy.tip
    assert tip is not None
    counts, errors = tip.by_count.measurements, tip.by_count.position
    assert counts[-1] == 80 and (np.diff(counts) > 0).all()
    assert (np.diff(errors) < 0).all()
    # The expected size of errors, which the curve leaves out, is worth a little.
    assert errors[-1] == pytest.approx(tip.rms[0], rel=1e-3)
    k = int(np.searchsorted(counts, 35))
    few = rows.rows(np.random.default_rng(0).permutation(80)[: int(counts[k])])
    refit = fit(few).accuracy.tip
    assert refit is not None
    assert refit.rms[0] == pytest.approx(errors[k], rel=0.4)


def test_it_falls_where_gears_are_not_modeled() -> None:
    """The curve is about noise to its end; other errors do not depend on numbers."""
    gears = {f"joint_{k}.transmission.sin1": 6e-4 * (-1) ** k for k in range(1, 7)}
    true = Setup(parameters=("placement", "transmission"))
    problem = nominal_problem(CHAIN, "position", true)
    theta, rng = problem.parameters.vector(gears), np.random.default_rng(0)
    rows = calib_pin.simulate(problem, theta, rng, count=60, noise=2e-5)
    tip = fit(rows.only).accuracy.tip
    assert tip is not None
    errors = tip.by_count.position
    assert (np.diff(errors) < 0).all() and tip.rms[0] > 1.5 * errors[-1]


@pytest.mark.slow
def test_very_many_rows_are_sampled() -> None:
    *_, rows = measured(2, 1200, model="position")
    result = fit(rows)
    assert result.accuracy.tip is not None
    found = result.accuracy.tip.by_count
    counts, errors = found.measurements, found.position
    assert counts[-2] <= 400 < counts[-1] == 1200
    # Three times as many rows, the root of three better.
    ratio = errors[-2] / errors[-1]
    assert ratio == pytest.approx(np.sqrt(1200 / counts[-2]), rel=0.15)


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
