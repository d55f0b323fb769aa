"""The gap stands where the structural rank is."""

from __future__ import annotations

import numpy as np
from matplotlib.text import Annotation

from calib_pin.report.figures.identifiability import singular_values
from calib_pin.report.figures.labels import plain


def test_the_gap_is_at_the_rank(calibrated, draw):
    drawn = draw(singular_values, calibrated)
    ranks = calibrated.identifiability
    left, right = drawn.figure.axes
    kept, rounding = left.lines[:2]
    assert np.asarray(kept.get_xdata()).tolist() == list(range(1, 35))
    np.testing.assert_allclose(kept.get_ydata(), ranks.structural_values[:34])
    np.testing.assert_allclose(rounding.get_ydata(), ranks.structural_values[34:])
    low, high = left.get_ylim()
    assert low < min(ranks.structural_values) and high > max(ranks.structural_values)
    (arrow,) = left.texts
    assert isinstance(arrow, Annotation) and arrow.xy[0] == 34.5
    # Its size is that of roundings, which processors make each in their own way.
    assert left.get_title("left") == f"structure: gap {plain(ranks.gap)}"
    assert ranks.gap > 1e9
    np.testing.assert_allclose(right.lines[0].get_ydata(), ranks.singular_values)
