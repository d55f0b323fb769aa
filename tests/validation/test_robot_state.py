"""Joint offsets as combinations of errors, in all parameterizations with them."""

from __future__ import annotations

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.setup import Setup
from calib_pin.validation.robot_state import changes, drifts


@pytest.mark.parametrize("name", ["placement", "dh", "joint-offset", "link-transform"])
def test_an_offset_is_one(name) -> None:
    chain = calib_pin.load_chain("space6")
    problem = nominal_problem(chain, "pose", Setup(parameters=(name,)))
    parameters = problem.parameters
    robot = parameters.free & ~parameters.nuisance
    part, q = problem.only, chain.random_configurations(5, np.random.default_rng(0))
    found = changes(problem, robot)
    offsets = [change for change in found.values() if change.kind == "offset"]
    assert [change.name for change in offsets] == list(chain.joints)
    for k, change in enumerate(offsets):
        theta = change.directions[:, 0] * parameters.scales / 1e3
        moved = q.copy()
        moved[:, k] += change.size / 1e3
        expected = part.error.poses(moved, 0.0 * theta)
        # Errors apply one after the other: the second order is left.
        np.testing.assert_allclose(part.error.poses(q, theta), expected, atol=1e-10)


def test_drifts_and_other_changes() -> None:
    chain = calib_pin.load_chain("space6")
    setup = Setup(parameters=("placement", "transmission"))
    problem = nominal_problem(chain, "pose", setup)
    parameters = problem.parameters
    robot = parameters.free & ~parameters.nuisance
    scales, units = parameters.scales[robot], [p.unit for p in parameters if p.free]
    sizes = np.diag(drifts(problem, robot, ())["geometry"][robot]) * scales
    own = [p for p, of in zip(parameters, robot, strict=True) if of]
    lengths = np.array([p.unit in ("m", "rad") for p in own])
    np.testing.assert_allclose(sizes[lengths], 1.0)
    np.testing.assert_allclose(sizes[~lengths], scales[~lengths] / 1e-3)
    assert len(units) > len(own)
    found = changes(problem, robot)
    placed = found["placement joint_3"].directions
    names = parameters.names
    touched = [names[k] for k in np.flatnonzero(placed.any(axis=1))]
    assert touched and all(name.startswith("joint_3.") for name in touched)
    assert found["robot"].directions.shape == (len(names), len(own))
