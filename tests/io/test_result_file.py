"""What a calibration.json tells comes back, or is refused in one line."""

from __future__ import annotations

import json
import math
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.calibration import calibrate
from calib_pin.errors import InputError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.calibration_document import calibration_document
from calib_pin.io.json_text import encode
from calib_pin.io.result_file import read_result
from calib_pin.io.results import read_accuracy
from calib_pin.setup import Setup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.validation.accuracy import Accuracy, QuantityErrors
from calib_pin.validation.breakdown import (
    BlockSummary,
    Breakdown,
    ChainSummary,
    CoupledFrames,
    FrameSummary,
)
from calib_pin.validation.comparison import DESCRIBED, compare, stated_noise
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.summaries import Provenance, ToolAccuracy


@pytest.fixture(scope="module")
def result() -> CalibrationResult:
    chain = calib_pin.load_chain("space6")
    problem = nominal_problem(chain, "pose", Setup())
    rng = np.random.default_rng(0)
    theta = draw_errors(problem.parameters, rng)
    return calibrate(chain, simulate(problem, theta, rng, count=40), Setup())


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


def test_the_breakdown_comes_back(result, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    unknown = Accuracy(1.0, 2.0, math.inf, 4.0)
    errors = (QuantityErrors("position", "m", unknown, unknown, None, None),)
    noise = result.statistics.noise
    assert noise
    pose = (0.1, 0.2, 0.3), (0.4, 0.5, 0.6)
    told = Breakdown(
        accuracies={"": result.accuracy, "touch": ToolAccuracy()},
        stations=(FrameSummary("a", "b", 7, errors, noise, *pose, (1e-3,) * 6, True),),
        tools=(FrameSummary("tool", "t", 7, errors, noise, *pose, (), False),),
        chains=(ChainSummary("", "b", "t", ("j", "k"), 7, errors, ("k",)),),
        blocks=(
            BlockSummary(
                *("pose", "", "a", "tool", 7, ("x", ""), errors, noise, 3, 2),
                ties=(("a",), ("tool", "c")),
            ),
        ),
        coupled_frames=(CoupledFrames(("a", "c"), "a.z + c.z", "both move"),),
    )
    whole = replace(result, **vars(told))
    # There is no such chain, so that it could not be read.
    data = encode(calibration_document(whole, Provenance((), "", 0.5, {})))
    document = json.loads(data)
    assert list(document["predicted_by_chain"]) == ["touch"]
    del document["predicted_by_chain"]
    Path("c.json").write_text(json.dumps(document))
    found = read_result("c.json")
    for name in ("stations", "tools", "chains", "blocks", "coupled_frames"):
        assert getattr(found, name) == getattr(told, name), name


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


def edit(*path: str | int, to: object) -> Callable[[dict[str, Any]], None]:
    def change(document: dict[str, Any]) -> None:
        part: Any = document
        for step in path[:-1]:
            part = part[step]
        if to is ...:
            del part[path[-1]]
        else:
            part[path[-1]] = to

    return change


COUPLED = ("identifiability", "coupled")
DEEP: list[Any] = []
for _ in range(200):
    DEEP = [DEEP]


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (edit("errors", to=...), "'errors' is missing"),
        (edit("errors", to=[1]), "list"),
        (edit("errors", "position", to="fine"), "str"),
        (edit("errors", "position", "unit", to="furlong"), "'furlong' is no unit"),
        (edit("errors", "position", "training", to=...), "'training' is missing"),
        (edit("errors", "position", "training", "after", to=None), "NoneType"),
        (edit("errors", "position", "training", "after", "rms", to="1"), "'1' stands"),
        (edit("errors", "position", "training", "after", "rms", to=...), "'rms' is"),
        (edit("errors", "position", "validation", "method", to=3), "3 stands"),
        (edit("parameters", 7, "sigma", to=...), "'sigma' is missing"),
        (edit("parameters", 7, "sigma", to=math.nan), "nan stands"),
        (edit("parameters", 7, "sigma", to=-1e-3), "standard deviation"),
        (edit("parameters", 7, "sigma", to=True), "True stands"),
        (edit("parameters", 7, "unit", to=None), "None stands"),
        (edit("parameters", 7, "groups", to=[[1]]), "[1] stands"),
        (edit("parameters", 7, "groups", to=1), "int"),
        (edit("identifiability", to=[]), "list indices"),
        (edit("identifiability", "remedies", to=[{}]), "is missing"),
        (edit("identifiability", "remedies", to=[1]), "int"),
        (edit(*COUPLED, to={"a": 1}), "string indices"),
        (edit(*COUPLED, 0, "terms", to=...), "'terms' is missing"),
        (edit(*COUPLED, 0, "terms", 0, "coefficient", to=1e300), "stands in the"),
        (edit(*COUPLED, 0, "value", to=DEEP), "stands in the place of a number"),
        (edit("predicted", to={"position": 1e-4}), "'orientation' is missing"),
        (edit("predicted", to=[1, 2]), "list indices"),
        (edit("predicted", "position", to=10**400), "stands in the place"),
        (edit("predicted", "samples", "points", 0, 0, to=1e9), "100 m away"),
        (edit("predicted", "samples", "position", 0, to=...), "not of one length"),
        (edit("statistics", to=...), "'statistics' is missing"),
        (edit("statistics", "sigma0", to="one"), "'one' stands"),
        (edit("measurements", "training", to=...), "'training' is missing"),
        (edit("measurements", "files", 0, to=...), ""),
        (edit("measurements", "files", to=[1]), "int"),
        (edit("verdict", to=...), "'verdict' is missing"),
        (edit("verdict", "status", to="fine"), "'fine' is no verdict"),
        (edit("verdict", "reason", to={}), "{} stands"),
        (edit("provenance", to=7), "int"),
        (edit("provenance", "command", to=["calib-pin", True]), "True stands"),
    ],
)
def test_damaged_and_edited_files(change, message, document, refused):
    document["measurements"]["files"] = [{"file": "a.csv", "sha256": "abc"}]
    change(document)
    file = stored(document)
    if not message:
        assert read_result(file).provenance.hashes == ()
        return
    with refused(InputError, file="c.json", reason=("damaged", message)):
        read_result(file)


@pytest.mark.parametrize(
    ("content", "fields"),
    [
        ("", dict(reason="not a calibration")),
        ("[1, 2", dict(line=1, reason="not a calibration")),
        ("[" * 100_000, dict(reason="not a calibration of calib-pin")),
        (
            '{"format": "calib-pin/comparison"}',
            dict(reason="not a calibration of calib-pin"),
        ),
        (
            '{"format": "calib-pin/calibration", "version": 9}',
            dict(value=9, reason="another version", allowed="1 to 1"),
        ),
    ],
)
def test_other_files(content, fields, tmp_path, monkeypatch, refused):
    monkeypatch.chdir(tmp_path)
    Path("c.json").write_text(content)
    with refused(InputError, file="c.json", **fields):
        read_result("c.json")


def test_a_folder_of_an_older_version(tmp_path):
    """It has neither `measurements.csv` nor what came with it."""
    folder = Path(__file__).parents[1] / "data" / "calibration-0.1"
    found = read_result(folder)
    assert (found.verdict, len(found.fitted)) == ("good", 40)
    assert found.identifiability.structural_rank == 34
    assert len(found.fitted) == 40 and np.isnan(found.fitted.after).all()
    assert found.held_out is None and np.isnan(found.covariance).all()
    calib_pin.report(folder, tmp_path / "page.html")
    assert b"GOOD" in (tmp_path / "page.html").read_bytes()
