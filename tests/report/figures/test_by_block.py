"""Errors block by block, and stations told apart by color."""

from __future__ import annotations

import numpy as np

from calib_pin.report.figures.by_block import MOST, errors_by_block
from calib_pin.report.figures.canvas import OF_STATIONS
from calib_pin.report.figures.measurement_errors import errors_per_measurement
from tests.report.results import with_blocks, with_stations


def test_errors_by_block(calibrated, draw):
    assert errors_by_block(with_blocks(calibrated, 1)) is None
    result = with_blocks(calibrated, 3)
    drawn = draw(errors_by_block, result)
    for axes, k, factor in zip(
        drawn.figure.axes, (0, 1), (1e3, 180 / np.pi), strict=True
    ):
        before, after = (np.asarray(line.get_xdata()) for line in axes.lines)
        errors = [block.errors[k] for block in result.blocks]
        np.testing.assert_allclose(before, [factor * e.before.rms for e in errors])
        np.testing.assert_allclose(after, [factor * e.after.rms for e in errors])
        names = [text.get_text() for text in axes.texts]
        assert names == ["day0", "day1", "day2"]
    assert "day2" in drawn.reading


def test_of_many_blocks_the_worst_are_drawn(calibrated, draw):
    drawn = draw(errors_by_block, with_blocks(calibrated, MOST + 5))
    names = [text.get_text() for text in drawn.figure.axes[0].texts]
    assert names == [f"day{k}" for k in range(5, MOST + 5)]


def test_stations_have_colors(calibrated, draw):
    drawn = draw(errors_per_measurement, with_stations(calibrated, 3))
    lines = {str(one.get_label()): one for one in drawn.figure.axes[0].lines}
    count, at = len(calibrated.fitted), []
    for k, color in enumerate(OF_STATIONS[:3]):
        line = lines[f"after, day{k}"]
        assert line.get_color() == color
        at += np.asarray(line.get_xdata()).tolist()
    assert at == list(range(1, count + 1))
