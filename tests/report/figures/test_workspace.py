"""Arrows end where the magnified error does; without a direction there are colors."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from matplotlib.patches import PathPatch

from calib_pin.report.figures.views import SIDES
from calib_pin.report.figures.workspace import (
    ARROWS,
    error_vectors,
    magnification,
)
from tests.report.results import in_pixels


def test_arrows_end_where_the_error_does(calibrated, draw):
    drawn = draw(error_vectors, calibrated)
    rows = calibrated.fitted
    assert rows.displacements is not None
    factor = float(drawn.reading.split("magnified ")[1].split(" times")[0])
    assert len(drawn.figure.axes) == 6
    scales = set()
    for k, axes in enumerate(drawn.figure.axes):
        side = SIDES[k % 3]
        (patch,) = (p for p in axes.get_children() if isinstance(p, PathPatch))
        vertices = np.asarray(patch.get_path().vertices).reshape(len(rows), 5, 2)
        starts = rows.points[:, side]
        ends = starts + factor * rows.displacements[k // 3][:, side]
        np.testing.assert_allclose(vertices[:, 0], starts)
        np.testing.assert_allclose(vertices[:, 1], ends, atol=1e-3)
        for which, k in zip("xy", side, strict=True):
            assert getattr(axes, f"get_{which}label")() == f"{'xyz'[k]} [m]"
        (left, right), (low, high) = axes.get_xlim(), axes.get_ylim()
        assert left < starts[:, 0].min() and starts[:, 0].max() < right
        size = axes.get_position().size * drawn.figure.get_size_inches()
        scales |= {round(size[0] / (right - left), 6), round(size[1] / (high - low), 6)}
    assert len(scales) == 1, "equal aspect, and the same scale in all views"


def test_the_magnification_is_round():
    for length in np.geomspace(1e-9, 1.0, 30):
        factor = magnification(np.full(9, length), 2.0)
        assert float(f"{factor:.0e}") == factor and f"{factor:.0e}"[0] in "125"
        assert 0.1 < factor * length * 2.0 <= 0.31
    assert magnification(np.zeros(3), 2.0) == 1.0


def test_very_many_arrows_are_thinned(many, draw):
    drawn = draw(error_vectors, many(3000))
    patch = next(
        p for p in drawn.figure.axes[3].get_children() if isinstance(p, PathPatch)
    )
    assert len(patch.get_path().vertices) == 5 * ARROWS
    assert f"{ARROWS} of 3000 " in drawn.reading


def test_other_measurements_are_points_in_color(calibrated, draw):
    fitted = in_pixels(calibrated).fitted
    after = fitted.after.copy()
    after[3], after[4] = np.nan, np.inf
    fitted = replace(fitted, after=after)
    drawn = draw(error_vectors, replace(calibrated, fitted=fitted))
    assert drawn.name == "errors-in-workspace" and len(drawn.figure.axes) == 3
    for axes, side in zip(drawn.figure.axes, SIDES, strict=True):
        patches = [p for p in axes.get_children() if isinstance(p, PathPatch)]
        spots = [np.asarray(p.get_path().vertices)[::2] for p in patches[1::2]]
        expected = np.delete(fitted.points, 3, axis=0)[:, side]
        found = np.concatenate(spots)
        assert len(found) == len(expected)
        # From the smallest error to the largest.
        sizes = np.linalg.norm(np.delete(after, 3, axis=0)[:, :2], axis=1)
        largest = expected[sizes.argmax()]
        assert np.abs(spots[-1] - largest).max(axis=1).min() < 1e-9
