"""Wrong input, and what each verdict leaves: status, words, files."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import calib_pin
import calib_pin.calibration
from calib_pin.io.results import read_result
from calib_pin.validation.result import CalibrationResult
from tests.cli.files import document, marked

MESSAGES, REFUSALS = (
    yaml.safe_load(Path(__file__).with_name(name).read_text())
    for name in ("messages.yaml", "refusals.yaml")
)
# `messages.yaml` has it word by word for one mistake of each kind, `refusals.yaml` what
# the line names for many others: a change of wording breaks the former alone.


@pytest.mark.parametrize("case", MESSAGES, ids=lambda case: case["run"])
def test_messages(case: dict[str, Any], here: Path, run: Callable[..., object]) -> None:
    for name, text in case.get("files", {}).items():
        (here / name).write_text(text)
    result = run(case["run"])
    assert (result.status, result.out) == (1, "")
    assert result.err == f"calib-pin: {case['says']}\n"


@pytest.mark.parametrize("of", REFUSALS, ids=lambda of: of["run"])
def test_refusals(of, here, inside, opened, fails, refuses) -> None:
    for name, text in of.get("files", {}).items():
        (here / name).parent.mkdir(parents=True, exist_ok=True)
        (here / name).write_text(text)
    for key, named in of["refused"].items():
        words = f"{of['run']} {key}"
        if "file" in of:
            words = of["run"]
            (here / of["file"]).write_text(key)
        if isinstance(named, dict):
            refuses(words, **named)
        else:
            fails(words, named)
    assert opened == [], "no window"


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
EVALUATE = "evaluate done/calibration.json new.csv"
TRUSTED_OR_NOT = {"calibration.json", "measurements.csv", "nominal.urdf", "report.html"}
MIMIC = swap('<child link="link3"/>', '<child link="link3"/><mimic joint="joint2"/>')
LONGER = swap('xyz="0 0 0.4"', 'xyz="0 0 0.41"')


# Command, files to write first, fields of the error. What reading a file refuses is
# tested with the reader, in tests/io, and what a setup states of a robot or of rows
# with what uses it; here stands one case of each kind of file.
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


def test_identification_of_too_few_rows(here, run):
    few_rows(here)
    result = run("identify arm.urdf rows.csv --setup setup.yaml")
    assert result.status == 2
    assert result.out.startswith("UNCHECKED: 6 ")
    result = run("identify arm.urdf rows.csv --setup setup.yaml --json")
    assert result.status == 2
    assert json.loads(result.out)["verdict"]["status"] == "unchecked"


# --- what each verdict leaves behind ----------------------------------------------


COMMAND = "calibrate arm.urdf rows.csv --setup setup.yaml --model position"
REASON = "it is as accurate as it gets"


@pytest.fixture
def judged(here: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Whatever is calibrated was calibrated before, and gets a verdict."""
    found = read_result("done")

    def judge(verdict: str) -> None:
        def judged(*args: Any, **options: Any) -> CalibrationResult:
            return replace(found, verdict=verdict, reason=REASON)

        monkeypatch.setattr(calib_pin.calibration, "calibrate", judged)

    return judge


@pytest.mark.parametrize(
    ("verdict", "status", "first", "urdf"),
    [
        ("good", 0, "GOOD", True),
        ("no-gain", 0, "NO GAIN", True),
        ("unchecked", 2, "UNCHECKED", False),
        ("untrusted", 2, "UNTRUSTED", False),
    ],
)
def test_what_a_verdict_leaves(here, run, judged, verdict, status, first, urdf):
    judged(verdict)
    result = run(f"{COMMAND} -o out")
    assert (result.status, result.err) == (status, "")
    assert result.out.startswith(f"{first}: {REASON}.")
    assert Path("out/arm.urdf").exists() == urdf
    assert ("wrote out/arm.urdf" in result.out) == urdf
    nominal = Path("arm.urdf").read_bytes()
    assert Path("out/nominal.urdf").read_bytes() == nominal
    if urdf:
        same = Path("out/arm.urdf").read_bytes() == nominal
        assert same == (verdict == "no-gain")
    assert f"{first}: {REASON}." in Path("out/report.html").read_text()
    assert document("out")["verdict"] == {"status": verdict, "reason": REASON}

    quiet = run(f"{COMMAND} --holdout 0.2 --quiet")
    assert (quiet.status, quiet.out) == (status, "")
    noted = f"calib-pin: note: {first.lower()}: {REASON}\n" if status == 2 else ""
    assert quiet.err == noted

    evaluated = run("evaluate out/calibration.json new.csv")
    assert evaluated.status == status
    doubted = evaluated.out.startswith(f"{first}: out/calibration.json ")
    assert doubted == (status == 2)
    compared = run("compare out/calibration.json done/calibration.json")
    assert compared.status == status
    assert (f"{first}: A (out/calibration.json)" in compared.out) == (status == 2)


def test_lines_that_undo_a_fault_stand_once(here, run, sought):
    chain = calib_pin.load_chain("arm.urdf", tip="tool")
    rows = calib_pin.read_measurements("rows.csv", chain).only
    signs = np.where(np.array(rows.joints) == "joint2", -1.0, 1.0)
    calib_pin.write_measurements("reversed.csv", replace(rows, q=rows.q * signs))
    result = run("calibrate arm.urdf reversed.csv --setup setup.yaml")
    assert result.status == 2
    first, _, rest = result.out.partition("Lines for the setup file\n")
    assert first.startswith("UNTRUSTED: joint 'joint2'")
    assert rest.startswith("  joints:\n    joint2: {joint: joint2, sign: -1}\n")
    assert result.out.count("sign: -1") == 1
