"""What is drawn are the errors of the rows, in millimeters and degrees."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from matplotlib.axes import Axes

from calib_pin.report.figures.canvas import Drawn
from calib_pin.report.figures.measurement_errors import LIMIT, errors_per_measurement
from calib_pin.validation.result import CalibrationResult


def line(axes: Axes, label: str) -> tuple[Any, Any]:
    found = next(one for one in axes.lines if one.get_label() == label)
    return np.asarray(found.get_xdata()), np.asarray(found.get_ydata())


def test_points_are_the_errors(
    calibrated: CalibrationResult, draw: Callable[..., Drawn]
) -> None:
    drawn = draw(errors_per_measurement, calibrated)
    titles = []
    for row, columns, factor in ((0, slice(0, 3), 1e3), (1, slice(3, 6), 180 / np.pi)):
        for k, part in enumerate((calibrated.fitted, calibrated.held_out)):
            axes = drawn.figure.axes[2 * row + k]
            assert axes.get_yscale() == "log"
            for stage, label in (("before", "before"), ("after", "after (calibrated)")):
                errors = factor * getattr(part, stage)[:, columns]
                at, shown = line(axes, label)
                assert at.tolist() == list(range(1, 41))
                np.testing.assert_allclose(shown, np.sqrt((errors**2).sum(axis=1)))
                low, high = axes.get_ylim()
                assert low < shown.min() and shown.max() < high
            titles.append(axes.get_title("left"))
    after = 1e3 * calibrated.errors[0].after.mean
    assert titles[0].startswith("fitted: ") and f"{after:.4f} mm" in titles[0]
    assert titles[3].startswith("validation: ") and titles[3].endswith(" deg")
    assert drawn.figure.axes[0].get_ylabel() == "position error [mm]"
    assert "(5-fold)" in drawn.reading


def test_rows_that_do_not_fit_are_ringed(
    calibrated: CalibrationResult, draw: Callable[..., Drawn]
) -> None:
    drawn = draw(errors_per_measurement, calibrated)
    at, shown = line(drawn.figure.axes[0], "outliers")
    after = 1e3 * np.linalg.norm(calibrated.fitted.after[[3, 7], :3], axis=1)
    assert at.tolist() == [4, 8]
    np.testing.assert_allclose(shown, after)
    assert "Rings mark 2 outliers" in drawn.reading
    unseen = drawn.figure.axes[1]
    assert all(one.get_label() != "outliers" for one in unseen.lines)


def test_what_has_no_logarithm_stands_at_the_ends(
    calibrated: CalibrationResult, draw: Callable[..., Drawn]
) -> None:
    after = calibrated.fitted.after.copy()
    after[5, :3], after[6, :3], after[9, :3] = np.inf, 0.0, np.nan
    fitted = replace(calibrated.fitted, after=after)
    result = replace(
        calibrated,
        fitted=fitted,
        held_out=None,
        statistics=replace(calibrated.statistics, outliers=()),
    )
    drawn = draw(errors_per_measurement, result)
    axes = drawn.figure.axes[0]
    at, _ = line(axes, "after (calibrated)")
    assert set(range(1, 41)) - set(at.tolist()) == {6, 7, 10}
    ends = {
        str(one.get_marker()): np.asarray(one.get_xdata()).tolist()
        for one in axes.lines
        if one.get_marker() in ("^", "v")
    }
    assert ends == {"^": [6], "v": [7]}
    assert "cannot be predicted" in drawn.reading
    assert len(drawn.figure.axes) == 2, "nothing unseen, no panels of it"


@pytest.mark.parametrize("count", [LIMIT, LIMIT + 5000])
def test_very_many_rows_are_thinned_and_rastered(
    many: Callable[[int], CalibrationResult], draw: Callable[..., Drawn], count: int
) -> None:
    drawn = draw(errors_per_measurement, many(count))
    axes = drawn.figure.axes[0]
    at, shown = line(axes, "after (calibrated)")
    assert len(at) == LIMIT and axes.lines[0].get_rasterized()
    assert count // 3 + 1 in at, "the worst row"
    assert {4, 8} <= set(at)
    assert shown.max() == shown[at == count // 3 + 1]
    assert (f"{LIMIT} of {count} measurements" in drawn.reading) == (count > LIMIT)
