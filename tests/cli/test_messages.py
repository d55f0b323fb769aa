"""Golden messages: what a user reads, word by word, for one mistake of each kind.

All other tests compare the fields of errors, so a change of wording breaks these alone.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

JOINTS = "joint1,joint2,joint3,joint4"
CALIBRATE = "calibrate arm.urdf rows.csv"
SIMULATE = "simulate arm.urdf --model position --count 5 -o out.csv"
PLAN = "plan arm.urdf --model position --setup setup.yaml -o plan.csv"
COMPENSATE = "compensate done/calibration.json bad.csv -o commands.csv"

# (command, files to write first, the line without the name of the program)
MESSAGES: list[tuple[str, Mapping[str, str], str]] = [
    (
        f"{CALIBRATE} --solver lm",
        {},
        "unknown solver 'lm'; allowed: gauss-newton, two-step, de, hybrid",
    ),
    (
        f"{CALIBRATE} --holdout 20%",
        {},
        "--holdout cannot be '20%'; allowed: a number between 0 and 1",
    ),
    (
        f"{CALIBRATE} --holdout 0.2 --validation new.csv",
        {},
        "give validation measurements or a holdout, not both",
    ),
    (f"{CALIBRATE} ./rows.csv", {}, "rows.csv: this file is given twice"),
    (
        "simulate arm.urdf --model pose --count 5 -o new.csv",
        {},
        "new.csv: exists already; --force replaces it",
    ),
    (
        f"{CALIBRATE} -o . --force",
        {},
        "arm.urdf: is an input of this run, and inputs are never changed; "
        "allowed: another file",
    ),
    (f"{CALIBRATE} --figures rows.csv", {}, "rows.csv: is a file, not a folder"),
    (
        f"{CALIBRATE} --tip tol",
        {},
        "arm.urdf: the robot has no link 'tol' for the tip (did you mean "
        "'tool'?); allowed: base_link, link1, link2, link3, link4, tool",
    ),
    (
        f"{CALIBRATE} --parameters compliance",
        {},
        "'compliance' needs something that gravity pulls at: there is no "
        "gravity, or the links of 'arm' have no mass that loads a joint and "
        "there is no payload; allowed: <inertial> in the URDF, or payloads in "
        "the setup file",
    ),
    (
        "calibrate ram.urdf rows.csv",
        {},
        "ram.urdf: no such file (did you mean 'arm.urdf'?); allowed: a URDF "
        "or xacro file, a bundled robot (heavy6, pa10, space6, space7), or "
        "example:NAME",
    ),
    (
        "calibrate rows.csv rows.csv",
        {},
        "rows.csv: is not XML (value b'# simulated by: '); allowed: a URDF, as text",
    ),
    (
        "calibrate arm.urdf row.csv",
        {},
        "row.csv: no such file (did you mean 'rows.csv'?)",
    ),
    (
        "calibrate arm.urdf bad.csv",
        {"bad.csv": ""},
        "bad.csv: the file is empty, it needs a header and rows",
    ),
    (
        "calibrate arm.urdf bad.csv",
        {"bad.csv": "joint1,joint2,joint_3,joint4,x,y,z\n0,0,0,0,1,2,3\n"},
        "bad.csv:1: no joint column joint3 (did you mean 'joint_3'?) (column 'joint3')",
    ),
    (
        "calibrate arm.urdf bad.csv",
        {"bad.csv": f"{JOINTS},x,y,z\n0,0,0,0,1,2,3\n0,0,0,0,1,-Inf,3\n"},
        "bad.csv:3: not a finite number (column 'y', value '-Inf'); allowed: a "
        "finite number",
    ),
    (
        "calibrate arm.urdf bad.csv",
        {"bad.csv": f"{JOINTS},x,y,z\n0,0,0,0,900,2,3\n"},
        "bad.csv:2: 900 m looks like the wrong unit; write the header as 'x "
        "[mm]' (column 'x', value '900'); allowed: m, mm, um, in",
    ),
    (
        "calibrate arm.urdf bad.csv",
        {"bad.csv": f"{JOINTS},x [cm],y,z\n0,0,0,0,900,2,3\n"},
        "bad.csv:1: unit 'cm' does not fit here (column 'x'); allowed: m, mm, um, in",
    ),
    (
        f"{CALIBRATE} --setup bad.yaml",
        {"bad.yaml": "tip: tool\nparamters: [dh]\n"},
        "bad.yaml:2: unknown key 'paramters' (did you mean 'parameters'?); "
        "allowed: base, tip, chains, model, parameters, learned, frames, stations, "
        "tools, planes, targets, sockets, spheres, anchors, camera, board, distances, "
        "angles, columns, joints, encoder_steps, reading and 19 more",
    ),
    (
        f"{CALIBRATE} --setup bad.yaml",
        {"bad.yaml": "payloads:\n  gripper: {mass: -2, com: [0, 0, 0]}\n"},
        "bad.yaml:2: 'payloads.gripper.mass' cannot have this value (value "
        "'-2'); allowed: a positive number [kg], at most 100000",
    ),
    (
        "calibrate arm.urdf distances.csv --setup bad.yaml",
        {"bad.yaml": "planes: {wal: {normal: [1, 0, 0], offset: -1}}\n"},
        "distances.csv:3: there is no plane 'wall' (did you mean 'wal'?) (column "
        "'target'); allowed: wal",
    ),
    (
        f"{CALIBRATE} --model-ladder --learned netwrok",
        {},
        "unknown residual model 'netwrok' (did you mean 'network'?); allowed: "
        "network, gaussian-process",
    ),
    (
        "evaluate done new.csv",
        {},
        "done: is a folder; allowed: done/calibration.json, or a robot",
    ),
    (
        "evaluate bad.json new.csv",
        {"bad.json": '{"format": "x"}'},
        "bad.json: not a calibration of calib-pin",
    ),
    (
        "simulate arm.urdf --count 5 -o out.csv",
        {},
        "without measurements, --model must name the measurement model; "
        "allowed: position, pose, plane-distance, point-distance, "
        "relative-distance, fixed-point, plane-contact, sphere-contact, camera",
    ),
    (
        f"{SIMULATE} --errors bad.yaml",
        {"bad.yaml": "joint1.placement.w: 1e-3\n"},
        "bad.yaml:1: no parameter 'joint1.placement.w' (did you mean "
        "'joint1.placement.z'?)",
    ),
    (PLAN, {}, "say how many configurations to plan with --count N"),
    (
        f"{PLAN} --count 3 --ignore-collisions --candidates 100",
        {},
        "3 configurations cannot determine the 11 identifiable parameters; "
        "allowed: 4 or more (--count, --add)",
    ),
    (
        f"{PLAN} --count 8 --limits joint1=-90:90",
        {},
        "--limits cannot be 'joint1=-90:90'; allowed: LOWER up to UPPER, at most "
        "12.57 rad or m; other units in brackets: [deg]",
    ),
    (
        COMPENSATE,
        {"bad.csv": "a,b\n1,2\n"},
        "bad.csv:1: neither targets nor joint positions; targets need x, y, z "
        "and may have an orientation, a motion needs the joints joint1, joint2, "
        "joint3, joint4",
    ),
    (
        "compare done/calibration.json done/calibration.json",
        {},
        "done/calibration.json: this file is given twice",
    ),
    ("fleet -o out", {}, "give either a table of JOBS, or --monte-carlo SETUP"),
    (
        "accept arm.urdf rows.csv --tip tool",
        {},
        "rows.csv: no pose was visited 3 times: 40 poses, at most 1 visits of one; "
        "allowed: repeated poses; 'plan --accept --cycles N' asks for them",
    ),
    (
        f"{CALIBRATE} --process-noise 1e-5",
        {},
        "a process noise belongs to an older calibration, 'start'",
    ),
]


@pytest.mark.parametrize(("words", "files", "message"), MESSAGES)
def test_messages(
    words: str,
    files: Mapping[str, str],
    message: str,
    here: Path,
    run: Callable[..., object],
) -> None:
    for name, text in files.items():
        (here / name).write_text(text)
    result = run(words)
    assert (result.status, result.out) == (1, "")
    assert result.err == f"calib-pin: {message}\n"
