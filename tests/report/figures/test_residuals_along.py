"""Residuals along the order of measurements and along each joint."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib_pin.observations import Observations
from calib_pin.report.figures.errors import (
    FEW,
    FEWEST,
    residuals_by_joint,
    residuals_over_order,
)
from tests.report.results import with_rows

FIGURES = (residuals_over_order, residuals_by_joint)


def test_order(calibrated, draw):
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


def test_outlier_at_the_edge(calibrated, draw):
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


def test_few_and_many(calibrated, draw, many):
    few = with_rows(calibrated, np.arange(FEWEST - 1))
    for figure in FIGURES:
        assert figure(few) is None
    drawn = draw(residuals_over_order, many(2 * FEW))
    assert f"{FEW} of {2 * FEW} " in drawn.reading
