"""Names that are safe to draw, log axes that can be read, and points to be drawn."""

from __future__ import annotations

import numpy as np
import pytest
from matplotlib.figure import Figure

from calib_pin.report.figures.canvas import (
    LARGEST,
    log_axis,
    shortened,
    thinned,
    thinning,
)


def test_long_names_keep_both_ends_and_what_xml_cannot_hold_is_replaced():
    name = "left_arm_shoulder_lift_joint.placement.rx"
    start, _, end = shortened(name, 21).partition("…")
    assert len(start + end) == 20 and name.startswith(start) and name.endswith(end)
    assert shortened("elbow", 5) == "elbow"
    for bad in "\0\n\x1b\ud800\u202e\ufffe":
        assert shortened(f"a{bad}b") == "a\N{REPLACEMENT CHARACTER}b"


@pytest.mark.parametrize("low", [1e-18, 3e-3, 7.7, 4e9])
def test_every_log_axis_has_few_ticks(low):
    axes = Figure().add_subplot()
    for span in np.geomspace(1.3, 1e18, 20):
        assert log_axis(axes, "y", np.array([low, low * span, np.inf, 0.0, np.nan]))
        bottom, top = axes.get_ylim()
        assert bottom < low and low * span < top
        ticks = [tick for tick in axes.get_yticks() if bottom <= tick <= top]
        assert 2 <= len(ticks) <= 10
        assert len({f"{tick:g}" for tick in ticks}) == len(ticks)
    assert not log_axis(axes, "y", np.array([0.0, np.nan]))


def test_the_worst_rows_are_always_drawn():
    rng = np.random.default_rng(0)
    sizes = [rng.uniform(size=50_000), rng.uniform(size=50_000)]
    sizes[0][::7] = np.nan
    sizes[1][1234] = np.inf
    drawn = thinned(50_000, 20_000, sizes, [7, 49_999])
    assert len(drawn) == 20_000 and (np.diff(drawn) > 0).all()
    assert {7, 49_999, 1234} <= set(drawn)
    for size in sizes:
        worst = np.argsort(np.nan_to_num(size, nan=-1.0))[-LARGEST:]
        assert set(worst) <= set(drawn)
    # Evenly over all rows.
    counts, _ = np.histogram(drawn, 10, (0, 50_000))
    assert counts.min() > 1900 and counts.max() < 2100
    assert "20000 of 50000 " in thinning(20_000, 50_000)
    always = list(range(0, 2000, 2))
    drawn = thinned(2000, 100, [np.arange(2000.0)], always)
    assert len(drawn) == 100, "outliers take half of all"
    assert set(always[:50]) <= set(drawn) and 1999 in drawn
