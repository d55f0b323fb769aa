"""What is learned in one part of the workspace, and what it does in another."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.model_errors import model_errors

PROCESS = "gaussian-process"
RIPPLE = 3e-4
TOOL = FrameSetup((0.05, 0.02, 0.1))


def measured(chain: calib_pin.Chain, count: int, seed: int) -> Observations:
    """Positions of a robot whose gears ripple, and whose geometry is off."""
    problem = nominal_problem(chain, "position", Setup(tool_frame=TOOL))
    rng = np.random.default_rng(seed)
    truth = calib_pin.draw_errors(problem.parameters, np.random.default_rng(5))
    q = chain.random_configurations(count, rng)
    rippled = q + RIPPLE * np.sin(17.0 * q + np.arange(q.shape[1]))
    error = problem.only.error
    points = error.poses(rippled, truth[: len(error.screws)])[:, :3, 3]
    rows = calib_pin.simulate(problem, truth, rng, q=q).only
    noise = 2e-5 * rng.standard_normal(points.shape)
    return Observations.of(replace(rows, values=points + noise))


def split(rows: Observations) -> tuple[Observations, Observations]:
    """Measurements in a part of the range of two joints, and all the others."""
    q = rows.q
    inside = (q[:, 1] < np.quantile(q[:, 1], 0.7)) & (
        q[:, 2] > np.quantile(q[:, 2], 0.3)
    )
    return rows.rows(inside), rows.rows(~inside)


def left(rows: Observations, there: Observations, learned: str | None) -> float:
    """Error on other measurements, root mean square [m]."""
    chain = calib_pin.load_chain("space6")
    model = fit_model(chain, rows, Setup(learned=learned), 0)
    found = model_errors(model, there, np.arange(len(there))).after
    return float(np.sqrt((found**2).sum(axis=1).mean()))


@pytest.fixture(scope="module")
def rows() -> Observations:
    return measured(calib_pin.load_chain("space6"), 400, 0)


def test_functions_of_single_joints_carry_over(rows: Observations) -> None:
    inside, outside = split(rows)
    fresh, _ = split(measured(calib_pin.load_chain("space6"), 200, 1))
    plain, learned = (left(inside, fresh, name) for name in (None, PROCESS))
    assert learned < 0.35 * plain, "near"
    plain, learned = (left(inside, outside, name) for name in (None, PROCESS))
    assert learned < 0.8 * plain, "away"


def errors_of_all_joints(rows: Observations, chain: calib_pin.Chain) -> Observations:
    """The same of a robot that a function of all joints bends as well."""
    problem = nominal_problem(chain, "position", Setup(tool_frame=TOOL))
    q, zero = rows.q, np.zeros(len(problem.only.error.screws))
    bent: Floats = 5e-4 * np.sin(q + np.roll(q, 1, axis=1) + np.roll(q, 2, axis=1))
    change = problem.only.error.poses(q + bent, zero) - problem.only.error.poses(
        q, zero
    )
    values = rows.only.values + change[:, :3, 3]
    return Observations.of(replace(rows.only, values=values))


@pytest.mark.slow
def test_what_does_not_carry_over_does_no_harm(rows: Observations) -> None:
    chain = calib_pin.load_chain("space6")
    for seed in range(4):
        every = errors_of_all_joints(measured(chain, 400, 10 + seed), chain)
        inside, outside = split(every)
        plain, learned = (left(inside, outside, name) for name in (None, PROCESS))
        assert learned < 1.03 * plain
