"""Clocks are found to milliseconds, and nothing that moved is taken for standing."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError
from calib_pin.observations.joining import Log, Standstill, join, mean_sigmas

SETTLE, GAP = 0.5, 0.5
NOISE = 2e-5


@dataclass(frozen=True)
class Recording:
    """Logs of a robot that goes from standstill to standstill, and the truth."""

    joints: Log
    readings: Log
    ahead: float
    speed: np.ndarray  # Of the joints, at each reading [rad/s].
    standstills: int


@cache
def recording(
    seed: int, rate: float = 20.0, standstills: int = 12, still_only: bool = False
) -> Recording:
    """A UR10 that moves by trapezoids of speed between standstills of random length."""
    rng = np.random.default_rng(seed)
    chain = calib_pin.load_chain("example:ur10_robot", tip="tool0")
    corners = 0.5 * chain.random_configurations(standstills, rng)
    dt = 1e-3
    q = [corners[:1]]
    for k, corner in enumerate(corners):
        rest = round(rng.uniform(1.5, 4.0) / dt)
        q.append(np.repeat(corner[None], rest, axis=0))
        if k + 1 < standstills:
            time, ramp = rng.uniform(1.0, 3.0), rng.uniform(0.15, 0.45)
            s = np.arange(dt, time, dt) / time
            up = np.clip(s / ramp, 0, 1) * np.clip((1 - s) / ramp, 0, 1)
            s = np.cumsum(up) / up.sum()
            q.append(corner + s[:, None] * (corners[k + 1] - corner))
    path = np.concatenate(q)
    clock = dt * np.arange(len(path))
    stamps = np.arange(0.0, clock[-1], 0.01) + rng.uniform(-1e-3, 1e-3)
    stamps = np.clip(stamps, 0.0, clock[-1])

    def at(times: np.ndarray) -> np.ndarray:
        return np.column_stack([np.interp(times, clock, column) for column in path.T])

    logged = at(stamps) + rng.normal(0.0, 1e-5, (len(stamps), path.shape[1]))
    ahead = float(rng.uniform(-30.0, 30.0))
    when = np.sort(rng.uniform(0.0, clock[-1], round(rate * clock[-1])))
    speed = np.linalg.norm(np.gradient(path, dt, axis=0), axis=1)
    speed = np.interp(when, clock, speed)
    if still_only:
        kept = np.flatnonzero(speed == 0.0)
        when, speed, ahead = when[kept][5::40], speed[kept][5::40], 0.0
    points = chain.poses(at(when))[:, :3, 3] + [0.3, -1.0, 2.0]
    points = points + rng.normal(0.0, NOISE, points.shape)
    unique = np.concatenate([[True], np.diff(stamps) > 0])
    return Recording(
        Log(stamps[unique], logged[unique]),
        Log(when + ahead, points),
        ahead,
        speed,
        standstills,
    )


@pytest.mark.parametrize("seed", range(5))
def test_random_logs_are_joined(seed):
    made = recording(seed)
    found = join(made.joints, made.readings, SETTLE, GAP)
    assert abs(found.clock.ahead - made.ahead) < 5e-3
    assert abs(found.clock.ahead - made.ahead) < 5.0 * found.clock.sigma + 1e-4
    used = np.concatenate([standstill.readings for standstill in found.standstills])
    assert made.speed[used].max() == 0.0
    assert len(found.standstills) + found.empty == made.standstills
    # Of the time that the robot stood for long enough, most readings are there.
    assert len(used) > 0.3 * np.count_nonzero(made.speed == 0.0)
    assert len(used) + found.moving + found.scattered == len(made.speed)


def test_readings_at_stands_alone_keep_the_clock():
    made = recording(0, still_only=True)
    found = join(made.joints, made.readings, SETTLE, GAP)
    assert found.clock.motions == 0 and found.clock.ahead == 0.0
    used = np.concatenate([standstill.readings for standstill in found.standstills])
    assert made.speed[used].max() == 0.0 and len(used) > 5
    # Dates without a zone, an hour and 30 minutes ahead.
    later = Log(made.readings.time + 5400.0, made.readings.values)
    zone = join(made.joints, later, SETTLE, GAP)
    assert zone.clock.ahead == 5400.0 and zone.used == found.used


def test_logs_that_cannot_be_joined():
    """Of a robot that never stands, of other days, and of other motions."""
    t = np.linspace(0.0, 10.0, 1000)
    moving = Log(t, np.sin(t)[:, None])
    with pytest.raises(InputError):
        join(moving, moving, SETTLE, GAP)
    made = recording(2, still_only=True)
    for readings in (made.readings, recording(4).readings):
        later = Log(readings.time + 86400.0, readings.values)
        with pytest.raises(InputError):
            join(made.joints, later, SETTLE, GAP)


def test_a_slow_log_has_positions_at_every_stand():
    """Of the joints, where none of its samples is between a stand's both ends."""
    t = np.round(0.2 * np.arange(15), 1)
    q = np.repeat([0.1, 0.25, 0.4], [7, 1, 7])
    joints = Log(t, q[:, None])
    readings = Log(np.array([0.35, 0.55, 1.95, 2.15]), np.arange(4.0)[:, None])
    found = join(joints, readings, SETTLE, GAP)
    assert [standstill.q[0] for standstill in found.standstills] == [0.1, 0.4]


def test_a_reading_that_jumped_is_left_out():
    made = recording(5)
    values = made.readings.values.copy()
    still = np.flatnonzero(made.speed == 0.0)
    values[still[len(still) // 2]] += 0.01
    found = join(made.joints, Log(made.readings.time, values), SETTLE, GAP)
    plain = join(made.joints, made.readings, SETTLE, GAP)
    assert found.scattered >= plain.scattered
    used = np.concatenate([standstill.readings for standstill in found.standstills])
    assert still[len(still) // 2] not in used


@pytest.mark.parametrize("phi", [0.0, 0.6, 0.85])
def test_the_sigma_of_a_mean(phi):
    """White and autocorrelated noise, in standstills of unequal length.

    The rms of 400 means by their sigma is known to 1 / sqrt(800), 4 %.
    """
    rng, rows, values = np.random.default_rng(3), [], []
    for k in range(400):
        noise = rng.normal(size=(rng.integers(60, 120) + 50, 2))
        noise[1:] *= np.sqrt(1.0 - phi**2)
        for i in range(1, len(noise)):
            noise[i] += phi * noise[i - 1]
        first = sum(map(len, values))
        rows.append(Standstill(k, np.zeros(1), np.arange(len(noise)) + first))
        values.append(noise)
    every = np.concatenate(values)
    means = np.array([part.mean(axis=0) for part in values])
    size = np.sqrt(np.mean((means / mean_sigmas(rows, every)) ** 2, axis=0))
    assert np.abs(size - 1.0).max() < 0.15
    single = [Standstill(0, np.zeros(1), np.array([k])) for k in range(3)]
    assert not mean_sigmas(single, every).any()
