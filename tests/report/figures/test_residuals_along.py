"""Residuals along the order of measurements and along each joint."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib_pin.observations import Observations
from calib_pin.report.figures.canvas import Drawn
from calib_pin.report.figures.residuals_along import (
    FEWEST,
    LIMIT,
    residuals_by_joint,
    residuals_over_order,
)
from calib_pin.validation.result import CalibrationResult

FIGURES = (residuals_over_order, residuals_by_joint)


def repeated(result: CalibrationResult, index: np.ndarray) -> CalibrationResult:
    """A result with some of its fitted measurements, or with more."""
    fitted = result.fitted
    changes = {
        name: getattr(fitted, name)[index]
        for name in ("before", "after", "sigma", "points", "leverage")
    }
    rows = fitted.rows.rows(index)
    return replace(result, fitted=replace(fitted, rows=rows, **changes))


def test_order(calibrated: CalibrationResult, draw: Callable[..., Drawn]) -> None:
    """A point stands where its line stands in the files, whatever its position."""
    (block,) = calibrated.fitted.rows.blocks
    fitted, count = calibrated.fitted, len(block)
    backwards = replace(block, lines=np.arange(count)[::-1] + 2)
    rows = Observations((backwards,))
    result = replace(calibrated, fitted=replace(fitted, rows=rows))
    axes = draw(residuals_over_order, result).figure.axes
    x, y = axes[0].get_lines()[0].get_data()
    expected = 1e3 * fitted.after[:, 0]
    found = dict(zip(np.asarray(x).tolist(), np.asarray(y).tolist(), strict=True))
    assert found[1.0] == pytest.approx(expected[-1])
    assert found[float(count)] == pytest.approx(expected[0])


def test_outlier_at_the_edge(
    calibrated: CalibrationResult, draw: Callable[..., Drawn]
) -> None:
    fitted = calibrated.fitted
    after = fitted.after.copy()
    after[5] += 1.0
    weight = np.ones(len(fitted))
    weight[5] = 0.0
    rows = fitted.rows.weighted(weight)
    result = replace(calibrated, fitted=replace(fitted, rows=rows, after=after))
    for figure in FIGURES:
        for axes in draw(figure, result).figure.axes:
            high = axes.get_ylim()[1]
            assert high < 10.0
            for line in axes.get_lines():
                assert np.abs(np.asarray(line.get_ydata(), float)).max() <= high


def test_joints(calibrated: CalibrationResult, draw: Callable[..., Drawn]) -> None:
    axes = draw(residuals_by_joint, calibrated).figure.axes
    assert [a.get_title(loc="left") for a in axes] == list(
        calibrated.model.chains.joints
    )


@pytest.mark.parametrize("figure", FIGURES)
def test_few_and_many(
    calibrated: CalibrationResult, draw: Callable[..., Drawn], figure: Callable
) -> None:
    some = repeated(calibrated, np.arange(FEWEST - 1))
    assert figure(some) is None
    count = len(calibrated.fitted)
    many = repeated(calibrated, np.arange(2 * LIMIT) % count)
    assert (
        f"{LIMIT} of {2 * LIMIT} measurements are drawn" in draw(figure, many).reading
    )
