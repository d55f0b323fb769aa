"""`export`: what it writes, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from calib_pin.cli.asked import Export
from calib_pin.cli.options import meanings
from calib_pin.io.exchange import FORMATS


def test_formats_are_explained(here, run):
    lines = run("export done --format list").out.splitlines()
    named = meanings(Export)["format"].removeprefix("One of ").partition(";")[0]
    assert max(map(len, lines)) <= 80
    said = [line.split()[0] for line in lines if line[0] != " "]
    assert said == [*FORMATS] == named.split(", ")


def test_a_table_is_written(here, run):
    result = run("export done --format dh -o dh.csv")
    assert (result.status, result.out) == (0, "wrote dh.csv\n")
    told = "calib-pin: note: dh holds no base and tool frames: see 'tf'\n"
    assert result.err == told
    assert "standard,base,frame" in Path("dh.csv").read_text()


def test_remarks_are_told(here, run):
    words = "calibrate arm.urdf rows.csv --setup setup.yaml -o out --quiet"
    assert run(f"{words} --parameters placement").status == 0
    words = "export out/calibration.json --format joint-offsets -o o.csv"
    result = run(words)
    assert result.status == 0 and result.err.startswith("calib-pin: note: ")
    assert run(f"{words} --force --quiet").err == ""


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("export done --format dhh -o a", "dhh"),
        ("export done --format dh", "-o"),
        ("export done --format lerobot -o a", "--template"),
        ("export done --format dh -o a --template t.yaml", "--template"),
        ("export none --format dh -o a", "none"),
        (
            "export done --format dh -o done/calibration.json --force",
            "done/calibration.json",
        ),
        ("export done --format dh -o rows.csv", "--force"),
        ("export done --format lerobot -o a --template none.json", "none.json"),
        ("export done --format ros2-control -o a --template rows.csv", "rows.csv"),
        ("export done --format camera-info -o a", "camera"),
        ("export done --format dh -o a --chain left", "left"),
    ],
)
def test_what_cannot_be_exported_is_told(here, fails, words, named):
    fails(words, named)


def test_an_untrusted_calibration_is_not_exported(here, fails):
    file = Path("done/calibration.json")
    document = json.loads(file.read_text())
    document["verdict"] = {"status": "untrusted", "reason": "bad"}
    file.write_text(json.dumps(document))
    fails("export done --format dh -o a", "bad")
