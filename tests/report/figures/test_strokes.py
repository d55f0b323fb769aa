"""Of very many rows some are drawn, the worst always."""

from __future__ import annotations

import numpy as np

from calib_pin.report.figures.strokes import LARGEST, thinned, thinning


def test_the_worst_rows_are_always_drawn():
    rng = np.random.default_rng(0)
    sizes = [rng.uniform(size=50_000), rng.uniform(size=50_000)]
    sizes[0][::7] = np.nan
    sizes[1][1234] = np.inf
    drawn = thinned(50_000, 20_000, sizes, [7, 49_999])
    assert len(drawn) == len(set(drawn)) == 20_000
    assert (np.diff(drawn) > 0).all()
    assert {7, 49_999, 1234} <= set(drawn)
    for size in sizes:
        worst = np.argsort(np.nan_to_num(size, nan=-1.0))[-LARGEST:]
        assert set(worst) <= set(drawn)
    # Evenly over all rows.
    counts, _ = np.histogram(drawn, 10, (0, 50_000))
    assert counts.min() > 1900 and counts.max() < 2100
    assert (drawn == thinned(50_000, 20_000, sizes, [7, 49_999])).all()
    assert "20000 of 50000 " in thinning(20_000, 50_000)


def test_rows_that_do_not_fit_take_half_of_all():
    always = list(range(0, 2000, 2))
    drawn = thinned(2000, 100, [np.arange(2000.0)], always)
    assert len(drawn) == 100
    assert set(always[:50]) <= set(drawn) and 1999 in drawn
