"""A parameterization of another package: one file and one entry point."""

from __future__ import annotations

import json
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from calib_pin.cli import main
from calib_pin.estimation.fit import fit
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.io.results import read_calibration
from calib_pin.io.urdf import load_chain
from calib_pin.parameterizations import PARAMETERIZATIONS, outside_urdf
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.plugins import extensions
from calib_pin.setup import Setup
from calib_pin.simulation import exact_problem

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
def installed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The package as pip would leave it."""
    info = tmp_path / "packages" / "poe-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Name: poe\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(
        "[calib_pin.parameterizations]\npoe = poe:ProductOfExponentials\n"
    )
    monkeypatch.syspath_prepend(Path(__file__).parent / "outside")
    monkeypatch.syspath_prepend(info.parent)
    extensions.cache_clear()
    yield
    extensions.cache_clear()


def test_it_is_listed(capsys: pytest.CaptureFixture[str]) -> None:
    assert list(PARAMETERIZATIONS)[-1] == "poe"
    assert "poe" not in outside_urdf()
    for command in ("calibrate", "identify", "plan", "simulate"):
        assert main([command, "--help"]) == 0
        assert "offset, poe; beyond" in " ".join(capsys.readouterr().out.split())
    assert main(["identify", "space6", "--model", "pose", "--parameters", "peo"]) == 1
    message = capsys.readouterr().err
    assert "did you mean 'poe'?" in message and "instrument-drift, poe" in message


@pytest.mark.parametrize(
    ("robot", "base", "tip"),
    [
        ("space6", None, None),
        ("example:talos_reduced", "gripper_right_base_link", "gripper_left_base_link"),
    ],
)
def test_jacobian_against_central_differences(
    robot: str, base: str | None, tip: str | None
) -> None:
    chain, rng = load_chain(robot, base=base, tip=tip), np.random.default_rng(0)
    model = ErrorModel.create(chain, ["poe"])
    assert model.geometric
    assert f"{chain.joints[0]}.poe.wz" in model.parameters.names
    q = chain.random_configurations(3, rng)
    theta = 0.05 * rng.normal(size=len(model.parameters))
    T, J = model.jacobian(q, theta)
    for k, step in enumerate(1e-6 * np.eye(len(theta))):
        change = model.poses(q, theta + step) - model.poses(q, theta - step)
        twist = np.linalg.inv(T) @ change / 2e-6
        found = np.stack(
            [*twist[:, :3, 3].T, twist[:, 2, 1], twist[:, 0, 2], twist[:, 1, 0]], axis=1
        )
        np.testing.assert_allclose(found, J[:, :, k], atol=1e-8)


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


def test_every_command_takes_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("setup.yaml").write_text(SETUP_FILE)
    words = "--setup setup.yaml --model pose"

    def run(command: str) -> str:
        assert main(command.split()) == 0, capsys.readouterr().err
        return capsys.readouterr().out

    run(
        f"simulate space6 {words} --count 60 --noise 1e-5 -o rows.csv --truth true.urdf"
    )
    run(f"plan space6 {words} --count 12 -o plan.csv")
    assert "joint_3.poe.wx" in run(f"identify space6 {words} rows.csv --json")
    assert "joint_3.poe" in run(
        "calibrate space6 rows.csv --setup setup.yaml --details -o done"
    )
    assert "poe" in Path("done/report.html").read_text()
    document = json.loads(Path("done/calibration.json").read_text())
    assert document["setup"]["parameters"] == ["poe"]
    model = read_calibration(Path("done/calibration.json"))
    true = load_chain("true.urdf")
    written = load_chain("done/space6.urdf")
    q = true.random_configurations(20, np.random.default_rng(2))
    np.testing.assert_allclose(written.poses(q), true.poses(q), atol=1e-4)
    assert any(name.endswith(".poe.vx") for name in model.given.names)
