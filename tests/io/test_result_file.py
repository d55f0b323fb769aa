"""What a calibration.json tells comes back, or is refused in one line."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError
from calib_pin.io.calibration_document import calibration_document
from calib_pin.io.json_text import encode
from calib_pin.io.result_file import read_result
from calib_pin.io.results import read_accuracy
from calib_pin.validation.comparison import DESCRIBED, compare, stated_noise
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.summaries import Provenance


@pytest.fixture(scope="module")
def result(calibrated_robot) -> CalibrationResult:
    return calibrated_robot("pose", count=40)


@pytest.fixture
def document(result, tmp_path, monkeypatch) -> dict[str, Any]:
    monkeypatch.chdir(tmp_path)
    provenance = Provenance(("calib-pin",), "2026-03-01T10:00:00+00:00", 0.5, {})
    return json.loads(encode(calibration_document(result, provenance)))


def stored(document: object) -> str:
    Path("c.json").write_text(json.dumps(document))
    return "c.json"


def test_all_comes_back(document, result):
    document["measurements"]["files"] = [
        {"file": "a.csv", "sha256": "abc"},
        {"file": "/dev/stdin", "sha256": ""},
    ]
    found = read_result(stored(document))
    assert found.parameters == result.parameters
    assert found.groups == result.groups
    assert found.robot_errors == result.robot_errors != ()
    assert found.errors == result.errors
    assert found.accuracy.tip.rms == result.accuracy.tip.rms
    assert found.accuracy.tip.of_robot == result.accuracy.tip.of_robot
    assert stated_noise(found) == result.statistics.sigma0
    assert (found.validation.method, len(found.fitted)) == ("5-fold", 40)
    assert (found.verdict, found.reason) == ("good", result.reason)
    assert result.reason and found.provenance.file == "c.json"
    assert found.provenance.hashes == ("abc", "")
    assert found.provenance.created == "2026-03-01T10:00:00+00:00"
    assert stated_noise(found) < DESCRIBED
    both = compare(found, found)
    assert both.oriented and both.drift.absorbed == ("base", "tool")


def test_older_files(document):
    del document["predicted"], document["provenance"]
    del document["statistics"]["stated_sigma"]
    for error in document["errors"].values():
        del error["training"]["after"]["p95"]
        error["validation"]["after"]["max"] = None  # JSON has no infinity.
        error["validation"]["before"] = None
    found = read_result(stored(document))
    assert found.accuracy.tip is None and stated_noise(found) is None
    assert found.provenance.created == ""
    for error in found.errors:
        assert math.isnan(error.after.p95)
        assert math.isnan(error.validation_after.max)
        assert error.validation_before is None
    for predicted in (None, {"position": None, "orientation": 1e-4}):
        document["predicted"] = predicted
        assert read_result(stored(document)).accuracy.tip is None


def test_the_accuracy_is_that_of_the_record(document):
    record = read_result(stored(document))
    for name, stated in read_accuracy("c.json").items():
        (error,) = (e for e in record.errors if e.name == name)
        after = error.validation_after
        assert stated == {
            "unit": error.unit,
            "mean": after.mean,
            "max": after.max,
            "method": "5-fold",
        }


DEEP: list[Any] = []
for _ in range(200):
    DEEP = [DEEP]

POSITION, COUPLED = ("errors", "position"), ("identifiability", "coupled")
DAMAGE: list[tuple[tuple[Any, ...], Any]] = [
    *(((key,), ...) for key in ("errors", "statistics", "verdict")),
    (("errors",), [1]),
    (POSITION, "fine"),
    ((*POSITION, "unit"), "furlong"),
    ((*POSITION, "training"), ...),
    ((*POSITION, "training", "after", "rms"), ...),
    (("parameters", 7, "sigma"), -1e-3),
    ((*COUPLED, 0, "terms", 0, "coefficient"), 1e300),
    ((*COUPLED, 0, "value"), DEEP),
    (("predicted", "position"), 10**400),
    (("predicted", "samples", "points", 0, 0), 1e9),
    (("predicted", "samples", "position", 0), ...),
    (("statistics", "sigma0"), "one"),
    (("measurements", "training"), ...),
    (("verdict", "status"), "fine"),
    (("provenance",), 7),
    (("provenance", "command"), ["calib-pin", True]),
]


def test_damaged_and_edited_files(document, refused):
    samples, document["covariance"] = document["predicted"]["samples"], None
    for name in samples:
        samples[name] = samples[name][:3]
    text = json.dumps(document)
    for path, to in DAMAGE:
        part = edited = json.loads(text)
        for step in path[:-1]:
            part = part[step]
        if to is ...:
            del part[path[-1]]
        else:
            part[path[-1]] = to
        with refused(InputError, file="c.json"):
            read_result(stored(edited))
    for content, fields in {
        "": {},
        "[1, 2": {"line": 1},
        "[" * 100_000: {},
        '{"format": "calib-pin/comparison"}': {},
        '{"format": "calib-pin/calibration", "version": 9}': {"value": 9},
    }.items():
        Path("c.json").write_text(content)
        with refused(InputError, file="c.json", **fields):
            read_result("c.json")


OLDER = Path(__file__).parents[1] / "data" / "calibration-0.1"


def test_a_folder_of_an_older_version():
    """It has neither `measurements.csv` nor what came with it."""
    found = read_result(OLDER)
    assert (found.verdict, len(found.fitted)) == ("good", 40)
    assert found.identifiability.structural_rank == 34
    assert len(found.fitted) == 40 and np.isnan(found.fitted.after).all()
    assert found.held_out is None and np.isnan(found.covariance).all()


@pytest.mark.slow
def test_a_folder_of_an_older_version_has_a_report(tmp_path):
    calib_pin.report(OLDER, tmp_path / "page.html")
    assert b"GOOD" in (tmp_path / "page.html").read_bytes()
