"""Robots, measurements and calibrations in other formats."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

from calib_pin.cli.asked import Export
from calib_pin.cli.options import meanings
from calib_pin.io.exchange import FORMATS, Exported
from calib_pin.io.results import read_calibration, read_result
from calib_pin.io.urdf import load_chain
from calib_pin.validation.joint_errors import configurations
from tests.cli.conftest import ARM
from tests.cli.files import document, table
from tests.io.test_mjcf_child import BODIES, written

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
        "--ignore-collisions --method greedy -o p.csv",
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


# --- MJCF -------------------------------------------------------------------------


@pytest.mark.needs("mujoco")
@pytest.mark.slow
def test_it_comes_back_corrected(alone, run):
    written(alone, BODIES)
    about = "arm.xml --tip tool"
    made = run(
        f"simulate {about} --model pose --count 20 --noise 1e-5 -o rows.csv --force"
    )
    assert made.status == 0, made.err
    found = run(f"calibrate {about} rows.csv -o out --force --quiet --holdout 0.25")
    assert found.status == 0, found.err
    assert run("evaluate out/calibration.json rows.csv").status == 0
    words = "export out/calibration.json --format mjcf -o new.xml --force"
    assert run(words).status == 0
    nominal = load_chain("arm.xml", tip="tool")
    of = Exported(read_result("out/calibration.json"), Path("out"))
    q = configurations(of.nominal)
    expected = of.chain.poses(q)
    assert np.abs(nominal.poses(q) - expected).max() > 1e-4
    again = load_chain("new.xml", tip="tool")
    assert np.abs(again.poses(q) - expected).max() < 1e-9
    assert again.joints == nominal.joints
    assert np.allclose(again.upper, nominal.upper)


# --- what is exported -------------------------------------------------------------


def test_formats_are_named(here):
    named = meanings(Export)["format"].removeprefix("One of ").rstrip(".")
    assert [*FORMATS] == named.split(", ")


def test_a_table_is_written(here, run):
    result = run("export done --format dh -o dh.csv")
    assert (result.status, result.out) == (0, "wrote dh.csv\n")
    told = "calib-pin: note: dh holds no base and tool frames: see 'tf'\n"
    assert result.err == told
    assert "standard,base,frame" in Path("dh.csv").read_text()


def test_an_untrusted_calibration_is_not_exported(here, fails):
    file = Path("done/calibration.json")
    document = json.loads(file.read_text())
    document["verdict"] = {"status": "untrusted", "reason": "bad"}
    file.write_text(json.dumps(document))
    fails("export done --format dh -o a", "bad")
