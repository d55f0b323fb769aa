"""A robot at random that was calibrated, and what is done with its files."""

from __future__ import annotations

import contextlib
import csv
import io
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
import yaml
from scipy.spatial.transform import Rotation

from benchmarks.round_trips.robots import (
    Floats,
    Positions,
    Robot,
    Tree,
    pose,
)
from calib_pin.cli import main as command

PROMISED = 3.0
"""Errors of commands by those that a calibration promises."""

LEAST = 2e-5
"""Errors below which there is nothing to tell apart [m]."""

LEAST_TURN = 2e-4
"""Errors of orientations below which there is nothing to tell apart [rad]."""

DIGITS = 1e-8
"""Differences of tips that the digits of files make [m, rad]."""

BEST = 1.3
"""What offsets leave, by what the best ones leave (other configurations)."""

JUMP = 0.1
"""Largest change of corrections between neighbors [rad, m]."""

KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
"""Numbers of an origin [m, rad]."""

COUNT = 100
"""Random configurations of a comparison."""

TARGETS, STEPS = 12, 40
"""Targets, and rows of a motion."""


class Told(Exception):
    """A sentence says what is missing."""


class Refused(Exception):
    """One line refuses it."""


class Silent(Exception):
    """Something is wrong, and nothing says so."""


class Internal(Exception):
    """The program fails."""


class Skipped(Exception):
    """The format is for other robots."""


@dataclass(frozen=True)
class Said:
    """What a command said.

    Attributes:
        status: Its exit status.
        out: Its output.
        remarks: Its lines on the stream of errors.
    """

    status: int
    out: str
    remarks: tuple[str, ...]

    def word(self, *words: str) -> str:
        """The first remark that has one of some words; empty where there is none."""
        remarks = (line for line in self.remarks if any(w in line for w in words))
        return next(remarks, "")

    def promised(self, measured: float) -> float:
        """The error that is told of a point that was not measured [m]."""
        told = re.search(r"known to \+- ([0-9.e-]+) mm", self.word("do not show"))
        return max(measured, 1e-3 * float(told[1])) if told else measured


def said(*words: str) -> Said:
    """Run a command.

    Raises:
        Internal: If it fails.
        Refused: If it refuses its input.
    """
    out, errors = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(errors):
        try:
            status = command([*words])
        except BaseException as error:
            raise Internal(repr(error)) from error
    lines = tuple(" ".join(errors.getvalue().split("\n")).split("calib-pin: "))
    lines = tuple(line.strip() for line in lines if line.strip())
    if any("internal error" in line for line in lines):
        raise Internal(lines[-1])
    if status == 1:
        raise Refused(lines[-1] if lines else "without a word")
    return Said(status, out.getvalue(), lines)


def size(points: Floats) -> float:
    """Length of vectors, shape (N, 3), root mean square."""
    return float(np.sqrt(np.mean(np.sum(points**2, axis=1))))


def away(T: Floats, wanted: Floats, pose: bool = True) -> float:
    """Largest difference of poses, shape (N, 4, 4) [m, rad]."""
    difference = np.abs(T - wanted)[:, :3]
    return float(difference[:, :, :].max() if pose else difference[:, :, 3].max())


def placed(frame: Mapping[str, Sequence[float]]) -> Floats:
    """The pose of a position and of roll, pitch and yaw."""
    return pose(frame["xyz"], Rotation.from_euler("xyz", frame["rpy"]))


def origin_of(numbers: Sequence[float]) -> Floats:
    """The pose of x, y, z, roll, pitch and yaw."""
    return pose(numbers[:3], Rotation.from_euler("xyz", numbers[3:]))


def read_urdf(file: Path, like: Tree) -> Tree:
    """A URDF as yourdfpy has it, with the chain of another."""
    import yourdfpy

    found = yourdfpy.URDF.load(
        str(file), load_meshes=False, build_collision_scene_graph=False
    )
    joints = []
    for joint in like.joints:
        read = found.joint_map[joint.name]
        origin = np.eye(4) if read.origin is None else read.origin
        mimic = None
        if read.mimic is not None:
            one = read.mimic
            mimic = (one.joint, one.multiplier or 0.0, one.offset or 0.0)
        ends = read.parent, read.child
        axis = joint.axis if read.axis is None else np.asarray(read.axis, float)
        axis = axis / np.linalg.norm(axis)
        joints.append(
            replace(
                joint,
                kind=read.type,
                parent=ends[0],
                child=ends[1],
                origin=origin,
                axis=axis,
                mimic=mimic,
            )
        )
    return replace(like, joints=tuple(joints))


def rows_of(file: Path) -> list[dict[str, str]]:
    """Rows of a table by header; lines of comments are left out."""
    lines = [line for line in file.read_text().splitlines() if line[:1] != "#"]
    return list(csv.DictReader(lines))


@dataclass(frozen=True)
class Trip:
    """A calibrated robot, in the folder of its files.

    Attributes:
        robot: The robot.
        rng: Generator of what is asked.
    """

    robot: Robot
    rng: np.random.Generator

    @cached_property
    def document(self) -> dict[str, object]:
        """The calibration."""
        found: dict[str, object] = json.loads(Path("out/calibration.json").read_text())
        return found

    @cached_property
    def promised(self) -> float:
        """Error that is promised on held-out measurements, rms [m]."""
        errors: Mapping = self.document["errors"]
        checked = errors["position"]["validation"]["after"]["rms"]
        return max(float(checked), LEAST)

    @cached_property
    def promised_turn(self) -> float:
        """The same of orientations [rad]."""
        errors: Mapping = self.document["errors"]
        if "orientation" not in errors:
            return LEAST_TURN
        checked = errors["orientation"]["validation"]["after"]["rms"]
        return max(float(checked), LEAST_TURN)

    @cached_property
    def corrected(self) -> Tree:
        """The corrected URDF."""
        (file,) = (f for f in Path("out").glob("*.urdf") if f.name.startswith("robot_"))
        return read_urdf(file, self.robot.nominal)

    @cached_property
    def ends(self) -> tuple[Floats, Floats]:
        """Base and tool of the calibration."""
        frames: Mapping = self.document["frames"]
        return placed(frames["base"]), placed(frames["tool"])

    @cached_property
    def columns(self) -> Positions:
        """Random columns of the controller."""
        return self.robot.random(COUNT, self.rng)

    @cached_property
    def q(self) -> Positions:
        """Positions of the joints there."""
        return self.robot.positions(self.columns)

    def same(self, T: Floats, q: Positions, what: str, found: Said) -> None:
        """Compare tips with those of the corrected robot.

        Raises:
            Told: If they differ, and a remark says so.
            Silent: If they differ.
        """
        far = away(T, self.corrected.poses(q))
        if far > DIGITS:
            line = found.word("mimic", "follow", "leave", "hold")
            if line:
                raise Told(line)
            raise Silent(f"{what} is {1e3 * far:.3g} mm or mrad off")

    def export(self, form: str, file: str, *more: str) -> Said:
        """Export to a format.

        Raises:
            Internal: If it fails.
            Refused: If it is refused.
        """
        return said("export", "out", "--format", form, "-o", file, "--force", *more)


def calibrate(trip: Trip) -> None:
    """The corrected robot is as the true one, where none was measured."""
    robot = trip.robot
    found = said("calibrate", "robot.urdf", "m.csv", "--setup", "s.yaml", "-o", "out")
    if found.status:
        raise Told(" ".join(found.out.split("\n\n")[0].split()))
    base, tool = trip.ends
    predicted = base @ trip.corrected.poses(trip.q) @ tool
    truth = robot.seen(trip.columns)
    far = size(predicted[:, :3, 3] - truth[:, :3, 3])
    if far > PROMISED * trip.promised:
        raise Silent(
            f"URDF and frames are {1e3 * far:.3g} mm off, "
            f"promised {1e3 * trip.promised:.3g} mm"
        )


def init(trip: Trip) -> None:
    """A drafted setup leads to a robot as good, where columns are joints.

    Raises:
        Skipped: If they are not.
    """
    robot = trip.robot
    if any(one.map for one in robot.controller) or robot.stated_base:
        raise Skipped
    said("init", "robot.urdf", "m.csv", "--tip", robot.nominal.tip, "-o", "d.yaml")
    drafted = yaml.safe_load(Path("d.yaml").read_text())
    if drafted.get("tip") != robot.nominal.tip:
        raise Silent(f"tip {drafted.get('tip')!r} instead of {robot.nominal.tip!r}")
    found = said("calibrate", "robot.urdf", "m.csv", "--setup", "d.yaml", "-o", "d")
    if found.status:
        raise Told(" ".join(found.out.split("\n\n")[0].split()))
    errors = json.loads(Path("d/calibration.json").read_text())["errors"]["position"]
    rms = errors["validation"]["after"]["rms"]
    if rms > PROMISED * trip.promised:
        line = f"{1e3 * rms:.3g} mm, with the true setup {1e3 * trip.promised:.3g} mm"
        raise Silent(line)
