"""Every parameterization with every measurement model against central differences.

This is the one place where they are compared: each parameterization with blocks of all
models in one problem, some of them together, on chains that take turns.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from benchmarks.exact import exact_at
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.nominal import (
    named_targets,
    observable_configurations,
    unmeasured,
)
from calib_pin.estimation.problem import Problem, measured_count
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.observations import BlockKey, Conditions, Observations
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.setup import Setup
from tests.shared import equipped_problem, visited

STEP = 1e-6
EVERY = tuple(map(BlockKey, MEASUREMENT_MODELS))
ARM = ("space6", None, None)
LIFT = ("example:tiago_no_hand", None, "arm_7_link")
"""A prismatic joint, skewed frames, and a tip without a fixed joint."""

HANDS = ("example:talos_reduced", "gripper_right_base_link", "gripper_left_base_link")
"""Two branches: from one hand to the other."""

MEMBERS = (
    # The screws of a place stand before its joint's motion, whatever their order.
    (("transmission", "placement", "compliance", "joint-offset"), ARM),
    (("transmission", "placement", "compliance", "joint-offset"), HANDS),
    (("link-transform", "thermal"), LIFT),
    (("dh", "hysteresis"), HANDS),
    (("dh-full", "cross-compliance"), ARM),
    (("motor-ripple", "warm-up"), LIFT),
    (("instrument-drift",), ARM),
)


def test_every_parameterization_is_compared() -> None:
    assert {name for names, _ in MEMBERS for name in names} == set(PARAMETERIZATIONS)


@pytest.mark.parametrize(
    ("names", "robot"),
    [pytest.param(n, r, id="+".join((*n, *r[:1]))) for n, r in MEMBERS],
)
def test_jacobian_agrees_with_central_differences(names, robot):
    name, base, tip = robot
    chain = calib_pin.load_chain(name, base=base, tip=tip)
    problem = equipped_problem(chain, EVERY, parameters=names, prior={"*": 0.01})
    check_jacobian(problem)


def check_jacobian(problem: Problem) -> None:
    rng = np.random.default_rng(3)
    # Twenty times what is expected of a robot: heavy arms must not sag by meters.
    sizes = np.minimum(0.02, 20.0 * problem.parameters.scales)
    theta = rng.normal(size=len(sizes)) * sizes
    at = []
    for key in problem.terms:
        count = max(3, len(named_targets(problem, key)))
        if problem.terms[key].measurement.declaration.contact:
            q, target = visited(problem, theta, count, rng, key)
        else:
            # Where a beam meets its plane: along it no derivative is of any size.
            seen = observable_configurations(problem, key, theta, count, rng)
            q, target = seen.q, seen.target
        held = Conditions(
            temperature=rng.uniform(5.0, 45.0, len(q)),
            time=rng.uniform(-600.0, 4200.0, len(q)),
        )
        at.append(unmeasured(problem, key, q, target, held))
    # Measured values away from the prediction: the residual's own curvature counts.
    disturbed = []
    for term, data, _, _ in exact_at(problem, theta, *at).blocks:
        noise = rng.normal(size=(len(data), term.components)) * 0.05
        values = term.measurement.disturb(data.values, noise)
        if term.measurement.declaration.readings:
            values = noise  # Of a gauge.
        disturbed.append(replace(data, values=values))
    measured = replace(problem, data=Observations(tuple(disturbed)))

    # Along some random signs of all parameters: whatever column is wrong shows in each.
    _, J = measured.linearize_rows(theta)
    ways = rng.choice([-1.0, 1.0], (12, len(theta)))
    ends = [[measured.residual(theta + s * way) for s in (STEP, -STEP)] for way in ways]
    slopes = np.array([ahead - behind for ahead, behind in ends]).T / (2.0 * STEP)
    error = np.abs(J @ ways.T - slopes).max(axis=1)
    size = np.abs(J).max(axis=1)
    for block in measured.blocks:
        # Pixels change by thousands where angles change by one.
        found, most = block.table(error).max(), block.table(size).max()
        assert found < 2e-7 * most, block.term.key
    # Priors and distances.
    rest = slice(measured_count(measured), None)
    assert error[rest].max() < 2e-7 * size[rest].max()


def test_screws_of_one_place_apply_in_order() -> None:
    chain = calib_pin.load_chain("space6")
    problem = nominal_problem(chain, "pose", Setup())
    values = {"x": 0.1, "ry": 0.2, "rz": -0.3}
    theta = problem.parameters.vector(
        {f"joint_3.placement.{key}": value for key, value in values.items()}
    )
    expected = pin.SE3(np.eye(3), np.array([0.1, 0, 0]))
    expected *= pin.SE3(pin.exp3(np.array([0, 0.2, 0])), np.zeros(3))
    expected *= pin.SE3(pin.exp3(np.array([0, 0, -0.3])), np.zeros(3))
    term = problem.only
    found = term.error.corrections(term.values(theta)[0])[3]
    assert found.isApprox(expected, 1e-12)
