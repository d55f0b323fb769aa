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
from calib_pin.estimation.learning import shift_directions, training_rows
from calib_pin.estimation.problem import error_table
from calib_pin.observations import Observations
from calib_pin.residual_models import ResidualModel, TrainingRows
from calib_pin.residual_models.covariance import FORMS
from calib_pin.residual_models.network import NetworkOptions, fit_network
from calib_pin.residual_models.process_fit import (
    GaussianProcessOptions,
    fit_gaussian_process,
)


@pytest.fixture(scope="module")
def fitted(data_folder: Path) -> tuple[Fit, Observations]:
    chain = calib_pin.load_chain("example:ur10_robot", base="base_link", tip="tool0")
    training, unseen = (
        calib_pin.read_measurements(
            data_folder / "ur10_tmac" / f"{name}.csv", chain, model="position"
        )
        for name in ("train", "validate")
    )
    setup = calib_pin.Setup(parameters=("placement", "compliance"))
    problem = make_problem(chain, training, setup)
    return fit(problem, np.random.default_rng(0)), unseen


@pytest.fixture(scope="module")
def rows(fitted: Any) -> TrainingRows:
    found = fitted[0]
    directions, known = shift_directions(found, found.problem, found.theta)
    return training_rows(found.problem, found.theta, directions, known)


def left(fitted: tuple[Fit, Any], model: ResidualModel) -> float:
    """Mean error of the unseen rows [m]."""
    found, unseen = fitted
    assert model.region.inside(unseen.q).mean() > 0.995
    directions, _ = shift_directions(found, found.problem, found.theta)
    theta = found.theta + directions @ model.shift
    corrected = replace(unseen.only, q=unseen.q + model(unseen.q))
    there = replace(found.problem, data=Observations.of(corrected))
    residual = error_table(there, theta)
    return float(np.linalg.norm(residual, axis=1).mean())


def test_network(fitted: Any, rows: TrainingRows) -> None:
    options = NetworkOptions(units=6, members=2)
    network = fit_network(rows, np.random.default_rng(0), options=options)
    assert left(fitted, network) < 0.12e-3


def test_gaussian_process(fitted: Any, rows: TrainingRows) -> None:
    options = GaussianProcessOptions(forms=FORMS[:2])
    process = fit_gaussian_process(rows, np.random.default_rng(0), options=options)
    assert left(fitted, process) < 0.08e-3
