"""A simulated job of calibration, written in the layouts of other software.

The layouts are those of the modules in `calib_pin/io/dialects`, which name their
sources; the writers here share no code with them.
"""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import chain

import numpy as np
from numpy.typing import NDArray

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.spatial import Floats, from_quaternion, to_quaternion
from calib_pin.setup import FrameSetup, Setup
from calib_pin.simulation import draw_errors, simulate

Files = dict[str, str]

STATION = FrameSetup((1.8, 0.3, 0.2), (0.1, -0.2, 2.0), estimate=True)
TOOL = FrameSetup((0.05, 0.02, 0.1), (0.1, 0.2, 0.3), estimate=True)
RATE = 10.0
"""Samples of both logs in a second."""

STILL, MOVING = 16, (12, 24)
"""Samples of a standstill, and of the motions between, at least and at most."""

POINTS = {"Ball": (0.0, 0.0, 0.0), "Nest": (0.07, -0.04, 0.03)}
"""Points on the tool frame [m]."""


@dataclass(frozen=True)
class Job:
    """Logs of a robot and of an instrument that sees its tool, sample by sample.

    Attributes:
        robot: Name of the robot.
        tip: Link that carries the tool.
        joints: Names of its joints.
        time: Times, shape (N,) [s].
        q: Joint positions, shape (N, n) [rad].
        commanded: Those that were commanded, shape (N, n) [rad].
        poses: The tool frame in that of the instrument, with noise, shape (N, 4, 4).
        computed: The tip as the controller has it, shape (N, 4, 4).
        measured: A sample of each standstill.
        truth: Joint positions and poses without noise, to judge a calibration by.
    """

    robot: str
    tip: str
    joints: tuple[str, ...]
    time: Floats
    q: Floats
    commanded: Floats
    poses: Floats
    computed: Floats
    measured: NDArray[np.int64]
    truth: tuple[Floats, Floats]

    def point(self, name: str) -> Floats:
        """Positions of a point on the tool, shape (N, 3) [m]."""
        return self.poses[:, :3, :3] @ POINTS[name] + self.poses[:, :3, 3]

    @property
    def quaternions(self) -> Floats:
        """Orientations of the tool, qx qy qz qw, shape (N, 4)."""
        return to_quaternion(self.poses[:, :3, :3])


def job(
    robot: str = "example:ur5_robot",
    tip: str = "tool0",
    *,
    seed: int = 0,
    count: int = 60,
    noise: float = 3e-5,
) -> Job:
    """A robot with errors of its geometry, measured at random configurations."""
    rng = np.random.default_rng(seed)
    arm = calib_pin.load_chain(robot, tip=tip)
    setup = Setup(base_frame=STATION, tool_frame=TOOL)
    problem = nominal_problem(arm, "pose", setup)
    theta = draw_errors(problem.parameters, rng)

    def seen(q: Floats) -> Floats:
        found = simulate(problem, theta, rng, q=q, noise=0.0).only.values
        poses = np.tile(np.eye(4), (len(q), 1, 1))
        poses[:, :3, :3], poses[:, :3, 3] = from_quaternion(found[:, 3:]), found[:, :3]
        return poses

    at = problem.chains.random_configurations(count, rng)
    steps = rng.integers(*MOVING, count)
    q = np.concatenate(
        [
            here + part[:, None] * (there - here)
            for here, there, count in zip(
                at, np.roll(at, -1, axis=0), steps, strict=True
            )
            for part in [np.append(np.zeros(STILL), _motion(count))]
        ]
    )
    starts = np.append(0, np.cumsum(STILL + steps)[:-1])
    poses = seen(q)
    poses[:, :3, 3] += rng.normal(scale=noise, size=(len(q), 3))
    other = problem.chains.random_configurations(200, rng)
    return Job(
        robot,
        tip,
        tuple(arm.joints),
        1700.0 + np.arange(len(q)) / RATE,
        q,
        q + rng.normal(scale=1e-3, size=q.shape),
        poses,
        arm.poses(q),
        starts + STILL // 2,
        (other, seen(other)),
    )


def _motion(count: int) -> Floats:
    """Parts of a way at the samples of a motion that begins and ends smoothly."""
    return 0.5 - 0.5 * np.cos(np.pi * np.arange(1, count + 1) / (count + 1))


def lines(rows: Iterable[Sequence[object]], separator: str = ",") -> str:
    """Text of cells; numbers with six decimals."""
    return "".join(
        separator.join(f"{x:.6f}" if isinstance(x, float) else str(x) for x in row)
        + "\n"
        for row in rows
    )


def table(names: Sequence[str], columns: Sequence[Floats], separator: str = ",") -> str:
    """Text of columns of numbers below their names."""
    rows = np.column_stack(columns).tolist()
    return lines([names, *rows], separator)


def joint_log(job: Job) -> str:
    """The joints by time, as we have them."""
    return table(["time", *job.joints], [job.time, job.q])


def reading_log(job: Job) -> str:
    """Positions by time, as we have them."""
    return table(["time", "x", "y", "z"], [job.time, job.point("Ball")])


def write_points(job: Job, rng: np.random.Generator) -> Files:
    """SpatialAnalyzer: points with their names, and the joints at each."""
    names = [f"p{k + 1}" for k in range(len(job.q[job.measured]))]
    separator = str(rng.choice([" ", ", ", "\t"]))
    points = 1e3 * job.point("Ball")[job.measured]
    found = lines(
        (
            ["A", "Measured", name, *row]
            for name, row in zip(names, points, strict=True)
        ),
        separator,
    )
    comments = "// SA 2023.2\n// Working frame: A::WORLD\n// Units: Millimeters\n"
    q = lines(
        [["point", *job.joints]]
        + [[name, *row] for name, row in zip(names, job.q[job.measured], strict=True)]
    )
    return {"points.txt": comments + found, "joints.csv": q}


def _gaps(count: int, rng: np.random.Generator) -> Floats:
    """Rows in which an object is out of sight."""
    return rng.random(count) < 0.02


def _with_gaps(columns: Floats, rng: np.random.Generator) -> list[list[object]]:
    rows: list[list[object]] = columns.tolist()
    for row in np.flatnonzero(_gaps(len(rows), rng)):
        rows[row] = [""] * columns.shape[1]
    return rows


def write_motive(
    job: Job,
    rng: np.random.Generator,
    *,
    rotation: str = "Quaternion",
    unit: str = "Millimeters",
    bodies: Sequence[str] = ("Gripper",),
) -> Files:
    """OptiTrack Motive: bodies, their markers as solved and as seen, or markers."""
    from scipy.spatial.transform import Rotation

    size = {"Meters": 1.0, "Centimeters": 1e2, "Millimeters": 1e3}[unit]
    R = Rotation.from_quat(job.quaternions)
    turned = job.quaternions if rotation == "Quaternion" else np.zeros((len(job.q), 3))
    if rotation != "Quaternion":
        # The columns are those of the axes, whatever the order.
        found = R.as_euler(rotation.upper(), degrees=True)
        for k, axis in enumerate(rotation):
            turned[:, "XYZ".index(axis)] = found[:, k]
    axes = "XYZW"[: turned.shape[1]]
    head: list[tuple[str, str, str, str]] = []
    rows = [[k, t] for k, t in enumerate(job.time - job.time[0])]
    cells: list[list[list[object]]] = []
    for k, body in enumerate(bodies):
        kind = ("Rigid Body", body)
        head += [(*kind, "Rotation", axis) for axis in axes]
        head += [(*kind, "Position", axis) for axis in "XYZ"]
        head += [(*kind, "Mean Marker Error", "")]
        place = job.point([*POINTS][k])
        error = np.full((len(job.q), 1), 0.0002)
        cells.append(_with_gaps(np.hstack([turned, size * place, error]), rng))
    for kind in ("Rigid Body Marker", "Marker"):
        for name in POINTS:
            head += [(kind, f"Gripper:{name}", "Position", axis) for axis in "XYZ"]
            cells.append(_with_gaps(size * job.point(name), rng))
    head += [("Marker", "Unlabeled 1042", "Position", axis) for axis in "XYZ"]
    cells.append([[""] * 3] * (len(job.q) - 1) + [[1.0, 2.0, 3.0]])
    settings = ["Format Version", "1.25", "Take Name", "Take 1", "Export Frame Rate"]
    settings += [f"{RATE:.6f}", "Rotation Type", rotation, "Length Units", unit]
    upper = [
        settings,
        [],
        ["", "Type", *(kind for kind, *_ in head)],
        ["", "Name", *(f'"{name}"' for _, name, *_ in head)],
        ["", "ID", *('"4CF0B31A"' for _ in head)],
        ["", "Parent", *("" for _ in head)],
        ["", "", *(part for _, _, part, _ in head)],
        ["Frame", "Time (Seconds)", *(axis for *_, axis in head)],
    ]
    whole = [
        row + [cell for part in parts for cell in part]
        for row, *parts in zip(rows, *cells, strict=True)
    ]
    return {"motive.csv": lines([*upper, *whole]), "joints.csv": joint_log(job)}


def write_motive_euler(job: Job, rng: np.random.Generator) -> Files:
    """The same with Euler angles in another order, in centimeters."""
    return write_motive(job, rng, rotation="ZYX", unit="Centimeters")


def write_motive_bodies(job: Job, rng: np.random.Generator) -> Files:
    """The same with two bodies, in meters."""
    return write_motive(job, rng, unit="Meters", bodies=("Gripper", "Wrist"))


def write_motive_markers(job: Job, rng: np.random.Generator) -> Files:
    """The same without bodies."""
    return write_motive(job, rng, bodies=())


def write_vicon(job: Job, rng: np.random.Generator) -> Files:
    """Vicon Nexus: trajectories of markers."""
    names = ["", "", *(cell for name in POINTS for cell in (f"Arm:{name}", "", ""))]
    head = [["Trajectories"], [f"{RATE:.0f}"], names]
    head += [["Frame", "Sub Frame", *"XYZ" * 2], ["", "", *["mm"] * 6]]
    frames = [[1 + k, 0] for k in range(len(job.q))]
    cells = [_with_gaps(1e3 * job.point(name), rng) for name in POINTS]
    rows = [f + a + b for f, a, b in zip(frames, *cells, strict=True)]
    return {"vicon.csv": lines([*head, *rows]), "joints.csv": joint_log(job)}


def write_vicon_objects(job: Job, rng: np.random.Generator) -> Files:
    """Vicon Tracker: an object with a quaternion."""
    axes = ["RX", "RY", "RZ", "RW", "TX", "TY", "TZ"]
    head = [["Objects"], [f"{RATE:.0f}"], ["", "", "Gripper", *[""] * 6]]
    head += [["Frame", "Sub Frame", *axes], ["", "", *[""] * 4, *["mm"] * 3]]
    frames = [[1 + k, 0] for k in range(len(job.q))]
    pose = np.hstack([job.quaternions, 1e3 * job.point("Ball")])
    rows = [f + row for f, row in zip(frames, _with_gaps(pose, rng), strict=True)]
    return {"vicon.csv": lines([*head, *rows]), "joints.csv": joint_log(job)}


def write_ndi(job: Job, rng: np.random.Generator) -> Files:
    """NDI Polaris: a row for each of two tools, rotations as matrices."""
    names = ["Tool ID", "Timestamp", "Frame #", "Tx", "Ty", "Tz"]
    names += [f"R{i}{j}" for i in range(3) for j in range(3)] + ["Tracking Quality"]
    rows: list[list[object]] = [[*names]]
    R = job.poses[:, :3, :3].reshape(-1, 9)
    for k, time in enumerate(job.time.tolist()):
        for tool, name in enumerate(POINTS, 1):
            cells = np.hstack([1e3 * job.point(name)[k], R[k]]).tolist()
            lost = rng.random() < 0.02
            seen = ["MISSING"] * 12 if lost else cells
            rows.append([tool, time, 3 * k, *seen, 0.3])
    return {"ndi.csv": lines(rows), "joints.csv": joint_log(job)}


def write_ndi_tools(job: Job, rng: np.random.Generator) -> Files:
    """NDI's tool tracker: two tools side by side, with their markers."""
    head, cells = ["Tools"], [[["2"]] * len(job.q)]
    columns = ["Frame", "Time [sec]", "Face", "State", "Q0", "Qx", "Qy", "Qz"]
    columns += ["Tx", "Ty", "Tz", "Error", "Markers", "State", "Tx", "Ty", "Tz"]
    for k, name in enumerate(POINTS, 1):
        port = f"Port 0x0{k}: {name}  s/n:3E4C880{k}"
        head += [port, *columns]
        lost = _gaps(len(job.q), rng)
        place = 1e3 * job.point(name)
        pose = np.hstack([job.quaternions[:, [3, 0, 1, 2]], place])
        cells.append(
            [
                [port, 650512279 + row, f"{job.time[row]:.6f}", 1]
                + (
                    ["Too Few Markers", *["-3.697314E28"] * 7]
                    if lost[row]
                    else ["OK", *pose[row].tolist()]
                )
                + [0.2, 1, "OK", *place[row].tolist()]
                for row in range(len(job.q))
            ]
        )
    rows = [[*chain.from_iterable(parts)] for parts in zip(*cells, strict=True)]
    return {"ndi.csv": lines([head, *rows]), "joints.csv": joint_log(job)}


def write_rostopic(job: Job, rng: np.random.Generator) -> Files:
    """`rostopic echo -p /joint_states`."""
    order = rng.permutation(len(job.joints))
    n = len(order)
    head = ["%time", "field.header.seq", "field.header.stamp", "field.header.frame_id"]
    for field in ("name", "position", "velocity"):
        head += [f"field.{field}{k}" for k in range(n)]
    rows: list[Sequence[object]] = [head]
    for k, time in enumerate(job.time):
        stamp = round(1e9 * time)
        names = [job.joints[j] for j in order]
        q = job.q[k, order].tolist()
        rows.append([stamp + 2_000_000, k, stamp, "base", *names, *q, *[0.0] * n])
    return {"joints.csv": lines(rows), "readings.csv": reading_log(job)}


def _pose_vector(poses: Floats) -> Floats:
    from scipy.spatial.transform import Rotation

    turned = Rotation.from_matrix(poses[:, :3, :3]).as_rotvec()
    return np.hstack([poses[:, :3, 3], turned])


def write_rtde(job: Job, rng: np.random.Generator) -> Files:
    """A recording of RTDE, separated by spaces or commas."""
    current = rng.normal(size=job.q.shape)
    outputs = {
        "timestamp": job.time,
        "target_q": job.commanded,
        "target_qd": 0.0 * job.q,
        "actual_q": job.q,
        "actual_qd": rng.normal(scale=1e-3, size=job.q.shape),
        "actual_current": current,
        "joint_temperatures": 30.0 + 0.0 * current,
        "actual_TCP_pose": _pose_vector(job.computed),
        "robot_mode": 7.0 + 0.0 * job.time,
        "speed_scaling": 1.0 + 0.0 * job.time,
    }
    names: list[str] = []
    for name, values in outputs.items():
        wide = values.ndim > 1
        names += [f"{name}_{k}" for k in range(6)] if wide else [name]
    text = table(names, [*outputs.values()], str(rng.choice([" ", ","])))
    return {"joints.csv": text, "readings.csv": reading_log(job)}


def write_franka(job: Job, rng: np.random.Generator) -> Files:
    """A log of libfranka, as `logToCSV` writes it."""
    noise = rng.normal(size=job.q.shape)
    matrices = job.computed.transpose(0, 2, 1).reshape(-1, 16)
    parts = {
        "state.q": job.q,
        "state.q_d": job.commanded,
        "state.dq": 1e-3 * noise,
        "state.dq_d": 0.0 * noise,
        "state.tau_J": noise,
        "cmd.q_d": job.commanded,
        "cmd.O_T_EE_d": matrices,
    }
    names = ["time", " success_rate"]
    for name, values in parts.items():
        names += [f" {name}[{k}]" for k in range(values.shape[1])]
    columns = [1e3 * job.time, 1.0 + 0.0 * job.time, *parts.values()]
    return {"joints.csv": table(names, columns), "readings.csv": reading_log(job)}


def write_plotjuggler(job: Job, rng: np.random.Generator) -> Files:
    """PlotJuggler: a file with the joints and the tracker, at the standstills."""
    by_name = rng.random() < 0.5
    series = {"/controller/tcp_pose/position/x": job.computed[:, 0, 3]}
    for k, joint in enumerate(job.joints):
        position = f"/joint_states/{joint}/position"
        series[position if by_name else f"/joint_states/position[{k}]"] = job.q[:, k]
        series[f"/joint_states/{joint}/velocity"] = 0.0 * job.time
    for k, axis in enumerate("xyz"):
        series[f"/tracker/point/{axis}"] = job.point("Ball")[:, k]
    names = ["__time", *sorted(series)]
    columns = [job.time, *(series[name] for name in names[1:])]
    some = [column[job.measured] for column in columns]
    return {"measurements.csv": table(names, some)}


def write_pandas(job: Job, rng: np.random.Generator) -> Files:
    """pandas: an index, and names of two parts in two lines."""
    upper = ["", *["q"] * len(job.joints), *["tip"] * 3]
    lower = ["", *(str(k) for k in range(len(job.joints))), *"xyz"]
    rows = np.hstack([job.q, job.point("Ball")])[job.measured].tolist()
    cells = [[k, *row] for k, row in enumerate(rows)]
    return {"measurements.csv": lines([upper, lower, *cells])}


def write_lerobot(job: Job, rng: np.random.Generator) -> Files:
    """A data set of LeRobot in degrees, with commands and a gripper."""
    names, columns = ["timestamp"], [job.time]
    for key, values in (
        ("action", np.degrees(job.commanded)),
        ("observation.state", np.degrees(job.q)),
    ):
        names += [f"{key}.{joint}.pos" for joint in (*job.joints, "gripper")]
        columns += [*values.T, np.full(len(job.q), 12.5)]
    return {"joints.csv": table(names, columns), "readings.csv": reading_log(job)}


def write_lerobot_normalized(job: Job, rng: np.random.Generator) -> Files:
    """The same in -100 to 100 of the ranges that the calibration file has."""
    motors, q = {}, np.degrees(job.q)
    for k, joint in enumerate((*job.joints, "gripper")):
        half = 1000
        if k < len(job.joints):
            half = int(np.ceil(np.abs(q[:, k]).max() * 4095 / 360)) + 5
            q[:, k] *= 100.0 / (half * 360.0 / 4095.0)
        motors[joint] = {
            "id": k + 1,
            "drive_mode": 0,
            "homing_offset": int(rng.integers(-1000, 1000)),
            "range_min": 2047 - half,
            "range_max": 2047 + half,
        }
    names = [f"observation.state.{joint}.pos" for joint in (*job.joints, "gripper")]
    columns = [job.time, *q.T, np.full(len(q), 12.5)]
    return {
        "joints.csv": table(["timestamp", *names], columns),
        "readings.csv": reading_log(job),
        "follower.json": json.dumps(motors, indent=4),
    }


WRITERS: Mapping[str, Callable[[Job, np.random.Generator], Files]] = {
    name.removeprefix("write_"): writer
    for name, writer in list(globals().items())
    if name.startswith("write_")
}
"""All writers by the name of their layout."""
