"""Whitened residuals and how many lie far out."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from calib_pin.report.figures.canvas import Drawn
from calib_pin.report.figures.residuals import residuals, whitened
from calib_pin.validation.result import CalibrationResult


def test_residuals_are_in_units_of_their_deviation(
    calibrated: CalibrationResult,
) -> None:
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


def test_what_a_row_lacks_is_no_residual(calibrated: CalibrationResult) -> None:
    after, sigma = calibrated.fitted.after.copy(), calibrated.fitted.sigma.copy()
    after[:30, :3], sigma[:30, :3] = np.nan, np.inf
    after[30, :3] = np.inf
    fitted = replace(calibrated.fitted, after=after, sigma=sigma)
    values = whitened(replace(calibrated, fitted=fitted))
    assert len(values["position"]) == 3 * 9 and len(values["orientation"]) == 3 * 40


def test_both_pictures_show_the_same_values(
    calibrated: CalibrationResult, draw: Callable[..., Drawn]
) -> None:
    after = calibrated.fitted.after.copy()
    after[0, 0], after[1, 4] = 1.0, -1.0  # Far outside.
    result = replace(calibrated, fitted=replace(calibrated.fitted, after=after))
    values = whitened(result)
    drawn = draw(residuals, result)
    left, right = drawn.figure.axes
    every = np.concatenate(list(values.values()))
    outside = 100.0 * np.mean(np.abs(every) > 3.0)
    assert left.get_title("left") == f"{outside:.2f} % outside ±3"
    assert f"{outside:.2f} % lie outside" in drawn.reading
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
