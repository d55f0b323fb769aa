"""Rows of the identification matrix and their derivative by the configuration."""

from __future__ import annotations

import numpy as np
import pytest

import calib_pin
from calib_pin.calibration import nominal_problem
from calib_pin.measurement_models import MEASUREMENT_MODELS, CurvedModel
from calib_pin.measurement_models.position import Position
from calib_pin.planning.rows import IdentificationRows
from calib_pin.problem import Problem, assumed_sigma, observable_configurations
from calib_pin.setup import FrameSetup, PlaneSetup, Setup

ROBOTS = {
    "space6": (None, None),
    # A prismatic joint, skewed frames, and a tip without a fixed joint.
    "example:tiago_no_hand": (None, "arm_7_link"),
    # Two branches: from one hand to the other.
    "example:talos_reduced": ("gripper_right_base_link", "gripper_left_base_link"),
}

SETUP = Setup(
    base_frame=FrameSetup((0.1, -0.2, 0.05), (0.3, -0.2, 0.4), estimate=True),
    tool_frame=FrameSetup((0.02, 0.03, 0.1), (-0.1, 0.2, 0.3), estimate=True),
    planes={
        "floor": PlaneSetup((0.1, 0.2, 1.0), 1.5),
        "wall": PlaneSetup((1.0, 0.3, 0.2), -3.0),
    },
    noise={"position": 2e-4, "orientation": 1e-3},
)


def make(robot: str, model: str, columns: int = 7) -> IdentificationRows:
    base, tip = ROBOTS[robot]
    chain = calib_pin.load_chain(robot, base=base, tip=tip)
    problem = nominal_problem(chain, model, SETUP)
    rng = np.random.default_rng(5)
    basis = rng.normal(size=(len(problem.parameters), columns))
    sigma = assumed_sigma(problem.measurement, problem.setup.noise)
    return IdentificationRows(problem, basis, 2, problem.measurement, sigma)


def configurations(
    problem: Problem, count: int = 4
) -> tuple[np.ndarray, tuple[str, ...]]:
    zero = np.zeros(len(problem.parameters))
    return observable_configurations(problem, zero, count, np.random.default_rng(2))


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("model", MEASUREMENT_MODELS)
def test_rows_are_those_of_the_problem(model: str, robot: str) -> None:
    of = make(robot, model)
    q, target = configurations(of.problem)
    zero = np.zeros(len(of.problem.parameters))
    _, J = of.problem.about(zero, q, target).linearize_rows(zero)
    expected = (J @ of.basis).reshape(len(q), -1, of.basis.shape[1])
    np.testing.assert_allclose(of.rows(q, target), expected, rtol=1e-10, atol=1e-9)
    np.testing.assert_allclose(of.linearize(q, target)[0], expected, atol=1e-8)


@pytest.mark.parametrize("robot", ROBOTS)
@pytest.mark.parametrize("model", MEASUREMENT_MODELS)
def test_pullback_agrees_with_central_differences(model: str, robot: str) -> None:
    of = make(robot, model)
    assert isinstance(of.measurement, CurvedModel)
    q, target = configurations(of.problem)
    rows, pullback = of.linearize(q, target)
    by_rows = np.random.default_rng(0).normal(size=rows.shape)
    found = pullback(by_rows)
    expected = np.empty_like(q)
    step = 1e-6
    for k in range(q.shape[1]):
        shift = step * np.eye(q.shape[1])[k]
        change = of.rows(q + shift, target) - of.rows(q - shift, target)
        expected[:, k] = np.sum(by_rows * change, axis=(1, 2)) / (2 * step)
    assert np.abs(found - expected).max() < 1e-7 * np.abs(expected).max()


def test_another_instrument_in_the_same_columns() -> None:
    """The tip's position in the columns of a study with a ranger."""
    ranger = make("space6", "plane-distance")
    q, _ = configurations(ranger.problem)
    of = IdentificationRows(
        ranger.problem, ranger.basis, 2, Position(), np.full(3, 1.0)
    )
    rows, pullback = of.linearize(q, ("",) * len(q))
    _, J = ranger.problem.error.jacobian(q, np.zeros(len(of.problem.error.screws)))
    T = ranger.problem.error.poses(q, np.zeros(len(of.problem.error.screws)))
    expected = T[:, :3, :3] @ J[:, :3] @ ranger.basis[: J.shape[2]]
    np.testing.assert_allclose(rows, expected, atol=1e-9)
    assert pullback(rows).shape == q.shape
