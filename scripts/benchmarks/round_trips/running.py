"""All steps of all robots, their outcomes, and a table."""

from __future__ import annotations

import argparse
import contextlib
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import numpy as np

from benchmarks.round_trips.commands import (
    motion,
    motion_message,
    motion_speed,
    targets,
    targets_base,
    targets_from,
    targets_message,
    targets_speed,
)
from benchmarks.round_trips.exports import (
    dh,
    joint_offsets,
    lerobot,
    mjcf,
    ros2_control,
    tf,
    vendor,
    xacro_overlay,
)
from benchmarks.round_trips.robots import robot
from benchmarks.round_trips.trip import (
    Internal,
    Refused,
    Silent,
    Skipped,
    Told,
    Trip,
    calibrate,
    init,
)


@dataclass(frozen=True)
class Outcome:
    """The outcome of a step.

    Attributes:
        seed: Number of the robot.
        step: The step.
        kind: `right`, `told`, `refused`, `silent` or `internal`.
        line: What was said, or is wrong.
    """

    seed: int
    step: str
    kind: str
    line: str = ""


STEPS_OF_A_TRIP: Mapping[str, Callable[[Trip], None]] = {
    "init": init,
    "joint-offsets": joint_offsets,
    "ros2-control": ros2_control,
    "mjcf": mjcf,
    "xacro": xacro_overlay,
    "dh": dh,
    "tf": tf,
    "vendor": vendor,
    "lerobot": lerobot,
    "targets": targets,
    "targets-from": targets_from,
    "targets-base": targets_base,
    "targets-speed": targets_speed,
    "targets-message": targets_message,
    "motion": motion,
    "motion-speed": motion_speed,
    "motion-message": motion_message,
}
"""Steps behind `calibrate`, each for itself."""


def outcomes(trip: Trip, name: str, step: Callable[[Trip], None]) -> Iterator[Outcome]:
    """The outcome of a step; none where the format is for other robots."""
    try:
        step(trip)
    except Skipped:
        return
    except (Told, Refused, Silent, Internal) as error:
        kind = type(error).__name__.lower()
        yield Outcome(trip.robot.seed, name, kind, str(error))
    except Exception as error:
        line = f"cannot be read: {error!r}"
        yield Outcome(trip.robot.seed, name, "silent", line)
    else:
        yield Outcome(trip.robot.seed, name, "right")


def run(
    seed: int,
    steps: Sequence[str] = tuple(STEPS_OF_A_TRIP),
    keep: Path | None = None,
) -> list[Outcome]:
    """The outcomes of a robot.

    Args:
        seed: Its number.
        steps: Steps behind `calibrate`.
        keep: Folder in which its files stay; None for none.
    """
    trip = Trip(robot(seed), np.random.default_rng([seed, 2]))
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        if keep is not None:
            folder = str(keep / str(seed))
            Path(folder).mkdir(parents=True)
        stack.enter_context(contextlib.chdir(folder))
        trip.robot.write(Path())
        found = [*outcomes(trip, "calibrate", calibrate)]
        if Path("out/calibration.json").exists() and found[0].kind != "told":
            for k, name in enumerate(STEPS_OF_A_TRIP):
                # A step asks the same whatever others ask.
                rng = np.random.default_rng([seed, 3, k])
                if name in steps:
                    one = replace(trip, rng=rng)
                    found += outcomes(one, name, STEPS_OF_A_TRIP[name])
    return found


FAULTS = ("silent", "internal")
KINDS = ("right", "told", "refused", *FAULTS)


def main() -> None:
    """Print the faults by seed, and a table of outcomes."""
    parser = argparse.ArgumentParser(prog="benchmark round-trips")
    parser.add_argument("name", nargs="*")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--only", default=",".join(STEPS_OF_A_TRIP))
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--show", action="store_true")
    asked = parser.parse_args()
    numbers = range(asked.first, asked.first + asked.count)
    keep = asked.keep and asked.keep.resolve()
    one = partial(run, steps=asked.only.split(","), keep=keep)
    found = list[Outcome]()
    with ProcessPoolExecutor(asked.workers) as pool:
        for outcomes in pool.map(one, numbers):
            found += outcomes
            for line in faults(outcomes, show=asked.show):
                print(line, flush=True)
    for line in counts(found):
        print(line)
    if any(one.kind in FAULTS for one in found):
        sys.exit(1)


def faults(found: Sequence[Outcome], *, show: bool = False) -> Iterator[str]:
    """A line for each fault, or for each outcome that is not right."""
    for one in found:
        if one.kind in FAULTS or (show and one.kind != "right"):
            special = ", ".join(robot(one.seed).properties)
            yield f"{one.seed:4d} {one.kind:9}{one.step}: {one.line} ({special})"


def counts(found: Sequence[Outcome]) -> Iterator[str]:
    """A table of steps and outcomes."""
    yield f"{'':20}" + "".join(f"{kind:>10}" for kind in KINDS)
    count = Counter((one.step, one.kind) for one in found)
    for step in dict.fromkeys(one.step for one in found):
        yield f"{step:20}" + "".join(f"{count[step, kind]:10d}" for kind in KINDS)
    seeds = {one.seed for one in found}
    bad = {one.seed for one in found if one.kind in FAULTS}
    yield f"{len(seeds)} robots, {len(bad)} with faults"
