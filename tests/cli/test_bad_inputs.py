"""Wrong input: one line, the right status, nothing written, no traceback."""

from __future__ import annotations

import json
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


def column(name: str, values: Callable[[int, float], object] | None) -> Edit:
    """Replace the numbers of a column, or add it, or drop it."""

    def edit(file: str) -> str:
        comment, names, *rows = file.splitlines()
        table = [row.split(",") for row in rows]
        heads = names.split(",")
        if name not in heads:
            heads.append(name)
            table = [[*row, "0"] for row in table]
        k = heads.index(name)
        if values is None:
            heads.pop(k)
        else:
            for i, row in enumerate(table):
                row.append(str(values(i, float(row[k]))))
                row[k] = row.pop()
        if values is None:
            for row in table:
                row.pop(k)
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


def both(*edits: Edit) -> Edit:
    def edit(file: str) -> str:
        for one in edits:
            file = one(file)
        return file

    return edit


def stored(*path: str | int, to: object) -> Edit:
    """Change an entry of a JSON document."""

    def edit(file: str) -> str:
        document = json.loads(file)
        part: Any = document
        for step in path[:-1]:
            part = part[step]
        if to is None:
            del part[path[-1]]
        else:
            part[path[-1]] = to
        return json.dumps(document)

    return edit


# --- the cases ---------------------------------------------------------------------

CALIBRATE = "calibrate arm.urdf rows.csv -o out"
SETUP = "calibrate arm.urdf rows.csv --setup bad.yaml -o out"
DISTANCES = "calibrate arm.urdf distances.csv --setup plane.yaml -o out"
POSES = "calibrate arm.urdf poses.csv -o out"
EVALUATE = "evaluate done/calibration.json new.csv"
TRUSTED_OR_NOT = {"calibration.json", "nominal.urdf", "report.html"}
SIMULATE = "simulate arm.urdf --model position --count 5 -o out.csv"

CONTACT = "calibrate arm.urdf touch.csv --setup bad.yaml -o out"

DEEP = "[" * 100_000


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

# (command, files to write first, what the line must contain)
CASES: Mapping[str, tuple[str, Mapping[str, str | bytes | Edit], str]] = {
    # the command line
    "unknown command": ("calibrat x y", {}, "calibrat|calibrate|--help"),
    "unknown option": (f"{CALIBRATE} --setpu x", {}, "--setpu|--setup"),
    "no robot": ("calibrate", {}, "ROBOT|calibrate --help"),
    "no measurements": ("calibrate arm.urdf -o out", {}, "MEASUREMENTS"),
    "option without value": (f"{CALIBRATE} --setup", {}, "--setup|argument"),
    "unknown solver": (f"{CALIBRATE} --solver lm", {}, "solver|'lm'|gauss-newton"),
    "population too small": (
        SETUP,
        {"bad.yaml": "solver:\n  name: de\n  population_size: 3\n"},
        "bad.yaml:3|solver.population_size|'3'|a whole number, 4 to 100000",
    ),
    "recombination out of range": (
        SETUP,
        {"bad.yaml": "solver: {recombination: 1.2}\n"},
        "bad.yaml:1|solver.recombination|'1.2'|0 to 1",
    ),
    "unknown mutation": (
        SETUP,
        {"bad.yaml": "solver: {name: hybrid, strategy: rand/2}\n"},
        "bad.yaml:1|solver.strategy|'rand/2'|rand/1, best/1, rand-to-best/1",
    ),
    "mutation of zero": (
        SETUP,
        {"bad.yaml": "solver: {mutation: 0}\n"},
        "bad.yaml:1|solver.mutation|'0'|more than 0, up to 2",
    ),
    "infinite target": (
        SETUP,
        {"bad.yaml": "solver: {name: de, target: .inf}\n"},
        "bad.yaml:1|solver.target|'.inf'|a finite number",
    ),
    "population for no memory": (
        SETUP,
        {"bad.yaml": "solver: {population_size: 1000000000000}\n"},
        "bad.yaml:1|solver.population_size|a whole number, 4 to 100000",
    ),
    "half a generation": (
        SETUP,
        {"bad.yaml": "solver: {maxiter: 2.5}\n"},
        "bad.yaml:1|solver.maxiter|'2.5'|a whole number",
    ),
    "a word for a number": (
        SETUP,
        {"bad.yaml": "solver: {tol: tight}\n"},
        "bad.yaml:1|solver.tol|'tight'|0 or more",
    ),
    "unknown solver in the setup": (
        SETUP,
        {"bad.yaml": "solver: {name: simplex}\n"},
        "bad.yaml:1|solver.name|'simplex'|gauss-newton, two-step, de, hybrid",
    ),
    "unknown option of the solver": (
        SETUP,
        {"bad.yaml": "solver: {popsize: 15}\n"},
        "bad.yaml:1|solver.popsize|did you mean 'population_size'",
    ),
    "bounds reversed": (
        SETUP,
        {"bad.yaml": "bounds: {'*.placement.x': [0.01, -0.01]}\n"},
        "bad.yaml:1|bounds|0.01",
    ),
    "bounds infinite": (
        SETUP,
        {"bad.yaml": "bounds: {'*.placement.x': .inf}\n"},
        "bad.yaml:1|bounds|.inf",
    ),
    "unknown parameterization": (
        f"{CALIBRATE} --parameters placements",
        {},
        "'placements'|did you mean 'placement'|joint-offset",
    ),
    "parameterization twice": (
        f"{CALIBRATE} --parameters dh,dh",
        {},
        "twice|'dh,dh'",
    ),
    "overlapping parameterizations": (
        f"{CALIBRATE} --parameters dh,dh-full",
        {},
        "joint1.dh.theta|twice",
    ),
    "unknown model": (
        f"{CALIBRATE} --model positions",
        {},
        "'positions'|did you mean 'position'|plane-distance",
    ),
    "columns of another model": (
        f"{CALIBRATE} --model camera",
        {},
        "rows.csv:2|model 'camera' needs the missing u, v",
    ),
    "unknown model among several": (
        f"{CALIBRATE} --model position+camra",
        {},
        "'camra'|did you mean 'camera'|fixed-point",
    ),
    "model twice": (
        f"{CALIBRATE} --model position+position",
        {},
        "twice|'position+position'",
    ),
    "empty tip": (["calibrate", "arm.urdf", "rows.csv", "--tip", ""], {}, "--tip"),
    "holdout too large": (f"{CALIBRATE} --holdout 1.5", {}, "holdout|1.5|0 and 1"),
    "holdout no number": (f"{CALIBRATE} --holdout 20%", {}, "--holdout|'20%'|0 and 1"),
    "holdout nan": (f"{CALIBRATE} --holdout nan", {}, "--holdout|'nan'|0 and 1"),
    "holdout and validation": (
        f"{CALIBRATE} --holdout 0.2 --validation new.csv",
        {},
        "validation|holdout|both",
    ),
    "seed no number": (f"{CALIBRATE} --seed one", {}, "--seed|'one'"),
    "negative seed": (f"{CALIBRATE} --seed -1", {}, "--seed|'-1'|0, 1"),
    "the same file twice": (
        "calibrate arm.urdf rows.csv ./rows.csv",
        {},
        "rows.csv|twice",
    ),
    "validated on the fitted rows": (
        f"{CALIBRATE} --validation rows.csv",
        {},
        "rows.csv|twice",
    ),
    "validated by other measurements": (
        f"{CALIBRATE} --validation distances.csv",
        {},
        "distances.csv:2|'position'|x, y, z",
    ),
    # the robot
    "missing robot": (
        "calibrate ram.urdf rows.csv",
        {},
        "ram.urdf|no such file|did you mean 'arm.urdf'|bundled robot",
    ),
    "robot is a folder": ("calibrate . rows.csv", {}, ".: is a directory|a URDF file"),
    "robot is no XML": ("calibrate rows.csv rows.csv", {}, "rows.csv|XML"),
    "robot is cut off": (
        "calibrate bad.urdf rows.csv",
        {"bad.urdf": lambda _: "<robot name='x'><link name='a'/>"},
        "bad.urdf|XML",
    ),
    "robot is a calibration": (
        "calibrate done/calibration.json new.csv",
        {},
        "done/calibration.json|robot",
    ),
    "entity expansion": (
        "calibrate bad.urdf rows.csv",
        {
            "bad.urdf": '<!DOCTYPE r [<!ENTITY a "aaaaaaaaaa"><!ENTITY b "'
            + "&a;" * 1000
            + '"><!ENTITY c "'
            + "&b;" * 1000
            + '">]><robot name="&c;"/>'
        },
        "bad.urdf:1|DOCTYPE",
    ),
    "document type": (
        "calibrate bad.urdf rows.csv",
        {"bad.urdf": '<?xml version="1.0"?>\n<!DOCTYPE robot SYSTEM "/etc/passwd">\n'},
        "bad.urdf:2|DOCTYPE",
    ),
    "unknown tip": (f"{CALIBRATE} --tip tol", {}, "arm.urdf|'tol'|did you mean 'tool'"),
    "unknown base": (f"{CALIBRATE} --base baselink", {}, "arm.urdf|'base_link'"),
    "several leaves": (
        "calibrate two.urdf rows.csv",
        {
            "two.urdf": '<robot name="two"><link name="a"/><link name="b"/>'
            '<link name="c"/><joint name="j" type="fixed"><parent link="a"/>'
            '<child link="b"/></joint><joint name="k" type="fixed"><parent link="a"/>'
            '<child link="c"/></joint></robot>'
        },
        "two.urdf|--tip|b, c",
    ),
    "tip is the base": (f"{CALIBRATE} --tip base_link", {}, "arm.urdf|no moving joint"),
    "no moving joint": (
        f"{CALIBRATE} --base link4 --tip tool",
        {},
        "arm.urdf|no moving joint|'link4'|'tool'",
    ),
    "mimic joint": (
        CALIBRATE,
        {
            "arm.urdf": swap(
                '<child link="link3"/>',
                '<child link="link3"/><mimic joint="joint2"/>',
            )
        },
        "arm.urdf|joint3|mimic",
    ),
    "floating joint": (
        CALIBRATE,
        {"arm.urdf": swap('"joint2" type="revolute"', '"joint2" type="floating"')},
        "arm.urdf|joint2|floating",
    ),
    # measurement files
    "missing measurements": (
        "calibrate arm.urdf row.csv",
        {},
        "row.csv|no such file|did you mean 'rows.csv'",
    ),
    "measurements are a folder": ("calibrate arm.urdf done", {}, "done|directory"),
    "empty file": (CALIBRATE, {"rows.csv": ""}, "rows.csv|empty"),
    "header only": (CALIBRATE, {"rows.csv": lines(2)}, "rows.csv|no rows"),
    "not text": (CALIBRATE, {"rows.csv": b"\x89PNG\r\n\0\0"}, "rows.csv"),
    "missing joint": (
        CALIBRATE,
        {"rows.csv": header("joint3", "joint_3")},
        "rows.csv:2|joint 'joint3'|did you mean 'joint_3'",
    ),
    "joint11 is not joint1": (
        CALIBRATE,
        {"rows.csv": header("joint1", "joint11")},
        "rows.csv:2|joint 'joint1'|'joint11'",
    ),
    "missing coordinate": (CALIBRATE, {"rows.csv": column("z", None)}, "rows.csv:2|z"),
    "not a number": (
        CALIBRATE,
        {"rows.csv": cell(7, "y", "NaN")},
        "rows.csv:7|column 'y'|value 'NaN'|finite",
    ),
    "infinite": (CALIBRATE, {"rows.csv": cell(5, "joint2", "inf")}, "rows.csv:5|'inf'"),
    "text in a number": (
        CALIBRATE,
        {"rows.csv": cell(4, "x", "1.0m")},
        "rows.csv:4|column 'x'|value '1.0m'|not a number",
    ),
    "empty cell": (CALIBRATE, {"rows.csv": cell(6, "x", "")}, "rows.csv:6|'x'|empty"),
    "decimal comma": (
        CALIBRATE,
        {"rows.csv": cell(6, "x", '"0,5"')},
        "rows.csv:6|'x'|decimal mark",
    ),
    "short row": (
        CALIBRATE,
        {"rows.csv": lambda file: file + "0.1,0.2\n"},
        "rows.csv:43|2 cells|10 columns",
    ),
    "long row": (
        CALIBRATE,
        {"rows.csv": cell(3, "x", "1,2")},
        "rows.csv:3|11 cells|10 columns",
    ),
    "column twice": (CALIBRATE, {"rows.csv": header("y", "x")}, "rows.csv:2|'x'|two"),
    "joint twice with a unit": (
        CALIBRATE,
        {"rows.csv": header("joint2", "joint1 [deg]")},
        "rows.csv:2|joint1 [deg]|two",
    ),
    "unknown unit": (
        CALIBRATE,
        {"rows.csv": header("x", "x [cm]")},
        "rows.csv:2|cm|m, mm, um, in",
    ),
    "unit of another kind": (
        CALIBRATE,
        {"rows.csv": header("joint1", "joint1 [mm]")},
        "rows.csv:2|'joint1'|mm|rad, deg, mrad",
    ),
    "positions in millimeters": (
        CALIBRATE,
        {"rows.csv": scaled(1e3, "x", "y", "z")},
        "rows.csv:|wrong unit|[mm]",
    ),
    "angles in degrees": (
        CALIBRATE,
        {"rows.csv": scaled(57.3, "joint1", "joint2", "joint3", "joint4")},
        "rows.csv:|wrong unit|joint1 [deg]",
    ),
    "distances in millimeters": (
        DISTANCES,
        {"distances.csv": scaled(1e3, "distance")},
        "distances.csv:|wrong unit|distance [mm]",
    ),
    "zero sigma": (
        CALIBRATE,
        {"rows.csv": cell(9, "sigma_x", "0")},
        "rows.csv:9|'sigma_x'|value '0'|positive",
    ),
    "negative sigma": (
        CALIBRATE,
        {"rows.csv": cell(9, "sigma_x", "-1e-4")},
        "rows.csv:9|'sigma_x'|positive",
    ),
    "sigma of some components": (
        CALIBRATE,
        {"rows.csv": column("sigma_y", None)},
        "rows.csv:2|sigma_y",
    ),
    "one sigma for a pose": (
        POSES,
        {"poses.csv": header("sigma_x", "sigma")},
        "poses.csv:2|'sigma'|sigma_rx",
    ),
    "half a quaternion": (POSES, {"poses.csv": column("qw", None)}, "poses.csv:2|qw"),
    "no unit quaternion": (
        POSES,
        {"poses.csv": scaled(2.0, "qw")},
        "poses.csv:|quaternion|norm|0.99 to 1.01",
    ),
    "unknown set": (
        CALIBRATE,
        {"rows.csv": column("set", lambda i, _: "train" if i else "test")},
        "rows.csv:3|'set'|'test'|train, validate",
    ),
    "all rows for validation": (
        CALIBRATE,
        {"rows.csv": column("set", lambda *_: "validate")},
        "no row|validation",
    ),
    "semicolons": (CALIBRATE, {"rows.csv": swap(",", ";")}, "rows.csv:2|semicolons"),
    "two models at once": (
        CALIBRATE,
        {"rows.csv": column("distance", lambda *_: 1.0)},
        "rows.csv:2|--model|position, pose, plane-distance",
    ),
    "unknown model of a row": (
        CALIBRATE,
        {"rows.csv": column("model", lambda i, _: "position" if i else "positon")},
        "rows.csv:3|column 'model'|'positon'|did you mean 'position'|camera",
    ),
    "model of a row with the cells of another": (
        CALIBRATE,
        {"rows.csv": column("model", lambda i, _: "camera" if i == 4 else "position")},
        "rows.csv:7|'camera'|has no x|a blank cell",
    ),
    "no measured columns": (
        "calibrate arm.urdf bare.csv",
        {"bare.csv": "joint1,joint2,joint3,joint4\n0,0,0,0\n"},
        "bare.csv:1|no measured columns",
    ),
    "unknown plane": (
        DISTANCES,
        {"distances.csv": cell(5, "target", "wal")},
        "'wal'|did you mean 'wall'",
    ),
    # points, sockets, wires and cameras
    "unknown target": (
        SETUP,
        {
            "rows.csv": column("target", lambda i, _: "ball" if i else "bal"),
            "bad.yaml": "targets: {ball: {xyz: [0, 0, 0.1]}}\n",
        },
        "rows.csv:3|column 'target'|'bal'|did you mean 'ball'",
    ),
    "unknown point in a socket": (
        CONTACT,
        {
            "touch.csv": touch("ball@s", "bal@s"),
            "bad.yaml": "model: fixed-point\ntargets: {ball: {}}\n",
        },
        "touch.csv:3|there is no target 'bal'|did you mean 'ball'",
    ),
    "unknown socket": (
        CONTACT,
        {
            "touch.csv": touch("front/0", "front/l"),
            "bad.yaml": "model: fixed-point\nsockets: {front/0: {}, front/1: {}}\n",
        },
        "touch.csv:3|there is no socket 'front/l'|did you mean 'front/",
    ),
    "socket with one row": (
        CONTACT,
        {
            "touch.csv": touch(*["a"] * 11, "b"),
            "bad.yaml": "model: fixed-point\n",
        },
        "touch.csv:13|the socket 'b' has one configuration only|two configurations",
    ),
    "no socket": (
        CONTACT,
        {"touch.csv": touch("a", ""), "bad.yaml": "model: fixed-point\n"},
        "touch.csv:3|the row names no socket|column 'target'",
    ),
    "no column of sockets": (
        CONTACT,
        {
            "touch.csv": touch("a", columns="note"),
            "bad.yaml": "model: fixed-point\n",
        },
        "touch.csv:1|needs a column 'target' with the socket of each row",
    ),
    "distance between unknown sockets": (
        CONTACT,
        {
            "touch.csv": touch("a/0", "a/1"),
            "bad.yaml": APART + "  - {between: [a/0, a/2], value: 0.05}\n",
        },
        "bad.yaml|'distances' names 'a/2', which no row does|did you mean 'a/",
    ),
    "negative distance": (
        CONTACT,
        {
            "touch.csv": touch("a/0", "a/1"),
            "bad.yaml": APART + "  - {between: [a/0, a/1], value: -0.05}\n",
        },
        "bad.yaml:3|distances[0].value|'-0.05'|a positive number",
    ),
    "distance from a socket to itself": (
        CONTACT,
        {
            "touch.csv": touch("a/0", "a/1"),
            "bad.yaml": APART + "  - {between: [a/0, a/0], value: 0.05}\n",
        },
        "bad.yaml:3|distances[0].between|two different names",
    ),
    "camera without intrinsics": (
        "calibrate arm.urdf touch.csv -o out",
        {"touch.csv": PIXELS},
        "'camera' in a setup file (--setup)|mount, focal and center",
    ),
    "camera without a focal length": (
        CONTACT,
        {
            "touch.csv": PIXELS,
            "bad.yaml": "camera:\n  mount: hand\n  center: [640, 480]\n",
        },
        "bad.yaml:1|'camera.focal' is missing",
    ),
    "camera on the head": (
        CONTACT,
        {
            "touch.csv": PIXELS,
            "bad.yaml": CAMERA.replace("hand", "head"),
        },
        "bad.yaml:1|camera.mount|'head'|hand, world",
    ),
    "camera without points": (
        CONTACT,
        {"touch.csv": PIXELS, "bad.yaml": CAMERA},
        "'camera' needs known points|the xyz of 'm' under 'targets'",
    ),
    "unknown point of a camera": (
        CONTACT,
        {
            "touch.csv": PIXELS,
            "bad.yaml": CAMERA + "targets: {n: {xyz: [0, 0, 0]}}\n",
        },
        "touch.csv:2|there is no target 'm'|allowed: n",
    ),
    "unknown anchor": (
        CONTACT,
        {
            "touch.csv": touch("0.5,wire", "0.5,wier", columns="distance,target"),
            "bad.yaml": "model: point-distance\nanchors: {wire: {}}\n",
        },
        "touch.csv:3|there is no anchor 'wier'|did you mean 'wire'",
    ),
    "way without a start": (
        CONTACT,
        {
            "touch.csv": touch("0.5,a", columns="distance,target"),
            "bad.yaml": "model: relative-distance\n",
        },
        "touch.csv:2|the first row of a target is its start|'0.5'|allowed: 0",
    ),
    "negative way": (
        CONTACT,
        {
            "touch.csv": touch("0,a", *["-0.5,a"] * 11, columns="distance,target"),
            "bad.yaml": "model: relative-distance\n",
        },
        "touch.csv:3|'-0.5'|more than 0",
    ),
    "something learned from ways": (
        f"{CONTACT} --learned network",
        {
            "touch.csv": touch("0,a", *["0.5,a"] * 11, columns="distance,target"),
            "bad.yaml": "model: relative-distance\n",
        },
        "bad.yaml|nothing can be learned|'network'",
    ),
    "prior of a socket that nobody has placed": (
        CONTACT,
        {
            "touch.csv": touch("a/0", "a/1"),
            "bad.yaml": "model: fixed-point\nprior: {a/0.socket.x: 0.001}\n",
        },
        "bad.yaml|fixed, bounds or prior|'sockets' in a setup file",
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
        "flat.csv:14|parallel|'wall'",
    ),
    # setup files
    "missing setup": (f"{CALIBRATE} --setup setpu.yaml", {}, "setpu.yaml|'setup.yaml'"),
    "unknown key": (
        SETUP,
        {"bad.yaml": "tip: tool\nparamters: [dh]\n"},
        "bad.yaml:2|'paramters'|'parameters'",
    ),
    "unknown key of a target": (
        SETUP,
        {"bad.yaml": "targets:\n  ball: {xy: [0, 0, 0]}\n"},
        "bad.yaml:2|'targets.ball.xy'|did you mean 'xyz'|xyz, estimate",
    ),
    "known target without a place": (
        SETUP,
        {"bad.yaml": "targets:\n  ball: {estimate: false}\n"},
        "bad.yaml:2|'targets.ball'|estimate: false only together with xyz",
    ),
    "bad YAML": (SETUP, {"bad.yaml": "tip: tool\nbase: [a\n"}, "bad.yaml|YAML"),
    "key twice": (SETUP, {"bad.yaml": "tip: a\ntip: b\n"}, "bad.yaml:2|'tip'|twice"),
    "setup is a list": (SETUP, {"bad.yaml": "- tip\n"}, "bad.yaml:1|mapping"),
    "number as text": (
        SETUP,
        {"bad.yaml": "noise: {position: 0.1 mm}\n"},
        "bad.yaml:1|noise.position|'0.1 mm'|number",
    ),
    "zero normal": (
        SETUP,
        {"bad.yaml": "planes:\n  wall: {normal: [0, 0, 0], offset: 1}\n"},
        "bad.yaml:2|planes.wall.normal|not all 0",
    ),
    "unknown parameterization in a setup": (
        SETUP,
        {"bad.yaml": "parameters: [placments]\n"},
        "bad.yaml:1|'placments'|placement",
    ),
    "glob without a match": (
        SETUP,
        {"bad.yaml": 'fixed: ["*.placment.z"]\n'},
        "'*.placment.z'",
    ),
    "bound that excludes zero": (
        SETUP,
        {"bad.yaml": 'bounds: {"*.placement.x": [0.001, 0.002]}\n'},
        "'*.placement.x'|zero",
    ),
    "mapped joint that is not there": (
        SETUP,
        {"bad.yaml": "joints: {J1: {joint: joint_1}}\n"},
        "'J1'|'joint_1'|did you mean 'joint1'",
    ),
    # gravity, payloads and gears
    "payload without a mass": (
        SETUP,
        {"bad.yaml": "payloads:\n  gripper: {com: [0, 0, 0.1]}\n"},
        "bad.yaml:2|'payloads.gripper.mass' is missing",
    ),
    "negative mass": (
        SETUP,
        {"bad.yaml": "payloads:\n  gripper:\n    mass: -2\n    com: [0, 0, 0]\n"},
        "bad.yaml:3|payloads.gripper.mass|'-2'|in kg, more than 0",
    ),
    "mass in grams of a ship": (
        SETUP,
        {"bad.yaml": "payloads: {ship: {mass: 2.0e+8}}\n"},
        "bad.yaml:1|payloads.ship.mass|'2.0e+8'|in kg|100000",
    ),
    "center of mass of two numbers": (
        SETUP,
        {"bad.yaml": "payloads:\n  gripper:\n    mass: 2\n    com: [0, 0.1]\n"},
        "bad.yaml:4|payloads.gripper.com|[0, 0.1]|three finite numbers in m",
    ),
    "center of mass in millimeters": (
        SETUP,
        {"bad.yaml": "payloads: {gripper: {mass: 2, com: [0, 0, 150]}}\n"},
        "bad.yaml:1|payloads.gripper.com|[0, 0, 150]|in m",
    ),
    "gravity of two numbers": (
        SETUP,
        {"bad.yaml": "parameters: [placement]\ngravity: [0, -9.81]\n"},
        "bad.yaml:2|'gravity'|[0, -9.81]|three finite numbers in m/s^2",
    ),
    "gravity that is not finite": (
        SETUP,
        {"bad.yaml": "gravity: [0, 0, -.inf]\n"},
        "bad.yaml:1|'gravity'|[0, 0, -.inf]|three finite numbers in m/s^2",
    ),
    "gravity in millimeters": (
        SETUP,
        {"bad.yaml": "gravity: [0, 0, -9810]\n"},
        "bad.yaml:1|'gravity'|[0, 0, -9810]|in m/s^2, such as [0, 0, -9.81]",
    ),
    "gear ratio of zero": (
        SETUP,
        {"bad.yaml": "gear_ratios:\n  joint1: 100\n  joint2: 0\n"},
        "bad.yaml:3|gear_ratios.joint2|'0'|other than 0",
    ),
    "gear ratio of no joint": (
        SETUP,
        {
            "bad.yaml": "parameters: [transmission]\ngear_ratios: {joint_2: 100}\n",
        },
        "bad.yaml|'joint_2'|did you mean 'joint2'|gear_ratios|joint1, joint2, joint3",
    ),
    "several payloads": (
        SETUP,
        {"bad.yaml": LOADS},
        "rows.csv:3|several payloads|the row names none|none, light, heavy",
    ),
    "unknown payload": (
        SETUP,
        {
            "rows.csv": column("payload", lambda i, _: "hevy" if i == 3 else "heavy"),
            "bad.yaml": LOADS,
        },
        "rows.csv:6|there is no payload 'hevy'|did you mean 'heavy'|light, heavy",
    ),
    "compliance without a mass": (
        f"{CALIBRATE} --parameters placement,compliance",
        {},
        "'compliance'|'arm'|no mass|<inertial>|payloads in the setup file",
    ),
    "simulated compliance without a mass": (
        f"{SIMULATE} --parameters compliance",
        {},
        "'compliance'|'arm'|no mass|payloads in the setup file",
    ),
    "structure of a compliance without a mass": (
        "identify arm.urdf --model pose --parameters compliance",
        {},
        "'compliance'|'arm'|no mass",
    ),
    "name of a correction": (
        f"{CALIBRATE} --parameters placement,compliances",
        {},
        "'compliances'|did you mean 'compliance'|transmission, compliance",
    ),
    "unknown residual model": (
        f"{CALIBRATE} --learned netwrok",
        {},
        "unknown residual model 'netwrok'|did you mean 'network'|gaussian-process",
    ),
    "unknown residual model in the setup": (
        SETUP,
        {"bad.yaml": "tip: tool\nlearned: netwrok\n"},
        "bad.yaml:2|'learned'|'netwrok'|network, gaussian-process",
    ),
    "too few rows for a ladder": (
        f"{CALIBRATE} --model-ladder",
        {"rows.csv": lines(6)},
        "the model ladder has no footing|4 configurations are too few",
    ),
    "name on no rung of a ladder": (
        f"{SETUP} --model-ladder",
        {"bad.yaml": "fixed: [joint1.transmision.sin1]\n"},
        "bad.yaml|'joint1.transmision.sin1'|did you mean 'joint1.transmission.sin1'",
    ),
    "unknown error of a gear": (
        f"{SIMULATE} --parameters transmission --errors bad.yaml",
        {"bad.yaml": "joint1.transmission.sin: 1.0e-3\n"},
        "bad.yaml:1|'joint1.transmission.sin'|did you mean",
    ),
    # outputs
    "output folder is a file": (
        "calibrate arm.urdf rows.csv -o setup.yaml",
        {},
        "setup.yaml|not a folder",
    ),
    "output exists": (
        "calibrate arm.urdf new.csv -o done",
        {},
        "done/arm.urdf|--force",
    ),
    "output over the robot": (
        "calibrate arm.urdf rows.csv -o . --force",
        {},
        "arm.urdf|input",
    ),
    "simulation exists": (
        "simulate arm.urdf --model position --count 5 -o new.csv",
        {},
        "new.csv|--force",
    ),
    "simulation over the robot": (
        "simulate arm.urdf --model position --count 5 -o arm.urdf --force",
        {},
        "arm.urdf|input",
    ),
    "truth over the robot": (
        f"{SIMULATE} --truth ./arm.urdf --force",
        {},
        "arm.urdf|input",
    ),
    "simulation over its configurations": (
        "simulate arm.urdf --model position --configurations new.csv -o new.csv "
        "--force",
        {},
        "new.csv|input",
    ),
    "two outputs in one file": (f"{SIMULATE} --truth out.csv", {}, "out.csv|two"),
    # calibrations
    "later version": (
        EVALUATE,
        {"done/calibration.json": stored("version", to=2)},
        "done/calibration.json|version|value 2|1 to 1",
    ),
    "no calibration": (
        EVALUATE,
        {"done/calibration.json": '{"format": "something else"}'},
        "done/calibration.json|not a calibration",
    ),
    "cut off": (
        EVALUATE,
        {"done/calibration.json": lines(30)},
        "done/calibration.json:|not a calibration",
    ),
    "so deep that Python gives up": (
        EVALUATE,
        {"done/calibration.json": DEEP},
        "done/calibration.json|not a calibration",
    ),
    "edited value": (
        EVALUATE,
        {"done/calibration.json": stored("parameters", 7, "value", to="1 mm")},
        "done/calibration.json|edited|'1 mm'",
    ),
    "missing value": (
        EVALUATE,
        {"done/calibration.json": stored("parameters", 7, to=None)},
        "done/calibration.json|edited|parameters",
    ),
    "missing part": (
        EVALUATE,
        {"done/calibration.json": stored("frames", "tool", to=None)},
        "done/calibration.json|edited|'tool'",
    ),
    "value that is not finite": (
        EVALUATE,
        {
            "done/calibration.json": stored(
                "frames", "base", "xyz", to=[0.0, float("nan"), 0.0]
            )
        },
        "done/calibration.json|edited|nan",
    ),
    "another robot": (
        EVALUATE,
        dict.fromkeys(
            ("arm.urdf", "done/nominal.urdf"),
            swap('xyz="0 0 0.4"', 'xyz="0 0 0.41"'),
        ),
        "done/calibration.json|arm.urdf|content differs",
    ),
    "no robot is the one": (
        EVALUATE,
        {"done/calibration.json": stored("robot", "sha256", to="0" * 64)},
        "done/calibration.json|arm.urdf|content differs",
    ),
    "measurements of another robot": (
        EVALUATE,
        {"new.csv": header("joint1", "axis_1")},
        "new.csv:2|joint1",
    ),
    "other kind of measurements": (
        "evaluate done/calibration.json distances.csv",
        {},
        "distances.csv:2|'position'|x, y, z",
    ),
    "a calibration has its tip": (f"{EVALUATE} --tip tool", {}, "calibration|tip"),
    # simulation and structure
    "no planes": (
        "simulate arm.urdf --model plane-distance --count 5 -o out.csv",
        {},
        "plane|planes|--setup",
    ),
    "no model": ("simulate arm.urdf --count 5 -o out.csv", {}, "--model|pose"),
    "structure of no model": ("identify arm.urdf", {}, "--model|pose"),
    "no count": ("simulate arm.urdf --model pose -o out.csv", {}, "--count"),
    "count of zero": (f"{SIMULATE} --count 0", {}, "--count|'0'|1 to"),
    "count is no number": (f"{SIMULATE} --count 5.5", {}, "--count|'5.5'"),
    "no repeats": (f"{SIMULATE} --repeats 0", {}, "--repeats|'0'"),
    "negative noise": (f"{SIMULATE} --noise -1e-4", {}, "--noise|'-1e-4'|0 to 1"),
    "infinite noise": (f"{SIMULATE} --noise inf", {}, "--noise|'inf'"),
    "unknown error": (
        f"{SIMULATE} --errors bad.yaml",
        {"bad.yaml": "joint1.placement.x: 1e-3\njoint1.placement.w: 1e-3\n"},
        "bad.yaml:2|'joint1.placement.w'|did you mean",
    ),
    "error is no number": (
        f"{SIMULATE} --errors bad.yaml",
        {"bad.yaml": "joint1.placement.x: 1 mm\n"},
        "bad.yaml:1|joint1.placement.x|'1 mm'",
    ),
    "no errors in the file": (
        f"{SIMULATE} --errors bad.yaml",
        {"bad.yaml": "# none\n"},
        "bad.yaml|empty",
    ),
    "no sockets": (
        "simulate arm.urdf --model fixed-point --count 5 -o out.csv",
        {},
        "'sockets' in a setup file (--setup)",
    ),
    "ways among other measurements": (
        "simulate arm.urdf --model position+relative-distance --count 5 -o out.csv",
        {},
        "relative distances are simulated by themselves",
    ),
    "plane out of reach": (
        "simulate arm.urdf --setup bad.yaml --count 5 -o out.csv",
        {
            "bad.yaml": "model: plane-distance\n"
            "planes: {wall: {normal: [1, 0, 0], offset: -50}}\n"
        },
        "0 of|plane-distance",
    ),
    "configuration out of reach": (
        "simulate arm.urdf --setup plane.yaml --configurations bad.csv -o out.csv",
        {"bad.csv": "joint1,joint2,joint3,joint4\n0,0,0,0\n2.4,0,0,0\n"},
        "configuration 2|plane-distance",
    ),
}


def test_there_are_enough_cases():
    assert len(CASES) >= 40


@pytest.mark.parametrize("name", CASES)
def test_wrong_input(name, here, run, listing):
    command, files, parts = CASES[name]
    for file, content in files.items():
        path = Path(file)
        if callable(content):
            content = content(path.read_text() if path.exists() else "")
        path.write_bytes(content if isinstance(content, bytes) else content.encode())
    before = listing(here)

    result = run(command)

    assert result.out == ""
    assert result.err.endswith("\n")
    assert result.err.count("\n") == 1, result.err
    assert result.err.startswith("calib-pin: ")
    assert "Traceback" not in result.err
    assert "internal error" not in result.err
    for part in parts.split("|"):
        assert part in result.err
    assert len(result.err) < 500
    assert result.status == 1
    assert listing(here) == before


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
    ("prepare", "parts"),
    [
        (few_rows, "6 measured values|identifiable parameters|measure more"),
        (barely_enough_rows, "4 measured values|4 estimated parameters|measure more"),
        (rows_of_another_robot, "not seen|worse than the nominal|position|rms"),
    ],
)
def test_untrusted(prepare, parts, here, run):
    prepare(here)
    result = run("calibrate arm.urdf rows.csv --setup setup.yaml -o out")

    assert result.status == 2
    assert result.err == ""
    first, *_ = result.out.split("\n\n")
    verdict = " ".join(first.split())
    assert verdict.startswith("UNTRUSTED: ")
    assert ".." not in verdict
    for part in parts.split("|"):
        assert part in verdict
    assert result.out.endswith("wrote out/calibration.json\nwrote out/report.html\n")
    assert {path.name for path in Path("out").iterdir()} == TRUSTED_OR_NOT
    assert f"UNTRUSTED: {first.split()[1]}" in Path("out/report.html").read_text()
    document = json.loads(Path("out/calibration.json").read_text())
    assert document["verdict"]["status"] == "untrusted"
    assert document["verdict"]["reason"].rstrip(".") in verdict


def test_untrusted_and_quiet(here, run):
    few_rows(here)
    result = run("calibrate arm.urdf rows.csv --setup setup.yaml --quiet")
    assert (result.status, result.out) == (2, "")
    assert result.err.startswith("calib-pin: note: untrusted: 6 measured values")
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
    assert result.out.startswith("UNTRUSTED: 6 measured values")
    result = run("identify arm.urdf rows.csv --setup setup.yaml --json")
    assert result.status == 2
    assert json.loads(result.out)["verdict"]["status"] == "untrusted"


def test_evaluation_of_an_untrusted_calibration_says_so(here, run):
    rows_of_another_robot(here)
    assert run("calibrate arm.urdf rows.csv --setup setup.yaml -o out").status == 2
    result = run("evaluate out/calibration.json new.csv")
    assert result.status == 2
    assert result.out.startswith(
        "UNTRUSTED: out/calibration.json must not be trusted: on rows"
    )
    assert "Nothing was fitted" in result.out
