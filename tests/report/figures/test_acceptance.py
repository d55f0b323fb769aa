"""The figure of an acceptance test."""

from __future__ import annotations

from functools import cache

import numpy as np

from calib_pin.report.figures import Judged, acceptance_figures
from calib_pin.setup import LimitSetup
from calib_pin.validation.acceptance import Acceptance, acceptance


@cache
def visits_of(offset: float, poses: int = 4) -> Acceptance:
    rng = np.random.default_rng(0)
    commanded = np.repeat(rng.uniform(-1.0, 1.0, (poses, 3)), 10, axis=0)
    away = rng.normal([offset, 0.0, 0.0], 1e-5, (10 * poses, 3))
    attained = commanded + away
    return acceptance(attained, commanded, np.repeat(np.arange(poses), 10))


def test_values_intervals_and_limits_are_drawn():
    test = visits_of(5e-3)
    limit = LimitSetup(position=1e-2)
    (drawn,) = acceptance_figures(Judged({"robot": test}, limit))
    accuracy, repeatability = drawn.figure.axes
    (points, *_), *_ = accuracy.containers
    shown = [1e3 * pose.accuracy.value for pose in test.poses]
    np.testing.assert_allclose(points.get_ydata(), shown)
    low, high = accuracy.get_ylim()
    assert low == 0.0 and high > 10.0  # The limit is inside.
    assert [line.get_linestyle() for line in repeatability.lines].count("--") == 0
    assert [line.get_linestyle() for line in accuracy.lines].count("--") == 1


def test_robots_that_differ_much_share_a_log_axis():
    tests = {"nominal": visits_of(5e-3), "calibrated": visits_of(2e-5)}
    (drawn,) = acceptance_figures(Judged(tests, LimitSetup()))
    accuracy, repeatability = drawn.figure.axes
    assert accuracy.get_yscale() == "log" and repeatability.get_yscale() == "linear"
    assert len(drawn.figure.legends[0].get_texts()) == 2
