"""`calib-pin compare` as users run it."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from calib_pin.io.results import read_result
from calib_pin.validation.comparison import compare, faults
from tests.cli.files import document

PAIR = "compare done/calibration.json later/calibration.json"


def edited(change: Callable[[dict[str, Any]], object]) -> None:
    """Change the second calibration."""
    found = document("later")
    change(found)
    Path("later/calibration.json").write_text(json.dumps(found))


def test_two_calibrations_of_one_robot(here, run, listing):
    before = listing(here)
    result = run(PAIR)
    assert (result.status, result.err) == (0, "")
    assert result.out.startswith("No drift ")
    assert max(map(len, result.out.splitlines())) <= 80
    assert listing(here) == before


def test_configurations_follow_the_seed(here, run):
    assert run(f"{PAIR} --seed 1").out != run(PAIR).out


def test_a_drift_is_no_failure(here, run):
    words = "calibrate arm.urdf foreign.csv --setup setup.yaml -o later --quiet --force"
    assert run(words).status == 0
    result = run(PAIR)
    assert (result.status, result.err) == (0, "")
    assert result.out.startswith("The robot changed")
    assert "joint3.joint-offset.q " in result.out


def test_calibrations_of_different_robots(here, run):
    text = Path("arm.urdf").read_text()
    Path("other.urdf").write_text(text.replace("0.5 0 0.05", "0.6 0 0.05"))
    words = "simulate other.urdf --model position --count 25 --noise 1e-4 -o other.csv"
    words += " --errors errors.yaml --parameters joint-offset"
    assert run(words).status == 0
    words = "calibrate other.urdf other.csv --setup setup.yaml -o later --quiet --force"
    assert run(words).status == 0
    result = run(PAIR)
    assert (result.status, result.err) == (2, "")
    (finding,) = faults(compare(read_result("done"), read_result("later")))
    assert (finding.code, finding.severity) == ("different-robots", "error")
    assert finding.evidence["rms"] > 0.02


@pytest.mark.parametrize(
    ("change", "named"),
    [
        (lambda d: d.update(version=1), "calibrate again"),
        (lambda d: d["parameters"][0].update(sigma="1 mm"), "1 mm"),
        (lambda d: d["robot"].update(tip="link4"), "compared"),
        (lambda d: d.pop("identifiability"), "'identifiability."),
        (lambda d: d["robot"].update(sha256="0" * 64), "is not the robot"),
    ],
)
def test_wrong_files(change, named, here, fails):
    edited(change)
    fails(PAIR, "later/", named)
