"""Whitened residuals and how many lie far out."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from calib_pin.report.figures.residuals import residuals, whitened


def test_residuals_are_in_units_of_their_deviation(calibrated):
    values = whitened(calibrated)
    rows = calibrated.fitted
    assert list(values) == ["position", "orientation"]
    for noise, quantity in zip(
        calibrated.statistics.noise, rows.quantities, strict=True
    ):
        used = noise.factor * noise.given
        sizes = rows.after[:, quantity.columns] / used
        np.testing.assert_allclose(values[quantity.name], np.sort(sizes.ravel()))
        # By definition of an estimate the squares add up to the redundancy; what is
        # stated stands here, and is 2 % off, as much as the redundancy may be.
        squares = np.sum((values[quantity.name] * used / noise.estimate) ** 2)
        assert squares == pytest.approx(noise.redundancy * noise.values, rel=0.02)


def test_both_pictures_show_the_same_values(calibrated, draw):
    after = calibrated.fitted.after.copy()
    after[0, 0], after[1, 4] = 1.0, -1.0  # Far outside.
    result = replace(calibrated, fitted=replace(calibrated.fitted, after=after))
    values = whitened(result)
    drawn = draw(residuals, result)
    left, right = drawn.figure.axes
    every = np.concatenate(list(values.values()))
    outside = 100.0 * np.mean(np.abs(every) > 3.0)
    assert f"{outside:.2f} %" in left.get_title("left")
    assert f"{outside:.2f} %" in drawn.reading
    for line in right.lines:
        label, shown = str(line.get_label()), np.asarray(line.get_ydata())
        if label in values:
            np.testing.assert_allclose(shown, values[label])
            normal = np.asarray(line.get_xdata())
            np.testing.assert_allclose(normal, -normal[::-1], atol=1e-12)
    density = [patch for patch in left.patches if patch.get_label() in values]
    for patch in density:
        heights, edges, _ = patch.get_data()  # type: ignore[attr-defined]
        assert (heights * np.diff(edges)).sum() == pytest.approx(1.0)
