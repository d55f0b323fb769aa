"""`calib-pin compare` as users run it."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

PAIR = "compare done/calibration.json later/calibration.json"


@pytest.fixture(scope="module")
def two(workshop: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The workshop with a second calibration of the same robot."""
    from calib_pin.cli import main

    folder = tmp_path_factory.mktemp("two") / "work"
    shutil.copytree(workshop, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        words = "calibrate arm.urdf new.csv --setup setup.yaml -o later --quiet"
        assert main(words.split()) == 0
    return folder


@pytest.fixture
def there(two: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    folder = tmp_path / "work"
    shutil.copytree(two, folder)
    monkeypatch.chdir(folder)
    return folder


def edited(file: str, change: Callable[[dict[str, Any]], None]) -> None:
    document = json.loads(Path(file).read_text())
    change(document)
    Path(file).write_text(json.dumps(document))


def test_two_calibrations_of_one_robot(there, run, listing):
    before = listing(there)
    result = run(PAIR)
    assert (result.status, result.err) == (0, "")
    assert result.out.startswith("No drift beyond the noise of both: ")
    assert (
        "later/calibration.json: position, 25 measurements, joint-offset;" in result.out
    )
    assert max(map(len, result.out.splitlines())) <= 80
    assert listing(there) == before


def test_json_has_the_numbers_of_the_report(there, run):
    document = json.loads(run(f"{PAIR} --json").out)
    assert document["format"] == "calib-pin/comparison"
    text = run(PAIR).out
    rms = document["tip"]["position"]["rms"]
    assert f"differ by {1e3 * rms:.4f} mm rms" in " ".join(text.split())
    for key in ("a", "b"):
        sizes = document[key]["errors"]["position"]["validation"]
        assert f"{1e3 * sizes['rms']:.4f}" in text
    other = json.loads(run(f"{PAIR} --json --seed 1").out)
    assert other["tip"]["largest"] != document["tip"]["largest"]
    assert other["parameters"] == document["parameters"]


def test_a_drift_is_no_failure(there, run):
    words = "calibrate arm.urdf foreign.csv --setup setup.yaml -o later --quiet --force"
    assert run(words).status == 0
    result = run(PAIR)
    assert (result.status, result.err) == (0, "")
    assert result.out.startswith("The robot changed: tool-point drift ")
    assert "joint3.joint-offset.q " in result.out


def test_what_must_not_be_trusted(there, run):
    verdict = {"status": "untrusted", "reason": "not converged"}
    edited("later/calibration.json", lambda d: d.update(verdict=verdict))
    result = run(PAIR)
    assert (result.status, result.err) == (2, "")
    first, second, *_ = result.out.splitlines()
    assert first == "UNTRUSTED: B (later/calibration.json): not converged."
    assert second.startswith("No drift ")
    result = run(f"{PAIR} --json")
    assert result.status == 2
    assert json.loads(result.out)["b"]["verdict"] == verdict


def test_calibrations_of_different_robots(there, run):
    text = Path("arm.urdf").read_text()
    Path("other.urdf").write_text(text.replace("0.5 0 0.05", "0.6 0 0.05"))
    words = "calibrate other.urdf rows.csv --setup setup.yaml -o later --quiet --force"
    assert run(words).status in (0, 2)
    result = run(PAIR)
    assert (result.status, result.err) == (2, "")
    said = " ".join(result.out.split())
    assert "mm rms apart: their nominal robots differ" in said
    (finding,) = json.loads(run(f"{PAIR} --json").out)["findings"]
    assert (finding["code"], finding["severity"]) == ("different-robots", "error")
    assert finding["evidence"]["rms"] > 0.02


@pytest.mark.parametrize(
    ("words", "fields"),
    [
        ("compare done/calibration.json", dict(text="Missing argument 'B.json'")),
        (
            "compare done/calibration.json done/calibration.json",
            dict(file="done/calibration.json", reason="is given twice"),
        ),
        (
            "compare done/calibration.json done/../done/calibration.json",
            dict(file="done/../done/calibration.json", reason="given twice"),
        ),
        ("compare done later/calibration.json", dict(file="done", allowed="done/cal")),
        (
            "compare done/calibration.json gone.json",
            dict(file="gone.json", reason="no such file"),
        ),
        (
            "compare arm.urdf done/calibration.json",
            dict(file="arm.urdf", line=1, reason="not a calibration"),
        ),
        (
            "compare done/calibration.json setup.yaml",
            dict(file="setup.yaml", line=1, reason="not a calibration"),
        ),
        (f"{PAIR} --seed x", dict(reason="--seed cannot be 'x'")),
    ],
)
def test_wrong_words(words, fields, there, refuses):
    refuses(words, **fields)


@pytest.mark.parametrize(
    ("change", "fields"),
    [
        (
            lambda d: d.update(version=2),
            dict(
                file="later/calibration.json",
                value=2,
                reason="another version",
                allowed="1 to 1",
            ),
        ),
        (
            lambda d: d["parameters"][0].update(sigma="1 mm"),
            dict(file="later/calibration.json", reason="'1 mm' stands"),
        ),
        (
            lambda d: d["robot"].update(tip="link4"),
            dict(file="later/calibration.json", reason="cannot be compared"),
        ),
        (
            lambda d: d.pop("identifiability"),
            dict(file="later/calibration.json", reason="'identifiability' is missing"),
        ),
        (
            lambda d: d["robot"].update(sha256="0" * 64),
            dict(file="later/calibration.json", reason="is not the robot that was"),
        ),
    ],
)
def test_wrong_files(change, fields, there, refuses):
    edited("later/calibration.json", change)
    refuses(PAIR, **fields)


def test_other_joints(there, run, refuses):
    Path("other.urdf").write_text(
        Path("arm.urdf").read_text().replace('"joint4"', '"wrist"')
    )
    rows = Path("new.csv").read_text().replace("joint4", "wrist")
    Path("other.csv").write_text(rows)
    words = "calibrate other.urdf other.csv --setup setup.yaml -o other --quiet"
    assert run(words).status == 0
    refuses(
        "compare done/calibration.json other/calibration.json",
        file="other/calibration.json",
        reason=("cannot be compared with done/calibration.json", "wrist", "joint4"),
    )


def test_help(run):
    result = run("compare --help")
    assert result.status == 0
    assert result.out.startswith("Usage: calib-pin compare [OPTIONS] A.json B.json\n")
    assert max(map(len, result.out.splitlines())) <= 80
    for option in ("--seed N", "--json"):
        assert f"  {option}" in result.out
