"""Wrong input, and what each verdict leaves: status, words, files."""

from __future__ import annotations

import json
import os
import re
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

import calib_pin
from calib_pin.io.results import read_result
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


CALIBRATE = "calibrate arm.urdf rows.csv -o out"
EVALUATE = "evaluate done/calibration.json new.csv"
ANYWAY = {"calibration.json", "measurements.csv", "nominal.urdf", "report.html"}
"""Files of every calibration, whatever its verdict."""


def first(count: int, file: str, to: str) -> None:
    """The first lines of a file."""
    lines = Path(file).read_text().splitlines(keepends=True)
    Path(to).write_text("".join(lines[:count]))


def test_all_rows_for_validation(here, refuses):
    marked("rows.csv", 1)
    refuses(CALIBRATE, line=None)


@pytest.mark.skipif(not hasattr(os, "mkfifo"), reason="needs named pipes")
@pytest.mark.parametrize("name", ["/dev/zero", "pipe"])
def test_the_robot_of_a_calibration_is_a_regular_file(name, here, run, refuses):
    os.mkfifo("pipe")
    os.mkfifo("done/pipe")
    stated = document("done")
    stated["robot"]["file"] = name
    for file in ("moved.json", "done/calibration.json"):
        Path(file).write_text(json.dumps(stated))
    refuses("evaluate moved.json new.csv", file="moved.json")
    # Where there is a copy, nobody waits for what nothing writes to.
    assert run(EVALUATE).status == 0


# --- it ran, but the result must not be trusted ------------------------------------


def few_rows() -> None:
    first(4, "rows.csv", "rows.csv")


def barely_enough_rows() -> None:
    # Four values for the four offsets, with both frames known.
    first(6, "distances.csv", "rows.csv")
    Path("setup.yaml").write_text(
        "parameters: [joint-offset]\nframes: {tool: {estimate: false}}\n"
        "planes: {wall: {normal: [1, 0.2, 0.3], offset: -1.8, estimate: false}}\n"
    )


@pytest.mark.parametrize(
    ("prepare", "words", "status", "number"),
    [
        (few_rows, "", "UNCHECKED", "6"),  # As many measured values.
        (barely_enough_rows, "", "UNCHECKED", "4"),
        (None, "--validation foreign.csv", "UNTRUSTED", "mm"),
    ],
)
def test_untrusted(prepare, words, status, number, here, run):
    if prepare is not None:
        prepare()
    result = run(f"{CALIBRATE} --setup setup.yaml {words}")
    assert (result.status, result.err) == (2, "")
    verdict = " ".join(result.out.partition("\n\n")[0].split())
    assert verdict.startswith(f"{status}: ") and ".." not in verdict
    assert number in re.findall(r"\w+", verdict)


def test_identification_of_too_few_rows(here, run):
    few_rows()
    result = run("identify arm.urdf rows.csv --setup setup.yaml")
    assert result.status == 2
    assert result.out.startswith("UNCHECKED: 6 ")
    result = run("identify arm.urdf rows.csv --setup setup.yaml --json")
    assert result.status == 2
    assert json.loads(result.out)["verdict"]["status"] == "unchecked"


# --- what each verdict leaves behind ----------------------------------------------


COMMAND = "calibrate arm.urdf rows.csv --setup setup.yaml --model position"
REASON = "it is as accurate as it gets"


@pytest.mark.parametrize(
    ("verdict", "status", "first", "urdf"),
    [
        ("good", 0, "GOOD", True),
        ("no-gain", 0, "NO GAIN", True),
        ("unchecked", 2, "UNCHECKED", False),
        ("untrusted", 2, "UNTRUSTED", False),
    ],
)
def test_what_a_verdict_leaves(here, run, monkeypatch, verdict, status, first, urdf):
    judged = replace(read_result("done"), verdict=verdict, reason=REASON)
    monkeypatch.setattr("calib_pin.calibration.calibrate", lambda *_, **__: judged)
    result = run(f"{COMMAND} -o out")
    assert (result.status, result.err) == (status, "")
    assert result.out.startswith(f"{first}: {REASON}.")
    written = {path.name for path in Path("out").iterdir()}
    assert written == (ANYWAY | {"arm.urdf"} if urdf else ANYWAY)
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
