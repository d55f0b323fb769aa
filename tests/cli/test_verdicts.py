"""What each verdict leaves behind: exit status, words, files, and what reads them."""

from __future__ import annotations

import shutil
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib_pin
import calib_pin.calibration
from calib_pin.validation.result import CalibrationResult
from tests.cli.files import document

COMMAND = "calibrate arm.urdf rows.csv --setup setup.yaml --model position"
REASON = "it is as accurate as it gets"


@pytest.fixture
def judged(monkeypatch: pytest.MonkeyPatch) -> Callable[[str], None]:
    """Whatever is calibrated gets a verdict."""
    calibrate = calib_pin.calibration.calibrate

    def judge(verdict: str) -> None:
        def judged(*args: Any, **options: Any) -> CalibrationResult:
            found = calibrate(*args, **options)
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
    assert (REASON in quiet.err) == (status == 2)

    evaluated = run("evaluate out/calibration.json new.csv")
    assert evaluated.status == status
    assert evaluated.out.startswith("UNTRUSTED: ") == (status == 2)
    compared = run("compare out/calibration.json done/calibration.json")
    assert compared.status == status
    assert (f"{first}: A (out/calibration.json)" in compared.out) == (status == 2)


def test_no_gain_replaces_the_robot_of_an_earlier_run(here, run, judged):
    shutil.copytree("done", "out")
    corrected = Path("out/arm.urdf").read_bytes()
    judged("no-gain")
    assert run(f"{COMMAND} -o out --force").status == 0
    nominal = Path("arm.urdf").read_bytes()
    assert Path("out/arm.urdf").read_bytes() == nominal != corrected
    # A folder that was calibrated can be calibrated again.
    again = run("calibrate out/nominal.urdf rows.csv --setup setup.yaml -o out --force")
    assert again.status == 0
    assert Path("out/nominal.urdf").read_bytes() == nominal


def test_lines_that_undo_a_fault_stand_once(here, run):
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
