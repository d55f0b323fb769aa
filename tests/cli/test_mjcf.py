"""A robot of MuJoCo's: calibrated, exported, and loaded as MuJoCo's again."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from calib_pin.io.exchange import Exported
from calib_pin.io.results import read_result
from calib_pin.io.urdf import load_chain
from calib_pin.validation.joint_errors import configurations
from tests.io.test_mjcf_child import BASE, BODIES, written

pytestmark = pytest.mark.needs("mujoco")


def test_it_comes_back_corrected(tmp_path, monkeypatch, run):
    monkeypatch.chdir(tmp_path)
    written(tmp_path, BODIES)
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


def test_the_file_is_an_input(tmp_path, monkeypatch, run):
    monkeypatch.chdir(tmp_path)
    before = written(tmp_path, BASE).read_bytes()
    words = "simulate arm.xml --tip tool --model pose --count 20 -o arm.xml --force"
    result = run(words)
    assert result.status == 1 and "arm.xml: is an input" in result.err
    assert Path("arm.xml").read_bytes() == before
