"""Wrong input: one line, the right status, nothing written, no traceback."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import pytest

from tests.cli.files import marked

Edit = Callable[[str], str]


# --- edits of the good files -------------------------------------------------------


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
EVALUATE = "evaluate done/calibration.json new.csv"
TRUSTED_OR_NOT = {"calibration.json", "measurements.csv", "nominal.urdf", "report.html"}
SIMULATE = "simulate arm.urdf --model position --count 5 -o out.csv"
CONTACT = "calibrate arm.urdf touch.csv --setup bad.yaml -o out"


CAMERA = "camera: {mount: hand, focal: [900, 900], center: [640, 480]}\n"
PIXELS = "joint1,joint2,joint3,joint4,u,v,target\n0,0,0.3,0,1,2,m\n0.1,0,0.3,0,1,2,m\n"
MIMIC = swap('<child link="link3"/>', '<child link="link3"/><mimic joint="joint2"/>')
LONGER = swap('xyz="0 0 0.4"', 'xyz="0 0 0.41"')


# Command, fields of the error.
OPTIONS: dict[str, dict[str, Any]] = {
    "calibrat x y": dict(text=("calibrate", "--help")),
    f"{CALIBRATE} --setpu x": dict(text=("--setpu", "--setup")),
    "calibrate": dict(text=("ROBOT", "calibrate --help")),
    "calibrate arm.urdf -o out": dict(text="MEASUREMENTS"),
    f"{CALIBRATE} --setup": dict(text="--setup"),
    f"{CALIBRATE} --loss hubert": dict(reason="'hubert'", allowed="huber"),
    f"{CALIBRATE} --parameters placements": dict(reason="'placement'"),
    f"{CALIBRATE} --parameters dh,dh": dict(value="dh,dh"),
    f"{CALIBRATE} --parameters dh,dh-full": dict(reason="joint1.dh.theta"),
    f"{CALIBRATE} --model positions": dict(reason="'position'"),
    f"{CALIBRATE} --model position+camra": dict(reason="'camera'"),
    f"{CALIBRATE} --model position+position": dict(value="position+position"),
    f"{CALIBRATE} --model camera": dict(file="rows.csv", line=2, column="u"),
    f"{CALIBRATE} --holdout 1.5": dict(reason=("--holdout", "'1.5'")),
    f"{CALIBRATE} --holdout nan": dict(reason=("--holdout", "'nan'")),
    f"{CALIBRATE} --seed one": dict(reason=("--seed", "'one'")),
    f"{CALIBRATE} --seed -1": dict(reason=("--seed", "'-1'")),
    f"{CALIBRATE} --validation rows.csv": dict(file="rows.csv", line=None),
    f"{CALIBRATE} --validation distances.csv": dict(
        file="distances.csv", line=2, column="x", reason="'position'"
    ),
    # the robot
    "calibrate . rows.csv": dict(file="."),
    "calibrate done/calibration.json new.csv": dict(file="done/calibration.json"),
    f"{CALIBRATE} --base baselink": dict(file="arm.urdf", reason="'base_link'"),
    f"{CALIBRATE} --tip base_link": dict(file="arm.urdf"),
    f"{CALIBRATE} --base link4 --tip tool": dict(
        file="arm.urdf", reason=("'link4'", "'tool'")
    ),
    "calibrate arm.urdf done": dict(file="done"),
    # the setup
    f"{CALIBRATE} --setup setpu.yaml": dict(file="setpu.yaml", reason="'setup.yaml'"),
    # outputs
    "calibrate arm.urdf rows.csv -o setup.yaml": dict(file="setup.yaml"),
    "calibrate arm.urdf new.csv -o done": dict(file="done/arm.urdf"),
    "calibrate arm.urdf rows.csv -o . --force": dict(file="arm.urdf"),
    "simulate arm.urdf --model position --count 5 -o new.csv": dict(file="new.csv"),
    f"{SIMULATE} -o arm.urdf --force": dict(file="arm.urdf"),
    f"{SIMULATE} --truth ./arm.urdf --force": dict(file="arm.urdf"),
    f"{SIMULATE} --truth out.csv": dict(file="out.csv"),
    "simulate arm.urdf --model position --configurations new.csv -o new.csv "
    "--force": dict(file="new.csv"),
    # calibrations
    "evaluate done/calibration.json distances.csv": dict(
        file="distances.csv", line=2, column="x", reason="'position'"
    ),
    f"{EVALUATE} --tip link3": dict(reason="tip"),
    # simulation and structure
    "simulate arm.urdf --model plane-distance --count 5 -o out.csv": dict(
        reason="planes"
    ),
    "simulate arm.urdf --model fixed-point --count 5 -o out.csv": dict(
        reason="'sockets'"
    ),
    "identify arm.urdf": dict(reason="--model", allowed="pose"),
    "simulate arm.urdf --model pose -o out.csv": dict(reason="--count"),
    f"{SIMULATE} --count 0": dict(reason=("--count", "'0'")),
    f"{SIMULATE} --count 5.5": dict(reason=("--count", "'5.5'")),
    f"{SIMULATE} --repeats 0": dict(reason=("--repeats", "'0'")),
    f"{SIMULATE} --noise -1e-4": dict(reason=("--noise", "'-1e-4'")),
    f"{SIMULATE} --noise inf": dict(reason=("--noise", "'inf'")),
    f"{SIMULATE} --parameters compliance": dict(reason=("'compliance'", "'arm'")),
    "identify arm.urdf --model pose --parameters compliance": dict(
        reason=("'compliance'", "'arm'")
    ),
}

# Command, files to write first, fields of the error. What reading a file refuses is
# tested with the reader, in tests/io, and what a setup states of a robot or of rows
# with what uses it; here stands one case of each kind of file. The cases of
# `test_messages.py` are not repeated.
Case = tuple[Any, Mapping[str, str | Edit], dict[str, Any]]
CASES: dict[str, Case] = {
    "empty tip": (
        ["calibrate", "arm.urdf", "rows.csv", "--tip", ""],
        {},
        dict(reason="'tip'", value=""),
    ),
    "mimic joint": (
        CALIBRATE,
        {"arm.urdf": MIMIC},
        dict(file="rows.csv", line=3, column="joint3", reason="'joint2'"),
    ),
    "camera without points": (
        CONTACT,
        {"touch.csv": PIXELS, "bad.yaml": CAMERA},
        dict(reason=("'camera'", "'m'", "'targets'")),
    ),
    # setup files
    "bound that excludes zero": (
        SETUP,
        {"bad.yaml": 'bounds: {"*.placement.x": [0.001, 0.002]}\n'},
        dict(file="bad.yaml", value=[0.001, 0.002], reason="'*.placement.x'"),
    ),
    "error is no number": (
        f"{SIMULATE} --errors bad.yaml",
        {"bad.yaml": "joint1.placement.x: 1 mm\n"},
        dict(file="bad.yaml", line=1, value="1 mm", reason="joint1.placement.x"),
    ),
    "no errors in the file": (
        f"{SIMULATE} --errors bad.yaml",
        {"bad.yaml": "# none\n"},
        dict(file="bad.yaml", line=1),
    ),
    # calibrations
    "earlier version": (
        EVALUATE,
        {"done/calibration.json": stored("version", to=1)},
        dict(file="done/calibration.json", value=1, allowed="2"),
    ),
    "another robot": (
        EVALUATE,
        dict.fromkeys(("arm.urdf", "done/nominal.urdf"), LONGER),
        dict(file="done/calibration.json", reason="arm.urdf"),
    ),
}


def test_wrong_options(here, refuses):
    for words, fields in OPTIONS.items():
        refuses(words, **fields)


@pytest.mark.parametrize("name", CASES)
def test_wrong_input(name, here, refuses):
    command, files, fields = CASES[name]
    for file, content in files.items():
        path = Path(file)
        if callable(content):
            content = content(path.read_text() if path.exists() else "")
        path.write_text(content)
    refuses(command, **fields)


def test_all_rows_for_validation(here, refuses):
    marked("rows.csv", 1)
    refuses(CALIBRATE, line=None)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize("name", ["/dev/zero", "pipe"])
def test_the_robot_of_a_calibration_is_a_regular_file(name, here, run, refuses):
    os.mkfifo("pipe")
    os.mkfifo("done/pipe")
    edit = stored("robot", "file", to=name)
    file = Path("done/calibration.json")
    Path("moved.json").write_text(edit(file.read_text()))
    refuses("evaluate moved.json new.csv", file="moved.json")
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
    ("prepare", "status", "number"),
    [
        (few_rows, "unchecked", "6"),  # As many measured values.
        (barely_enough_rows, "unchecked", "4"),
        (rows_of_another_robot, "untrusted", "mm"),
    ],
)
def test_untrusted(prepare, status, number, here, run):
    prepare(here)
    result = run("calibrate arm.urdf rows.csv --setup setup.yaml -o out")

    assert (result.status, result.err) == (2, "")
    first, *_ = result.out.split("\n\n")
    verdict = " ".join(first.split())
    assert verdict.startswith(f"{status.upper()}: ")
    assert ".." not in verdict
    assert number in re.findall(r"\w+", verdict)
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
    assert result.err.startswith("calib-pin: note: unchecked: 6 ")
    assert result.err.count("\n") == 1


def test_the_robot_of_an_earlier_run_does_not_stay(here, run):
    few_rows(here)
    result = run("calibrate arm.urdf rows.csv --setup setup.yaml -o done --force")
    assert result.status == 2
    assert result.err.startswith("calib-pin: note: ") and "done/arm.urdf" in result.err
    assert {path.name for path in Path("done").iterdir()} == TRUSTED_OR_NOT


def test_identification_of_too_few_rows(here, run):
    few_rows(here)
    result = run("identify arm.urdf rows.csv --setup setup.yaml")
    assert result.status == 2
    assert result.out.startswith("UNCHECKED: 6 ")
    result = run("identify arm.urdf rows.csv --setup setup.yaml --json")
    assert result.status == 2
    assert json.loads(result.out)["verdict"]["status"] == "unchecked"


def test_evaluation_of_an_untrusted_calibration_says_so(here, run):
    rows_of_another_robot(here)
    assert run("calibrate arm.urdf rows.csv --setup setup.yaml -o out").status == 2
    result = run("evaluate out/calibration.json new.csv")
    assert result.status == 2
    assert result.out.startswith("UNTRUSTED: out/calibration.json ")
