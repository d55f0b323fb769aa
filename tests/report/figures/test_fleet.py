"""The figures of a fleet and of a Monte Carlo study."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from calib_pin.monte_carlo import Outlook
from calib_pin.report.figures import (
    Foreseen,
    fleet_figures,
    outlook_figures,
)
from calib_pin.setup import LimitSetup
from calib_pin.validation.fleet import FleetRow


def row(job: str, before: float, after: float, quantity: str = "position") -> FleetRow:
    unit = "m" if quantity == "position" else "px"
    return FleetRow(
        job,
        verdict="good",
        quantity=quantity,
        unit=unit,
        nominal=before,
        calibrated=after,
    )


def outlook(count: int, met: float = 0.9) -> Outlook:
    size = 1e-3 / count
    spread = (size, 2.0 * size, 3.0 * size)
    return Outlook(
        configurations=count,
        robots=100,
        failed=0,
        nominal=(1e-3, 2e-3, 3e-3),
        position=spread,
        position_share=spread,
        orientation=spread,
        orientation_share=spread,
        coverage=(0.95, 0.9, 0.98),
        honesty=1.0,
        met=(met, met - 0.05, min(met + 0.05, 1.0)),
    )


def test_errors_of_a_fleet_are_distributions():
    rows = [row(f"r{k}", 1e-3 * k, 1e-4 * k) for k in range(1, 6)]
    rows += [FleetRow("failed"), row("camera", 3.0, 1.0, "pixel")]
    (drawn,) = fleet_figures(rows)
    (axes,) = drawn.figure.axes
    before, after = axes.lines
    np.testing.assert_allclose(before.get_xdata(), [1.0, 2.0, 3.0, 4.0, 5.0])
    np.testing.assert_allclose(after.get_xdata(), [0.1, 0.2, 0.3, 0.4, 0.5])
    np.testing.assert_allclose(after.get_ydata(), [20.0, 40.0, 60.0, 80.0, 100.0])
    assert "3.000 mm" in drawn.reading and "0.3000 mm" in drawn.reading


def test_few_robots_have_no_distribution():
    assert not [*fleet_figures([row("a", 1e-3, 1e-4), row("b", 1e-3, 1e-4)])]


def test_an_outlook_shows_errors_and_chances():
    found = [outlook(12, 0.5), outlook(30, 1.0)]
    limit = LimitSetup(position=2e-4)
    (drawn,) = outlook_figures(Foreseen(found, limit))
    errors, chances = drawn.figure.axes
    np.testing.assert_allclose(errors.lines[0].get_ydata(), [2 / 12, 2 / 30])
    low, high = errors.get_ylim()
    assert low < 0.2 < high  # The limit is inside.
    np.testing.assert_allclose(chances.lines[0].get_ydata(), [50.0, 100.0])


def test_without_a_limit_there_are_errors_only():
    nobody = (math.nan, math.nan, math.nan)
    found = [replace(outlook(k), met=nobody) for k in (12, 30)]
    (drawn,) = outlook_figures(Foreseen(found, LimitSetup()))
    assert len(drawn.figure.axes) == 1
    lost = [replace(one, failed=one.robots) for one in found]
    assert not [*outlook_figures(Foreseen(lost, LimitSetup()))]
