"""Residual models, and joint commands with all corrections."""

from __future__ import annotations

import numpy as np
from sklearn.gaussian_process import GaussianProcessRegressor
from sklearn.gaussian_process.kernels import RBF, WhiteKernel

import calib_pin
from benchmarks.timing import best, show
from calib_pin.control.compensation import compensate
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.residual_models import RESIDUAL_MODELS
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.calibrated_model import CalibratedModel

TOOL = FrameSetup((0.05, 0.03, 0.1))
ROWS, NOISE = 500, 2e-5
TARGETS, SINGLE = 10_000, 100


def main() -> None:
    """Residual models of a UR10, and joint commands for 10 000 poses."""
    problem, theta = _truth()
    chain, rng = problem.error.chain, np.random.default_rng(2)
    rows = calib_pin.simulate(problem, theta, rng, count=ROWS, noise=NOISE)
    left = _left(chain, rows)
    plain = best(lambda: _regression(rows.q, left), 1)
    for name in RESIDUAL_MODELS:
        setup = Setup(learned=name)
        seconds = best(
            lambda setup=setup: calib_pin.calibrate(chain, rows, setup, validate=False),
            2,
        )
        show(
            f"{name}, {ROWS} measurements", seconds, "regression of the residual", plain
        )
    _commands(CalibratedModel.create(problem, theta))


def _truth() -> tuple[Problem, Floats]:
    """A UR10 with errors of its geometry, gears and compliance."""
    chain = calib_pin.load_chain("example:ur10_robot", tip="tool0")
    kinds = ("placement", "transmission", "compliance")
    problem = nominal_problem(
        chain, "position", Setup(parameters=kinds, tool_frame=TOOL)
    )
    rng = np.random.default_rng(1)
    return problem, calib_pin.draw_errors(problem.parameters, rng)


def _left(chain: Chain, rows: Measurements) -> Floats:
    """Errors beyond geometry, shape (N, 3) [m]."""
    model = calib_pin.calibrate(chain, rows, validate=False).model
    return model.problem(rows).errors(model.theta)


def _regression(q: Floats, residual: Floats) -> None:
    """The usual way: a Gaussian process from joint angles to position errors."""
    features = np.concatenate([np.sin(q), np.cos(q)], axis=1)
    kernel = RBF(np.ones(features.shape[1])) + WhiteKernel()
    GaussianProcessRegressor(kernel, normalize_y=True).fit(features, residual)


def _commands(model: CalibratedModel) -> None:
    """Inverse kinematics with all corrections."""
    chain, rng = model.chain, np.random.default_rng(3)
    q = chain.random_configurations(TARGETS, rng)
    targets, near = model.poses(q), q + rng.normal(size=q.shape) * 3e-3
    start = np.clip(near, chain.lower, chain.upper)

    def one_by_one() -> None:
        for k in range(SINGLE):
            compensate(model, targets[k : k + 1], start[k : k + 1])

    loop = best(one_by_one, 1)
    for label, given in (("from nominal commands", start), ("without a start", None)):
        seconds = best(lambda given=given: compensate(model, targets, given), 2)
        name = f"{TARGETS} poses, {label}"
        show(name, seconds, "one by one", loop * TARGETS / SINGLE)
