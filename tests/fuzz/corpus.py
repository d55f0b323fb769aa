"""Valid files of every kind that calib-pin reads, and commands that read them."""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import trimesh

from calib_pin.cli import main
from tests.shared import collada

BALL = '<geometry><sphere radius="0.05"/></geometry>'
ROD = '<geometry><cylinder radius="0.04" length="0.4"/></geometry>'
PLATE = '<geometry><box size="0.2 0.2 0.1"/></geometry>'
ALONG = '<origin xyz="0.25 0 0" rpy="0 1.5708 0"/>'

MASS = """<inertial><origin xyz="0.2 0 0.1"/><mass value="6.5"/>
<inertia ixx="1" ixy="0.1" ixz="0" iyy="2" iyz="0" izz="3"/></inertial>"""
FINGER = """<link name="finger"/><joint name="finger_joint" type="prismatic">
<parent link="link4"/><child link="finger"/><axis xyz="1 0 0"/>
<mimic joint="joint4" multiplier="0.01" offset="0.02"/>
<limit lower="0" upper="0.05" effort="1" velocity="1"/>
<dynamics damping="0.1" friction="0.0"/></joint></robot>"""
INSIDE = {
    "base_link": f'<collision><origin xyz="0 0 -0.1"/>{PLATE}</collision>',
    "link1": f"<!-- a comment -->{MASS}",
    "link2": f"<visual>{BALL}</visual><collision>{ALONG}{ROD}</collision>{MASS}",
    "link3": f"<collision>{BALL}</collision>{MASS}",
}
ARM = Path(__file__).parents[1].joinpath("cli/arm.urdf").read_text()
ARM = ARM.replace("</robot>", FINGER)
ARM = ARM.replace('"joint4" type="revolute"', '"joint4" type="continuous"')
for _name, _inside in INSIDE.items():
    ARM = ARM.replace(f'"{_name}"/>', f'"{_name}">{_inside}</link>', 1)

SHAPES = {
    '<box size="0.2 0.2 0.1"/>': '<mesh filename="block.stl" scale="0.1 0.1 0.1"/>',
    '<cylinder radius="0.04" length="0.4"/>': '<mesh filename="block.obj"/>',
    '<sphere radius="0.05"/></geometry></collision>': (
        '<mesh filename="block.ply"/></geometry></collision><collision><geometry>'
        '<mesh filename="block.dae" scale="0.5 0.5 0.5"/></geometry></collision>'
    ),
}
"""Shapes of the arm, and the meshes in their places in another."""

CORNERS = ((0.0, 0.0, 0.0), (0.05, 0.0, 0.0), (0.0, 0.05, 0.0), (0.0, 0.0, 0.05))
FACES = ((0, 2, 1), (0, 1, 3), (1, 2, 3), (0, 3, 2))
"""A tetrahedron [m]."""


def meshes() -> dict[str, bytes]:
    """The tetrahedron in every format."""
    solid = trimesh.Trimesh(CORNERS, FACES, process=False)
    faces = " ".join(str(k) for face in FACES for k in face)
    return {
        "block.stl": solid.export(file_type="stl"),
        "block.obj": solid.export(file_type="obj").encode(),
        "block.ply": solid.export(file_type="ply", encoding="ascii"),
        "block.dae": collada(CORNERS, faces).encode(),
    }


HEAD = "tip: tool\nparameters: [joint-offset]\n"
TEXTS = {
    "arm.urdf": ARM,
    "arm.srdf": """<?xml version="1.0"?>
<robot name="arm">
  <group name="arm"><chain base_link="base_link" tip_link="tool"/></group>
  <disable_collisions link1="base_link" link2="link2" reason="Never"/>
  <disable_collisions link1="link2" link2="link3" reason="Adjacent"/>
</robot>
""",
    "errors.yaml": "joint2.joint-offset.q: 2.0e-3\njoint3.joint-offset.q: -3.0e-3\n",
    "position.yaml": """tip: tool
model: position
parameters: [joint-offset, transmission]
frames:
  base: {estimate: true}
  tool: {xyz: [0, 0, 0.1], rpy: [0, 0, 0], estimate: true}
stations: {day1: {xyz: [0, 0, 0], rpy: [0, 0, 0]}, day2: {estimate: true}}
tools:
  probe: {xyz: [0, 0, 0.1]}
  ball: {xyz: [0.01, 0, 0.05], on: probe}
chains: {elbow: {tip: link3, base: base_link}}
joints:
  joint2: {joint: joint2, sign: 1, gear: 1, offset: 0.0}
  joint3: {joint: joint3, coupled: {joint2: 0.0}}
gear_ratios: {joint1: 100, "joint[23]": 81.5}
fixed: ["*.transmission.sin2", joint3.transmission.gain]
bounds: {"*.joint-offset.q": 0.01, "*.transmission.sin1": [-0.02, 0.01]}
prior: {"*.transmission.*": 0.002}
noise: {position: 1.0e-4}
solver: {name: gauss-newton}
loss: auto
""",
    "load.yaml": """tip: tool
parameters: [joint-offset, compliance]  # a comment
gravity: [0, 0, -9.81]
payloads:
  light: {mass: 1, com: [0, 0, 0]}
  heavy: {mass: 20, com: [0, 0, 0.15]}
""",
    "plan.yaml": """tip: tool
model: pose
parameters: [joint-offset]
obstacles:
  - {box: [1, 1, 0.02], xyz: [0, 0, -0.3]}
  - {sphere: 0.2, xyz: [1, 0, 1.5]}
  - {cylinder: [0.1, 1.0], xyz: [0.9, 0.9, 0.5], rpy: [0, 0.1, 0]}
region: {box: [[-1.2, -1.2, 0.0], [1.2, 1.2, 1.5]]}
limits: {joint1: [-2.0, 2.0], "joint*": [-2.4, 2.4]}
""",
    "plane.yaml": HEAD + "model: plane-distance\n"
    "planes:\n  wall: {normal: [1, 0.2, 0.3], offset: -1.8}\n"
    "ranger: {}\n",
    "wire.yaml": HEAD + "model: point-distance\nanchors:\n"
    "  left: {xyz: [1, 1, 0], bias: 0.01, estimate_bias: true}\n"
    "  right: {xyz: [1, -1, 0.2]}\n  back: {xyz: [-1, 0, 1]}\n",
    "steps.yaml": HEAD + "model: relative-distance\n",
    "socket.yaml": HEAD + "model: fixed-point\n"
    "sockets: {front/0: {xyz: [0.6, 0.1, 0.4]}, front/1: {xyz: [0.6, 0.2, 0.4]}}\n"
    "distances: [{between: [front/0, front/1], value: 0.1, sigma: 1.0e-5}]\n",
    "touch.yaml": HEAD + "model: plane-contact\n"
    "planes: {table: {normal: [0, 0, 1], offset: -0.2}}\n"
    "targets: {ball: {xyz: [0, 0, 0.05]}}\n",
    "sphere.yaml": HEAD + "model: sphere-contact\n"
    "spheres: {dome: {xyz: [0.7, 0, 0.3], radius: 0.1, estimate_radius: true}}\n",
    "camera.yaml": HEAD + "model: camera\n"
    "camera: {mount: hand, focal: [900, 910], center: [640, 480],\n"
    "  distortion: [-0.02, 0.01], size: [1280, 960]}\n"
    "board: {type: charuco, columns: 4, rows: 3, square: 0.05}\n"
    "stations: {cell: {xyz: [0, 0, 0]}}\n",
    "log.csv": "Zeit;J1;J2;J3;J4;X (mm);Y [mm];Z [mm]\n"
    "0;10,5;-12;20;3;700,5;-12,25;400\n1,5;20,5;12;-20;-3;650;12,25;450,125\n"
    "2,5;-20,5;22;-30;33;550;100;500\n3;5;-5;40;13;600;0;480\n",
    "log.yaml": HEAD + "model: position\ncolumns:\n  x: X (mm) [mm]\n  y: Y\n"
    "  z: Z [mm]\n" + "".join(f"  joint{k}: J{k} [deg]\n" for k in range(1, 5)),
    "limits.yaml": "tip: tool\nlimit: {position: 1.0e-3, repeatability: 1.0e-3}\n",
    "stood.csv": "time;joint1 [deg];joint2 [deg]\n"
    + "".join(
        f"{0.1 * k:.1f};{10 * min(k % 40, 20)}".replace(".", ",") + f";{k // 40}\n"
        for k in range(120)
    ),
    "seen.csv": "time,x [mm],y [mm],z\n"
    + "".join(
        f"{0.05 + 0.1 * k:.2f},{50 * min(k % 40, 20)},{7 * (k // 40)},0.5\n"
        for k in range(118)
    ),
    "motors.json": "{"
    + ", ".join(
        f'"joint{k}": {{"id": {k}, "drive_mode": 0, "homing_offset": -{k}00, '
        f'"range_min": {700 + k}, "range_max": 3{k}00}}'
        for k in range(1, 5)
    )
    + "}",
    "r.xml": "<robot>"
    + "".join(
        f'<transmission name="t{k}"><plugin>transmission_interface/SimpleTransmission'
        f'</plugin><actuator name="a{k}" role="a"/><joint name="joint{k}" role="j">'
        f"<mechanical_reduction>{k}00.5</mechanical_reduction><offset>0.{k}</offset>"
        "</joint></transmission>"
        for k in range(1, 5)
    )
    + "</robot>",
    "k.yaml": """kinematics:
  joint1: {x: 0, y: 0, z: 0.4, roll: 0, pitch: 0, yaw: 0}
  joint2: {x: 0.1, y: 0, z: 0, roll: -1.470796327, pitch: 0, yaw: 0}
  joint3: {x: 0.5, y: -0.05, z: 0, roll: 0, pitch: 0, yaw: 0}
  joint4: {x: 0.4, y: 0, z: 0, roll: 1.570796327, pitch: 0, yaw: 0}
  hash: calib_12
""",
    "targets.csv": "x,y,z\n0.7,0.1,0.4\n0.6,-0.2,0.5\n0.5,0.3 ,0.6\n",
    "motion.csv": "# a path\njoint1,joint2,joint3,joint4,speed\n"
    "0,0.1,0.5,0,fast\n0.05,0.12,0.5,0.1,slow\n0.1,0.14,0.52,0.2,slow\n",
}


MADE = {
    "rows.csv": "--model position --count 24 --errors errors.yaml",
    "visits.csv": "--model position --count 3 --repeats 4 --seed 4",
    "new.csv": "--model position --count 12 --seed 2",
    "poses.csv": "--model pose --count 12",
    "distances.csv": "--setup plane.yaml --count 20",
    "wires.csv": "--setup wire.yaml --count 20",
    "steps.csv": "--setup steps.yaml --count 16",
    "sockets.csv": "--setup socket.yaml --count 16",
    "touches.csv": "--setup touch.yaml --count 16",
    "spheres.csv": "--setup sphere.yaml --count 16",
    "images.csv": "--setup camera.yaml --count 8 --noise 0.2",
}
"""Measurements of every model, by the options that simulate them."""

SIMULATE = "simulate arm.urdf --tip tool --parameters joint-offset -o"
FIT = "--tip tool --parameters joint-offset --quiet -o"

ADDED = {
    "mixed.csv": ("rows.csv", {"station": ("day1", "day2"), "tool": ("probe", "ball")}),
    "chains.csv": ("rows.csv", {"chain": ("tool", "tool"), "set": ("train",)}),
    "loaded.csv": (
        "rows.csv",
        {"payload": ("light", "heavy", "none"), "sigma": ("1e-4",), "time": ("0",)},
    ),
}
"""Measurements with further columns: the file that they follow, and their cells."""


@dataclass(frozen=True)
class Job:
    """A command, and the files among those it reads that may be damaged.

    Attributes:
        words: Its command line.
        files: The files, with spaces between them.
        weight: How often it is run, against the others.
    """

    words: str
    files: str
    weight: int = 1


JOBS = (
    Job("evaluate arm.urdf poses.csv --tip tool", "arm.urdf poses.csv", 6),
    Job("identify arm.urdf --tip tool --model pose", "arm.urdf", 4),
    Job("identify arm.urdf loaded.csv --setup load.yaml", "arm.urdf load.yaml", 4),
    Job("identify arm.urdf loaded.csv --setup load.yaml --json", "loaded.csv", 2),
    Job("evaluate arm.urdf mixed.csv --setup position.yaml", "position.yaml", 6),
    Job("evaluate arm.urdf mixed.csv --setup position.yaml", "mixed.csv", 3),
    Job("evaluate arm.urdf chains.csv --setup position.yaml", "chains.csv", 2),
    Job("evaluate arm.urdf distances.csv --setup plane.yaml", "distances.csv", 2),
    Job("evaluate arm.urdf distances.csv --setup plane.yaml", "plane.yaml", 2),
    Job("evaluate arm.urdf wires.csv --setup wire.yaml", "wires.csv wire.yaml", 3),
    Job("evaluate arm.urdf steps.csv --setup steps.yaml", "steps.csv steps.yaml", 3),
    Job("evaluate arm.urdf sockets.csv --setup socket.yaml", "sockets.csv", 2),
    Job("evaluate arm.urdf sockets.csv --setup socket.yaml", "socket.yaml", 2),
    Job(
        "evaluate arm.urdf touches.csv --setup touch.yaml", "touches.csv touch.yaml", 3
    ),
    Job("evaluate arm.urdf spheres.csv --setup sphere.yaml", "spheres.csv", 2),
    Job("evaluate arm.urdf spheres.csv --setup sphere.yaml", "sphere.yaml", 2),
    Job(
        "evaluate arm.urdf images.csv --setup camera.yaml", "images.csv camera.yaml", 4
    ),
    Job("evaluate done/calibration.json new.csv", "done/calibration.json new.csv", 6),
    Job("evaluate done/calibration.json new.csv --register", "done/nominal.urdf"),
    Job("calibrate arm.urdf rows.csv --setup position.yaml", "rows.csv position.yaml"),
    Job("calibrate arm.urdf rows.csv --tip tool -o out", "arm.urdf rows.csv"),
    Job(f"calibrate arm.urdf wires.csv --setup wire.yaml {FIT} out", "wire.yaml"),
    Job("simulate arm.urdf --setup position.yaml --count 4 -o out", "position.yaml", 3),
    Job(
        f"{SIMULATE} out --model pose --count 4 --errors errors.yaml", "errors.yaml", 3
    ),
    Job(f"{SIMULATE} out --model pose --configurations plan.csv", "plan.csv", 3),
    Job("simulate arm.urdf --setup camera.yaml --count 2 -o out", "camera.yaml", 2),
    Job(
        "plan arm.urdf --setup plan.yaml --count 6 --candidates 30 --method greedy "
        "--srdf arm.srdf -o out",
        "arm.urdf plan.yaml arm.srdf arm.srdf",
        2,
    ),
    Job(
        "plan solid.urdf --tip tool --parameters joint-offset --model pose --count 4 "
        "--candidates 20 --method greedy -o out",
        "solid.urdf block.stl block.obj block.ply block.dae",
    ),
    Job(
        "plan arm.urdf --tip tool --parameters joint-offset --to poses.csv --add "
        "--count 2 --candidates 30 --method greedy -o out",
        "arm.urdf poses.csv",
    ),
    Job("compensate done/calibration.json targets.csv -o out", "targets.csv", 4),
    Job("compensate done/calibration.json motion.csv -o out", "motion.csv", 3),
    Job("compensate done/calibration.json targets.csv -o out", "done/calibration.json"),
    Job(
        "compare done/calibration.json later/calibration.json", "done/calibration.json"
    ),
    Job("report done -o out", "done/calibration.json done/measurements.csv"),
    Job("evaluate arm.urdf log.csv --setup log.yaml", "log.csv log.yaml", 4),
    Job("accept arm.urdf visits.csv --setup limits.yaml", "visits.csv limits.yaml", 3),
    Job("join stood.csv seen.csv -o out", "stood.csv seen.csv", 4),
    Job("export done --format mjcf -o out", "done/calibration.json"),
    Job("export done --format lerobot --template motors.json -o out", "motors.json"),
    Job("export done --format ros2-control --template r.xml -o out", "r.xml"),
    Job("export done --format xarm-kinematics --template k.yaml -o out", "k.yaml", 2),
)


def written() -> dict[str, bytes]:
    """The corpus, made in the working folder by the commands themselves.

    This runs most of what a case will run, so that nothing is compiled meanwhile.
    """
    for name, text in TEXTS.items():
        Path(name).write_text(text)
    solid = ARM
    for shape, mesh in SHAPES.items():
        solid = solid.replace(shape, mesh)
    for name, data in {"solid.urdf": solid.encode(), **meshes()}.items():
        Path(name).write_bytes(data)
    for name, options in MADE.items():
        _run(f"{SIMULATE} {name} {options}")
    for name, (source, columns) in ADDED.items():
        head, *rows = Path(source).read_text().splitlines()[1:]
        cells = [
            ",".join(words[k % len(words)] for words in columns.values())
            for k in range(len(rows))
        ]
        lines = [f"{row},{more}" for row, more in zip(rows, cells, strict=True)]
        Path(name).write_text("\n".join([f"{head},{','.join(columns)}", *lines, ""]))
    _run(f"calibrate arm.urdf rows.csv {FIT} done")
    _run(f"calibrate arm.urdf new.csv {FIT} later")
    _run("plan arm.urdf --setup plan.yaml --count 8 --candidates 60 -o plan.csv")
    found = {str(path): path.read_bytes() for path in Path().rglob("*.*")}
    # Times would make other files of every run.
    return {
        name: re.sub(rb'("seconds": |T..:..:)[0-9.e-]+', rb"\g<1>10", data)
        for name, data in found.items()
        if not name.endswith(".html")
    }


def _run(words: str) -> None:
    assert main(words.split()) == 0, words


def needed(words: str, corpus: Mapping[str, bytes]) -> dict[str, bytes]:
    """The files that a command line names, and all of the folders that it names."""
    named = {word.split("/")[0] for word in words.split()}
    if "solid.urdf" in named:
        named |= {name for name in corpus if name.startswith("block")}
    return {name: data for name, data in corpus.items() if name.split("/")[0] in named}
