"""Robots at random, there and back: no fault is silent, and the judge is a judge."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import yourdfpy

from benchmarks.round_trips.commands import paced, short_ways, smooth
from benchmarks.round_trips.exports import check_offsets
from benchmarks.round_trips.robots import robot
from benchmarks.round_trips.running import FAULTS, STEPS_OF_A_TRIP, faults, run
from benchmarks.round_trips.trip import Said, Silent, Trip, read_urdf

SLOW = pytest.mark.slow
SAID = Said(0, "", ())


def trip(seed: int) -> Trip:
    return Trip(robot(seed), np.random.default_rng(seed))


@pytest.mark.parametrize("seed", range(5))
def test_kinematics_are_those_of_the_urdf(seed: int, tmp_path: Path) -> None:
    of = trip(seed)
    of.robot.write(tmp_path)
    nominal, file = of.robot.nominal, tmp_path / "robot.urdf"
    T = nominal.poses(of.q)
    assert np.allclose(read_urdf(file, nominal).poses(of.q), T, rtol=0.0, atol=1e-12)
    other = yourdfpy.URDF.load(str(file), load_meshes=False)
    at_zero = dict.fromkeys(other.actuated_joint_names, 0.0)
    for k in range(3):
        drives = {joint.name: of.q[joint.name][k] for joint in nominal.drives}
        other.update_cfg(at_zero | drives)
        found = other.get_transform(nominal.tip, nominal.base)
        assert np.allclose(found, T[k], rtol=0.0, atol=1e-12)


@pytest.mark.parametrize("seed", range(5))
def test_columns_and_drives_are_inverse(seed: int) -> None:
    of = trip(seed)
    drives = of.robot.drives(of.columns)
    for name, x in of.robot.columns(drives).items():
        assert np.allclose(x, of.columns[name], rtol=0.0, atol=1e-12)
    wrapped = of.robot.seen(of.robot.wrapped(of.columns))
    assert np.allclose(wrapped, of.robot.seen(of.columns), rtol=0.0, atol=1e-12)


def turning() -> Trip:
    """A robot with a column that begins again, and with speeds."""
    found = (trip(seed) for seed in range(100))
    return next(
        of
        for of in found
        if any(one.least is not None for one in of.robot.controller)
        and all(joint.speed for joint in of.robot.nominal.chain)
    )


def test_a_joint_that_is_turned_back_is_found() -> None:
    of = turning()
    way = of.robot.motion(20, of.rng)
    shown = of.robot.wrapped(way)
    smooth(of, shown, shown)
    (one, *_) = (c for c in of.robot.controller if c.least is not None)
    step = np.abs(np.diff(shown[one.column])).max()
    assert step > np.pi, "the motion does not pass the seam"
    with pytest.raises(Silent, match="turns by"):
        short_ways(of, shown)
    with pytest.raises(Silent, match="slower"):
        q = of.robot.drives(shown)
        speeds = np.array([joint.speed for joint in of.robot.nominal.drives])
        ways = np.abs(np.diff([*q.values()], axis=1)) / speeds[:, None]
        paced(of, way, np.append(0.0, np.cumsum(ways.max(axis=0))), 1.0)


def test_offsets_that_are_worse_than_the_best_are_found() -> None:
    of = next(of for of in map(trip, range(100)) if of.robot.offsets)
    names = [*of.robot.slips]
    vars(of).update(corrected=of.robot.nominal, ends=(of.robot.base, of.robot.tool))
    slips = np.array([*of.robot.slips.values()])

    def poses(x: np.ndarray) -> np.ndarray:
        moved = zip(names, x - slips, strict=True)
        columns = {name: of.columns[name] + by for name, by in moved}
        return of.robot.nominal.poses(of.robot.positions(columns))

    check_offsets(of, poses, slips, SAID)
    with pytest.raises(Silent, match="said 7 mm"):
        check_offsets(of, poses, slips, Said(0, "", ("7 of 9 mm are missing",)))
    with pytest.raises(Silent, match="the best"):
        check_offsets(of, poses, -slips, SAID)


QUICK = ("joint-offsets", "motion-message")
"""Of one robot; all steps of all robots are a benchmark."""


@pytest.mark.parametrize(
    ("seed", "steps"),
    [(1, QUICK), *(pytest.param(k, [*STEPS_OF_A_TRIP], marks=SLOW) for k in (0, 3))],
)
def test_no_fault_is_silent(seed: int, steps: list[str]) -> None:
    found = run(seed, steps)
    assert len(found) > 1 and found[0].kind == "right"
    assert not [one for one in found if one.kind in FAULTS], [*faults(found)]
