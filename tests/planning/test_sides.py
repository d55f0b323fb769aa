"""Plans for robots with lost motion say from which side joints shall come."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import calib_pin
from calib_pin.calibration import calibrate
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.measurements import encode_configurations, read_held
from calib_pin.io.table import read_table
from calib_pin.observations import Conditions, approached
from calib_pin.planning.aims import sides_tried
from calib_pin.planning.plan import plan, sides_of
from calib_pin.report.plan_text import plan_report
from calib_pin.setup import FrameSetup, Setup
from calib_pin.simulation import draw_errors, simulate

CHAIN = calib_pin.load_chain("space6")
SETUP = Setup(
    parameters=("placement", "hysteresis"),
    tool_frame=FrameSetup((0.1, 0.05, 0.15), estimate=True),
)


def test_sides_are_balanced() -> None:
    sides = sides_tried(nominal_problem(CHAIN, "position", SETUP)).astype(float)
    assert sides.shape == (8, 6)
    assert not sides.sum(axis=0).any()
    np.testing.assert_array_equal(sides.T @ sides, 8.0 * np.eye(6))
    plain = replace(SETUP, parameters=("placement",))
    assert not sides_tried(nominal_problem(CHAIN, "position", plain)).size


def test_a_plan_says_from_where_to_come(tmp_path: Path) -> None:
    options = {"method": "exchange", "candidates": 120}
    found = plan(CHAIN, "position", 30, SETUP, **options)
    told = sides_of(found)
    sides = np.stack([np.array(side) for side in told.values()], axis=1)
    assert list(told) == list(CHAIN.joints)
    # From both, each joint at a fifth of the configurations at least.
    assert np.abs(sides.mean(axis=0)).max() < 0.6
    assert "<joint>.direction" in str([*plan_report(found)])
    # They stand in the file, and are read as what is measured there.
    file = tmp_path / "plan.csv"
    file.write_bytes(encode_configurations(CHAIN, found.q, sides=told))
    held = read_held(read_table(file), CHAIN.joints, found.q)
    np.testing.assert_array_equal(held.direction, sides)
    # What is expected of the plan is what a calibration of it gets, and less than
    # the sides tell from which a plan without them would come.
    problem = nominal_problem(CHAIN, "position", SETUP)
    lost = np.array([".hysteresis." in name for name in problem.parameters.names])
    # Errors so large that a fit holds none of them back by their usual size.
    theta = 10.0 * draw_errors(problem.parameters, np.random.default_rng(0))

    def sigmas(conditions: Conditions) -> np.ndarray:
        rng = np.random.default_rng(0)
        job = {"q": found.q, "conditions": conditions, "noise": 1e-4}
        rows = simulate(problem, theta, rng, **job)
        fitted = calibrate(CHAIN, rows, SETUP, validate=False)
        return fitted.covariance.diagonal()[lost] ** 0.5

    asked = sigmas(held)
    predicted = found.predicted.covariance.diagonal()[lost] ** 0.5
    np.testing.assert_allclose(asked, predicted, rtol=0.35)
    came = sigmas(Conditions(direction=approached(found.q)))
    assert np.mean(np.log(asked / came)) < 0.0


def test_without_lost_motion_no_side_matters() -> None:
    setup = replace(SETUP, parameters=("placement",))
    found = plan(CHAIN, "position", 16, setup, method="greedy", candidates=100)
    assert not sides_of(found)
    table = encode_configurations(CHAIN, found.q, sides=sides_of(found))
    assert b"direction" not in table
