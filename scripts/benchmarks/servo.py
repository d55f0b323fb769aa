"""Beginners with a servo arm, a pencil and a sheet: from touches to motor offsets.

Each has an arm whose zeros are off by up to 8 degrees, with a reversed servo in half of
them, touches 30 points with the tip of something in the gripper, and follows what the
command says: `init`, `calibrate`, the lines it prints into the setup file, `calibrate`
again, `export`. Some know where the arm stands on the sheet and where the tip sits; for
others these are estimated, and the first and the last zero may be told as not known.
The true arm has kinematics of its own, read from the URDF here.

    scripts/benchmark servo [--count 200] [--first 0] [--workers 2] [--keep DIR]
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import os
import re
import sys
import tempfile
from collections import Counter
from collections.abc import Mapping
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from unittest.mock import patch
from xml.etree import ElementTree

import numpy as np
import yaml
from numpy.typing import NDArray
from scipy.spatial.transform import Rotation

import calib_pin.cli.calibrate as calibrate
from benchmarks.round_trips.trip import Internal, Refused, said
from calib_pin.io.urdf import locate_robot

Floats = NDArray[np.float64]

TOUCHES, NOISE, FARTHEST = 30, 1e-3, 8.0
"""Touches, their noise [m], and the largest error of a zero [deg]."""

WITHIN = 3.0
"""Deviations within which an offset has to be."""

TURN = 4096
"""Steps of a turn."""

ROUNDS = 3
"""Times that lines which are printed go into the setup file."""

ARMS = {
    "example:so101": "gripper_frame_link",
    "example:so100": "gripper",
    "desk4": "tip",
}
"""Robots and their tips; the last is written here."""

DESK4 = [
    ("base", "turntable", (0, 0, 0.05), (0, 0, 1), 2.0),
    ("shoulder", "upper", (0, 0, 0.04), (0, 1, 0), 1.3),
    ("elbow", "fore", (0, 0, 0.15), (0, 1, 0), 2.2),
    ("wrist", "hand", (0.14, 0, 0), (0, 1, 0), 1.8),
]
"""Joints of an arm: name, link, origin [m], axis, and the limit either way [rad]."""


def desk4() -> str:
    """The URDF of an arm of four joints."""
    lines, parent = ['<robot name="desk4">', '<link name="base_link"/>'], "base_link"
    for name, link, xyz, axis, limit in DESK4:
        place, way = (" ".join(map(str, numbers)) for numbers in (xyz, axis))
        lines += [
            f'<joint name="{name}" type="revolute"><origin xyz="{place}"/>',
            f'<parent link="{parent}"/><child link="{link}"/><axis xyz="{way}"/>',
            f'<limit lower="-{limit}" upper="{limit}" effort="1" velocity="1"/>',
            f'</joint><link name="{link}"/>',
        ]
        parent = link
    lines += [
        '<joint name="mount" type="fixed"><origin xyz="0.08 0 0"/>',
        f'<parent link="{parent}"/><child link="tip"/></joint><link name="tip"/>',
    ]
    return "\n".join([*lines, "</robot>"])


@dataclass(frozen=True)
class Arm:
    """A serial arm: origins, axes (zero for a fixed joint) and limits from a URDF.

    Attributes:
        names: Its moving joints.
        places: Poses of all joints in their parents, shape (4, 4) each.
        axes: Their axes.
        limits: Limits of the moving joints, shape (n, 2) [rad].
    """

    names: tuple[str, ...]
    places: tuple[Floats, ...]
    axes: tuple[Floats, ...]
    limits: Floats

    @staticmethod
    def read(path: Path, tip: str) -> Arm:
        """The arm of a URDF from its root to a tip."""
        of_child = {
            joint.find("child").attrib["link"]: joint
            for joint in ElementTree.parse(path).getroot().iter("joint")
            if joint.find("child") is not None
        }
        way = []
        while tip in of_child:
            way.append(of_child[tip])
            tip = of_child[tip].find("parent").attrib["link"]
        names, places, axes, limits = [], [], [], []
        for joint in reversed(way):
            given = {tag: joint.find(tag) for tag in ("origin", "axis", "limit")}
            said_of = {t: {} if e is None else e.attrib for t, e in given.items()}
            numbers = [
                [float(word) for word in said_of["origin"].get(key, "0 0 0").split()]
                for key in ("xyz", "rpy")
            ]
            T = np.eye(4)
            T[:3, 3] = numbers[0]
            T[:3, :3] = Rotation.from_euler("xyz", numbers[1]).as_matrix()
            axis = np.zeros(3)
            if joint.attrib["type"] != "fixed":
                axis = np.array(said_of["axis"]["xyz"].split(), float)
                names.append(joint.attrib["name"])
                limits.append([float(said_of["limit"][k]) for k in ("lower", "upper")])
            places.append(T)
            axes.append(axis)
        return Arm(tuple(names), tuple(places), tuple(axes), np.array(limits))

    def tip(self, q: Floats, point: Floats) -> Floats:
        """A point on the tip in the base, shape (3,)."""
        R, p, moving = np.eye(3), np.zeros(3), iter(q)
        for place, axis in zip(self.places, self.axes, strict=True):
            p = p + R @ place[:3, 3]
            R = R @ place[:3, :3]
            if axis.any():
                angle = next(moving)
                K = np.cross(np.eye(3), axis)
                # The formula of Rodrigues.
                R = R @ (np.eye(3) + np.sin(angle) * K + (1.0 - np.cos(angle)) * K @ K)
        return R @ point + p

    def reached(
        self, target: Floats, point: Floats, rng: np.random.Generator
    ) -> Floats | None:
        """Joints that bring a point of the tip to a target, or None."""
        low, high = self.limits.T
        q = rng.uniform(low, high)
        for _ in range(30):
            here = self.tip(q, point)
            if np.abs(here - target).max() < 1e-6:
                return q
            steps = 1e-6 * np.eye(len(q))
            J = np.column_stack([self.tip(q + s, point) - here for s in steps]) / 1e-6
            damped = J @ J.T + 1e-5 * np.eye(3)
            q = np.clip(q + J.T @ np.linalg.solve(damped, target - here), low, high)
        return None


@dataclass(frozen=True)
class Beginner:
    """An arm with its errors, and what was written down.

    Attributes:
        robot: Name or file of the robot.
        tip: Its tip.
        known: Whether base and tool are known.
        zeros: True position where the servo says zero, by joint [rad].
        signs: Direction of the servos, by joint.
        table: The file.
        frames: Where the sheet and the tip are.
    """

    robot: str
    tip: str
    known: bool
    zeros: dict[str, float]
    signs: dict[str, int]
    table: str
    frames: dict[str, object]


def beginner(seed: int) -> Beginner:
    """One of them; its robot is written to the current folder where it has none."""
    rng = np.random.default_rng([42, seed])
    robot, tip = list(ARMS.items())[seed % len(ARMS)]
    if robot == "desk4":
        robot = "desk4.urdf"
        Path(robot).write_text(desk4())
    arm = Arm.read(Path(locate_robot(robot)), tip)
    n = len(arm.names)
    zeros = np.radians(rng.uniform(-FARTHEST, FARTHEST, n))
    signs = np.ones(n, int)
    if rng.random() < 0.5:
        signs[rng.integers(n)] = -1
    point = rng.uniform([-0.02, -0.02, -0.01], [0.02, 0.02, 0.03])
    turn, stand = rng.uniform(-np.pi, np.pi), rng.uniform(-0.2, 0.2, 3) * [1, 1, 0]
    sheet = rng.random() < 0.5
    rows, seen = [], []
    while len(rows) < TOUCHES:
        r, way = rng.uniform(0.12, 0.32), rng.uniform(-1.2, 1.2)
        height = 0.0 if sheet else rng.choice([0.0, 0.03, 0.06, 0.1])
        # Some arms have their zero to the side.
        center = arm.tip(arm.limits.mean(axis=1), point)
        way += np.arctan2(center[1], center[0])
        target = np.array([r * np.cos(way), r * np.sin(way), height])
        q = arm.reached(target, point, rng)
        # A servo counts within a turn.
        if q is None or np.abs(q - zeros).max() > 0.99 * np.pi:
            continue
        rows.append((q - zeros) * signs)
        on_sheet = Rotation.from_euler("z", turn).apply(target) + stand
        seen.append(on_sheet + rng.normal(0.0, NOISE, 3))
    frames = {
        "base": {"xyz": stand.tolist(), "rpy": [0.0, 0.0, float(turn)]},
        "tool": {"xyz": point.tolist(), "rpy": [0.0, 0.0, 0.0]},
    }
    table = _written(arm, np.array(rows), 1e3 * np.array(seen), sheet, rng)
    names = arm.names
    return Beginner(
        robot,
        tip,
        bool(rng.random() < 0.5),
        dict(zip(names, zeros.tolist(), strict=True)),
        dict(zip(names, signs.tolist(), strict=True)),
        table,
        {k: {**v, "estimate": False} for k, v in frames.items()},
    )


def _written(
    arm: Arm, shown: Floats, seen: Floats, sheet: bool, rng: np.random.Generator
) -> str:
    """A table in steps or degrees, in millimeters, with units or without."""
    way = rng.choice(["steps", "degrees", "tenths"])
    places = {"steps": 0, "degrees": 0, "tenths": 1}[way]
    if way == "steps":
        shown = TURN / 2 + shown * TURN / (2.0 * np.pi)
    else:
        shown = np.degrees(shown)
    unit, axes = {"steps": "steps/4096"}.get(way, "deg"), ("x", "y", "z")
    headed = rng.random() < 0.5
    header = [*arm.names, *axes[: 2 if sheet else 3]]
    if headed:
        units = [unit] * len(arm.names) + ["mm"] * 3
        header = [f"{name} [{u}]" for name, u in zip(header, units, strict=False)]
    lines = [",".join(header)]
    for q, p in zip(shown, seen, strict=True):
        cells = [f"{value:.{places}f}" for value in q]
        cells += [f"{value:.1f}" for value in (p[:2] if sheet else p)]
        lines.append(",".join(cells))
    return "\n".join(lines) + "\n"


def followed(one: Beginner) -> str:
    """What became of one: `right`, or what is wrong."""
    Path("touches.csv").write_text(one.table)
    said("init", one.robot, "touches.csv", "--tip", one.tip, "-o", "setup.yaml")
    setup = yaml.safe_load(Path("setup.yaml").read_text())
    if one.known:
        setup["frames"] = one.frames
    words = ["calibrate", one.robot, "touches.csv", "--setup", "setup.yaml", "--force"]
    words += ["--workers", "1"]
    for _ in range(ROUNDS):
        Path("setup.yaml").write_text(yaml.safe_dump(setup))
        found = said(*words, "-o", "out")
        lines = _lines(found.out)
        if found.status == 0 or not lines:
            break
        setup = _merged(setup, lines)
    verdict = found.out.partition(":")[0].split("\n")[-1]
    if found.status != 0:
        return f"refused: {' '.join(found.out.split())[:160]}"
    said("export", "out", "--format", "joint-offsets", "-o", "offsets.csv", "--force")
    return _judged(one, Path("offsets.csv").read_text(), verdict)


def _lines(text: str) -> Mapping[str, object]:
    """Lines for the setup file that a command prints."""
    found = re.search(r"Lines for the setup file\n((?:  .*\n)+)", text)
    return yaml.safe_load(found[1]) if found else {}


def _merged(setup: dict[str, object], lines: Mapping[str, object]) -> dict[str, object]:
    """A setup with more lines; mappings are merged."""
    merged = dict(setup)
    for key, value in lines.items():
        before = merged.get(key)
        if isinstance(before, dict) and isinstance(value, Mapping):
            value = _merged(before, value)
        merged[key] = value
    return merged


def _judged(one: Beginner, text: str, verdict: str) -> str:
    """Compare the exported offsets with what is true."""
    rows = csv.DictReader(line for line in text.splitlines() if line[:1] != "#")
    wrong, unknown = [], 0
    for row in rows:
        joint, sign = row["joint"], one.signs[row["joint"]]
        if int(row["sign"]) != sign:
            wrong.append(f"sign of {joint}")
        elif row["sigma"]:
            true = np.degrees(sign * one.zeros[joint])
            off = (float(row["offset"]) - true) / float(row["sigma"])
            if abs(off) > WITHIN:
                wrong.append(f"{joint} {off:+.1f} sigma of {row['sigma']} deg")
        else:
            unknown += 1
    if wrong:
        return f"wrong: {', '.join(wrong)} ({verdict})"
    return f"right, {unknown} not known"


def run(seed: int, keep: Path | None = None) -> tuple[int, str, str]:
    """The seed, its kind and its outcome."""
    with contextlib.ExitStack() as stack:
        folder = stack.enter_context(tempfile.TemporaryDirectory())
        if keep is not None:
            folder = str(keep / str(seed))
            Path(folder).mkdir(parents=True, exist_ok=True)
        stack.enter_context(contextlib.chdir(folder))
        # Figures take most of the time.
        stack.enter_context(patch.object(calibrate, "draw_calibration", lambda *_: []))
        one = beginner(seed)
        kind = f"{one.robot} {'known' if one.known else 'estimated'}"
        kind += " reversed" * (-1 in one.signs.values())
        try:
            return seed, kind, followed(one)
        except (Internal, Refused) as error:
            return seed, kind, f"{type(error).__name__.lower()}: {error}"


def main() -> None:
    """Print what is wrong, and a table."""
    parser = argparse.ArgumentParser(prog="benchmark servo")
    parser.add_argument("name", nargs="*")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--keep", type=Path)
    asked = parser.parse_args()
    table, seeds = (
        Counter[tuple[str, str]](),
        range(asked.first, asked.first + asked.count),
    )
    with ProcessPoolExecutor(asked.workers) as pool:
        keep = asked.keep and asked.keep.resolve()
        for seed, kind, outcome in pool.map(partial(run, keep=keep), seeds):
            table[kind, re.split("[:,]", outcome)[0]] += 1
            if not outcome.startswith("right"):
                print(f"{seed:4d} {kind}: {outcome}", flush=True)
    ways = sorted({way for _, way in table})
    print(f"{'':34}" + "".join(f"{way:>10}" for way in ways))
    for kind in sorted({kind for kind, _ in table}):
        print(f"{kind:34}" + "".join(f"{table[kind, way]:10d}" for way in ways))
    right = sum(n for (_, way), n in table.items() if way == "right")
    print(f"{right} of {asked.count} right: {100.0 * right / asked.count:.1f} %")
    if right < 0.97 * asked.count:
        sys.exit(1)
