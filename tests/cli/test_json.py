"""`--json` wherever there is a result: one object on standard output."""

from __future__ import annotations

import json
import shutil
from pathlib import Path

import pytest

from calib_pin.cli.asked import COMMANDS
from tests.cli.files import table, write

INTERACTIVE = {"app", "view", "watch"}
"""Commands that go on until they are ended."""

PLAN = "--method greedy --candidates 60 --ignore-collisions --count 8 -o new.csv"
RESULTS = {
    # By command: its words behind files that the fixture made, and keys of its object.
    "init": ("arm.urdf rows.csv", {"setup", "nominal"}),
    "calibrate": (
        "arm.urdf rows.csv --setup setup.yaml -o out",
        {"verdict", "errors"},
    ),
    "identify": (
        "arm.urdf --setup setup.yaml --model position",
        {"identifiability"},
    ),
    "evaluate": ("arm.urdf rows.csv", {"errors", "registered", "rows"}),
    "accept": ("arm.urdf visits.csv --tip tool", {"format"}),
    "simulate": (
        "arm.urdf --model pose --count 3 -o new.csv",
        {"measurements", "models", "written"},
    ),
    "join": ("joints.csv readings.csv -o new.csv", {"standstills", "clock", "written"}),
    "plan": (f"arm.urdf --setup setup.yaml --model position {PLAN}", {"format"}),
    "compensate": ("done/calibration.json targets.csv -o new.csv", {"format"}),
    "export": ("done --format joint-offsets -o new.csv", {"remarks", "written"}),
    "fleet": ("jobs.csv -o fleet --no-pages", {"jobs", "written"}),
    "compare": ("done/calibration.json later/calibration.json", {"format"}),
    "report": ("done", {"verdict", "format"}),
    "robots": ("", {"robots"}),
}


@pytest.fixture(scope="module")
def inputs(workshop: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder with input of every command."""
    folder = tmp_path_factory.mktemp("json") / "work"
    shutil.copytree(workshop, folder)
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        header, rows, _ = table("new.csv")
        write("visits.csv", ",".join(header), rows[:5] * 4)
        times = [0.1 * k for k in range(40)]
        steps = [1.0 if t > 2 else 0.5 for t in times]
        write("joints.csv", "time,joint_1", zip(times, steps, strict=True))
        rows = [[t + 0.05, step, 0, 0] for t, step in zip(times, steps, strict=True)]
        write("readings.csv", "time,x,y,z", rows)
        Path("jobs.csv").write_text("robot,measurements\narm.urdf,rows.csv\n")
        write("targets.csv", "x,y,z", [[0.6, 0.2, 0.7]])
    return folder


def test_every_command_has_it():
    named = {*COMMANDS}
    assert named == {*RESULTS, *INTERACTIVE, "detect"}  # See test_detect.


@pytest.mark.parametrize("command", RESULTS)
def test_one_object(command, inputs, monkeypatch, run, inside):
    monkeypatch.chdir(inputs)
    words, keys = RESULTS[command]
    Path("new.csv").unlink(missing_ok=True)
    result = run(f"{command} {words} --json")
    assert result.status in (0, 2)
    document = json.loads(result.out)
    assert keys <= document.keys()
    if "written" in keys:
        assert all(Path(file).exists() for file in document["written"])
    if command == "calibrate":
        assert result.out == Path("out/calibration.json").read_text()
