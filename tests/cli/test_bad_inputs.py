"""Wrong input: one line, the right status, nothing written, no traceback."""

from __future__ import annotations

import json
import os
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

Edit = Callable[[str], str]


# --- edits of the good files -------------------------------------------------------


def cell(line: int, column: str, text: str) -> Edit:
    """Replace a cell; lines as an editor counts them, the header is the second."""

    def edit(file: str) -> str:
        lines = file.splitlines()
        cells = lines[line - 1].split(",")
        cells[lines[1].split(",").index(column)] = text
        lines[line - 1] = ",".join(cells)
        return "\n".join(lines) + "\n"

    return edit


def header(old: str, new: str) -> Edit:
    def edit(file: str) -> str:
        lines = file.splitlines()
        names = [new if name == old else name for name in lines[1].split(",")]
        lines[1] = ",".join(names)
        return "\n".join(lines) + "\n"

    return edit


def column(name: str, values: Callable[[int, float], object]) -> Edit:
    """Replace the numbers of a column, or add it."""

    def edit(file: str) -> str:
        comment, names, *rows = file.splitlines()
        table = [row.split(",") for row in rows]
        heads = names.split(",")
        if name not in heads:
            heads.append(name)
            table = [[*row, "0"] for row in table]
        k = heads.index(name)
        for i, row in enumerate(table):
            row[k] = str(values(i, float(row[k])))
        lines = [comment, ",".join(heads), *map(",".join, table)]
        return "\n".join(lines) + "\n"

    return edit


def scaled(factor: float, *names: str) -> Edit:
    def edit(file: str) -> str:
        for name in names:
            file = column(name, lambda _, value: value * factor)(file)
        return file

    return edit


def swap(old: str, new: str, count: int = -1) -> Edit:
    def edit(file: str) -> str:
        assert old in file
        return file.replace(old, new, count)

    return edit


def lines(count: int) -> Edit:
    """Only the first lines."""
    return lambda file: "\n".join(file.splitlines()[:count]) + "\n"


def stored(*path: str | int, to: object) -> Edit:
    """Change an entry of a JSON document."""

    def edit(file: str) -> str:
        document = json.loads(file)
        part: Any = document
        for step in path[:-1]:
            part = part[step]
        part[path[-1]] = to
        return json.dumps(document)

    return edit


# --- the cases ---------------------------------------------------------------------

CALIBRATE = "calibrate arm.urdf rows.csv -o out"
SETUP = "calibrate arm.urdf rows.csv --setup bad.yaml -o out"
DISTANCES = "calibrate arm.urdf distances.csv --setup plane.yaml -o out"
EVALUATE = "evaluate done/calibration.json new.csv"
TRUSTED_OR_NOT = {"calibration.json", "measurements.csv", "nominal.urdf", "report.html"}
SIMULATE = "simulate arm.urdf --model position --count 5 -o out.csv"

CONTACT = "calibrate arm.urdf touch.csv --setup bad.yaml -o out"


def touch(*rows: str, columns: str = "target") -> str:
    """A file of twelve configurations, with these cells in turn."""
    lines = [f"joint1,joint2,joint3,joint4,{columns}"]
    for k in range(12):
        q = f"{0.1 * k:.1f},{0.2 * k - 1:.1f},0.3,{-0.1 * k:.1f}"
        lines.append(f"{q},{rows[k % len(rows)]}")
    return "\n".join(lines) + "\n"


LOADS = """\
parameters: [compliance]
payloads:
  light: {mass: 1, com: [0, 0, 0]}
  heavy: {mass: 9, com: [0, 0, 0]}
"""
CAMERA = "camera: {mount: hand, focal: [900, 900], center: [640, 480]}\n"
PIXELS = touch("1,2,m", columns="u,v,target")
APART = "model: fixed-point\ndistances:\n"

# (command, files to write first, fields of the error). What reading a file refuses is
# tested with the reader, in tests/io; here stands one case of each kind of file.
CASES: Mapping[str, tuple[Any, Mapping[str, str | Edit], dict[str, Any]]] = {
    # the command line
    "unknown command": (
        "calibrat x y",
        {},
        dict(text=("calibrat", "calibrate", "--help")),
    ),
    "unknown option": (
        f"{CALIBRATE} --setpu x",
        {},
        dict(text=("--setpu", "--setup")),
    ),
    "no robot": ("calibrate", {}, dict(text=("ROBOT", "calibrate --help"))),
    "no measurements": ("calibrate arm.urdf -o out", {}, dict(text="MEASUREMENTS")),
    "option without value": (
        f"{CALIBRATE} --setup",
        {},
        dict(text=("--setup", "argument")),
    ),
    "unknown solver": (
        f"{CALIBRATE} --solver lm",
        {},
        dict(reason=("solver", "'lm'"), allowed="gauss-newton"),
    ),
    "unknown loss": (
        f"{CALIBRATE} --loss hubert",
        {},
        dict(reason=("loss", "'hubert'"), allowed="auto, squared, huber, gnc"),
    ),
    "unknown parameterization": (
        f"{CALIBRATE} --parameters placements",
        {},
        dict(
            reason=("'placements'", "did you mean 'placement'"), allowed="joint-offset"
        ),
    ),
    "parameterization twice": (
        f"{CALIBRATE} --parameters dh,dh",
        {},
        dict(value="dh,dh", reason="twice"),
    ),
    "overlapping parameterizations": (
        f"{CALIBRATE} --parameters dh,dh-full",
        {},
        dict(reason=("joint1.dh.theta", "twice")),
    ),
    "unknown model": (
        f"{CALIBRATE} --model positions",
        {},
        dict(
            reason=("'positions'", "did you mean 'position'"), allowed="plane-distance"
        ),
    ),
    "columns of another model": (
        f"{CALIBRATE} --model camera",
        {},
        dict(
            file="rows.csv",
            line=2,
            column="u",
            reason="model 'camera' needs the missing u, v",
        ),
    ),
    "unknown model among several": (
        f"{CALIBRATE} --model position+camra",
        {},
        dict(reason=("'camra'", "did you mean 'camera'"), allowed="fixed-point"),
    ),
    "model twice": (
        f"{CALIBRATE} --model position+position",
        {},
        dict(value="position+position", reason="twice"),
    ),
    "empty tip": (
        ["calibrate", "arm.urdf", "rows.csv", "--tip", ""],
        {},
        dict(reason="--tip"),
    ),
    "holdout too large": (
        f"{CALIBRATE} --holdout 1.5",
        {},
        dict(value=1.5, reason="holdout", allowed="0 and 1"),
    ),
    "holdout no number": (
        f"{CALIBRATE} --holdout 20%",
        {},
        dict(reason=("--holdout", "'20%'"), allowed="0 and 1"),
    ),
    "holdout nan": (
        f"{CALIBRATE} --holdout nan",
        {},
        dict(reason=("--holdout", "'nan'"), allowed="0 and 1"),
    ),
    "holdout and validation": (
        f"{CALIBRATE} --holdout 0.2 --validation new.csv",
        {},
        dict(reason=("validation", "holdout", "both")),
    ),
    "seed no number": (f"{CALIBRATE} --seed one", {}, dict(reason=("--seed", "'one'"))),
    "negative seed": (
        f"{CALIBRATE} --seed -1",
        {},
        dict(reason=("--seed", "'-1'"), allowed="0, 1"),
    ),
    "the same file twice": (
        "calibrate arm.urdf rows.csv ./rows.csv",
        {},
        dict(file="rows.csv", reason="twice"),
    ),
    "validated on the fitted rows": (
        f"{CALIBRATE} --validation rows.csv",
        {},
        dict(file="rows.csv", reason="twice"),
    ),
    "validated by other measurements": (
        f"{CALIBRATE} --validation distances.csv",
        {},
        dict(
            file="distances.csv", line=2, column="x", reason=("'position'", "x, y, z")
        ),
    ),
    # the robot
    "missing robot": (
        "calibrate ram.urdf rows.csv",
        {},
        dict(
            file="ram.urdf",
            reason=("no such file", "did you mean 'arm.urdf'"),
            allowed="bundled robot",
        ),
    ),
    "robot is a folder": (
        "calibrate . rows.csv",
        {},
        dict(file=".", reason="is a directory", allowed="a URDF or xacro file"),
    ),
    "robot is no XML": (
        "calibrate rows.csv rows.csv",
        {},
        dict(file="rows.csv", reason="XML"),
    ),
    "robot is a calibration": (
        "calibrate done/calibration.json new.csv",
        {},
        dict(file="done/calibration.json", reason="robot"),
    ),
    "unknown tip": (
        f"{CALIBRATE} --tip tol",
        {},
        dict(file="arm.urdf", reason=("'tol'", "did you mean 'tool'")),
    ),
    "unknown base": (
        f"{CALIBRATE} --base baselink",
        {},
        dict(file="arm.urdf", reason="'base_link'"),
    ),
    "several leaves": (
        "calibrate two.urdf rows.csv",
        {
            "two.urdf": '<robot name="two"><link name="a"/><link name="b"/>'
            '<link name="c"/><joint name="j" type="fixed"><parent link="a"/>'
            '<child link="b"/></joint><joint name="k" type="fixed"><parent link="a"/>'
            '<child link="c"/></joint></robot>'
        },
        dict(file="two.urdf", reason="--tip", allowed="b, c"),
    ),
    "tip is the base": (
        f"{CALIBRATE} --tip base_link",
        {},
        dict(file="arm.urdf", reason="nothing moves"),
    ),
    "no moving joint": (
        f"{CALIBRATE} --base link4 --tip tool",
        {},
        dict(file="arm.urdf", reason=("no moving joint", "'link4'", "'tool'")),
    ),
    "mimic joint": (
        CALIBRATE,
        {
            "arm.urdf": swap(
                '<child link="link3"/>',
                '<child link="link3"/><mimic joint="joint2"/>',
            )
        },
        dict(file="rows.csv", line=3, column="joint3", reason="mimics 'joint2'"),
    ),
    "floating joint": (
        CALIBRATE,
        {"arm.urdf": swap('"joint2" type="revolute"', '"joint2" type="floating"')},
        dict(file="arm.urdf", reason=("joint2", "floating")),
    ),
    # measurement files
    "missing measurements": (
        "calibrate arm.urdf row.csv",
        {},
        dict(file="row.csv", reason=("no such file", "did you mean 'rows.csv'")),
    ),
    "measurements are a folder": (
        "calibrate arm.urdf done",
        {},
        dict(file="done", reason="directory"),
    ),
    "missing joint": (
        CALIBRATE,
        {"rows.csv": header("joint3", "joint_3")},
        dict(
            file="rows.csv",
            line=2,
            column="joint3",
            reason=("joint 'joint3'", "did you mean 'joint_3'"),
        ),
    ),
    "not a number": (
        CALIBRATE,
        {"rows.csv": cell(7, "y", "NaN")},
        dict(file="rows.csv", line=7, column="y", value="NaN", reason="finite"),
    ),
    "angles in degrees": (
        CALIBRATE,
        {"rows.csv": scaled(57.3, "joint1", "joint2", "joint3", "joint4")},
        dict(file="rows.csv", column="joint1", reason=("wrong unit", "joint1 [deg]")),
    ),
    "all rows for validation": (
        CALIBRATE,
        {"rows.csv": column("set", lambda *_: "validate")},
        dict(reason=("no measurement", "validation")),
    ),
    "two models at once": (
        CALIBRATE,
        {"rows.csv": column("distance", lambda *_: 1.0)},
        dict(
            file="rows.csv",
            line=2,
            reason="--model",
            allowed="position, pose, plane-distance",
        ),
    ),
    "unknown plane": (
        DISTANCES,
        {"distances.csv": cell(5, "target", "wal")},
        dict(
            file="distances.csv",
            line=5,
            column="target",
            reason=("'wal'", "did you mean 'wall'"),
        ),
    ),
    # points, sockets, wires and cameras
    "unknown target": (
        SETUP,
        {
            "rows.csv": column("target", lambda i, _: "ball" if i else "bal"),
            "bad.yaml": "targets: {ball: {xyz: [0, 0, 0.1]}}\n",
        },
        dict(
            file="rows.csv",
            line=3,
            column="target",
            reason=("'bal'", "did you mean 'ball'"),
        ),
    ),
    "unknown point in a socket": (
        CONTACT,
        {
            "touch.csv": touch("ball@s", "bal@s"),
            "bad.yaml": "model: fixed-point\ntargets: {ball: {}}\n",
        },
        dict(
            file="touch.csv",
            line=3,
            column="target",
            reason=("there is no target 'bal'", "did you mean 'ball'"),
        ),
    ),
    "unknown socket": (
        CONTACT,
        {
            "touch.csv": touch("front/0", "front/l"),
            "bad.yaml": "model: fixed-point\nsockets: {front/0: {}, front/1: {}}\n",
        },
        dict(
            file="touch.csv",
            line=3,
            column="target",
            reason=(
                "there is no socket 'front/l'",
                "did you mean 'front/",
            ),
        ),
    ),
    "distance between unknown sockets": (
        CONTACT,
        {
            "touch.csv": touch("a/0", "a/1"),
            "bad.yaml": APART + "  - {between: [a/0, a/2], value: 0.05}\n",
        },
        dict(
            file="bad.yaml",
            value=["a/0", "a/2"],
            reason=(
                "'distances' names 'a/2', which no measurement does",
                "did you mean 'a/",
            ),
        ),
    ),
    "camera without intrinsics": (
        "calibrate arm.urdf touch.csv -o out",
        {"touch.csv": PIXELS},
        dict(reason=("'camera' in a setup file (--setup)", "mount, focal and center")),
    ),
    "camera without points": (
        CONTACT,
        {"touch.csv": PIXELS, "bad.yaml": CAMERA},
        dict(reason=("'camera' needs known points", "the xyz of 'm' under 'targets'")),
    ),
    "unknown point of a camera": (
        CONTACT,
        {
            "touch.csv": PIXELS,
            "bad.yaml": CAMERA + "targets: {n: {xyz: [0, 0, 0]}}\n",
        },
        dict(
            file="touch.csv",
            line=2,
            column="target",
            reason=("there is no target 'm'"),
            allowed="n",
        ),
    ),
    "unknown anchor": (
        CONTACT,
        {
            "touch.csv": touch("0.5,wire", "0.5,wier", columns="distance,target"),
            "bad.yaml": "model: point-distance\nanchors: {wire: {}}\n",
        },
        dict(
            file="touch.csv",
            line=3,
            column="target",
            reason=("there is no anchor 'wier'", "did you mean 'wire'"),
        ),
    ),
    "something learned from ways": (
        f"{CONTACT} --learned network",
        {
            "touch.csv": touch("0,a", *["0.5,a"] * 11, columns="distance,target"),
            "bad.yaml": "model: relative-distance\n",
        },
        dict(file="bad.yaml", value="network", reason="nothing can be learned"),
    ),
    "prior of a socket that nobody has placed": (
        CONTACT,
        {
            "touch.csv": touch("a/0", "a/1"),
            "bad.yaml": "model: fixed-point\nprior: {a/0.socket.x: 0.001}\n",
        },
        dict(
            file="bad.yaml",
            reason=("fixed, bounds or prior", "'sockets' in a setup file"),
        ),
    ),
    "beam parallel to the plane": (
        "calibrate arm.urdf flat.csv --setup bad.yaml",
        {
            "bad.yaml": "parameters: [joint-offset]\nframes: {tool: {rpy: [0, -1.4, 0],"
            " estimate: false}}\nplanes: {wall: {normal: [1, 0, 0], offset: -1}}\n",
            "flat.csv": "joint1,joint2,joint3,joint4,distance\n"
            + "0,0.5,0,0.1,1\n" * 12
            + "0,0,0,0,1\n",
        },
        dict(file="flat.csv", line=14, reason=("parallel", "'wall'")),
    ),
    # setup files
    "missing setup": (
        f"{CALIBRATE} --setup setpu.yaml",
        {},
        dict(file="setpu.yaml", reason="'setup.yaml'"),
    ),
    "unknown key": (
        SETUP,
        {"bad.yaml": "tip: tool\nparamters: [dh]\n"},
        dict(file="bad.yaml", line=2, reason=("'paramters'", "'parameters'")),
    ),
    "glob without a match": (
        SETUP,
        {"bad.yaml": 'fixed: ["*.placment.z"]\n'},
        dict(file="bad.yaml", reason="'*.placment.z'"),
    ),
    "bound that excludes zero": (
        SETUP,
        {"bad.yaml": 'bounds: {"*.placement.x": [0.001, 0.002]}\n'},
        dict(file="bad.yaml", value=[0.001, 0.002], reason=("'*.placement.x'", "zero")),
    ),
    "mapped joint that is not there": (
        SETUP,
        {"bad.yaml": "joints: {J1: {joint: joint_1}}\n"},
        dict(reason=("'J1'", "'joint_1'", "did you mean 'joint1'")),
    ),
    # gravity, payloads and gears
    "gear ratio of no joint": (
        SETUP,
        {
            "bad.yaml": "parameters: [transmission]\ngear_ratios: {joint_2: 100}\n",
        },
        dict(
            file="bad.yaml",
            column="gear_ratios",
            reason=("'joint_2'", "did you mean 'joint2'"),
            allowed="joint1, joint2, joint3",
        ),
    ),
    "several payloads": (
        SETUP,
        {"bad.yaml": LOADS},
        dict(
            file="rows.csv",
            line=3,
            column="payload",
            reason=("several payloads", "the row names none"),
            allowed="none, light, heavy",
        ),
    ),
    "unknown payload": (
        SETUP,
        {
            "rows.csv": column("payload", lambda i, _: "hevy" if i == 3 else "heavy"),
            "bad.yaml": LOADS,
        },
        dict(
            file="rows.csv",
            line=6,
            column="payload",
            reason=("there is no payload 'hevy'", "did you mean 'heavy'"),
            allowed="light, heavy",
        ),
    ),
    "compliance without a mass": (
        f"{CALIBRATE} --parameters placement,compliance",
        {},
        dict(
            reason=("'compliance'", "'arm'", "no mass"),
            allowed=("<inertial>", "payloads in the setup file"),
        ),
    ),
    "simulated compliance without a mass": (
        f"{SIMULATE} --parameters compliance",
        {},
        dict(
            reason=("'compliance'", "'arm'", "no mass"),
            allowed="payloads in the setup file",
        ),
    ),
    "structure of a compliance without a mass": (
        "identify arm.urdf --model pose --parameters compliance",
        {},
        dict(reason=("'compliance'", "'arm'", "no mass")),
    ),
    "name of a correction": (
        f"{CALIBRATE} --parameters placement,compliances",
        {},
        dict(
            reason=("'compliances'", "did you mean 'compliance'"),
            allowed="transmission, compliance",
        ),
    ),
    "unknown residual model": (
        f"{CALIBRATE} --learned netwrok",
        {},
        dict(
            reason=("unknown residual model 'netwrok'", "did you mean 'network'"),
            allowed="gaussian-process",
        ),
    ),
    "too few rows for a ladder": (
        f"{CALIBRATE} --model-ladder",
        {"rows.csv": lines(6)},
        dict(reason=("no model can be selected", "4 configurations are too few")),
    ),
    "name on no rung of a ladder": (
        f"{SETUP} --model-ladder",
        {"bad.yaml": "fixed: [joint1.transmision.sin1]\n"},
        dict(
            file="bad.yaml",
            reason=(
                "'joint1.transmision.sin1'",
                "did you mean 'joint1.transmission.sin1'",
            ),
        ),
    ),
    "unknown error of a gear": (
        f"{SIMULATE} --parameters transmission --errors bad.yaml",
        {"bad.yaml": "joint1.transmission.sin: 1.0e-3\n"},
        dict(
            file="bad.yaml",
            line=1,
            reason=("'joint1.transmission.sin'", "did you mean"),
        ),
    ),
    # outputs
    "output folder is a file": (
        "calibrate arm.urdf rows.csv -o setup.yaml",
        {},
        dict(file="setup.yaml", reason="not a folder"),
    ),
    "output exists": (
        "calibrate arm.urdf new.csv -o done",
        {},
        dict(file="done/arm.urdf", reason="--force"),
    ),
    "output over the robot": (
        "calibrate arm.urdf rows.csv -o . --force",
        {},
        dict(file="arm.urdf", reason="input"),
    ),
    "simulation exists": (
        "simulate arm.urdf --model position --count 5 -o new.csv",
        {},
        dict(file="new.csv", reason="--force"),
    ),
    "simulation over the robot": (
        "simulate arm.urdf --model position --count 5 -o arm.urdf --force",
        {},
        dict(file="arm.urdf", reason="input"),
    ),
    "truth over the robot": (
        f"{SIMULATE} --truth ./arm.urdf --force",
        {},
        dict(file="arm.urdf", reason="input"),
    ),
    "simulation over its configurations": (
        "simulate arm.urdf --model position --configurations new.csv -o new.csv "
        "--force",
        {},
        dict(file="new.csv", reason="input"),
    ),
    "two outputs in one file": (
        f"{SIMULATE} --truth out.csv",
        {},
        dict(file="out.csv", reason="two"),
    ),
    # calibrations
    "later version": (
        EVALUATE,
        {"done/calibration.json": stored("version", to=2)},
        dict(file="done/calibration.json", value=2, reason="version", allowed="1 to 1"),
    ),
    "edited value": (
        EVALUATE,
        {"done/calibration.json": stored("parameters", 7, "value", to="1 mm")},
        dict(file="done/calibration.json", reason=("edited", "'1 mm'")),
    ),
    "another robot": (
        EVALUATE,
        dict.fromkeys(
            ("arm.urdf", "done/nominal.urdf"),
            swap('xyz="0 0 0.4"', 'xyz="0 0 0.41"'),
        ),
        dict(file="done/calibration.json", reason=("arm.urdf", "content differs")),
    ),
    "no robot is the one": (
        EVALUATE,
        {"done/calibration.json": stored("robot", "sha256", to="0" * 64)},
        dict(file="done/calibration.json", reason=("arm.urdf", "content differs")),
    ),
    "measurements of another robot": (
        EVALUATE,
        {"new.csv": header("joint1", "axis_1")},
        dict(file="new.csv", line=2, column="joint1", reason="missing"),
    ),
    "other kind of measurements": (
        "evaluate done/calibration.json distances.csv",
        {},
        dict(
            file="distances.csv", line=2, column="x", reason=("'position'", "x, y, z")
        ),
    ),
    "a calibration has its tip": (
        f"{EVALUATE} --tip tool",
        {},
        dict(reason=("calibration", "tip")),
    ),
    # simulation and structure
    "no planes": (
        "simulate arm.urdf --model plane-distance --count 5 -o out.csv",
        {},
        dict(reason=("plane", "planes", "--setup")),
    ),
    "no model": (
        "simulate arm.urdf --count 5 -o out.csv",
        {},
        dict(reason="--model", allowed="pose"),
    ),
    "structure of no model": (
        "identify arm.urdf",
        {},
        dict(reason="--model", allowed="pose"),
    ),
    "no count": (
        "simulate arm.urdf --model pose -o out.csv",
        {},
        dict(reason="--count"),
    ),
    "count of zero": (
        f"{SIMULATE} --count 0",
        {},
        dict(reason=("--count", "'0'"), allowed="1 to"),
    ),
    "count is no number": (
        f"{SIMULATE} --count 5.5",
        {},
        dict(reason=("--count", "'5.5'")),
    ),
    "no repeats": (f"{SIMULATE} --repeats 0", {}, dict(reason=("--repeats", "'0'"))),
    "negative noise": (
        f"{SIMULATE} --noise -1e-4",
        {},
        dict(reason=("--noise", "'-1e-4'"), allowed="0 to 1"),
    ),
    "infinite noise": (
        f"{SIMULATE} --noise inf",
        {},
        dict(reason=("--noise", "'inf'")),
    ),
    "unknown error": (
        f"{SIMULATE} --errors bad.yaml",
        {"bad.yaml": "joint1.placement.x: 1e-3\njoint1.placement.w: 1e-3\n"},
        dict(file="bad.yaml", line=2, reason=("'joint1.placement.w'", "did you mean")),
    ),
    "error is no number": (
        f"{SIMULATE} --errors bad.yaml",
        {"bad.yaml": "joint1.placement.x: 1 mm\n"},
        dict(file="bad.yaml", line=1, value="1 mm", reason="joint1.placement.x"),
    ),
    "no errors in the file": (
        f"{SIMULATE} --errors bad.yaml",
        {"bad.yaml": "# none\n"},
        dict(file="bad.yaml", reason="empty"),
    ),
    "no sockets": (
        "simulate arm.urdf --model fixed-point --count 5 -o out.csv",
        {},
        dict(reason="'sockets' in a setup file (--setup)"),
    ),
    "plane out of reach": (
        "simulate arm.urdf --setup bad.yaml --count 5 -o out.csv",
        {
            "bad.yaml": "model: plane-distance\n"
            "planes: {wall: {normal: [1, 0, 0], offset: -50}}\n"
        },
        dict(reason=("0 of", "plane-distance")),
    ),
    "configuration out of reach": (
        "simulate arm.urdf --setup plane.yaml --configurations bad.csv -o out.csv",
        {"bad.csv": "joint1,joint2,joint3,joint4\n0,0,0,0\n2.4,0,0,0\n"},
        dict(reason=("configuration 2", "plane-distance")),
    ),
}


@pytest.mark.parametrize("name", CASES)
def test_wrong_input(name, here, refuses):
    command, files, fields = CASES[name]
    for file, content in files.items():
        path = Path(file)
        if callable(content):
            content = content(path.read_text() if path.exists() else "")
        path.write_text(content)
    refuses(command, **fields)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize("name", ["/dev/zero", "pipe"])
def test_the_robot_of_a_calibration_is_a_regular_file(name, here, run, refuses):
    os.mkfifo("pipe")
    os.mkfifo("done/pipe")
    edit = stored("robot", "file", to=name)
    file = Path("done/calibration.json")
    Path("moved.json").write_text(edit(file.read_text()))
    refuses("evaluate moved.json new.csv", file="moved.json", reason="neither there")
    # Where there is a copy, nobody waits for what nothing writes to.
    file.write_text(edit(file.read_text()))
    assert run(EVALUATE).status == 0


# --- it ran, but the result must not be trusted ------------------------------------


def few_rows(_: Path) -> None:
    Path("rows.csv").write_text(lines(4)(Path("rows.csv").read_text()))


def barely_enough_rows(_: Path) -> None:
    # Four values for the four offsets, with both frames known.
    file = Path("distances.csv")
    file.write_text(lines(6)(file.read_text()))
    Path("setup.yaml").write_text(
        "parameters: [joint-offset]\nframes: {tool: {estimate: false}}\n"
        "planes: {wall: {normal: [1, 0.2, 0.3], offset: -1.8, estimate: false}}\n"
    )
    file.rename("rows.csv")


def rows_of_another_robot(_: Path) -> None:
    mixed = Path("rows.csv").read_text().splitlines()
    foreign = Path("foreign.csv").read_text().splitlines()
    marked = [row + ",train" for row in mixed[2:]]
    marked += [row + ",validate" for row in foreign[2:]]
    Path("rows.csv").write_text("\n".join([mixed[1] + ",set", *marked]) + "\n")


@pytest.mark.parametrize(
    ("prepare", "status", "parts"),
    [
        (few_rows, "unchecked", "6 measured values|identifiable parameters|measure"),
        (
            barely_enough_rows,
            "unchecked",
            "4 measured values|4 estimated parameters|measure more",
        ),
        (
            rows_of_another_robot,
            "untrusted",
            "held-out|worse than the nominal|position errors larger by| mm",
        ),
    ],
)
def test_untrusted(prepare, status, parts, here, run):
    prepare(here)
    result = run("calibrate arm.urdf rows.csv --setup setup.yaml -o out")

    assert result.status == 2
    assert result.err == ""
    first, *_ = result.out.split("\n\n")
    verdict = " ".join(first.split())
    assert verdict.startswith(f"{status.upper()}: ")
    assert ".." not in verdict
    for part in parts.split("|"):
        assert part in verdict
    written = ("calibration.json", "measurements.csv", "report.html")
    assert result.out.endswith("".join(f"wrote out/{name}\n" for name in written))
    assert {path.name for path in Path("out").iterdir()} == TRUSTED_OR_NOT
    said = " ".join(first.split()[:2])
    assert said in Path("out/report.html").read_text()
    document = json.loads(Path("out/calibration.json").read_text())
    assert document["verdict"]["status"] == status
    assert document["verdict"]["reason"].rstrip(".") in verdict


def test_untrusted_and_quiet(here, run):
    few_rows(here)
    result = run("calibrate arm.urdf rows.csv --setup setup.yaml --quiet")
    assert (result.status, result.out) == (2, "")
    assert result.err.startswith("calib-pin: note: unchecked: 6 measured values")
    assert result.err.count("\n") == 1


def test_the_robot_of_an_earlier_run_does_not_stay(here, run):
    few_rows(here)
    result = run("calibrate arm.urdf rows.csv --setup setup.yaml -o done --force")
    assert result.status == 2
    assert result.err == "calib-pin: note: removed done/arm.urdf of an earlier run\n"
    assert {path.name for path in Path("done").iterdir()} == TRUSTED_OR_NOT


def test_identification_of_too_few_rows(here, run):
    few_rows(here)
    result = run("identify arm.urdf rows.csv --setup setup.yaml")
    assert result.status == 2
    assert result.out.startswith("UNCHECKED: 6 measured values")
    result = run("identify arm.urdf rows.csv --setup setup.yaml --json")
    assert result.status == 2
    assert json.loads(result.out)["verdict"]["status"] == "unchecked"


def test_evaluation_of_an_untrusted_calibration_says_so(here, run):
    rows_of_another_robot(here)
    assert run("calibrate arm.urdf rows.csv --setup setup.yaml -o out").status == 2
    result = run("evaluate out/calibration.json new.csv")
    assert result.status == 2
    assert result.out.startswith(
        "UNTRUSTED: out/calibration.json must not be trusted: on held-out"
    )
    assert "Nothing was fitted" in result.out
