"""An instrument of another package: one file and one entry point, and all know it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.cli import main
from calib_pin.errors import CalibPinError
from calib_pin.io.measurements import read_measurements, write_measurements
from calib_pin.measurement_models import MEASUREMENT_MODELS
from calib_pin.observations import BlockKey
from calib_pin.setup import FrameSetup, Setup

NAME = "theodolite"
STATION = FrameSetup((2.5, 0.4, 0.3), (0.0, 0.0, 2.9), True)
TOOL = FrameSetup((0.05, 0.03, 0.12), None, True)


@pytest.fixture(autouse=True)
def package(
    installed: Callable[..., Path], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its code is where the documents quote it from."""
    monkeypatch.syspath_prepend(Path(__file__).parent / "data" / "plugins")
    monkeypatch.chdir(tmp_path)
    entry = "theodolite = theodolite:Theodolite"
    installed(NAME, "calib_pin.measurement_models", entry)


def run(words: str) -> int:
    return main(words.split())


def test_it_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(MEASUREMENT_MODELS)[-1] == NAME
    assert len(MEASUREMENT_MODELS) == 10
    assert run("identify pa10 --model theodolit") == 1
    assert f"'{NAME}'" in capsys.readouterr().err


def test_files_are_read_in_gon_and_inferred() -> None:
    chain = calib_pin.load_chain("space6")
    text = ",".join([*chain.joints, "azimuth [gon]", "elevation [gon]", "sigma [mrad]"])
    Path("t.csv").write_text(f"{text}\n0,0,0,0,0,0,100,-50,0.01\n")
    data = read_measurements("t.csv", chain)
    assert data.models == (NAME,)
    np.testing.assert_allclose(data.only.values, [[np.pi / 2, -np.pi / 4]], rtol=1e-12)
    np.testing.assert_allclose(data.only.sigma, [[1e-5, 1e-5]], rtol=1e-12)
    write_measurements("again.csv", data)
    again = read_measurements("again.csv", chain)
    assert again.only.values.tobytes() == data.only.values.tobytes()
    # Both columns are needed, and directions are no positions.
    Path("t.csv").write_text(f"{','.join(chain.joints)},azimuth\n0,0,0,0,0,0,1\n")
    with pytest.raises(CalibPinError, match="elevation"):
        read_measurements("t.csv", chain)
    header = ",".join([*chain.joints, "azimuth", "elevation", "distance"])
    Path("t.csv").write_text(f"{header}\n0,0,0,0,0,0,1,1,1\n")
    with pytest.raises(CalibPinError):
        read_measurements("t.csv", chain)


@pytest.mark.parametrize("known", [True, False], ids=["guess", "no guess"])
def test_recovery_without_noise(known: bool) -> None:
    from calib_pin.estimation.formulation import nominal_problem

    chain = calib_pin.load_chain("pa10")
    rng = np.random.default_rng(5)
    true = Setup(base_frame=STATION, tool_frame=TOOL)
    problem = nominal_problem(chain, NAME, true)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, theta, rng, count=150, noise=0.0)
    unseen = calib_pin.simulate(problem, theta, rng, count=50, noise=0.0)
    # Of the tool, a point: its orientation is unobservable and not looked for.
    stated = true if known else Setup()
    found = calib_pin.calibrate(chain, rows, stated, validation=unseen)
    (quantity,) = found.errors
    assert (quantity.name, quantity.unit) == ("direction", "rad")
    assert quantity.before.rms > 1e-4
    assert quantity.after.rms < 1e-12
    assert quantity.validation_after is not None
    assert quantity.validation_after.rms < 1e-9


def test_beside_a_tracker() -> None:
    """Two stations and one tool: positions give the directions their lengths."""
    from calib_pin.estimation.fit import fit
    from calib_pin.estimation.formulation import make_problem, nominal_problem

    other = FrameSetup((-0.8, 1.2, 0.1), (-0.1, 0.3, -1.0), True)
    setup = Setup(stations={"pillar": STATION, "tripod": other}, tool_frame=TOOL)
    keys = BlockKey(NAME, station="pillar"), BlockKey("position", station="tripod")
    problem = nominal_problem(calib_pin.load_chain("space6"), keys, setup)
    rng = np.random.default_rng(5)
    truth = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, truth, rng, count=120, noise=0.0)
    found = fit(make_problem(problem.chains, rows, Setup()), rng)
    assert found.structure.scaled and found.rank == 27 + 6
    assert np.abs(found.problem.errors(found.theta)).max() < 1e-12
    new = calib_pin.simulate(problem, truth, rng, count=40, noise=0.0)
    there = replace(found.problem, data=new)
    assert np.abs(there.errors(found.theta)).max() < 1e-9


@pytest.mark.slow
def test_commands_know_it(capsys: pytest.CaptureFixture[str]) -> None:
    """Simulated, planned, calibrated and evaluated."""
    Path("setup.yaml").write_text(
        "frames:\n"
        "  base: {xyz: [2.5, 0.4, 0.3], rpy: [0, 0, 2.9], estimate: true}\n"
        "  tool: {xyz: [0.05, 0.03, 0.12], estimate: true}\n"
    )
    words = "pa10 --model theodolite --setup setup.yaml"
    assert run(f"simulate {words} --count 60 --seed 1 -o rows.csv") == 0
    plan = f"plan {words} --count 20 --candidates 40 --method greedy --seed 1"
    assert run(f"{plan} -o plan.csv") == 0
    capsys.readouterr()
    # Angles tell no length: the fit is good, and its scale is not to be trusted.
    assert run("calibrate pa10 rows.csv --setup setup.yaml -o out") == 2
    report = capsys.readouterr().out
    assert report.startswith("UNTRUSTED") and "direction" in report
    assert NAME in Path("out/calibration.json").read_text()
    page = Path("out/report.html").read_text()
    assert "direction" in page and NAME in page
    assert run("evaluate out/calibration.json rows.csv") in (0, 2)
    assert "direction" in capsys.readouterr().out
