"""What is drawn are the errors of the rows, in millimeters and degrees."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from calib_pin.report.figures.measurement_errors import LIMIT, errors_per_measurement
from tests.report.results import changed


def line(axes: Axes, label: str) -> tuple[Any, Any]:
    found = next(one for one in axes.lines if one.get_label() == label)
    return np.asarray(found.get_xdata()), np.asarray(found.get_ydata())


def test_points_are_the_errors(calibrated, draw):
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
    assert f"{after:.4f} mm" in titles[0] and titles[3].endswith(" deg")
    assert drawn.figure.axes[0].get_ylabel() == "position error [mm]"


def test_rows_that_do_not_fit_are_ringed(calibrated, draw):
    drawn = draw(errors_per_measurement, calibrated)
    at, shown = line(drawn.figure.axes[0], "outliers")
    after = 1e3 * np.linalg.norm(calibrated.fitted.after[[3, 7], :3], axis=1)
    assert at.tolist() == [4, 8]
    np.testing.assert_allclose(shown, after)
    unseen = drawn.figure.axes[1]
    assert all(one.get_label() != "outliers" for one in unseen.lines)


def test_what_has_no_logarithm_stands_at_the_ends(calibrated, draw):
    after = calibrated.fitted.after.copy()
    after[5, :3], after[6, :3], after[9, :3] = np.inf, 0.0, np.nan
    fitted = replace(calibrated.fitted, after=after)
    result = changed(calibrated, fitted=fitted, held_out=None, outliers=())
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
    assert len(drawn.figure.axes) == 2, "nothing unseen, no panels of it"


def test_very_many_rows_are_thinned_and_rastered(many, draw):
    count = LIMIT + 5000
    drawn = draw(errors_per_measurement, many(count))
    axes = drawn.figure.axes[0]
    at, shown = line(axes, "after (calibrated)")
    assert len(at) == LIMIT and axes.lines[0].get_rasterized()
    assert count // 3 + 1 in at, "the worst row"
    assert shown.max() == shown[at == count // 3 + 1]
    assert f"{LIMIT} of {count} " in drawn.reading
