"""`export`: what it writes, and what it refuses."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from calib_pin.cli.export import FORMAT_NAMES
from calib_pin.io.exchange import FORMATS

CALIBRATE = "calibrate arm.urdf rows.csv --setup setup.yaml --quiet -o out"


def test_all_formats_are_named():
    assert ", ".join(FORMATS) == FORMAT_NAMES


def test_formats_are_explained(here, run):
    lines = run("export out --format list").out.splitlines()
    assert [line.split()[0] for line in lines] == [*FORMATS]


def test_a_table_is_written(here, run):
    assert run(CALIBRATE).status == 0
    result = run("export out --format dh -o dh.csv")
    assert (result.status, result.out, result.err) == (0, "wrote dh.csv\n", "")
    assert "standard,base,frame" in Path("dh.csv").read_text()


def test_remarks_are_told(here, run):
    assert run(f"{CALIBRATE} --parameters placement").status == 0
    words = "export out/calibration.json --format joint-offsets -o o.csv"
    result = run(words)
    assert result.status == 0 and "offsets alone leave" in result.err
    assert run(f"{words} --force --quiet").err == ""


@pytest.mark.parametrize(
    ("words", "text"),
    [
        ("export out --format dhh -o a", "dhh"),
        ("export out --format dh", "-o is missing: the .csv file"),
        ("export out --format lerobot -o a", "lerobot needs --template"),
        ("export out --format dh -o a --template t.yaml", "takes no --template"),
        ("export none --format dh -o a", "none"),
        ("export out --format dh -o out/calibration.json --force", "input"),
        ("export out --format dh -o rows.csv", "exists already"),
        ("export out --format lerobot -o a --template none.json", "no such file"),
        ("export out --format ros2-control -o a --template rows.csv", "is not XML"),
        ("export out --format camera-info -o a", "one camera can be exported"),
        ("export out --format dh -o a --chain left", "left"),
    ],
)
def test_what_cannot_be_exported_is_told(here, run, listing, words, text):
    assert run(CALIBRATE).status == 0
    before = listing(Path.cwd())
    result = run(words)
    assert (result.status, result.out) == (1, "")
    assert text in result.err and result.err.count("\n") == 1
    assert listing(Path.cwd()) == before


def test_an_untrusted_calibration_is_not_exported(here, run, refuses):
    assert run(CALIBRATE).status == 0
    file = Path("out/calibration.json")
    document = json.loads(file.read_text())
    document["verdict"] = {"status": "untrusted", "reason": "bad"}
    file.write_text(json.dumps(document))
    refuses("export out --format dh -o a", reason="must not be trusted: bad")
