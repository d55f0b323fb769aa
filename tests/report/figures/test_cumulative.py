"""Cumulative errors before and after."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib_pin.report.figures.canvas import AFTER, BEFORE
from calib_pin.report.figures.errors import cumulative_errors
from calib_pin.report.tables import significant
from calib_pin.units import DISPLAY


def test_curves_are_those_of_the_held_out_measurements(calibrated, draw):
    drawn = draw(cumulative_errors, calibrated)
    assert calibrated.held_out is not None
    assert len(drawn.figure.axes) == len(calibrated.errors)
    for axes, error in zip(drawn.figure.axes, calibrated.errors, strict=True):
        assert axes.get_xscale() == axes.get_yscale() == "linear"
        pair = error.validation_before, error.validation_after
        for color, accuracy in zip((BEFORE, AFTER), pair, strict=True):
            assert accuracy is not None
            curve, dot = (line for line in axes.lines if line.get_color() == color)
            across, up = np.asarray(curve.get_data())
            assert up[0] == 0.0 and up[-1] == 100.0 and (np.diff(up) >= 0.0).all()
            # The table of the report has the same 95 %.
            p95 = DISPLAY[error.unit][1] * accuracy.p95
            np.testing.assert_allclose(dot.get_xydata(), [[p95, 95.0]])
            assert up[across < p95 * (1.0 - 1e-9)].max() < 95.0
            assert up[across <= p95 * (1.0 + 1e-9)].max() >= 95.0
            assert significant(p95) in axes.get_title("left")
    assert f"{len(calibrated.held_out)} " in drawn.reading


def test_some_cannot_be_predicted_and_one_is_far_off(calibrated, draw):
    """A curve ends below all, and what is far off does not make the rest a line."""
    after, before = calibrated.fitted.after.copy(), calibrated.fitted.before.copy()
    after[:10], before[3] = np.inf, 1e3
    fitted = replace(calibrated.fitted, after=after, before=before)
    drawn = draw(cumulative_errors, replace(calibrated, fitted=fitted, held_out=None))
    axes = drawn.figure.axes[0]
    _, curve = (line for line in axes.lines if line.get_linestyle() == "-")
    count = len(fitted)
    assert np.asarray(curve.get_ydata()).max() == pytest.approx(100 - 1000 / count)
    assert axes.get_xlim()[1] < 1e3
    nothing = replace(fitted, after=np.full_like(after, np.nan))
    result = replace(calibrated, fitted=nothing, held_out=None)
    assert cumulative_errors(result) is None
