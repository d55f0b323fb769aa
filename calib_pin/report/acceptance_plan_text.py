"""The schedule of an acceptance test: how it is made, in lines for people."""

from __future__ import annotations

from collections.abc import Iterator, Sequence

import numpy as np
import pinocchio as pin
from scipy import stats

from calib_pin.control.acceptance_poses import ORDER, AcceptancePoses
from calib_pin.kinematics.spatial import Floats
from calib_pin.validation.acceptance import LEVEL, repeatability

PAUSE = 5.0
"""Time to settle and to be measured at a pose [s]."""


def acceptance_schedule(
    found: AcceptancePoses,
    robot: str,
    cycles: int,
    speeds: Floats | None,
    commands: Sequence[str],
) -> Iterator[str]:
    """The poses and what to do on the day, in lines of ASCII.

    Args:
        found: The poses.
        robot: Name of the robot.
        cycles: Number of cycles.
        speeds: Largest speeds of the joints, shape (n,) [rad/s, m/s]; None if the URDF
            does not state them.
        commands: The command lines to type when it is done.
    """
    order = ", ".join(f"P{pose}" for pose in ORDER)
    yield f"Acceptance test of {robot} in the terms of ISO 9283"
    yield ""
    x, y, z = 1e3 * found.center
    yield f"Cube of {1e3 * found.edge:.0f} mm, edges along the base frame, center"
    yield f"({x:.0f}, {y:.0f}, {z:.0f}) mm in the base link. Poses in a diagonal plane:"
    for k, T in enumerate(found.T, 1):
        x, y, z = np.round(1e3 * T[:3, 3], 1) + 0.0  # No negative zeros.
        yield f"  P{k}  x {x:8.1f}  y {y:8.1f}  z {z:8.1f} mm"
    if found.oriented:
        turns = np.degrees(pin.rpy.matrixToRpy(found.T[0, :3, :3]))
        roll, pitch, yaw = np.round(turns, 1) + 0.0
        yield "The tool has one orientation at all of them:"
        yield f"  roll {roll:.1f}, pitch {pitch:.1f}, yaw {yaw:.1f} deg"
    else:
        yield "A robot of fewer than six joints: positions only, orientations follow."
    yield f"Order: from P1 (not measured), then {cycles} cycles of {order}."
    yield ""
    yield "On the day"
    yield "  Robot assembled and adjusted as in use; robot and instrument in the room"
    yield "  long enough to have its temperature, 20 +- 2 degC; note another one."
    yield "  Load: 100 % of the rated load on the flange, its center of mass as the"
    yield "  maker states; with 10 % as a second test."
    yield "  Speed: 100 % of the rated speed; with 50 % and 10 % as further tests."
    yield "  Every load and every speed is a file of its own."
    yield "  Warm-up: run the cycle without measuring until readings drift no more."
    yield "  Instrument: its uncertainty is at most 25 % of the value to be proven."
    yield "  For AP, base and tool come from a calibration or from other poses."
    yield "  Approach every pose only from the one before it, as the file has them."
    yield "  Measure after the robot has settled: try the time out once, then keep it."
    yield from _duration(found, cycles, speeds)
    yield ""
    yield "Power of the test"
    yield from _power(cycles)
    yield ""
    yield "Fill in x, y, z (columns of orientations may be added), then type"
    yield from (f"  {line}" for line in commands)
    yield "A certified test needs the standard itself."


def _duration(
    found: AcceptancePoses, cycles: int, speeds: Floats | None
) -> Iterator[str]:
    waits = PAUSE * len(ORDER) * cycles
    pause = f"{PAUSE:.0f} s to settle and measure at each pose"
    if speeds is None:
        yield f"  Time: {waits / 60.0:.0f} min with {pause}, and the moves."
        return
    q = found.q[[pose - 1 for pose in ORDER]]
    way = np.abs(np.diff(np.concatenate([q[-1:], q]), axis=0)) / speeds
    moves = cycles * float(way.max(axis=1).sum())
    yield f"  Time: {(waits + moves) / 60.0:.0f} min with {pause};"
    yield f"  the moves take {moves / 60.0:.1f} min of it at full joint speeds."


def _power(cycles: int) -> Iterator[str]:
    """How well so many cycles tell AP and RP."""
    half = float(stats.t.ppf(0.5 + 0.5 * LEVEL, cycles - 1)) / cycles**0.5
    rng = np.random.default_rng(0)
    # The same scatter along all axes, exactly.
    noise = rng.standard_normal((max(cycles, 4), 3))
    noise -= noise.mean(axis=0)
    u, _, v = np.linalg.svd(noise, full_matrices=False)
    told = repeatability(np.asarray(u @ v), rng)
    low, high = (100.0 * (end / told.value - 1.0) for end in (told.low, told.high))
    yield f"  {cycles} cycles tell RP to {low:+.0f} % and {high:+.0f} % (95 % interval)"
    yield f"  and each component of AP to +- {half:.2f} standard deviations of a visit."
    yield "  A limit that is nearer to the value than that stays undecided."
