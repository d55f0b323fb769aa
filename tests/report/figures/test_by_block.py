"""Errors block by block, and stations told apart by color."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from xml.etree import ElementTree

import numpy as np

from calib_pin.observations import Observations
from calib_pin.report.figures.by_block import MOST, errors_by_block
from calib_pin.report.figures.canvas import OF_STATIONS, Drawn
from calib_pin.report.figures.measurement_errors import errors_per_measurement
from calib_pin.report.figures.residuals import residuals, whitened
from calib_pin.validation.breakdown import BlockSummary
from calib_pin.validation.result import CalibrationResult


def with_blocks(result: CalibrationResult, count: int) -> CalibrationResult:
    """A result of blocks whose errors grow from one to the next."""
    blocks = []
    for k in range(count):
        errors = tuple(
            replace(e, after=replace(e.after, rms=(k + 1) * e.after.rms))
            for e in result.errors
        )
        of = ("pose", "", f"day{k}", "tool")
        blocks.append(BlockSummary(*of, 10, ("",), errors, (), 12, 0))
    return replace(result, blocks=tuple(blocks))


def with_stations(result: CalibrationResult, count: int) -> CalibrationResult:
    """A result whose fitted measurements come from stations in turn, some from each."""
    (block,) = result.fitted.rows.blocks
    shares = np.array_split(np.arange(len(block)), count)
    parts = [
        replace(block.rows(own), station=f"day{k}") for k, own in enumerate(shares)
    ]
    rows = Observations(tuple(parts))
    turned = np.repeat(result.fitted.to_base, count, axis=0)
    fitted = replace(result.fitted, rows=rows, to_base=turned)
    return replace(result, fitted=fitted, held_out=None)


def test_errors_by_block(
    calibrated: CalibrationResult, draw: Callable[..., Drawn]
) -> None:
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
    assert "is that of day2" in drawn.reading
    ElementTree.fromstring(drawn.svg())


def test_of_many_blocks_the_worst_are_drawn(
    calibrated: CalibrationResult, draw: Callable[..., Drawn]
) -> None:
    drawn = draw(errors_by_block, with_blocks(calibrated, MOST + 5))
    names = [text.get_text() for text in drawn.figure.axes[0].texts]
    assert names == [f"day{k}" for k in range(5, MOST + 5)]
    assert "5 with smaller errors are left out" in drawn.reading


def test_stations_have_colors(
    calibrated: CalibrationResult, draw: Callable[..., Drawn]
) -> None:
    drawn = draw(errors_per_measurement, with_stations(calibrated, 3))
    lines = {str(one.get_label()): one for one in drawn.figure.axes[0].lines}
    count, at = len(calibrated.fitted), []
    for k, color in enumerate(OF_STATIONS[:3]):
        line = lines[f"after, day{k}"]
        assert line.get_color() == color
        at += np.asarray(line.get_xdata()).tolist()
    assert at == list(range(1, count + 1))
    more = draw(errors_per_measurement, with_stations(calibrated, 5))
    labels = {str(one.get_label()) for one in more.figure.axes[0].lines}
    assert "after (calibrated)" in labels


def test_residuals_of_stations(
    calibrated: CalibrationResult, draw: Callable[..., Drawn]
) -> None:
    every = whitened(calibrated)
    apart = whitened(with_stations(calibrated, 2))
    assert list(apart) == [
        f"{quantity}, day{k}" for quantity in every for k in range(2)
    ]
    for quantity, values in every.items():
        both = [apart[f"{quantity}, day{k}"] for k in range(2)]
        np.testing.assert_array_equal(np.sort(np.concatenate(both)), values)
    # With two quantities three stations would need more colors than there are.
    assert list(whitened(with_stations(calibrated, 3))) == list(every)
    ElementTree.fromstring(draw(residuals, with_stations(calibrated, 2)).svg())
