"""Robots at random, there and back: calibrated, exported, read back, compensated.

A random robot (`random_robots`) is measured, and the commands are run on its files:
`calibrate`, `export` to each format that applies, `compensate` with targets and with a
motion, to tables and to programs. What is written is read by others: yourdfpy, MuJoCo,
xacro, a page of arithmetic. Commands are replayed on the true robot, in the columns of
its controller.

A step is right where the tip is as the corrected robot has it (commands: where the
target is, within three times the error that the calibration promises); told where a
sentence says what is missing, or a verdict is not trusted; refused where one line
refuses it; silent where it is none of these; internal where the program fails.

    scripts/benchmark round-trips [--count 200] [--first 0] [--workers 2] [--keep DIR]
        [--show]
"""

from __future__ import annotations

import argparse
import contextlib
import csv
import io
import itertools
import json
import os
import sys
import tempfile
from collections import Counter
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import dataclass, replace
from functools import cached_property, partial
from pathlib import Path
from xml.etree import ElementTree

import mujoco
import numpy as np
import xacro
import yaml
import yourdfpy
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.random_robots import (
    TURN,
    Drive,
    Floats,
    Joint,
    Positions,
    Robot,
    Tree,
    pose,
    robot,
    rpy_of,
    table,
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


def cost(T: Floats, wanted: Floats, reach: float) -> Floats:
    """Differences of poses as lengths, shape (6 N,) [m]."""
    turn = Rotation.from_matrix(
        np.swapaxes(T[:, :3, :3], 1, 2) @ wanted[:, :3, :3]
    ).as_rotvec()
    return np.hstack([T[:, :3, 3] - wanted[:, :3, 3], reach * turn]).ravel()


def check_offsets(
    trip: Trip,
    poses: Callable[[Floats], Floats],
    offsets: Floats,
    found: Said,
    rounded: float = 0.0,
) -> None:
    """Offsets bring the nominal robot as near the corrected one as offsets can.

    Args:
        trip: The calibrated robot.
        poses: Tips of the nominal robot by offsets.
        offsets: Those that were written [rad, m].
        found: What was said with them.
        rounded: What they are rounded by [rad].

    Raises:
        Told: If they do not, and a remark says that they are not known.
        Silent: If they do not, or leave more than is said.
    """
    wanted = trip.corrected.poses(trip.q)
    reach = max(float(np.linalg.norm(wanted[:, :3, 3], axis=1).mean()), 0.1)

    def residual(x: Floats) -> Floats:
        return cost(poses(x), wanted, reach)

    scale = np.sqrt(COUNT)
    best = least_squares(residual, np.zeros(len(offsets)), x_scale=1e-3, xtol=1e-12)
    left, least = np.linalg.norm(residual(offsets)), np.linalg.norm(best.fun)
    steps = (residual(best.x + by) - best.fun for by in rounded * np.eye(len(best.x)))
    few = LEAST * scale + sum(np.linalg.norm(by) for by in steps)
    if left > BEST * least + few:
        before = np.linalg.norm(residual(0.0 * offsets))
        if (line := found.word("not known by themselves", "unknown")) != "":
            raise Told(line)
        names = [one.column for one in trip.robot.controller]
        apart = ", ".join(
            f"{name} {1e3 * x:+.3f} instead of {1e3 * y:+.3f}"
            for name, x, y in zip(names, offsets, best.x, strict=True)
            if abs(x - y) > 0.2 * abs(y) + 1e-4
        )
        a, b, c = (1e3 * float(x / scale) for x in (before, left, least))
        raise Silent(f"leaves {b:.3g} of {a:.3g} mm, the best {c:.3g} mm: {apart}")
    if least > few and not found.word("alone leave"):
        raise Silent(f"leaves {1e3 * least / scale:.3g} mm and does not say so")


def joint_offsets(trip: Trip) -> None:
    """Offsets, typed into the controller: added to what its columns show."""
    robot = trip.robot
    found = trip.export("joint-offsets", "offsets.csv")
    stated = rows_of(Path("offsets.csv"))
    names = [one.column for one in robot.controller]
    other = [row["column"] for row in stated if row["column"] not in names]
    if other:
        raise Silent(f"offsets of what the controller does not have: {other}")
    missing = set(names) - {row["column"] for row in stated}
    if missing:
        raise Silent(f"no offset of {sorted(missing)}")
    given = {row["column"]: row["offset_si"] for row in stated}
    blank = [name for name in names if given[name] == ""]
    if blank:
        raise Told(found.word("not known by themselves") or f"blank: {blank}")
    offsets = np.array([float(given[name]) for name in names])

    def poses(x: Floats) -> Floats:
        moved = zip(names, x, strict=True)
        return robot.nominal.poses(
            robot.positions({name: trip.columns[name] + by for name, by in moved})
        )

    check_offsets(trip, poses, offsets, found)


SPELLINGS = (
    ("plugin", "joint", "mechanical_reduction"),
    ("plugin", "actuator", "mechanical_reduction"),
    ("type", "actuator", "mechanicalReduction"),
    ("plugin", "joint", "mechanicalReduction"),
)
"""Of transmissions: their kind, where the reduction is, and how it is spelled."""


def ros2_control(trip: Trip) -> None:
    """Transmissions of the drives, about those that there were."""
    robot = trip.robot
    drives = robot.nominal.drives
    kind, owner, key = SPELLINGS[int(trip.rng.integers(len(SPELLINGS)))]
    stated, more = dict[str, tuple[float, float]](), list[str]()
    if trip.rng.random() < 0.6:
        lines = ["<robot name='own'>"]
        for joint in drives:
            name = joint.name
            stated[name] = float(trip.rng.choice([40.0, -100.0, 2.5])), 0.1
            reduction = f"<{key}>{stated[name][0]}</{key}>"
            lines += [
                f"<transmission name='t {name}'>"
                f"<{kind}>transmission_interface/SimpleTransmission</{kind}>"
                f"<joint name='{name}' role='joint1'>{reduction * (owner == 'joint')}"
                "<offset>0.1</offset></joint>"
                f"<actuator name='m {name}' role='actuator1'>"
                f"{reduction * (owner == 'actuator')}</actuator></transmission>"
            ]
        Path("own.xml").write_text("\n".join([*lines, "</robot>"]))
        more = ["--template", "own.xml"]
    found = trip.export("ros2-control", "control.xml", *more)
    written = dict[str, tuple[float, float]]()
    for one in ElementTree.parse("control.xml").getroot().iter("transmission"):
        joint = one.find("joint")
        assert joint is not None
        reductions = [float(e.text or "nan") for e in one.iter("mechanical_reduction")]
        offset = float(joint.findtext("offset", "0"))
        written[joint.get("name", "")] = float(np.prod(reductions)), offset
    names = [joint.name for joint in drives]
    if set(written) != set(names):
        raise Silent(f"transmissions of {sorted(written)}, motors of {sorted(names)}")

    def poses(x: Floats) -> Floats:
        moved = zip(names, x, strict=True)
        q = {name: trip.q[name] + by for name, by in moved}
        return robot.nominal.poses(robot.nominal.followed(q))

    offsets = []
    for name in names:
        own, at_zero = stated.get(name, (1.0, 0.0))
        reduction, offset = written[name]
        if abs(reduction / own - 1.0) > 1e-6:
            raise Silent(f"{name}: reduction {own} ({owner}: {key}) became {reduction}")
        offsets.append(offset - at_zero)
    check_offsets(trip, poses, np.array(offsets), found)


def mjcf(trip: Trip) -> None:
    """MuJoCo's description, with the equality constraints of joints that follow."""
    robot = trip.robot
    found = trip.export("mjcf", "robot.xml")
    model = mujoco.MjModel.from_xml_path("robot.xml")
    state = mujoco.MjData(model)
    equal = list[tuple[int, int, Floats]]()
    for k in range(model.neq):
        if model.eq_type[k] == mujoco.mjtEq.mjEQ_JOINT:
            ends = int(model.eq_obj1id[k]), int(model.eq_obj2id[k])
            equal.append((*ends, model.eq_data[k][:5].copy()))
    base = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, robot.nominal.base)
    tip = mujoco.mj_name2id(model, mujoco.mjtObj.mjOBJ_BODY, robot.nominal.tip)
    if tip < 0:
        raise Silent("has no tip")
    poses = []
    for k in range(COUNT):
        state.qpos[:] = model.qpos0
        for joint in robot.nominal.drives:
            state.joint(joint.name).qpos[0] = trip.q[joint.name][k]
        for follower, leader, factors in equal:
            x = 0.0
            if leader >= 0:
                at = model.jnt_qposadr[leader]
                x = state.qpos[at] - model.qpos0[at]
            at = model.jnt_qposadr[follower]
            state.qpos[at] = model.qpos0[at] + np.polyval(factors[::-1], x)
        mujoco.mj_kinematics(model, state)
        ends = [np.eye(4), np.eye(4)]
        for T, body in zip(ends, (max(base, 0), tip), strict=True):
            T[:3, :3], T[:3, 3] = state.xmat[body].reshape(3, 3), state.xpos[body]
        poses.append(np.linalg.inv(ends[0]) @ ends[1])
    trip.same(np.array(poses), trip.q, "MuJoCo's tip", found)


def xacro_overlay(trip: Trip) -> None:
    """Origins as properties, taken by a description that includes them."""
    robot = trip.robot
    found = trip.export("xacro", "origins.xacro")
    namespace = "http://www.ros.org/wiki/xacro"
    stated = {
        e.get("name")
        for e in ElementTree.parse("origins.xacro").getroot()
        if e.tag == f"{{{namespace}}}property"
    }
    ElementTree.register_namespace("xacro", namespace)
    root = ElementTree.parse("robot.urdf").getroot()
    for joint in root.iter("joint"):
        own = "".join(c if c.isalnum() else "_" for c in joint.get("name", ""))
        origin = joint.find("origin")
        if f"{own}_xyz" in stated and origin is not None:
            origin.set("xyz", f"${{{own}_xyz}}")
            origin.set("rpy", f"${{{own}_rpy}}")
    root.insert(
        0, ElementTree.Element(f"{{{namespace}}}include", filename="origins.xacro")
    )
    Path("own.xacro").write_bytes(ElementTree.tostring(root))
    Path("read.urdf").write_text(xacro.process_file("own.xacro").toxml())
    tree = read_urdf(Path("read.urdf"), robot.nominal)
    trip.same(tree.poses(trip.q), trip.q, "the description", found)


def step(names: str, numbers: Sequence[float]) -> Floats:
    """Elementary poses, one after another: Rz(theta) is `Rz`, Tx(a) is `Tx`."""
    T = np.eye(4)
    for name, x in zip(names.split(), numbers, strict=True):
        axis = "xyz".index(name[1])
        if name[0] == "R":
            T = T @ pose(np.zeros(3), Rotation.from_euler(name[1], x))
        else:
            T = T @ pose(x * np.eye(3)[axis], Rotation.identity())
    return T


KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
CONVENTIONS = {"standard": "Rz Tz Tx Rx Ry", "modified": "Tx Rx Ry Rz Tz"}


def dh(trip: Trip) -> None:
    """Denavit-Hartenberg tables, both conventions, row by row."""
    found = trip.export("dh", "dh.csv")
    stated = rows_of(Path("dh.csv"))
    for convention, names in CONVENTIONS.items():
        rows = [row for row in stated if row["convention"] == convention]
        ends = (rows[0], rows[-1])
        frames = [origin_of([float(row[key]) for key in KEYS]) for row in ends]
        T = []
        for k in range(COUNT):
            here = frames[0]
            for row in rows[1:-1]:
                numbers = {
                    key: float(row[key]) for key in ("theta", "d", "a", "alpha", "beta")
                }
                moves = "theta" if row["type"] == "revolute" else "d"
                numbers[moves] += trip.q[row["joint"]][k]
                order = [numbers[key] for key in ("theta", "d", "a", "alpha", "beta")]
                if convention == "modified":
                    order = [*order[2:], *order[:2]]
                here = here @ step(names, order)
            T.append(here @ frames[1])
        trip.same(np.array(T), trip.q, f"the {convention} table", found)


def tf(trip: Trip) -> None:
    """Static transforms beside the corrected URDF: where the tool is seen."""
    robot = trip.robot
    trip.export("tf", "tf.yaml")
    links = {j.parent for j in robot.nominal.joints}
    links |= {j.child for j in robot.nominal.joints}
    found = dict[str, Floats]()
    for one in yaml.safe_load(Path("tf.yaml").read_text())["transforms"]:
        parent, child = one["header"]["frame_id"], one["child_frame_id"]
        if parent not in links:
            raise Silent(f"'{parent}' is no link")
        if child in links:
            raise Silent(f"'{parent}' carries '{child}', which is a link already")
        move, turn = one["transform"]["translation"], one["transform"]["rotation"]
        rotation = Rotation.from_quat([turn[key] for key in "xyzw"])
        found[parent] = pose([move[key] for key in "xyz"], rotation)
    T = trip.corrected.poses(trip.q) @ found[robot.nominal.tip]
    T = np.linalg.inv(found[robot.nominal.base]) @ T
    truth = robot.seen(trip.columns)
    far = size(T[:, :3, 3] - truth[:, :3, 3])
    if far > PROMISED * trip.promised:
        raise Silent(f"the tool is {1e3 * far:.3g} mm off")


UR = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")


def vendor(trip: Trip) -> None:
    """A vendor's kinematics: origins of joints that turn about z.

    Raises:
        Skipped: If a joint does not turn.
    """
    robot, template = trip.robot, {}
    chain = robot.nominal.chain
    if not all(joint.turns for joint in chain):
        raise Skipped
    form, names = "xarm-kinematics", [f"joint{k + 1}" for k in range(len(chain))]
    first = np.eye(4)
    if len(chain) == 6:
        form, names = "ur-kinematics", [*UR]
        first = pose(np.zeros(3), Rotation.from_euler("z", np.pi))
    zero, before = {joint.name: np.zeros(1) for joint in chain}, first
    for joint, name in zip(chain, names, strict=True):
        frame = replace(robot.nominal, tip=joint.child).poses(zero)[0]
        across = np.cross(joint.axis, np.eye(3)[np.argmin(np.abs(joint.axis))])
        across /= np.linalg.norm(across)
        turned = [across, np.cross(joint.axis, across), joint.axis]
        about_z = Rotation.from_matrix(np.column_stack(turned))
        frame = frame @ pose(np.zeros(3), about_z)
        T = np.linalg.inv(before) @ frame
        numbers = [*T[:3, 3].tolist(), *rpy_of(T)]
        template[name] = dict(zip(KEYS, numbers, strict=True))
        before = frame
    Path("own.yaml").write_text(yaml.safe_dump({"kinematics": template}))
    found = trip.export(form, "new.yaml", "--template", "own.yaml")
    stated = yaml.safe_load(Path("new.yaml").read_text())["kinematics"]
    T = np.tile(first, (COUNT, 1, 1))
    for joint, name in zip(chain, names, strict=True):
        numbers = [stated[name][key] for key in KEYS]
        about_z = Joint("", "revolute", "", "", origin_of(numbers))
        T = T @ about_z.moved(trip.q[joint.name])
    # Behind the last joint the flange stands still; where it does is a remark.
    flange = np.linalg.inv(T) @ trip.corrected.poses(trip.q)
    trip.same(T @ flange[:1], trip.q, "the kinematics", found)


def lerobot(trip: Trip) -> None:
    """Motors: the angle of an encoder's step is changed by what is to be added."""
    robot = trip.robot
    if not all(joint.turns for joint in robot.nominal.drives):
        raise Skipped
    motors = {
        one.column: {
            "id": k + 1,
            "drive_mode": 0,
            "homing_offset": int(trip.rng.integers(-900, 900)),
            "range_min": 0,
            "range_max": 4095,
        }
        for k, one in enumerate(robot.controller)
    }
    if trip.rng.random() < 0.5:
        for motor in motors.values():
            motor |= {"range_min": 700, "range_max": 3400}
    Path("motors.json").write_text(json.dumps(motors))
    found = trip.export("lerobot", "new.json", "--template", "motors.json")
    read = json.loads(Path("new.json").read_text())
    names = [one.column for one in robot.controller]
    if set(read) != set(names):
        raise Silent(f"motors {sorted(read)} instead of {sorted(names)}")
    offsets = []
    for name in names:
        own, new = motors[name], read[name]
        if not 0 <= new["range_min"] < new["range_max"] <= 4095:
            raise Silent(f"{name}: range {new['range_min']} to {new['range_max']}")
        middle = [0.5 * (m["range_min"] + m["range_max"]) for m in (own, new)]
        # position = encoder - homing_offset, angle = (position - middle) 360 / 4095
        moved = own["homing_offset"] - new["homing_offset"] + middle[0] - middle[1]
        offsets.append(moved * TURN / 4095)

    def poses(x: Floats) -> Floats:
        added = zip(names, x, strict=True)
        return robot.nominal.poses(
            robot.positions({name: trip.columns[name] + by for name, by in added})
        )

    # Whole steps are up to half a step from the best.
    check_offsets(trip, poses, np.array(offsets), found, 0.5 * TURN / 4095)


@dataclass(frozen=True)
class Commands:
    """Commands in a table.

    Attributes:
        rows: Line of the target of each, counted from 0 behind the header.
        columns: Columns of the controller, each of shape (N,) [rad, m].
        time: Times [s]; empty where there are none.
    """

    rows: list[int]
    columns: Positions
    time: list[float]


def read_commands(trip: Trip, file: Path, headers: bool) -> Commands:
    """Commands in the columns of the controller.

    Args:
        trip: The calibrated robot.
        file: The table.
        headers: Whether headers must be those of the controller's files.

    Raises:
        Silent: If a column is missing, or none of the controller's.
    """
    robot, stated = trip.robot, rows_of(file)
    found, spare = dict[str, Floats](), {*stated[0]} - {"row", "time"}
    for one in robot.controller:
        header = next((h for h in spare if _names(h, one, headers)), None)
        if header is None:
            raise Silent(f"no column '{one.header}' among {[*stated[0]]}")
        spare.remove(header)
        unit = {"deg": np.pi / 180.0, "mm": 1e-3}.get(header[-4:].strip(" []"), 1.0)
        found[one.column] = unit * np.array([float(row[header]) for row in stated])
    followers = {j.name for j in robot.nominal.chain if j.mimic}
    if robot.beside and headers:
        q = robot.positions(found)
        for name in followers & spare:
            x = np.array([float(row[name]) for row in stated])
            if np.abs(x - q[name]).max() > 1e-6:
                raise Silent(f"column '{name}' does not follow its leader")
        spare -= followers
    if spare:
        raise Silent(f"columns that the controller does not have: {sorted(spare)}")
    rows = [int(row["row"]) - 2 for row in stated if row.get("row")]
    return Commands(
        rows, found, [float(row["time"]) for row in stated if "time" in row]
    )


def _names(header: str, one: Drive, headers: bool) -> bool:
    if headers:
        return header == one.header
    units = ("rad", "deg", "m", "mm")
    return header in (one.column, *(f"{one.column} [{unit}]" for unit in units))


def reached(trip: Trip, commands: Commands, targets: Floats, pose: bool) -> None:
    """Commands reach their targets on the true robot.

    Raises:
        Silent: If they do not.
        Told: If many are told as out of reach.
    """
    T = trip.robot.seen(commands.columns)
    wanted = targets[commands.rows]
    far = size(T[:, :3, 3] - wanted[:, :3, 3])
    if far > PROMISED * trip.promised:
        raise Silent(f"{1e3 * far:.3g} mm, promised {1e3 * trip.promised:.3g} mm")
    if pose:
        turn = np.swapaxes(T[:, :3, :3], 1, 2) @ wanted[:, :3, :3]
        angle = size(Rotation.from_matrix(turn).as_rotvec())
        if angle > PROMISED * trip.promised_turn:
            raise Silent(f"turned {1e3 * angle:.3g} mrad away from the target")


def lost(asked: int, commands: Commands, found: Said, few: int = 1) -> None:
    """Tell of targets that were not reached.

    Raises:
        Told: If there are some.
    """
    missing = asked - len(commands.rows)
    if missing > few:
        line = found.word("reach") or " ".join(found.out.split())[:200]
        raise Told(f"{missing} of {asked} targets are told as out of reach: {line}")


@dataclass(frozen=True)
class Asked:
    """Targets that the true robot can reach.

    Attributes:
        columns: Where it does.
        T: The targets, shape (N, 4, 4).
        pose: Whether orientations are asked for.
    """

    columns: Positions
    T: Floats
    pose: bool


def asked(trip: Trip) -> Asked:
    """Targets, with orientations where six drives or more can bring them."""
    robot = trip.robot
    columns = robot.random(TARGETS, trip.rng, 0.8)
    T = robot.seen(columns)
    return Asked(columns, T, robot.pose and len(robot.controller) >= 6)


def compensate(file: str, output: str, *more: str) -> Said:
    """Run the command; status 2 with nothing written is told.

    Raises:
        Internal: If it fails.
        Refused: If it refuses its input.
        Told: If it writes nothing.
    """
    words = ["out/calibration.json", file, "-o", output, "--force", *more]
    Path(output).unlink(missing_ok=True)
    found = said("compensate", *words)
    if not Path(output).exists():
        raise Told(" ".join(found.out.split())[:300])
    return found


def targets(trip: Trip) -> None:
    """A list of targets, without where to begin."""
    of = asked(trip)
    Path("t.csv").write_text(table(trip.robot.points(of.T, of.pose)))
    degrees = ["--degrees"] if trip.rng.random() < 0.5 else []
    found = compensate("t.csv", "c.csv", *degrees)
    commands = read_commands(trip, Path("c.csv"), headers=False)
    reached(trip, commands, of.T, of.pose)
    short_ways(trip, commands.columns)
    lost(TARGETS, commands, found)


def short_ways(trip: Trip, columns: Positions) -> None:
    """Joints that turn without end take the short way.

    Raises:
        Silent: If one does not.
    """
    q = trip.robot.drives(columns)
    for joint in trip.robot.nominal.drives:
        # A leader whose turn moves others elsewhere goes where it must.
        followers = (j for j in trip.robot.nominal.chain if j.mimic)
        leads = any(j.mimic and j.mimic[0] == joint.name for j in followers)
        way = np.abs(np.diff(q[joint.name])).max(initial=0.0)
        if joint.kind == "continuous" and not leads and way > np.pi + 0.01:
            raise Silent(f"'{joint.name}' turns by {np.degrees(way):.0f} deg at once")


def targets_from(trip: Trip) -> None:
    """Targets with the columns of the controller, as they were planned."""
    robot, of = trip.robot, asked(trip)
    cells = robot.cells(of.columns) | robot.points(of.T, of.pose)
    Path("t.csv").write_text(table(cells))
    found = compensate("t.csv", "c.csv")
    commands = read_commands(trip, Path("c.csv"), headers=True)
    reached(trip, commands, of.T, of.pose)
    shown = robot.wrapped(of.columns)
    near = {name: x[commands.rows] for name, x in shown.items()}
    for name, x in commands.columns.items():
        far = np.abs(x - near[name]).max(initial=0.0)
        if len(robot.controller) <= 6 and of.pose and far > 3.0:
            raise Silent(f"column '{name}' goes {far:.3g} rad or m from where it was")
    lost(TARGETS, commands, found)


def follows(trip: Trip, columns: Positions, before: Positions) -> None:
    """The true tip goes where the nominal one would have gone.

    Base and tip may be displaced where they were estimated.

    Raises:
        Silent: If it does not.
    """
    robot = trip.robot
    T = robot.flange(columns)
    wanted = robot.nominal.poses(robot.positions(before))
    promised = trip.promised
    if robot.known:
        far = size(T[:, :3, 3] - wanted[:, :3, 3])
    else:

        def residual(x: Floats) -> Floats:
            ends = [pose(p[:3], Rotation.from_rotvec(p[3:])) for p in (x[:6], x[6:])]
            return ((ends[0] @ T @ ends[1])[:, :3, 3] - wanted[:, :3, 3]).ravel()

        best = least_squares(residual, np.zeros(12), x_scale=1e-2)
        far = size(best.fun.reshape(-1, 3))
        if np.abs(best.x).max() > 0.05:
            raise Silent(f"the tip is displaced by {np.abs(best.x).max():.3g}")
    # The tip is as far from the tool as the tool is seen.
    if far > PROMISED * promised:
        raise Silent(f"{1e3 * far:.3g} mm off, promised {1e3 * promised:.3g} mm")


def smooth(trip: Trip, columns: Positions, before: Positions) -> None:
    """Corrections do not jump, but for whole turns of what begins again.

    Raises:
        Silent: If they do.
    """
    for one in trip.robot.controller:
        change = columns[one.column] - before[one.column]
        if one.least is not None:
            change = np.unwrap(change)
        jump = np.abs(np.diff(change)).max()
        if jump > JUMP:
            raise Silent(f"column '{one.column}' jumps by {jump:.3g}")


def motion(trip: Trip) -> None:
    """A motion in the columns of the controller."""
    robot = trip.robot
    way = robot.motion(STEPS, trip.rng)
    Path("way.csv").write_text(table(robot.cells(way)))
    compensate("way.csv", "c.csv")
    commands = read_commands(trip, Path("c.csv"), headers=True)
    follows(trip, commands.columns, way)
    smooth(trip, commands.columns, robot.wrapped(way))


def least_times(trip: Trip, columns: Positions, part: float) -> tuple[Floats, Floats]:
    """Times of steps at a part of the speeds: of drives, and of all joints."""
    robot = trip.robot
    q = robot.positions(columns)
    times = {}
    for joint in {j.name: j for j in [*robot.nominal.chain, *robot.nominal.drives]}:
        speed = robot.nominal.named[joint].speed
        assert speed, "which `compensate` refuses"
        times[joint] = np.abs(np.diff(q[joint])) / (part * speed)
    drives = [times[joint.name] for joint in robot.nominal.drives]
    return np.max(drives, axis=0), np.max([*times.values()], axis=0)


def paced(trip: Trip, columns: Positions, time: Floats, part: float) -> None:
    """Times are those of the steps.

    Raises:
        Silent: If they are not.
    """
    least, most = least_times(trip, columns, part)
    steps = np.diff(time)
    slow, fast = steps > most * 1.001 + 1e-6, steps < least * 0.999 - 1e-6
    for off, what in ((slow, "slower"), (fast, "faster")):
        if off.any():
            k = int(np.argmax(off))
            raise Silent(
                f"step {k} in {steps[k]:.3g} s, {what} than the speeds of the URDF "
                f"({least[k]:.3g} to {most[k]:.3g} s)"
            )


def unwound(trip: Trip, columns: Positions) -> Positions:
    """Columns of a motion, those that begin again as they go on."""
    ends = [one.column for one in trip.robot.controller if one.least is not None]
    return columns | {name: np.unwrap(columns[name]) for name in ends}


def motion_speed(trip: Trip) -> None:
    """A motion with times that follow from its steps."""
    robot = trip.robot
    way = robot.motion(STEPS, trip.rng)
    Path("way.csv").write_text(table(robot.cells(way)))
    compensate("way.csv", "c.csv", "--speed", "0.3")
    commands = read_commands(trip, Path("c.csv"), headers=True)
    if len(commands.time) != STEPS:
        raise Silent("has no times")
    follows(trip, commands.columns, way)
    smooth(trip, commands.columns, robot.wrapped(way))
    paced(trip, unwound(trip, commands.columns), np.array(commands.time), 0.3)


def targets_base(trip: Trip) -> None:
    """Targets of the tip link in the base link.

    Raises:
        Skipped: If base and tool are not known.
    """
    if not trip.robot.known:
        raise Skipped
    of = asked(trip)
    T = trip.robot.flange(of.columns)
    Path("t.csv").write_text(table(trip.robot.points(T, of.pose)))
    found = compensate("t.csv", "c.csv", "--frame", "base", "--point", "tip")
    commands = read_commands(trip, Path("c.csv"), headers=False)
    moved = trip.robot.base @ T @ trip.robot.tool
    if of.pose:
        reached(trip, commands, moved, pose=True)
    else:
        far = trip.robot.flange(commands.columns) - T[commands.rows]
        if size(far[:, :3, 3]) > PROMISED * trip.promised:
            raise Silent(f"{1e3 * size(far[:, :3, 3]):.3g} mm off")
    lost(TARGETS, commands, found)


def targets_speed(trip: Trip) -> None:
    """Targets with times that follow from the ways between them."""
    of = asked(trip)
    Path("t.csv").write_text(table(trip.robot.points(of.T, of.pose)))
    found = compensate("t.csv", "c.csv", "--speed", "0.3")
    commands = read_commands(trip, Path("c.csv"), headers=False)
    reached(trip, commands, of.T, of.pose)
    short_ways(trip, commands.columns)
    paced(trip, commands.columns, np.array(commands.time), 0.3)
    lost(TARGETS, commands, found)


def read_trajectory(trip: Trip, file: Path) -> tuple[Positions, Floats]:
    """Columns and times of a message of ROS.

    Raises:
        Silent: If it is not of the joints with a drive.
    """
    robot, message = trip.robot, yaml.safe_load(file.read_text())
    names, drives = message["joint_names"], [j.name for j in robot.nominal.drives]
    if set(names) != set(drives):
        raise Silent(f"a trajectory of {names}, drives are {drives}")
    points = message["points"]
    q = dict(zip(names, np.array([p["positions"] for p in points]).T, strict=True))
    stamps = (point["time_from_start"] for point in points)
    time = np.array([s["sec"] + 1e-9 * s["nanosec"] for s in stamps])
    return robot.columns(q), time


def motion_message(trip: Trip) -> None:
    """A motion as a message: joints go on where columns begin again."""
    robot = trip.robot
    way = robot.motion(STEPS, trip.rng)
    Path("way.csv").write_text(table(robot.cells(way)))
    compensate("way.csv", "c.yaml", "--format", "joint-trajectory", "--speed", "0.3")
    columns, time = read_trajectory(trip, Path("c.yaml"))
    follows(trip, columns, way)
    smooth(trip, columns, way)
    short_steps(trip, columns, way)
    paced(trip, columns, time, 0.3)


def short_steps(trip: Trip, columns: Positions, way: Positions) -> None:
    """No joint moves much more than the motion does.

    Raises:
        Silent: If one does.
    """
    for name, x in columns.items():
        far = np.abs(np.diff(x) - np.diff(way[name])).max()
        if far > JUMP:
            raise Silent(f"column '{name}' moves by {far:.3g} more than the motion")


def targets_message(trip: Trip) -> None:
    """Targets as a message."""
    robot, of = trip.robot, asked(trip)
    cells = robot.cells(of.columns) | robot.points(of.T, of.pose)
    Path("t.csv").write_text(table(cells))
    found = compensate("t.csv", "c.yaml", "--format", "joint-trajectory")
    columns, time = read_trajectory(trip, Path("c.yaml"))
    rows = [*range(TARGETS)]
    if len(time) != TARGETS:
        lost(TARGETS, Commands([*range(len(time))], columns, []), found, 0)
    reached(trip, Commands(rows, columns, []), of.T, of.pose)
    short_ways(trip, columns)
    paced(trip, columns, time, 0.25)


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
    "targets from joints": targets_from,
    "targets, base": targets_base,
    "targets, speed": targets_speed,
    "targets, message": targets_message,
    "motion": motion,
    "motion, speed": motion_speed,
    "motion, message": motion_message,
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


def main() -> None:
    """Print the faults by seed, and a table of outcomes."""
    parser = argparse.ArgumentParser(prog="benchmark round-trips")
    parser.add_argument("name", nargs="*")
    parser.add_argument("--count", type=int, default=200)
    parser.add_argument("--first", type=int, default=0)
    parser.add_argument("--workers", type=int, default=os.cpu_count())
    parser.add_argument("--keep", type=Path)
    parser.add_argument("--show", action="store_true")
    asked = parser.parse_args()
    numbers = range(asked.first, asked.first + asked.count)
    with ProcessPoolExecutor(asked.workers) as pool:
        one = partial(run, keep=asked.keep and asked.keep.resolve())
        found = list(itertools.chain(*pool.map(one, numbers)))
    for line in report(found, show=asked.show):
        print(line)
    if any(one.kind in FAULTS for one in found):
        sys.exit(1)


FAULTS = ("silent", "internal")
KINDS = ("right", "told", "refused", *FAULTS)


def report(found: Sequence[Outcome], *, show: bool) -> Iterator[str]:
    """A line for each fault, and a table of steps and outcomes."""
    for one in found:
        if one.kind in FAULTS or (show and one.kind != "right"):
            special = ", ".join(robot(one.seed).properties)
            yield f"{one.seed:4d} {one.kind:9}{one.step}: {one.line} ({special})"
    yield f"{'':20}" + "".join(f"{kind:>10}" for kind in KINDS)
    count = Counter((one.step, one.kind) for one in found)
    for step in dict.fromkeys(one.step for one in found):
        yield f"{step:20}" + "".join(f"{count[step, kind]:10d}" for kind in KINDS)
    seeds = {one.seed for one in found}
    bad = {one.seed for one in found if one.kind in FAULTS}
    yield f"{len(seeds)} robots, {len(bad)} with faults"


if __name__ == "__main__":
    main()
