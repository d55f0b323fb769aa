"""The benchmark of whole days: a small version of it."""

from __future__ import annotations

import numpy as np
import pytest

import calib_pin
from benchmarks.field import away, trial
from benchmarks.field.days import INSTRUMENTS, JOBS, ROBOTS, day, located
from benchmarks.field.mishaps import NONE


def test_days_are_made_from_their_numbers() -> None:
    days = [day(number) for number in (3, 4, 3)]
    assert days[0].label == days[2].label != days[1].label
    np.testing.assert_array_equal(days[0].rows.values, days[2].rows.values)
    assert {of.instrument for of in days} <= {*INSTRUMENTS}


def test_the_robots_are_as_large_as_is_said() -> None:
    """From 0.4 to 4 m, those that are scaled among them."""
    reaches = {}
    for name, robot in ROBOTS.items():
        chain = calib_pin.load_chain(located(robot), base=robot.base, tip=robot.tip)
        q = chain.random_configurations(100, np.random.default_rng(0))
        reaches[name] = float(np.linalg.norm(chain.poses(q)[:, :3, 3], axis=1).max())
    assert min(reaches, key=reaches.__getitem__) == "bench"
    assert (reaches["bench"], reaches["giant"]) == pytest.approx((0.4, 4.0), rel=0.1)


@pytest.mark.parametrize(
    ("name", "instrument"),
    [
        (NONE, "wire"),
        ("instrument moved", "poses"),
        pytest.param("joint zero", "sockets", marks=pytest.mark.slow),
        pytest.param("rehomed", "tracker", marks=pytest.mark.slow),
        pytest.param("joint gear", "tracker", marks=pytest.mark.slow),
        pytest.param("inches", "tracker", marks=pytest.mark.slow),
    ],
)
def test_a_day(name: str, instrument: str) -> None:
    """Gross mishaps of an easy day are named, and nothing else is."""
    found = trial.run(7 * JOBS + 2, name, (instrument,))
    assert found.clean.verdict == "good"
    assert found.named == (name != NONE)
    assert not (found.false or found.wrong or found.refused)
    lines = {line.text.strip(): line for line in trial.judge([found])}
    assert lines[name].figure.split()[:2] == ["1", str(int(found.costly))]


def test_a_promise() -> None:
    found = away.run(7 * JOBS)
    assert found.actual < found.nominal
    assert 0.2 < found.ratio < 5.0
    assert all(line.passed is not False for line in away.judge([found]))
