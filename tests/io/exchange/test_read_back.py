"""Every format, of robots of every kind, is read by others than those who wrote it.

A file moves the robot as the whole calibration does, or is refused, or says in a line
how far the tool point is from there. The readers know nothing of the package: yourdfpy,
xacro, MuJoCo, and a page of arithmetic for what is typed into controllers.
"""

from __future__ import annotations

import csv
import io
import json
import re
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from functools import partial
from itertools import pairwise
from pathlib import Path
from typing import Any
from xml.etree import ElementTree
from xml.sax.saxutils import quoteattr

import numpy as np
import pinocchio as pin
import pytest
import xacro
import yaml
import yourdfpy

from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.exchange import FORMATS, Encoded, Exported
from calib_pin.io.exchange.joint_frames import UR_LINKS, along, axis_frames
from calib_pin.io.urdf_tree import ORIGIN, origin_of, parse_robot
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import BlockKey
from calib_pin.parameterizations import parameterization
from calib_pin.setup import ChainSetup, FrameSetup, JointMap, Payload, Setup, ToolSetup
from calib_pin.simulation import draw_errors
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import NamedArray, ParameterEstimate
from tests.io.exchange.test_descriptions import of_model, transforms
from tests.shared import joint, urdf_of

COUNT = 40
"""Random configurations."""

SAME = 1e-6
"""Difference that is that of printed digits [m, 1]."""

CONVENTIONS = ("standard", "modified")

At = Mapping[str, np.ndarray]
"""Positions of the joints, each of shape (N,)."""


MASS = '<inertial><mass value="2"/><origin xyz="0.1 0 0.1"/><inertia ixx="0.1" '
MASS += 'ixy="0" ixz="0" iyy="0.1" iyz="0" izz="0.1"/></inertial>'


massive = partial(joint, limits="-1.5 1.4", inside=MASS)


def urdf(*joints: Mapping[str, Any], name: str = "arm") -> bytes:
    """Of a world with a mass, which that of MuJoCo cannot have."""
    return urdf_of(*joints, name=name, inside=MASS).encode()


def follow(leader: str, factor: float, offset: float) -> str:
    return f'<mimic joint="{leader}" multiplier="{factor}" offset="{offset}"/>'


MOUNT = massive("mount", "world base", "0.2 -0.1 0.8;0 0.1 1.5", kind="fixed")


def arm(
    prefix: str = "", base: str = "base", names: str = "J{}", **more: dict[str, str]
) -> list[dict[str, Any]]:
    """Six joints behind a mount, and two fixed ones before the tip."""
    places = [
        ("0 0 1", "0.05 0.02 0.3;0.01 0 0.2"),
        ("0 1 0", "0.1 0.03 0.2"),
        ("0 1 0", "0.02 0.01 0.5;0 0.03 0"),
        ("1 0 0", "0.3 0 0.05;0.1 0 0"),
        ("0 -1 0", "0.25 0.01 0"),
        ("1 0 0", "0.1 0 0.02;0 0 0.1"),
    ]
    links = [base, *(f"{prefix}l{k}" for k in range(1, 7))]
    joints, flange = [], f"{prefix}flange"
    for k, (axis, place) in enumerate(places, start=1):
        name, ends = prefix + names.format(k), f"{links[k - 1]} {links[k]}"
        joints.append(massive(name, ends, place, axis, **more.get(f"j{k}", {})))
    ends = f"{links[6]} {flange}"
    joints.append(massive(f"{prefix}f1", ends, "0.05 0 0;0 1.5 0", kind="fixed"))
    ends = f"{flange} {prefix}tool"
    return [*joints, massive(f"{prefix}f2", ends, "0 0 0.1", kind="fixed")]


PLAIN = urdf(MOUNT, *arm())
INSIDE = {"j3": {"more": follow("J2", -1.5, 0.1)}}
KNOB = massive("knob", "base dial")
SLIDES = {"j1": {"kind": "continuous"}, "j2": {"kind": "prismatic"}}
JOINTS = {
    "A1": JointMap("J1", sign=-1, gear=2.0, offset=0.3),
    "A2": JointMap("J2", gear=0.5),
    "A3": JointMap("J3", coupled={"A2": 0.5, "A1": -0.1}),
    "A5": JointMap("J5", sign=-1, coupled={"ext": 0.3}),
}
FOLLOWED = {name: of for name, of in JOINTS.items() if of.joint != "J3"}
TWO = urdf(
    MOUNT,
    massive("torso", "base chest", "0 0 0.4"),
    *arm("L", "chest"),
    *arm("R", "chest"),
)
SIDES = (BlockKey("pose", chain="left"), BlockKey("pose", chain="right"))
OFFSETS = ("joint-offset",)
KNOWN = {
    "base_frame": FrameSetup((0.0, 0.0, 0.0), (0.0, 0.0, 0.0), estimate=False),
    "tool_frame": FrameSetup((0.0, 0.0, 0.1), (0.0, 0.0, 0.0), estimate=False),
}


@dataclass(frozen=True)
class Case:
    """A robot, how it was measured, and what was calibrated."""

    source: bytes = PLAIN
    parameters: tuple[str, ...] = ("placement",)
    base: str | None = None
    tip: str = "tool"
    setup: Mapping[str, Any] = field(default_factory=dict)
    keys: tuple[BlockKey, ...] = (BlockKey("pose"),)
    learned: bool = False


GAINS = ("joint-offset", "transmission")
CASES = {
    "plain": Case(),
    "offsets": Case(parameters=OFFSETS, setup=KNOWN),
    "brackets": Case(urdf(MOUNT, *arm(names="joint [{}] a b"), name="a--b"), OFFSETS),
    "alike": Case(urdf(MOUNT, *arm(names="J {}")).replace(b"J 4", b"J_3")),
    "inside": Case(urdf(MOUNT, *arm(**INSIDE)), (*OFFSETS, "placement")),
    "outside": Case(
        urdf(MOUNT, KNOB, *arm(j3={"more": follow("knob", 2.0, -0.2)})), OFFSETS
    ),
    "slides": Case(urdf(MOUNT, *arm(**SLIDES)), OFFSETS),
    "reversed": Case(base="tool", tip="world"),
    "hands": Case(TWO, base="Ltool", tip="Rtool"),
    "columns": Case(parameters=OFFSETS, setup={"joints": JOINTS}),
    "columns-inside": Case(
        urdf(MOUNT, *arm(**INSIDE)), OFFSETS, setup={"joints": FOLLOWED}
    ),
    "gains": Case(parameters=GAINS, setup={"fixed": ("*.sin*", "*.cos*")}),
    "sags": Case(
        parameters=("placement", "compliance"),
        setup={
            "payloads": {"a": Payload(1.0, (0, 0, 0)), "b": Payload(9.0, (0, 0, 0))}
        },
    ),
    "backlash": Case(parameters=("placement", "hysteresis")),
    "learned": Case(learned=True),
    "bare": Case(parameters=("dh",), tip="l6"),
    "two": Case(
        TWO,
        OFFSETS,
        setup={"chains": {"left": ChainSetup("Ltool"), "right": ChainSetup("Rtool")}},
        keys=SIDES,
    ),
    "stations": Case(
        setup={
            "stations": {
                "day1": FrameSetup((1.0, 0, 0)),
                "day2": FrameSetup((0, 2, 0)),
            },
            "tools": {"probe": ToolSetup((0, 0, 0.1)), "ball": ToolSetup((0.1, 0, 0))},
        },
        keys=(
            BlockKey("pose", "", "day1", "probe"),
            BlockKey("pose", "", "day2", "ball"),
        ),
    ),
}


@dataclass(frozen=True)
class Learned:
    """A correction of joints that a URDF cannot hold."""

    shift: np.ndarray
    space = "joint"

    def __call__(self, q: np.ndarray) -> np.ndarray:
        return np.pad(1e-3 * np.sin(2.0 * q[:, :6]), ((0, 0), (0, q.shape[1] - 6)))

    def weight(self, q: np.ndarray) -> np.ndarray:
        return np.ones(len(q))


def calibrated(case: Case) -> Exported:
    """A calibration that found errors of a few mm."""
    frames = {
        "base_frame": FrameSetup((0.5, 0.2, 0.1), (0.1, 0.2, 0.3)),
        "tool_frame": FrameSetup((0.02, 0.01, 0.1), (0.1, 0.0, 0.2)),
    }
    setup = replace(Setup(**frames | case.setup), parameters=case.parameters)
    robot = parse_robot(case.source, "robot.urdf")
    names = tuple(key.chain for key in case.keys)
    chains = Chains(robot, case.base, case.tip, setup.chains, names)
    problem = nominal_problem(chains, case.keys, setup)
    theta = draw_errors(problem.parameters, np.random.default_rng(1))
    model = CalibratedModel.create(problem, theta)
    # A URDF gets the geometry that was fitted alone.
    alone = [p for p in case.parameters if parameterization(p, setup).geometric]
    geometric = nominal_problem(
        chains, case.keys, replace(setup, parameters=(*alone,), fixed=())
    )
    values = dict(zip(problem.parameters.names, theta, strict=True))
    geometry = CalibratedModel.create(
        geometric, np.array([values[name] for name in geometric.parameters.names])
    )
    if case.learned:
        ((key, term),) = model.terms.items()
        learned = Learned(np.zeros(len(term.error.screws)))
        term = replace(term, error=replace(term.error, learned=learned))
        model = replace(model, terms={key: term})
    names = model.given.names
    covariance = NamedArray.of(1e-8 * np.eye(len(theta)), names, names)
    about = {"parameters": (), "robot_errors": (), "covariance": covariance}
    return of_model(model, urdf=None, geometry=geometry, **about)


def chain_poses(source: bytes, base: str, tip: str, at: At) -> np.ndarray:
    """Poses of the tip in the base of a URDF, as yourdfpy reads it, (N, 4, 4)."""
    robot = yourdfpy.URDF.load(
        io.BytesIO(source), build_scene_graph=True, load_meshes=False
    )
    poses = []
    for k in range(COUNT):
        robot.update_cfg({n: at[n][k] for n in robot.actuated_joint_names if n in at})
        poses.append(robot.get_transform(tip, base))
    return np.array(poses)


def mimics(of: Exported) -> dict[str, tuple[str, float, float]]:
    """Leader, factor and offset of the mimic joints that the URDF states."""
    root = ElementTree.fromstring(of.nominal.robot.source)
    found = {}
    for element in root.iter("joint"):
        for m in element.iter("mimic"):
            numbers = float(m.get("multiplier", "1")), float(m.get("offset", "0"))
            found[element.get("name", "")] = (m.get("joint", ""), *numbers)
    return found


class Reader:
    """Reads a format, here a URDF: the poses of a chain's tip in its base."""

    def __init__(self, of: Exported, folder: Path) -> None:
        self.of, self.folder = of, folder

    def own(self) -> Path | None:
        """The user's own file, where the format corrects one."""
        return None

    def poses(self, encoded: Encoded, base: str, tip: str, at: At) -> np.ndarray:
        return chain_poses(encoded.data, base, tip, at)

    def moved(self, base: str, tip: str, at: At) -> np.ndarray:
        """Poses of the nominal robot."""
        return chain_poses(self.of.nominal.robot.source, base, tip, at)


class Xacro(Reader):
    """The description takes all origins by property, under the names that are told."""

    def poses(self, encoded: Encoded, base: str, tip: str, at: At) -> np.ndarray:
        told = [
            re.match(r"(\S+)_xyz, .* '(.*)'$", remark) for remark in encoded.remarks
        ]
        names = {match[2]: match[1] for match in told if match}
        overlay = self.folder / "origins.xacro"
        overlay.write_bytes(encoded.data)
        held = {e.get("name") for e in ElementTree.fromstring(encoded.data)}
        root = ElementTree.fromstring(self.of.nominal.robot.source)
        for element in root.findall("joint"):
            name = names.get(element.get("name", ""), element.get("name"))
            origin = element.find("origin")
            if f"{name}_xyz" in held and origin is not None:
                for key in ("xyz", "rpy"):
                    origin.set(key, f"${{{name}_{key}}}")
        prefix = "http://www.ros.org/wiki/xacro"
        ElementTree.register_namespace("xacro", prefix)
        root.insert(
            0, ElementTree.Element(f"{{{prefix}}}include", filename=str(overlay))
        )
        source = self.folder / "robot.xacro"
        source.write_bytes(ElementTree.tostring(root))
        return chain_poses(
            xacro.process_file(str(source)).toxml().encode(), base, tip, at
        )


class Mjcf(Reader):
    """MuJoCo, with joints that are coupled where their equality puts them."""

    def poses(self, encoded: Encoded, base: str, tip: str, at: At) -> np.ndarray:
        import mujoco

        model = mujoco.MjModel.from_xml_string(encoded.data.decode())
        state, poses = mujoco.MjData(model), []
        coupled = {
            int(model.eq_obj1id[k]): (int(model.eq_obj2id[k]), *model.eq_data[k, :2])
            for k in range(model.neq)
        }
        names = [model.joint(j).name for j in range(model.njnt)]
        for k in range(COUNT):
            for j, name in enumerate(names):
                if j not in coupled and name in at:
                    state.qpos[j] = at[name][k]
            for j, (leader, offset, factor) in coupled.items():
                state.qpos[j] = offset + factor * state.qpos[leader]
            mujoco.mj_kinematics(model, state)
            ends = []
            for link in (base, tip):
                T = np.eye(4)
                T[:3, :3] = state.body(link).xmat.reshape(3, 3)
                T[:3, 3] = state.body(link).xpos
                ends.append(T)
            poses.append(np.linalg.inv(ends[0]) @ ends[1])
        return np.array(poses)


def about(axis: int, angle: Any, *xyz: Any) -> np.ndarray:
    """A translation, then a turn about an axis, (N, 4, 4)."""
    count = max(np.size(angle), *(np.size(x) for x in xyz), 1)
    T = np.tile(np.eye(4), (count, 1, 1))
    i, j = (axis + 1) % 3, (axis + 2) % 3
    T[:, i, i] = T[:, j, j] = np.cos(angle)
    T[:, j, i] = np.sin(angle)
    T[:, i, j] = -np.sin(angle)
    for k, x in enumerate(xyz):
        T[:, k, 3] = x
    return T


def placed(row: Any) -> np.ndarray:
    """x y z roll pitch yaw of fixed axes."""
    x, y, z, roll, pitch, yaw = map(float, row)
    return about(2, yaw, x, y, z) @ about(1, pitch, 0, 0, 0) @ about(0, roll, 0, 0, 0)


class Dh(Reader):
    """The matrices of Denavit and Hartenberg, and those of Craig."""

    def poses(self, encoded: Encoded, base: str, tip: str, at: At) -> np.ndarray:
        standard, modified = (self.table(encoded, kind, at) for kind in CONVENTIONS)
        assert np.abs(standard - modified).max() < 1e-9
        return standard

    def table(self, encoded: Encoded, convention: str, at: At) -> np.ndarray:
        lines = encoded.data.decode().splitlines()
        rows = [row for row in csv.reader(lines) if row[0] == convention]
        T = placed(rows[0][8:])
        for _, name, kind, *numbers in rows[1:-1]:
            theta, d, a, alpha, beta = map(float, numbers[:5])
            assert abs(d) < 2.0  # Nearly parallel axes meet nowhere near.
            slides = kind == "prismatic"
            turn, slide = (0.0, at[name]) if slides else (at[name], 0.0)
            along = about(2, theta + turn, 0, 0, d + slide)
            across = about(0, alpha, a, 0, 0) @ about(1, beta, 0, 0, 0)
            T = T @ (along @ across if convention == "standard" else across @ along)
        return np.asarray(T @ placed(rows[-1][8:]))


class Vendor(Reader):
    """All joints turn about z; what is behind the flange goes into the controller."""

    names: tuple[str, ...] = UR_LINKS

    def own(self) -> Path:
        nominal, file = self.of.nominal, self.folder / "own.yaml"
        tip = pin.SE3(nominal.poses(np.zeros((1, len(nominal.joints))))[0])
        frames = [pin.SE3.Identity()]
        for point, axis in axis_frames(nominal):
            frames.append(along(point, axis, frames[-1]))
        frames[-1] = along(*axis_frames(nominal)[-1], tip)
        origins = [origin_of(a.actInv(b)) for a, b in pairwise(frames)]
        entries = {
            name: dict(zip(ORIGIN, origin, strict=True))
            for name, origin in zip(self.names, origins, strict=False)
        }
        file.write_text(yaml.safe_dump({"kinematics": entries}, sort_keys=False))
        return file

    def poses(self, encoded: Encoded, base: str, tip: str, at: At) -> np.ndarray:
        entries = yaml.safe_load(encoded.data)["kinematics"]
        T = about(2, 0.0, 0, 0, 0)
        for name, driven in zip(self.names, self.of.nominal.joints, strict=True):
            T = T @ placed([entries[name][key] for key in ORIGIN])
            T = T @ about(2, at[driven], 0, 0, 0)
        told = [r for r in encoded.remarks if "tool of the controller: " in r]
        words = told[0].partition("controller: ")[2].split(", ") if told else []
        flange = [word.split()[1] for word in words] or [0.0] * 6
        return np.asarray(T @ placed(flange))


class XArm(Vendor):
    names = tuple(f"joint{k}" for k in range(1, 7))


class Transmissions(Reader):
    """`joint = actuator / reduction + offset`, about those of the user's own file."""

    def drives(self) -> list[str]:
        follows = mimics(self.of)
        joints = ElementTree.fromstring(self.of.nominal.robot.source).iter("joint")
        return [j.get("name", "") for j in joints if j.get("name") not in follows]

    def own(self) -> Path:
        file, text = (
            self.folder / "own.xml",
            "".join(
                f'<transmission name="t{k}"><type>X/SimpleTransmission</type>'
                f'<joint name={quoteattr(name)}/><actuator name="m{k}">'
                f"<mechanicalReduction>{50 - k}</mechanicalReduction>"
                "</actuator></transmission>"
                for k, name in enumerate(self.drives())
            ),
        )
        file.write_text(f"<robot>{text}</robot>")
        return file

    def poses(self, encoded: Encoded, base: str, tip: str, at: At) -> np.ndarray:
        moved = dict(at)
        own = {name: 50.0 - k for k, name in enumerate(self.drives())}
        for one in ElementTree.fromstring(encoded.data):
            joint = one.find("joint")
            assert joint is not None
            name = joint.get("name", "")
            if name in at:
                new = [
                    float(joint.findtext(tag, ""))
                    for tag in ("mechanical_reduction", "offset")
                ]
                moved[name] = at[name] * own[name] / new[0] + new[1]
        return self.moved(base, tip, moved)


class Columns(Reader):
    """What a controller shows plus the offset; joints are where the setup says."""

    def offsets(self, encoded: Encoded) -> dict[str, float]:
        lines = encoded.data.decode().splitlines()
        (header, *rows) = [r for r in csv.reader(lines) if r[0][:1] != "#"]
        table = [dict(zip(header, row, strict=True)) for row in rows]
        units = {"deg": np.pi / 180.0, "mm": 1e-3}
        return {
            row["column"]: float(row["offset"] or 0.0) * units[row["unit"]]
            for row in table
        }

    def poses(self, encoded: Encoded, base: str, tip: str, at: At) -> np.ndarray:
        maps = {
            of.joint: (c, of) for c, of in self.of.result.model.setup.joints.items()
        }
        follows, shown = mimics(self.of), dict[str, Any]()
        drives = [name for name in at if name not in follows]
        maps = {n: maps.get(n, (n, JointMap(n))) for n in drives}
        # No coupling here leads on to one that is coupled itself.
        for name in sorted(drives, key=lambda n: len(maps[n][1].coupled)):
            column, of = maps[name]
            others = sum(f * shown.get(c, 0.0) for c, f in of.coupled.items())
            shown[column] = (at[name] - of.offset) / (of.sign * of.gear) - others
        offsets = self.offsets(encoded)
        assert {*offsets} == {*shown}
        shown = {column: x + offsets[column] for column, x in shown.items()}
        moved = {}
        for name, (column, of) in maps.items():
            others = sum(f * shown.get(c, 0.0) for c, f in of.coupled.items())
            moved[name] = of.sign * of.gear * (shown[column] + others) + of.offset
        return self.moved(base, tip, moved)


class Motors(Columns):
    """`position = encoder - homing_offset`, in degrees from the middle of the range."""

    def own(self) -> Path:
        of = self.of.result.model
        mapped = {given.joint: column for column, given in of.setup.joints.items()}
        names = [mapped.get(name, name) for name in Transmissions.drives(self)]  # type: ignore[arg-type]
        self.before = {
            name: {"id": k, "homing_offset": 7 * k, "range_min": 500, "range_max": 3500}
            for k, name in enumerate(names)
        }
        file = self.folder / "own.json"
        file.write_text(json.dumps(self.before))
        return file

    def offsets(self, encoded: Encoded) -> dict[str, float]:
        def zero(motor: Mapping[str, int]) -> float:
            middle = (motor["range_min"] + motor["range_max"]) / 2
            return middle + motor["homing_offset"]

        after, model = json.loads(encoded.data), self.of.result.model
        for name, new in after.items():
            # Nothing that was out of reach is in reach.
            moved = new["homing_offset"] - self.before[name]["homing_offset"]
            assert new["range_min"] + moved >= self.before[name]["range_min"]
            assert new["range_max"] + moved <= self.before[name]["range_max"]
        mapped = {given.joint: column for column, given in model.setup.joints.items()}
        follows = mimics(self.of)
        drives = {follows.get(n, (n,))[0] for n in self.of.chains.joints}
        return {
            name: (zero(self.before[name]) - zero(after[name])) * 2 * np.pi / 4095
            for name in (mapped.get(joint, joint) for joint in drives)
        }


class Frames(Reader):
    """Measured poses go into the base link, and from the tool to the tip."""

    def poses(self, encoded: Encoded, base: str, tip: str, at: At) -> np.ndarray:
        # Of several stations and tools the first.
        found = dict(reversed(transforms(encoded).values()))
        model = self.of.result.model
        name = next(n for n in model.measured_chains if model.of(n).chain.tip == tip)
        fitted = model.of(name)
        error = fitted.error.carrying(model.setup.heaviest)
        q = np.column_stack([at[j] for j in fitted.chain.joints])
        measured = error.poses(q, fitted.theta)
        return np.asarray(found[base] @ measured @ np.linalg.inv(found[tip]))


READERS: Mapping[str, type[Reader]] = {
    "xacro": Xacro,
    "mjcf": Mjcf,
    "dh": Dh,
    "ur-kinematics": Vendor,
    "xarm-kinematics": XArm,
    "ros2-control": Transmissions,
    "joint-offsets": Columns,
    "lerobot": Motors,
    "tf": Frames,
    "camera-info": Reader,
}


def outcome(form: str, of: Exported, folder: Path) -> str:
    """`same`, `refused`, or `told`; else what differs, silently."""
    reader = READERS[form](of, folder)
    model = of.result.model
    try:
        encoded = FORMATS[form].encode(of, reader.own())
    except (InputError, OptionError):
        return "refused"
    rng = np.random.default_rng(7)
    q = model.chains.random_configurations(COUNT, rng)
    at = dict(zip(model.chains.joints, q.T, strict=True))
    one_chain = any("holds one chain" in remark for remark in encoded.remarks)
    far, largest = [], 0.0
    for name in model.measured_chains[: 1 if one_chain else None]:
        fitted = model.of(name)
        chain, tool = fitted.chain, fitted.tool.homogeneous
        carried = replace(fitted.error, payload=model.setup.heaviest)
        own = q[:, model.chains.columns(name)]
        base = fitted.error.base.inverse().homogeneous
        truth = base @ carried.poses(own, fitted.theta)
        found = reader.poses(encoded, chain.base, chain.tip, at) @ tool
        far.append(np.linalg.norm((found - truth)[:, :3, 3], axis=1))
        largest = max(largest, float(np.abs(found - truth).max()))
    if largest < SAME:
        return "same"
    distance = 1e3 * float(np.sqrt(np.mean(np.concatenate(far) ** 2)))
    told = [re.search(r"([\d.e-]+) of [\d.e-]+ mm", r) for r in encoded.remarks]
    # It is that of as many other configurations.
    squares = np.concatenate(far) ** 2
    scatter = float(squares.std() / squares.mean()) / 2 * np.sqrt(2 / COUNT)
    if any(m and abs(float(m[1]) / distance - 1) < 4 * scatter for m in told):
        return "told"
    return f"{distance:.3g} mm ({'; '.join(encoded.remarks)})"


UNHELD = {
    "backlash": "hysteresis",
    "gains": "gains",
    "learned": "learned correction",
    "sags": "compliance",
}
"""Parts of a calibration that no description holds."""

NO_VENDORS = ("hands", "slides", "two")
"""Robots that have other joints than those of vendors."""


def expected(form: str, name: str) -> str:
    """The outcome of a format and a robot."""
    case = CASES[name]
    joints_alone = case.parameters == OFFSETS
    if form == "camera-info" or (form, name) == ("lerobot", "slides"):
        return "refused"
    if form in ("ur-kinematics", "xarm-kinematics") and name in NO_VENDORS:
        return "refused"
    if form in ("joint-offsets", "ros2-control"):
        gains = form == "ros2-control" and name == "gains"
        return "same" if joints_alone or gains else "told"
    if form == "lerobot":
        return "told"  # Motors have whole steps.
    # A backlash moves nothing while no measurement states the sides.
    told = form != "tf" and name in UNHELD and name != "backlash"
    return "told" if told else "same"


@pytest.mark.parametrize("name", CASES)
def test_it_moves_as_the_calibration_or_says_how_far_it_is(name: str, tmp_path: Path):
    of, forms = calibrated(CASES[name]), READERS.keys() - {"mjcf"}
    found = {form: outcome(form, of, tmp_path) for form in forms}
    assert found == {form: expected(form, name) for form in forms}
    remarks = " ".join(FORMATS["dh"].encode(of, None).remarks)
    assert f"dh holds no {UNHELD.get(name, 'base and tool frames')}" in remarks or (
        name == "offsets"  # Where all frames are known.
    )
    assert ("one chain: 'left', not right" in remarks) == (name == "two")
    assert ("J3 is " in remarks) == bool(mimics(of))


@pytest.mark.needs("mujoco")
@pytest.mark.parametrize("name", CASES)
def test_so_does_mujoco(name: str, tmp_path: Path):
    found = outcome("mjcf", calibrated(CASES[name]), tmp_path)
    assert found == expected("mjcf", name)


def test_the_formats_are_all_read():
    assert {*READERS} == {*FORMATS}


def test_an_offset_is_as_well_known_as_those_that_it_is_made_of(tmp_path: Path):
    of = calibrated(CASES["columns"])
    statuses = {f"J{k}": "identifiable" for k in range(1, 7)} | {"J2": "weak"}
    model, end = of.result.model, ".joint-offset.q"
    values = dict(zip(model.given.names, model.theta.tolist(), strict=True))
    of.result.parameters = tuple(
        ParameterEstimate(name + end, "rad", values[name + end], 1e-4, status, ())
        for name, status in statuses.items()
    )
    encoded = FORMATS["joint-offsets"].encode(of, None)
    assert "A2 (weak), A3 (weak)" in encoded.remarks[0]
    lines = encoded.data.decode().splitlines()
    header, *rows = [row for row in csv.reader(lines) if row[0][0] != "#"]
    table = {row[1]: dict(zip(header, row, strict=True)) for row in rows}
    # A3 is coupled to A2: what one does not know, the other does not.
    blank = {column for column, row in table.items() if not row["offset"]}
    assert (
        blank == {"A2", "A3"} == {c for c, r in table.items() if r["status"] == "weak"}
    )
    assert float(table["A1"]["sigma"]) == pytest.approx(np.rad2deg(1e-4) / 2, abs=1e-6)
    assert table["A3"]["sigma"] == "" and table["J4"]["sigma"] != ""
    assert outcome("joint-offsets", of, tmp_path) == "told"
