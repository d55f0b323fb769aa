"""Lost motion shows in fits without it, and in no others."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

import calib_pin
from calib_pin.calibration import calibrate
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Conditions, Observations
from calib_pin.setup import FrameSetup, Setup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.joint_motions import approach, approach_order

CHAIN = calib_pin.load_chain("pa10")
TOOL = FrameSetup((0.1, 0.05, 0.15), estimate=True)
PLACEMENT = Setup(parameters=("placement",), tool_frame=TOOL)


def robot_with(lost: dict[int, float], seed: int, count: int = 60) -> Observations:
    """Measurements of a robot with lost motion of some joints [rad]."""
    setup = replace(PLACEMENT, parameters=("placement", "hysteresis"))
    problem = nominal_problem(CHAIN, "position", setup)
    rng = np.random.default_rng(seed)
    theta = draw_errors(problem.parameters, rng)
    for k, name in enumerate(problem.parameters.names):
        if ".hysteresis." in name:
            theta[k] = lost.get(CHAIN.joints.index(name.split(".")[0]), 0.0)
    rows = simulate(problem, theta, rng, count=count, noise=3e-5).only
    # As from a file that does not state them.
    held = replace(rows.conditions, source="order")
    return Observations.of(replace(rows, conditions=held))


def case_of(data: Observations) -> Case:
    return Case.of(fit_model(CHAIN, data, PLACEMENT, 0).fit, Chains.of(CHAIN))


def told(data: Observations) -> Finding | None:
    return next(approach(case_of(data)), None)


def test_lost_motion_is_told_by_joint() -> None:
    lost = {1: 2e-3, 2: 5e-4, 4: 1e-3}
    found = told(robot_with(lost, 3))
    assert found is not None
    names = {CHAIN.joints[j]: size for j, size in lost.items()}
    assert set(str(found.evidence["joints"]).split(", ")) == set(names)
    for name, size in names.items():
        # Half of the smallest is a tenth of a millimeter here, beside the noise.
        assert abs(float(found.evidence[name]) - size) < 1e-4


def test_what_is_estimated_is_not_sought() -> None:
    data = robot_with({1: 2e-3, 2: 1e-3}, 3)
    setup = replace(PLACEMENT, parameters=("placement", "hysteresis"))
    result = calibrate(CHAIN, data, setup, validate=False)
    codes = {f.code: f.severity for f in result.findings}
    assert "backlash" not in codes and codes["approach-by-order"] == "info"
    held = replace(data.only.conditions, source="columns")
    stated = Observations.of(replace(data.only, conditions=held))
    assert not [*approach_order(case_of(stated))]


def test_nothing_is_sought_where_no_side_is_known() -> None:
    data = robot_with({1: 2e-3}, 3)
    assert told(data) is not None
    unknown = replace(data.only, conditions=Conditions())
    assert told(Observations.of(unknown)) is None
