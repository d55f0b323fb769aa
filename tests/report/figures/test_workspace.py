"""Points in the workspace from three sides."""

from __future__ import annotations

import numpy as np

from calib_pin.report.figures.workspace import SIDES, tip_in_workspace


def test_every_point_is_seen_from_three_sides_the_largest_in_front(calibrated, draw):
    tip = calibrated.accuracy.tip
    *views, scale = draw(tip_in_workspace, calibrated).figure.axes
    assert scale.get_xlabel() == "uncertainty [mm], rms"
    order = np.argsort(tip.position)
    for axes, side in zip(views, SIDES, strict=True):
        (points,) = axes.collections
        np.testing.assert_allclose(points.get_offsets(), tip.points[order][:, side])
        np.testing.assert_allclose(points.get_array(), 1e3 * tip.position[order])
        names = [f"{'xyz'[k]} [m]" for k in side]
        assert [axes.get_xlabel(), axes.get_ylabel()] == names
        assert axes.get_aspect() == 1.0
