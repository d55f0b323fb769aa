"""Every parameterization with every measurement model against central differences."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.estimation.configurations import asked, named_targets
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.observations import BlockKey, Conditions, Observations, Targets
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.setup import Setup
from calib_pin.simulation import exact_at

Equipped = Callable[..., Problem]
Visited = Callable[..., tuple[Floats, Targets]]

FREE = ("position", "pose", "plane-distance")
"""Models whose rows need not name anything."""

MIXED = tuple(
    BlockKey(model)
    for model in (
        "position",
        "pose",
        "fixed-point",
        "plane-contact",
        "relative-distance",
        "camera",
    )
)
NAMED = [m for m in MEASUREMENT_MODELS if m not in ("pose", "plane-distance")]


@pytest.mark.parametrize("model", FREE)
@pytest.mark.parametrize("name", PARAMETERIZATIONS)
def test_jacobian_agrees_with_central_differences(
    name: str, model: str, special_chain: Chain, framed: Setup, visited: Visited
) -> None:
    setup = replace(framed, parameters=(name,), prior={"*": 0.01})
    check_jacobian(nominal_problem(special_chain, model, setup), visited)


@pytest.mark.parametrize("model", NAMED)
@pytest.mark.parametrize("name", PARAMETERIZATIONS)
def test_jacobian_with_named_points_and_places(
    name: str, model: str, equipped_problem: Equipped, visited: Visited
) -> None:
    """On one chain: what a model adds knows nothing of the chain."""
    stated = {"parameters": (name,), "prior": {"*": 0.01}}
    problem = equipped_problem(calib_pin.load_chain("space6"), model, **stated)
    check_jacobian(problem, visited)


def test_jacobian_of_the_tool_itself(
    special_chain: Chain, framed: Setup, visited: Visited
) -> None:
    setup = replace(framed, prior={"*": 0.01})
    check_jacobian(nominal_problem(special_chain, "position", setup), visited)


CORRECTED = ("transmission", "placement", "compliance", "joint-offset")


@pytest.mark.parametrize("model", ["pose", MIXED], ids=["pose", "mixed"])
def test_joint_corrections_among_errors_of_the_geometry(
    model: str | Sequence[BlockKey],
    special_chain: Chain,
    equipped_problem: Equipped,
    visited: Visited,
) -> None:
    """The screws of a place stand before its joint's motion, whatever their order."""
    stated = {"parameters": CORRECTED, "prior": {"*": 0.01}}
    check_jacobian(equipped_problem(special_chain, model, **stated), visited)


@pytest.mark.parametrize("model", [m for m in MEASUREMENT_MODELS if m != "pose"])
def test_joint_corrections_with_every_model(
    model: str, equipped_problem: Equipped, visited: Visited
) -> None:
    """On one chain: what a model adds knows nothing of the chain."""
    stated = {"parameters": CORRECTED, "prior": {"*": 0.01}}
    problem = equipped_problem(calib_pin.load_chain("space6"), model, **stated)
    check_jacobian(problem, visited)


def check_jacobian(problem: Problem, visited: Visited) -> None:
    rng = np.random.default_rng(3)
    # Twenty times what is expected of a robot: heavy arms must not sag by meters.
    sizes = np.minimum(0.02, 20.0 * problem.parameters.scales)
    theta = rng.normal(size=len(sizes)) * sizes
    at = []
    for key in problem.parts:
        count = max(6, len(named_targets(problem, key)))
        q, target = visited(problem, theta, count, rng, key)
        held = Conditions(
            temperature=rng.uniform(5.0, 45.0, len(q)),
            time=rng.uniform(-600.0, 4200.0, len(q)),
        )
        at.append(asked(problem, key, q, target, held))
    # Measured values away from the prediction: the residual's own curvature counts.
    disturbed = []
    for part, data, _, _ in exact_at(problem, theta, *at).blocks:
        noise = rng.normal(size=(len(data), part.components)) * 0.05
        values = part.measurement.disturb(data.values, noise)
        disturbed.append(replace(data, values=values))
    measured = replace(problem, data=Observations(tuple(disturbed)))

    _, J = measured.linearize(theta)
    assert np.abs(J - _differences(measured, theta)).max() < 2e-7 * np.abs(J).max()


def _differences(problem: Problem, theta: np.ndarray) -> np.ndarray:
    step = 1e-6
    columns = []
    for k in range(len(theta)):
        shift = step * np.eye(len(theta))[k]
        ahead, behind = (problem.residual(theta + s) for s in (shift, -shift))
        columns.append((ahead - behind) / (2 * step))
    return np.column_stack(columns)


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
    part = problem.only
    found = part.error.corrections(part.split(theta)[0])[3]
    assert found.isApprox(expected, 1e-14)
