"""Real measurements of a UR10: its gears show in the residuals.

Another tool's Gaussian process leaves 0.169 mm on the same unseen rows.
"""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.problem import error_table
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.residual_models import Linearized, ResidualModel, TrainingRows
from calib_pin.residual_models.gaussian_process import (
    GaussianProcessOptions,
    fit_gaussian_process,
)
from calib_pin.residual_models.network import NetworkOptions, fit_network


@pytest.fixture(scope="module")
def fitted(data_folder: Path) -> tuple[Fit, Observations]:
    chain = calib_pin.load_chain("example:ur10_robot", base="base_link", tip="tool0")
    training, unseen = (
        calib_pin.read_measurements(
            data_folder / "ur10_tmac" / f"{name}.csv", chain, model="position"
        )
        for name in ("train", "validate")
    )
    problem = make_problem(chain, training, calib_pin.Setup())
    return fit(problem, np.random.default_rng(0)), unseen


@pytest.fixture(scope="module")
def rows(fitted: Any) -> TrainingRows:
    found = fitted[0]
    (block,), columns = found.problem.blocks, shifts(found)
    part, data, sigma = block.part, block.data, block.table(found.problem.sigma)

    def by_joint(dq: Floats, shift: Floats) -> Linearized:
        of_robot, own = part.split(found.theta + columns @ shift)
        poses = part.error.linearize(data.q + dq, of_robot)
        linear = part.measurement.linearize(poses.T, own, data)
        J_pose = linear.J_pose / sigma[:, :, None]
        return Linearized(
            linear.residual / sigma,
            J_pose @ poses.joint_twists(),
            poses.derivative(J_pose) @ columns,
        )

    return TrainingRows(
        q=data.q,
        groups=data.groups(),
        revolute=np.asarray(part.error.chain.revolute, bool),
        by_joint=by_joint,
        by_tip=by_joint,
        values=3,
        shifts=columns.shape[1],
    )


def shifts(found: Fit) -> Floats:
    scales = found.problem.parameters.scales
    return np.asarray(scales[:, None] * found.directions.basis)


def left(fitted: tuple[Fit, Any], model: ResidualModel) -> float:
    """Mean error of the unseen rows [m]."""
    found, unseen = fitted
    assert model.region.inside(unseen.q).mean() > 0.995
    theta = found.theta + shifts(found) @ model.shift
    corrected = replace(unseen.only, q=unseen.q + model(unseen.q))
    there = replace(found.problem, data=Observations.of(corrected))
    residual = error_table(there, theta)
    return float(np.linalg.norm(residual, axis=1).mean())


def test_network(fitted: Any, rows: TrainingRows) -> None:
    options = NetworkOptions(units=6, members=2)
    network = fit_network(rows, np.random.default_rng(0), options=options)
    assert left(fitted, network) < 0.12e-3


def test_gaussian_process(fitted: Any, rows: TrainingRows) -> None:
    options = GaussianProcessOptions(searched=240, spaces=("joint",))
    process = fit_gaussian_process(rows, np.random.default_rng(0), options=options)
    assert left(fitted, process) < 0.09e-3
