"""Commands on a xacro file: its arguments, its packages, and what they leave."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from calib_pin.io.results import read_calibration
from tests.cli.conftest import ARM

XACRO = ARM.replace(
    '<robot name="arm">',
    '<robot name="arm" xmlns:xacro="http://www.ros.org/wiki/xacro">\n'
    '  <xacro:arg name="reach" default="0.7"/>\n'
    '  <xacro:include filename="$(find parts)/limits.xacro"/>',
).replace('xyz="0.5 0 0.05"', 'xyz="$(arg reach) 0 ${10 * thin}"')

LIMITS = """<robot xmlns:xacro="http://www.ros.org/wiki/xacro">
  <xacro:property name="thin" value="0.005"/>
</robot>
"""


@pytest.fixture
def described(here):
    """The arm as a xacro file, which needs a package and an argument to be it."""
    Path("arm.urdf.xacro").write_text(XACRO)
    Path("stack/parts").mkdir(parents=True)
    Path("stack/parts/limits.xacro").write_text(LIMITS)
    return here


def test_the_result_is_that_of_its_urdf(described, run):
    """And needs neither the xacro file nor its package to be read again."""
    words = "arm.urdf.xacro reach:=0.5 rows.csv --setup setup.yaml --package-dir stack"
    result = run(f"calibrate {words} -o out")
    assert result.status == 0, result.err
    plain, found = (
        read_calibration(f"{folder}/calibration.json") for folder in ("done", "out")
    )
    assert np.allclose(found.theta, plain.theta, rtol=0, atol=1e-12)
    document = json.loads(Path("out/calibration.json").read_text())
    assert document["robot"]["file"] == "arm.urdf.xacro reach:=0.5"
    command = ["calibrate", *words.split(), "-o", "out"]
    assert document["provenance"]["command"][1:] == command
    assert b"xacro" not in Path("out/nominal.urdf").read_bytes()
    assert found.chains.robot.file == "arm.urdf.xacro reach:=0.5"
    for name in ("arm.urdf.xacro", "stack/parts/limits.xacro"):
        Path(name).unlink()
    again = run("evaluate out/calibration.json new.csv --json")
    assert again.status == 0, again.err
    assert json.loads(again.out) == json.loads(
        run("evaluate done/calibration.json new.csv --json").out
    )
    assert run("export out/calibration.json --format xacro -o x.xacro").status == 0


@pytest.mark.parametrize(
    "words",
    [
        "evaluate arm.urdf.xacro rows.csv reach:=0.5 --tip tool --json",
        "evaluate reach:=0.5 arm.urdf.xacro rows.csv --tip tool --json",
        "identify arm.urdf.xacro reach:=0.5 --model position --json",
        "identify arm.urdf.xacro rows.csv reach:=0.5 --parameters joint-offset --json",
        "simulate arm.urdf.xacro reach:=0.5 --model pose --count 20 --seed 4 -o p.csv",
        "plan arm.urdf.xacro reach:=0.5 --model position --count 8 --candidates 30 "
        "--ignore-collisions --json -o plan.csv",
        "accept arm.urdf.xacro reach:=0.5 visits.csv --tip tool --quiet -o test",
    ],
)
def test_every_command_takes_it(described, run, words):
    rows = Path("poses.csv").read_text().splitlines()
    head = [line for line in rows if line.startswith("#")]
    names, *visits = rows[len(head) :]
    Path("visits.csv").write_text("\n".join([names, *visits[:4] * 6]))
    given = run(f"{words} --package-dir stack")
    assert given.status in (0, 2), given.err
    files = {"p.csv", "plan.csv", "test/acceptance.csv"}
    found = {name: Path(name).read_text() for name in files if Path(name).exists()}
    plain = words.replace("arm.urdf.xacro", "arm.urdf").replace("reach:=0.5 ", "")
    expected = run(f"{plain} --force" if found else plain)
    told = given.out.replace("arm.urdf.xacro reach:=0.5", "arm.urdf")
    assert (given.status, told) == (expected.status, expected.out)
    for name, text in found.items():
        lines = [line for line in text.splitlines() if line[:1] != "#"]
        assert lines == [
            line for line in Path(name).read_text().splitlines() if line[:1] != "#"
        ]


def test_what_is_refused(described, refuses):
    dirs = "--package-dir stack"
    refuses(
        f"evaluate arm.urdf.xacro raech:=1 rows.csv {dirs}",
        reason=["no argument 'raech'", "'reach'"],
        file="arm.urdf.xacro",
    )
    refuses(
        "evaluate arm.urdf.xacro rows.csv",
        reason=["package 'parts' is not found", "--package-dir"],
    )
    refuses(
        "evaluate arm.urdf.xacro rows.csv --package-dir nowhere",
        reason="no such folder",
        file="nowhere",
    )
    refuses(
        "evaluate arm.urdf reach:=0.5 rows.csv",
        reason="argument for a xacro file",
    )
    refuses(
        "evaluate done/calibration.json reach:=0.5 new.csv",
        reason="argument for a xacro file",
    )
    refuses(
        "report done/calibration.json reach:=0.5",
        reason="this command takes none",
    )
    refuses(
        f"calibrate arm.urdf.xacro reach:=0.5 rows.csv {dirs} -o arm.urdf.xacro",
        reason="is a file",
    )
