"""The predicted error of the tip against the true one, and against refits."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.cli import main
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.tip_drift import absorbed

TOOL = FrameSetup((0.05, 0.1, 0.1), (0.3, 0.2, 0.1))
CHAIN = calib_pin.load_chain("space6")


def simulated(
    seed: int, count: int, noise: float = 1e-4, model: str = "pose"
) -> tuple[Problem, Floats, Measurements]:
    problem = nominal_problem(CHAIN, model, Setup(tool_frame=TOOL))
    truth = calib_pin.draw_errors(problem.parameters, np.random.default_rng(0))
    rng = np.random.default_rng(seed)
    rows = calib_pin.simulate(problem, truth, rng, count=count, noise=noise)
    return problem, truth, rows.only


def fit(rows: Measurements) -> CalibrationResult:
    return calib_pin.calibrate(CHAIN, rows, validate=False)


def test_it_is_the_error_that_fits_have() -> None:
    """Over independent noise, true errors at the same configurations."""
    squares, turned, predicted = [], [], []
    for seed in range(14):
        problem, truth, rows = simulated(seed, 30)
        result = fit(rows)
        tip = result.accuracy.tip
        assert tip is not None
        true = problem.only.error.poses(tip.q, problem.only.split(truth)[0])
        found = result.model.of().poses(tip.q)
        squares.append(np.sum((found[:, :3, 3] - true[:, :3, 3]) ** 2, axis=1).mean())
        R = np.swapaxes(true[:, :3, :3], 1, 2) @ found[:, :3, :3]
        w = 0.5 * np.stack(
            [R[:, 2, 1] - R[:, 1, 2], R[:, 0, 2] - R[:, 2, 0], R[:, 1, 0] - R[:, 0, 1]]
        )
        turned.append(np.sum(w**2, axis=0).mean())
        predicted.append(tip.rms)
    expected = np.sqrt(np.mean(np.square(predicted), axis=0))
    assert np.sqrt(np.mean(squares)) == pytest.approx(expected[0], rel=0.15)
    assert np.sqrt(np.mean(turned)) == pytest.approx(expected[1], rel=0.15)


@pytest.mark.parametrize("stated", [True, False])
def test_it_falls_with_the_number_of_rows(stated: bool) -> None:
    """What is said of some of the rows is what a fit of as many says."""
    *_, rows = simulated(1, 80)
    rows = rows if stated else replace(rows, sigma=None)
    tip = fit(rows).accuracy.tip
    assert tip is not None
    counts, errors = tip.by_count.curve
    assert counts[-1] == 80 and (np.diff(counts) > 0).all()
    assert (np.diff(errors) < 0).all()
    # The expected size of errors, which the curve leaves out, is worth a little.
    assert errors[-1] == pytest.approx(tip.rms[0], rel=1e-3)
    k = int(np.searchsorted(counts, 35))
    few = [
        fit(
            rows.rows(np.random.default_rng(n).permutation(80)[: int(counts[k])])
        ).accuracy.tip
        for n in range(3)
    ]
    refits = [part.rms[0] for part in few if part is not None]
    assert np.median(refits) == pytest.approx(errors[k], rel=0.25)


def test_it_falls_where_gears_are_not_modeled(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The curve is about noise to its end; other errors do not depend on numbers."""
    monkeypatch.chdir(tmp_path)
    Path("gears.yaml").write_text("parameters: [placement, transmission]\n")
    gears = {f"joint_{k}.transmission.sin1": 6e-4 * (-1) ** k for k in range(1, 7)}
    lines = [f"{name}: {value}\n" for name, value in gears.items()]
    Path("errors.yaml").write_text("".join(lines))
    words = "simulate space6 --model position --setup gears.yaml --errors errors.yaml"
    assert (
        main([*words.split(), "--count", "60", "--noise", "2e-5", "-o", "m.csv"]) == 0
    )
    chain = calib_pin.load_chain("space6")
    rows = calib_pin.read_measurements("m.csv", chain)
    tip = calib_pin.calibrate(chain, rows, validate=False).accuracy.tip
    assert tip is not None
    _, errors = tip.by_count.curve
    assert (np.diff(errors) < 0).all() and tip.rms[0] > 1.5 * errors[-1]


def test_very_many_rows_are_sampled() -> None:
    *_, rows = simulated(2, 2000, model="position")
    result = fit(rows)
    assert result.accuracy.tip is not None
    counts, errors = result.accuracy.tip.by_count.curve
    assert counts[-2] <= 400 < counts[-1] == 2000
    # Five times as many rows, the root of five better.
    ratio = errors[-2] / errors[-1]
    assert ratio == pytest.approx(np.sqrt(2000 / counts[-2]), rel=0.15)


def test_points_are_those_of_the_tool_in_the_base_link() -> None:
    *_, rows = simulated(3, 30)
    result = fit(rows)
    tip, model = result.accuracy.tip, result.model.of()
    assert tip is not None
    T = model.error.base.inverse().homogeneous @ model.poses(tip.q)
    np.testing.assert_allclose(tip.points, T[:, :3, 3], atol=1e-12)
    assert (tip.q >= CHAIN.lower).all() and (tip.q <= CHAIN.upper).all()


def test_without_redundancy_nothing_is_predicted() -> None:
    *_, rows = simulated(4, 5)
    assert fit(rows).accuracy.tip is None
    assert fit(replace(rows, sigma=None)).accuracy.tip is None


def test_what_frames_absorb_is_taken_away() -> None:
    """Of the robot alone the error is smaller, and as large as that of refits."""
    squares, predicted = [], []
    for seed in range(8):
        problem, truth, rows = simulated(seed, 30)
        result = fit(rows)
        tip = result.accuracy.tip
        assert tip is not None
        assert tip.of_robot[0] < tip.rms[0]
        true = problem.only.error.poses(tip.q, problem.only.split(truth)[0])
        moved = absorbed(true, result.model.of().poses(tip.q), left=True, right=True)
        squares.append(np.sum((moved[:, :3, 3] - true[:, :3, 3]) ** 2, axis=1).mean())
        predicted.append(tip.of_robot[0])
    expected = np.sqrt(np.mean(np.square(predicted)))
    assert np.sqrt(np.mean(squares)) == pytest.approx(expected, rel=0.15)


def test_a_far_first_guess_predicts_the_same() -> None:
    """Parameters belong to references, and so does their covariance."""
    *_, rows = simulated(2, 40)
    far = FrameSetup((0.5, 0.1, -0.2), (1.0, -0.3, 0.4), estimate=True)
    found = [
        calib_pin.calibrate(CHAIN, rows, setup, validate=False).accuracy.tip
        for setup in (Setup(), Setup(base_frame=far))
    ]
    near, other = found
    assert near is not None and other is not None
    # Directions of the structure come from Jacobians about other references.
    np.testing.assert_allclose(other.position, near.position, rtol=1e-6)
    np.testing.assert_allclose(other.orientation, near.orientation, rtol=1e-6)
