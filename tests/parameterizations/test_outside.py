"""A parameterization of another package: one file and one entry point."""

from __future__ import annotations

import json
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from benchmarks.exact import exact_problem
from calib_pin.cli import main
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.io.urdf import load_chain
from calib_pin.parameterizations import PARAMETERIZATIONS, outside_urdf
from calib_pin.setup import Setup

SETUP = Setup(parameters=("poe",))

SETUP_FILE = """\
parameters: [poe]
fixed: ['joint_6.poe.*']
frames:
  base: {xyz: [0, 0, 0], rpy: [0, 0, 0], estimate: false}
  tool: {xyz: [0, 0, 0], rpy: [0, 0, 0], estimate: false}
"""
"""The frames are known, so the corrected URDF has the poses of the true one."""


@pytest.fixture(autouse=True)
def package(installed: Callable[..., Path], monkeypatch: pytest.MonkeyPatch) -> None:
    """Its code is where the documents quote it from."""
    monkeypatch.syspath_prepend(Path(__file__).parent / "outside")
    entry = "poe = poe:ProductOfExponentials"
    installed("poe", "calib_pin.parameterizations", entry)


def test_it_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(PARAMETERIZATIONS)[-1] == "poe"
    assert "poe" not in outside_urdf()
    assert main(["identify", "space6", "--model", "pose", "--parameters", "peo"]) == 1
    assert "'poe'" in capsys.readouterr().err


def test_noise_free_recovery() -> None:
    chain, rng = load_chain("space6"), np.random.default_rng(1)
    nominal = nominal_problem(chain, "pose", SETUP)
    parameters = nominal.parameters
    truth = np.where(parameters.nuisance, 0.0, parameters.scales)
    truth *= rng.normal(size=len(truth))
    q = chain.random_configurations(60, rng)
    measured = exact_problem(nominal, truth, q, ("",) * len(q))
    found = fit(make_problem(chain, measured.data, SETUP), rng)
    new = chain.random_configurations(20, rng)
    expected = nominal.only.error.poses(new, truth)
    fitted = found.problem.only.error.poses(new, found.theta)
    np.testing.assert_allclose(fitted, expected, atol=1e-9)


def test_commands_take_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """No page is written and no best plan sought: those take seconds."""
    monkeypatch.chdir(tmp_path)
    Path("setup.yaml").write_text(SETUP_FILE)
    words = "--setup setup.yaml --model pose"
    for command in (
        f"simulate space6 {words} --count 60 --noise 1e-5 --truth true.urdf -o r.csv",
        f"plan space6 {words} --count 12 --candidates 40 --method greedy -o plan.csv",
        "calibrate space6 r.csv --setup setup.yaml --json",
    ):
        capsys.readouterr()
        assert main(command.split()) == 0, capsys.readouterr().err
    document = json.loads(capsys.readouterr().out)
    assert document["setup"]["parameters"] == ["poe"]
    assert "joint_3.poe.wx" in {p["name"] for p in document["parameters"]}
    chain, setup = load_chain("space6"), calib_pin.read_setup("setup.yaml")
    found = calib_pin.calibrate(
        chain, calib_pin.read_measurements("r.csv", chain), setup, validate=False
    )
    calib_pin.write_urdf(found.model, "found.urdf")
    true, written = load_chain("true.urdf"), load_chain("found.urdf")
    q = true.random_configurations(20, np.random.default_rng(2))
    np.testing.assert_allclose(written.poses(q), true.poses(q), atol=1e-4)
