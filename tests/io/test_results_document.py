"""What a calibration.json tells comes back, or is refused in one line."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import Any

import pytest

from calib_pin.errors import InputError
from calib_pin.io.json_text import encode
from calib_pin.io.results import calibration_document, read_accuracy, read_result
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


def test_what_is_not_known(document):
    """JSON has no infinity, and a fit without redundancy no predicted uncertainty."""
    for error in document["errors"].values():
        error["validation"]["after"]["max"] = None
        error["validation"]["before"] = None
    found = read_result(stored(document))
    for error in found.errors:
        assert math.isnan(error.validation_after.max)
        assert error.validation_before is None
    for predicted in (None, {"position": None, "orientation": None}):
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
    ((*COUPLED, 0, "terms", 0, "coefficient"), "1"),
    ((*COUPLED, 0, "value"), DEEP),
    (("predicted", "robot", "position"), 10**400),
    (("predicted", "samples", "points", 0, 0), 10**400),
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
