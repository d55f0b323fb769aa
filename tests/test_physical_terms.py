"""Simulated robots with one physical error each: it is found, and commands know it.

Errors are those at other configurations. A drift of the instrument is in
`estimation/test_fit`, and how ripples are found in
`validation/findings/test_joint_motions`.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.control.compensation import compensate as commands
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats, invert
from calib_pin.observations import Conditions, Observations
from calib_pin.setup import FrameSetup, Payload, Setup, ThermalSetup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.validation.calibrated_model import CalibratedModel

NOISE = 2e-5

TERMS: dict[str, dict[str, Any]] = {
    "cross-compliance": {"payloads": {"load": Payload(20.0, (0.1, 0.0, 0.1))}},
    "thermal": {"thermal": ThermalSetup(20.0)},
    "warm-up": {"thermal": ThermalSetup(switched_on=(0.0,), warm_up_time=300.0)},
    "motor-ripple": {"gear_ratios": {"joint_2": 80.0, "joint_3": 101.0}},
}
"""Terms with what a setup states of them."""


def simulated(
    problem: Problem, theta: Floats, count: int, seed: int, noise: float = NOISE
) -> Observations:
    """Positions of a robot that grows warm from 15 to 35 degC."""
    rng = np.random.default_rng(seed)
    q = problem.chains.random_configurations(count, rng)
    held = Conditions(
        temperature=np.linspace(15.0, 35.0, count), time=10.0 * np.arange(count)
    )
    return simulate(problem, theta, rng, q=q, conditions=held, noise=noise)


@pytest.mark.parametrize("term", TERMS)
def test_it_is_found_and_commands_take_it_into_account(term: str) -> None:
    """A robot with errors of the geometry and of a term goes where it shall."""
    chain = calib_pin.load_chain("space6")
    tool = FrameSetup((0.0, 0.0, 0.1), estimate=True)
    setup = Setup(parameters=("placement", term), tool_frame=tool, **TERMS[term])
    problem = nominal_problem(chain, "position", setup)
    theta = draw_errors(problem.parameters, np.random.default_rng(3))
    data = simulated(problem, theta, 100, 3)
    at = simulated(problem, theta, 100, 77, noise=0.0).only
    fits, models, errors = [], [], []
    for stated in (setup, replace(setup, parameters=("placement",))):
        fits.append(fit_model(chain, data, stated, 0))
        models.append(CalibratedModel.create(fits[-1].problem, fits[-1].theta))
        off = models[-1].predict(models[-1].theta, at) - at.values
        errors.append(np.sqrt(np.mean(np.sum(off**2, axis=1))))
    assert errors[0] < 0.25 * errors[1]
    found = fits[0]
    kind = {"motor-ripple": "transmission"}.get(term, term)
    own = [name.split(".")[-2] == kind for name in found.problem.parameters.names]
    # Far beyond what chance gives.
    ratios = found.theta[own] / np.sqrt(np.diag(found.posterior.covariance)[own])
    assert np.abs(ratios).max() > 10.0

    true = models[0].of()
    q = 0.5 * chain.random_configurations(5, np.random.default_rng(0))
    targets = chain.poses(q) @ true.tool.homogeneous
    sent = commands(true, targets, q, frame="base")
    assert sent.reached.all()
    T = invert(true.error.base.homogeneous) @ true.poses(sent.q)
    np.testing.assert_allclose(T[:, :3, 3], targets[:, :3, 3], rtol=0, atol=1e-6)
    assert np.abs(sent.q - q).max() > 1e-5
