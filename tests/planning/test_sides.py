"""Plans for robots with lost motion say from which side joints shall come."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np

import calib_pin
from calib_pin.calibration import calibrate
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.condition_columns import read_held
from calib_pin.io.measurements import encode_configurations
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
    found = plan(CHAIN, "position", 30, SETUP, method="exchange")
    sides = np.stack([np.array(s) for s in sides_of(found).values()], axis=1)
    assert list(sides_of(found)) == list(CHAIN.joints)
    # From both, each joint at a fifth of the configurations at least.
    assert np.abs(sides.mean(axis=0)).max() < 0.6
    assert "'<joint>.direction'" in str([*plan_report(found)])
    # They stand in the file, and are read as what is measured there.
    file = tmp_path / "plan.csv"
    file.write_bytes(encode_configurations(CHAIN, found.q, sides=sides_of(found)))
    held = read_held(file, CHAIN.joints, found.q)
    np.testing.assert_array_equal(held.direction, sides)
    # What is expected of the plan is what a calibration of it gets.
    problem = nominal_problem(CHAIN, "position", SETUP)
    rng = np.random.default_rng(0)
    # Errors so large that a fit holds none of them back by their usual size.
    theta = 10.0 * draw_errors(problem.parameters, rng)
    rows = simulate(problem, theta, rng, q=found.q, conditions=held, noise=1e-4)
    sigma = calibrate(CHAIN, rows, SETUP).covariance.diagonal() ** 0.5
    predicted = found.predicted.covariance.diagonal() ** 0.5
    lost = np.array([".hysteresis." in name for name in problem.parameters.names])
    np.testing.assert_allclose(sigma[lost], predicted[lost], rtol=0.35)


def test_it_beats_short_travel_alone() -> None:
    """The sides from which a plan without them would come tell less."""
    found = plan(CHAIN, "position", 30, SETUP, method="exchange")
    problem = nominal_problem(CHAIN, "position", SETUP)
    lost = [k for k, n in enumerate(problem.parameters.names) if ".hysteresis." in n]

    def deviations(held: Conditions) -> np.ndarray:
        rng = np.random.default_rng(0)
        zero = np.zeros(len(problem.parameters))
        rows = simulate(problem, zero, rng, q=found.q, conditions=held, noise=1e-4)
        return calibrate(CHAIN, rows, SETUP).covariance.diagonal()[lost] ** 0.5

    sides = np.stack([np.array(s) for s in sides_of(found).values()], axis=1)
    asked, came = (
        deviations(Conditions(direction=d.astype(np.int8)))
        for d in (sides, approached(found.q))
    )
    assert np.mean(np.log(asked / came)) < 0.0


def test_without_lost_motion_no_side_matters() -> None:
    setup = replace(SETUP, parameters=("placement",))
    found = plan(CHAIN, "position", 16, setup, method="greedy")
    assert not sides_of(found)
    table = encode_configurations(CHAIN, found.q, sides=sides_of(found))
    assert b"direction" not in table
