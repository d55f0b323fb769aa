"""The figures of an acceptance test and of a Monte Carlo study."""

from __future__ import annotations

import math
from dataclasses import replace
from functools import cache

import numpy as np

from calib_pin.monte_carlo import Outlook
from calib_pin.report.figures import drawn
from calib_pin.setup import LimitSetup
from calib_pin.validation.acceptance import Acceptance, acceptance


@cache
def visits_of(offset: float, poses: int = 4) -> Acceptance:
    rng = np.random.default_rng(0)
    commanded = np.repeat(rng.uniform(-1.0, 1.0, (poses, 3)), 10, axis=0)
    away = rng.normal([offset, 0.0, 0.0], 1e-5, (10 * poses, 3))
    return acceptance(commanded + away, away, np.repeat(np.arange(poses), 10))


def outlook(count: int, met: float = 0.9) -> Outlook:
    size = 1e-3 / count
    spread = (size, 2.0 * size, 3.0 * size)
    return Outlook(
        *(count, 100, 0, (1e-3, 2e-3, 3e-3), spread, spread, spread, spread),
        coverage=(0.95, 0.9, 0.98),
        honesty=1.0,
        met=(met, met - 0.05, min(met + 0.05, 1.0)),
    )


def test_values_intervals_and_limits_are_drawn():
    test = visits_of(5e-3)
    limit = LimitSetup(position=1e-2)
    (found,) = drawn("acceptance", {"robot": test}, limit)
    accuracy, repeatability = found.figure.axes
    (points, *_), *_ = accuracy.containers
    shown = [1e3 * pose.accuracy.value for pose in test.poses]
    np.testing.assert_allclose(points.get_ydata(), shown)
    low, high = accuracy.get_ylim()
    assert low == 0.0 and high > 10.0  # The limit is inside.
    assert [line.get_linestyle() for line in repeatability.lines].count("--") == 0
    assert [line.get_linestyle() for line in accuracy.lines].count("--") == 1


def test_robots_that_differ_much_share_a_log_axis():
    tests = {"nominal": visits_of(5e-3), "calibrated": visits_of(2e-5)}
    (found,) = drawn("acceptance", tests, LimitSetup())
    accuracy, repeatability = found.figure.axes
    assert accuracy.get_yscale() == "log" and repeatability.get_yscale() == "linear"
    assert len(found.figure.legends[0].get_texts()) == 2


def test_an_outlook_shows_errors_and_chances():
    limit = LimitSetup(position=2e-4)
    foreseen = [outlook(12, 0.5), outlook(30, 1.0)]
    (found,) = drawn("outlook", foreseen, limit)
    errors, chances = found.figure.axes
    np.testing.assert_allclose(errors.lines[0].get_ydata(), [2 / 12, 2 / 30])
    low, high = errors.get_ylim()
    assert low < 0.2 < high  # The limit is inside.
    np.testing.assert_allclose(chances.lines[0].get_ydata(), [50.0, 100.0])
    nobody = replace(foreseen[0], met=(math.nan, math.nan, math.nan))
    (found,) = drawn("outlook", [nobody], LimitSetup())
    assert len(found.figure.axes) == 1, "without a limit there are errors only"
    lost = replace(nobody, failed=nobody.robots)
    assert not [*drawn("outlook", [lost], LimitSetup())]
