"""One calibration and one plan that all figures are drawn of."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.evidence import Outlier
from calib_pin.planning.plan import Plan
from calib_pin.report.figures.canvas import Drawn, drawing
from calib_pin.validation.measurement_errors import MeasurementErrors
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.summaries import Candidate, ModelSelection


@pytest.fixture(scope="session")
def calibrated() -> CalibrationResult:
    """A calibration with all that there are figures of."""
    chain = calib_pin.load_chain("space7")
    setup = calib_pin.read_setup(calib_pin.robot_file("space7", "setup.yaml"))
    rows = calib_pin.read_measurements(
        calib_pin.robot_file("space7", "measurements.csv"), chain
    )
    result = calib_pin.calibrate(chain, rows, setup)
    rungs = (
        Candidate(
            "joint offset", (), None, 7, (("position", "m", 2e-3),), 20.0, 2.0, True
        ),
        Candidate(
            "geometric", (), None, 34, (("position", "m", 1e-4),), 1.0, 0.1, True
        ),
        Candidate("+ compliance", (), None, reason="no masses"),
    )
    return replace(
        result,
        solver=replace(result.solver, history=(50.0, 20.0, 5.0, 5.0)),
        model_selection=ModelSelection(rungs, 1),
        statistics=replace(
            result.statistics,
            outliers=(Outlier("row 8", 7, 9.0), Outlier("row 4", 3, 8.0)),
        ),
    )


@pytest.fixture(scope="session")
def planned() -> Plan:
    """A plan."""
    chain = calib_pin.load_chain("space6")
    return calib_pin.plan(chain, "position", 12, method="greedy", candidates=200)


@pytest.fixture(scope="session")
def draw() -> Callable[..., Drawn]:
    """Draw one figure in the common style: `draw(residuals, result)`."""

    def one(figure: Callable[[Any], Drawn | None], subject: Any) -> Drawn:
        with drawing():
            drawn = figure(subject)
        assert drawn is not None
        return drawn

    return one


@pytest.fixture(scope="session")
def many(calibrated: CalibrationResult) -> Callable[[int], CalibrationResult]:
    """A calibration with very many rows: `many(count)`; one of them is far off."""

    def repeated(count: int) -> CalibrationResult:
        rows = calibrated.fitted
        chosen = np.arange(count) % len(rows)
        noise = np.random.default_rng(0).uniform(0.5, 1.5, (count, 1))
        errors = {
            name: getattr(rows, name)[chosen] * noise for name in ("before", "after")
        }
        errors["after"][count // 3] *= 500.0
        parts = {
            name: getattr(rows, name)[chosen]
            for name in ("sigma", "points", "leverage")
        }
        taller = replace(rows, rows=rows.rows.rows(chosen), **errors, **parts)
        return replace(calibrated, fitted=taller, held_out=taller)

    return repeated


@pytest.fixture(scope="session")
def with_errors() -> Callable[..., CalibrationResult]:
    """A result with other errors of its fitted rows: `with_errors(result, after=...)`.

    A number stands for all of them.
    """

    def changed(result: CalibrationResult, **errors: Any) -> CalibrationResult:
        fitted: MeasurementErrors = result.fitted
        shape = fitted.after.shape
        arrays = {k: np.broadcast_to(v, shape).copy() for k, v in errors.items()}
        return replace(result, fitted=replace(fitted, **arrays))

    return changed
