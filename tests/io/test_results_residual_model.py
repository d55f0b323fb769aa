"""Residual models in files: they come back as they were, or not at all."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.learning import with_learned
from calib_pin.io.calibrated_model import (
    RESIDUAL_MODEL,
    encode_residual_model,
    read_residual_model,
    reference,
    write_urdf,
)
from calib_pin.io.json_text import encode
from calib_pin.io.results import calibration_document, read_calibration
from calib_pin.observations import BlockKey
from calib_pin.residual_models import LearnedCorrection
from calib_pin.setup import FrameSetup, Setup, ToolSetup
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import CalibrationResult, Provenance

NOTHING = Provenance((), "", 0.0, {})
TOOL = FrameSetup((0.05, 0.02, 0.1), (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def learned(simulated: Callable[..., Any]) -> CalibrationResult:
    """A calibration of space6 with harmonics that only a network can describe."""
    truth = Setup(parameters=("joint-offset", "transmission"), tool_frame=TOOL)
    problem, _ = simulated("position", truth, 30, 1.0, seed=2, noise=2e-5)
    setup = Setup(parameters=("joint-offset",), learned="network")
    chain = problem.chains[""]
    return calib_pin.calibrate(chain, problem.data, setup, validate=False)


@pytest.fixture
def folder(learned: CalibrationResult, tmp_path: Path) -> Path:
    """What `calibrate` would write."""
    data = encode_residual_model(learned.model)
    assert data is not None
    (tmp_path / RESIDUAL_MODEL).write_bytes(data)
    document = calibration_document(learned, NOTHING, reference(data))
    (tmp_path / "calibration.json").write_bytes(encode(document))
    return tmp_path


def network_of(result: CalibrationResult) -> LearnedCorrection:
    network = result.model.only.error.learned
    assert isinstance(network, LearnedCorrection)
    return network


def test_it_predicts_as_before(
    learned: CalibrationResult, folder: Path, refused: Callable[..., Any]
) -> None:
    model = read_calibration(folder / "calibration.json")
    q = model.chains.random_configurations(50, np.random.default_rng(0))
    assert model.setup.learned == "network"
    found = model.only.error.learned
    assert isinstance(found, LearnedCorrection) and found.model.name == "network"
    poses = model.of().poses(q)
    # Frames are written as angles, and poses of 1 m come back to some eps.
    np.testing.assert_allclose(poses, learned.model.of().poses(q), rtol=0, atol=1e-12)
    # It does correct something.
    plain = model.without_corrections.of().poses(q)
    assert np.abs(plain - poses).max() > 1e-5
    assert not model.of().outside(q).all()
    assert encode_residual_model(model.without_corrections) is None
    with refused(OptionError):
        write_urdf(model, folder / "corrected.urdf")
    write_urdf(model.without_corrections, folder / "corrected.urdf")


def test_it_belongs_to_all_tools_of_a_chain(learned: CalibrationResult) -> None:
    keys = [BlockKey("position", "", "", tool) for tool in ("a", "b")]
    setup = Setup(
        parameters=("joint-offset",),
        tools={"a": ToolSetup(TOOL.xyz), "b": ToolSetup((0.0, 0.1, 0.2))},
    )
    problem = nominal_problem(learned.model.chains, keys, setup)
    model = CalibratedModel.create(problem, np.zeros(len(problem.given)))
    shift = np.arange(1.0, len(problem.given) + 1.0) * 1e-4
    model = with_learned(model, replace(network_of(learned), shift=shift))
    data = encode_residual_model(model)
    assert data is not None
    found = with_learned(model, read_residual_model(data, model, RESIDUAL_MODEL))
    q = model.chains.random_configurations(5, np.random.default_rng(0))
    for key in keys:
        np.testing.assert_array_equal(found.of(key).poses(q), model.of(key).poses(q))


def test_damaged_or_other_files(
    learned: CalibrationResult, folder: Path, refused: Callable[..., Any]
) -> None:
    file = folder / RESIDUAL_MODEL
    good = file.read_bytes()
    document = json.loads(good)
    edited = json.loads(good)
    edited["model"]["held_out"][0] *= 1.5
    contents = [json.dumps(edited).encode()]
    contents += [good[: int(part * len(good))] for part in (0.0, 0.3, 0.9999)]
    contents += [b"[]", b"{}", b'{"format": "something"}']
    # It is whole, but this calibration was written with another one.
    network = network_of(learned)
    other = with_learned(learned.model, replace(network, shift=2.0 * network.shift))
    contents.append(encode_residual_model(other) or b"")
    for content in contents:
        file.write_bytes(content)
        with refused(InputError, file=str(file)):
            read_calibration(folder / "calibration.json")
    for part in ({"version": 2}, {"version": "1"}, {"model": {}}, {"shift": [1.0]}):
        data = json.dumps(document | part).encode()
        with refused(InputError, file=str(file)):
            read_residual_model(data, learned.model, file)
    for key in ("made_of", "free"):  # A process of harmonics, and one that fades.
        older = {"kind": "gaussian-process", key: "harmonics"}
        data = json.dumps(document | {"model": older}).encode()
        with refused(InputError, ("older version", "again"), file=str(file)):
            read_residual_model(data, learned.model, file)
    file.unlink()
    with refused(InputError, file=str(file)):
        read_calibration(folder / "calibration.json")


def test_the_calibration_must_name_the_file_beside_it(
    folder: Path, refused: Callable[..., Any]
) -> None:
    """Else what was learned would get lost, or be taken from another folder."""
    file = folder / "calibration.json"
    good = json.loads(file.read_text())
    elsewhere = good["residual_model"] | {"file": "/etc/passwd"}
    file.write_text(json.dumps(good | {"residual_model": elsewhere}))
    with refused(InputError, file=str(folder / "passwd")):
        read_calibration(file)
    without = {key: value for key, value in good.items() if key != "residual_model"}
    for document in (without, *(good | {"residual_model": x} for x in (None, "net"))):
        file.write_text(json.dumps(document))
        with refused(InputError, file=str(file)):
            read_calibration(file)
