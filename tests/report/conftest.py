"""One calibration and one plan that all pages and figures are of, drawn once."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.estimation.evidence import Outlier
from calib_pin.planning.plan import Plan
from calib_pin.report.figures import drawn as draw_all
from calib_pin.report.figures.canvas import Drawn, drawing
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.result import CalibrationResult
from tests.report.results import LADDER, changed, with_rows


@pytest.fixture(scope="session")
def calibrated() -> CalibrationResult:
    """A calibration with all that there are figures of."""
    chain = calib_pin.load_chain("space7")
    setup = calib_pin.read_setup(calib_pin.robot_file("space7", "setup.yaml"))
    file = calib_pin.robot_file("space7", "measurements.csv")
    result = calib_pin.calibrate(chain, calib_pin.read_measurements(file, chain), setup)
    return changed(
        result,
        history=(50.0, 20.0, 5.0, 5.0),
        model_selection=LADDER,
        outliers=(Outlier("row 8", 7, 9.0), Outlier("row 4", 3, 8.0)),
    )


@pytest.fixture(scope="session")
def planned() -> Plan:
    """A plan for a tool that stands aside of the tip."""
    setup = Setup(tool_frame=FrameSetup((0.05, 0.08, 0.12)))
    more: dict[str, Any] = {"method": "greedy", "candidates": 120}
    chain = calib_pin.load_chain("space6")
    return calib_pin.plan(chain, "position", 14, setup, **more)


class Once(Drawn):
    """A figure that is written for a page but once."""

    svg = cache(Drawn.svg)


@pytest.fixture(scope="session")
def drawn(calibrated: CalibrationResult) -> list[Drawn]:
    """All figures of the calibration."""
    return [Once(**vars(figure)) for figure in draw_all("calibration", calibrated)]


@pytest.fixture(scope="session")
def inline(drawn: list[Drawn]) -> dict[str, str]:
    """The same by name, as they stand in a page."""
    return {figure.name: figure.svg() for figure in drawn}


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
        index = np.arange(count) % len(calibrated.fitted)
        result = with_rows(calibrated, index)
        noise = np.random.default_rng(0).uniform(0.5, 1.5, (count, 1))
        rows = result.fitted
        after = rows.after * noise
        after[count // 3] *= 500.0
        taller = replace(rows, before=rows.before * noise, after=after)
        outliers = calibrated.statistics.outliers
        return changed(result, fitted=taller, held_out=taller, outliers=outliers)

    return repeated
