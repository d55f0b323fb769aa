"""What is drawn are the errors of the rows, in millimeters and degrees."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib_pin.report.figures.errors import LIMIT, errors_per_measurement
from tests.report.results import changed


def test_points_are_the_errors_and_outliers_are_ringed(calibrated, draw):
    figure = draw(errors_per_measurement, calibrated).figure
    titles = []
    for row, columns, factor in ((0, slice(0, 3), 1e3), (1, slice(3, 6), 180 / np.pi)):
        for k, part in enumerate((calibrated.fitted, calibrated.held_out)):
            axes = figure.axes[2 * row + k]
            assert axes.get_yscale() == "log"
            for stage, line in zip(("before", "after"), axes.lines, strict=False):
                errors = factor * getattr(part, stage)[:, columns]
                assert np.asarray(line.get_xdata()).tolist() == list(range(1, 41))
                shown = np.asarray(line.get_ydata())
                np.testing.assert_allclose(shown, np.sqrt((errors**2).sum(axis=1)))
                low, high = axes.get_ylim()
                assert low < shown.min() and shown.max() < high
            titles.append(axes.get_title("left"))
    after = 1e3 * calibrated.errors[0].after.mean
    assert f"{after:.4f} mm" in titles[0] and titles[3].endswith(" deg")
    assert figure.axes[0].get_ylabel() == "position error [mm]"
    rings, none = (axes.lines[2] for axes in figure.axes[:2])
    sizes = 1e3 * np.linalg.norm(calibrated.fitted.after[[3, 7], :3], axis=1)
    np.testing.assert_allclose(rings.get_data(), [[4, 8], sizes])
    assert not len(np.asarray(none.get_xdata()))


def test_what_has_no_logarithm_stands_at_the_edges(calibrated, draw):
    after = calibrated.fitted.after.copy()
    after[5, :3], after[6, :3], after[9, :3] = np.inf, 0.0, np.nan
    fitted = replace(calibrated.fitted, after=after)
    result = changed(calibrated, fitted=fitted, held_out=None, outliers=())
    drawn = draw(errors_per_measurement, result)
    axes = drawn.figure.axes[0]
    at, shown = (np.asarray(of) for of in axes.lines[1].get_data())
    assert set(range(1, 41)) - set(at.tolist()) == {10}
    low, high = axes.get_ylim()
    assert low < shown[at == 7].item() == shown.min() < 1.1 * low
    assert high > shown[at == 6].item() == shown.max() > high / 1.1
    assert "cannot be predicted" in drawn.reading
    assert len(drawn.figure.axes) == 2, "nothing unseen, no panels of it"


def test_very_many_rows_are_thinned_and_rastered(many, draw):
    count = LIMIT + 5000
    drawn = draw(errors_per_measurement, many(count))
    line = drawn.figure.axes[0].lines[1]
    at, shown = (np.asarray(of) for of in line.get_data())
    assert len(at) == LIMIT and line.get_rasterized()
    assert shown.max() == shown[at == count // 3 + 1].item(), "the worst row"
    assert f"{LIMIT} of {count} " in drawn.reading
