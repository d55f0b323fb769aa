"""Exports, read as those read them who load them."""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import yaml
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation

from benchmarks.round_trips.robots import (
    TURN,
    Floats,
    Joint,
    pose,
    rpy_of,
)
from benchmarks.round_trips.trip import (
    BEST,
    COUNT,
    KEYS,
    LEAST,
    PROMISED,
    Said,
    Silent,
    Skipped,
    Told,
    Trip,
    origin_of,
    read_urdf,
    rows_of,
    size,
)


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
    apart = (poses(offsets) - wanted) @ trip.ends[1]
    missing = size(apart[:, :3, 3])
    stated = re.search(r"([\d.e+-]+) of [\d.e+-]+ mm", found.word(" mm "))
    if stated is None and missing > LEAST:
        raise Silent(f"leaves {1e3 * missing:.3g} mm and does not say so")
    if stated is not None:
        said = 1e-3 * float(stated[1])
        if not said / BEST - LEAST < missing < BEST * said + LEAST:
            raise Silent(f"leaves {1e3 * missing:.3g} mm, said {1e3 * said:.3g} mm")


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
    import mujoco

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
    import xacro

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
