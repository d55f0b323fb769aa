"""`--json` wherever there is a result: one object on standard output."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from calib_pin.cli import main
from calib_pin.cli.app import COMMANDS

INTERACTIVE = {"view"}
"""Commands whose result is a picture in a browser."""

RESULTS = {
    # By command: its words behind files that the fixture made, and keys of its object.
    "init": ("space6 tracker.csv", {"setup", "nominal"}),
    "calibrate": ("space6 tracker.csv --model position", {"verdict", "errors"}),
    "identify": ("space6 --model position", {"identifiability"}),
    "evaluate": ("space6 tracker.csv", {"errors"}),
    "accept": ("space6 visits.csv", {"format"}),
    "simulate": (
        "space6 --model pose --count 3 -o new.csv",
        {"measurements", "models", "written"},
    ),
    "join": ("joints.csv readings.csv -o new.csv", {"standstills", "clock", "written"}),
    "plan": ("space6 --model position --count 10 -o new.csv", {"format"}),
    "compensate": ("out/calibration.json tracker.csv -o new.csv", {"format"}),
    "export": ("out --format joint-offsets -o new.csv", {"remarks", "written"}),
    "fleet": ("jobs.csv -o fleet", {"jobs", "written"}),
    "compare": ("out/calibration.json out2/calibration.json", {"format"}),
    "report": ("out", {"verdict", "format"}),
    "robots": ("", {"robots"}),
}


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with input of every command."""
    folder = tmp_path_factory.mktemp("json")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        words = "simulate space6 --model position --noise 1e-4 --seed 1 -o"
        assert main([*words.split(), "tracker.csv", "--count", "40"]) == 0
        made = "plan space6 --tip tool --accept -o poses.csv"
        assert main(made.split()) == 0
        assert (
            main([*words.split(), "visits.csv", "--configurations", "poses.csv"]) == 0
        )
        for out in ("out", "out2"):
            made = f"calibrate space6 tracker.csv --model position --quiet -o {out}"
            assert main(made.split()) == 0
        times = [0.1 * k for k in range(40)]
        lines = [f"{t:.1f},{1.0 if t > 2 else 0.5}" for t in times]
        Path("joints.csv").write_text("\n".join(["time,joint_1", *lines]))
        lines = [f"{t + 0.05:.2f},{1.0 if t > 2 else 0.5},0,0" for t in times]
        Path("readings.csv").write_text("\n".join(["time,x,y,z", *lines]))
        Path("jobs.csv").write_text("robot,measurements\nspace6,tracker.csv\n")
    return folder


def test_every_command_has_it():
    named = {command.__name__ for command in COMMANDS}
    assert named == {*RESULTS, *INTERACTIVE, "detect"}  # See test_detect.


@pytest.mark.parametrize("command", RESULTS)
def test_one_object(
    command: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    monkeypatch.chdir(folder)
    words, keys = RESULTS[command]
    Path("new.csv").unlink(missing_ok=True)
    capsys.readouterr()
    assert main([command, *words.split(), "--json"]) in (0, 2)
    document = json.loads(capsys.readouterr().out)
    assert keys <= document.keys()
    if "written" in keys:
        assert all(Path(file).exists() for file in document["written"])


def test_a_calibration_prints_the_document_that_it_writes(
    folder: Path, monkeypatch: pytest.MonkeyPatch, capsys
):
    monkeypatch.chdir(folder)
    words = "calibrate space6 tracker.csv --model position --json -o out3"
    assert main(words.split()) == 0
    assert capsys.readouterr().out == Path("out3/calibration.json").read_text()
