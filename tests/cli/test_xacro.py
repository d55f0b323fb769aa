"""Commands on a xacro file: its arguments, its packages, and what they leave."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from calib_pin.io.results import read_calibration
from tests.cli.conftest import ARM
from tests.cli.files import document, table

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
    assert document("out")["robot"]["file"] == "arm.urdf.xacro reach:=0.5"
    command = ["calibrate", *words.split(), "-o", "out"]
    assert document("out")["provenance"]["command"][1:] == command
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
        "evaluate reach:=0.5 arm.urdf.xacro rows.csv --tip tool --json",
        "identify arm.urdf.xacro reach:=0.5 --model position --json",
        "simulate arm.urdf.xacro reach:=0.5 --model pose --count 20 --seed 4 -o p.csv",
        "plan arm.urdf.xacro reach:=0.5 --model position --count 8 --candidates 30 "
        "--ignore-collisions --method greedy --json -o p.csv",
    ],
)
def test_every_command_takes_it(described, run, words):
    given = run(f"{words} --package-dir stack")
    assert given.status in (0, 2), given.err
    found = table("p.csv")[:2] if "p.csv" in words else None
    plain = words.replace("arm.urdf.xacro", "arm.urdf").replace("reach:=0.5 ", "")
    expected = run(f"{plain} --force" if found else plain)
    told = given.out.replace("arm.urdf.xacro reach:=0.5", "arm.urdf")
    assert (given.status, told) == (expected.status, expected.out)
    assert found is None or found == table("p.csv")[:2]


@pytest.mark.parametrize(
    ("words", "named"),
    [
        ("evaluate arm.urdf.xacro raech:=1 rows.csv --package-dir stack", "'reach'"),
        ("evaluate arm.urdf.xacro rows.csv", "'parts'"),
        ("evaluate arm.urdf.xacro rows.csv --package-dir nowhere", "nowhere"),
        ("evaluate arm.urdf reach:=0.5 rows.csv", "arm.urdf: reach:="),
        (
            "evaluate done/calibration.json reach:=0.5 new.csv",
            "done/calibration.json: reach:=",
        ),
        ("report done/calibration.json reach:=0.5", "reach:=0.5"),
        (
            "calibrate arm.urdf.xacro reach:=0.5 rows.csv --package-dir stack "
            "-o arm.urdf.xacro",
            "arm.urdf.xacro",
        ),
    ],
)
def test_what_is_refused(described, fails, words, named):
    fails(words, named)
