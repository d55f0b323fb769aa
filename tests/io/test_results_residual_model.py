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
from calib_pin.errors import InputError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.estimation.learning import with_learned
from calib_pin.io.calibration_document import calibration_document
from calib_pin.io.json_text import encode
from calib_pin.io.result_folder import RESIDUAL_MODEL
from calib_pin.io.results import (
    encode_residual_model,
    read_calibration,
    read_residual_model,
    reference,
)
from calib_pin.kinematics.chain import Chain
from calib_pin.observations import BlockKey
from calib_pin.residual_models import LearnedCorrection, TrainedRegion
from calib_pin.residual_models.harmonic_process import HarmonicProcess
from calib_pin.residual_models.harmonics import Harmonics
from calib_pin.setup import FrameSetup, Setup, ToolSetup
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.summaries import Provenance

NOTHING = Provenance((), "", 0.0, {})
TOOL = FrameSetup((0.05, 0.02, 0.1), (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def learned() -> CalibrationResult:
    """A calibration of space6 with harmonics that only a network can describe."""
    chain = calib_pin.load_chain("space6")
    truth = Setup(parameters=("joint-offset", "transmission"), tool_frame=TOOL)
    problem = nominal_problem(chain, "position", truth)
    rng = np.random.default_rng(2)
    errors = calib_pin.draw_errors(problem.parameters, rng)
    rows = calib_pin.simulate(problem, errors, rng, count=60, noise=2e-5)
    setup = Setup(parameters=("joint-offset",), learned="network")
    return calib_pin.calibrate(chain, rows, setup, validate=False)


@pytest.fixture
def folder(learned: CalibrationResult, tmp_path: Path) -> Path:
    """What `calibrate` would write."""
    data = encode_residual_model(learned.model)
    assert data is not None
    (tmp_path / RESIDUAL_MODEL).write_bytes(data)
    document = calibration_document(learned, NOTHING, reference(data))
    (tmp_path / "calibration.json").write_bytes(encode(document))
    return tmp_path


def test_it_predicts_as_before(learned: CalibrationResult, folder: Path) -> None:
    model = read_calibration(folder / "calibration.json")
    q = model.chains.random_configurations(50, np.random.default_rng(0))
    found = model.only.error.learned
    assert isinstance(found, LearnedCorrection) and found.model.name == "network"
    poses = model.of().poses(q)
    np.testing.assert_allclose(poses, learned.model.of().poses(q), atol=1e-13)
    # It does correct something.
    plain = model.without_corrections.of().poses(q)
    assert np.abs(plain - poses).max() > 1e-5
    assert not model.of().outside(q).all()


def test_so_does_one_of_many_measurements(
    learned: CalibrationResult, folder: Path
) -> None:
    q = learned.model.chains.random_configurations(40, np.random.default_rng(0))
    modes = np.zeros((2, 6), np.int64)
    modes[:, 1] = 1, 2
    process = HarmonicProcess(
        region=TrainedRegion.of(q, np.ones(6, bool), np.random.default_rng(0)),
        shift=np.zeros(0),
        space="joint",
        unit=np.full(6, 1e-3),
        harmonics=Harmonics(modes, np.array([2, 4])),
        amplitudes=np.array([0.5, 0.25]),
        root=np.ones(2),
        spread=np.array([0.1, 0.0, 0.2]),
        held_out=(1.0, 0.5),
        released=np.zeros((0, 0)),
    )
    network = learned.model.only.error.learned
    assert isinstance(network, LearnedCorrection)
    model = with_learned(learned.model, replace(network, model=process))
    data = encode_residual_model(model)
    assert data is not None
    (folder / "other.json").write_bytes(data)
    found = read_residual_model(folder / "other.json", learned.model)
    assert isinstance(found.model, HarmonicProcess)
    np.testing.assert_array_equal(found(q), process(q))
    np.testing.assert_array_equal(found.model.deviation(q), process.deviation(q))


def test_it_belongs_to_all_tools_of_a_chain(
    learned: CalibrationResult, tmp_path: Path
) -> None:
    network = learned.model.only.error.learned
    assert isinstance(network, LearnedCorrection)
    keys = [BlockKey("position", "", "", tool) for tool in ("a", "b")]
    setup = Setup(
        parameters=("joint-offset",),
        tools={"a": ToolSetup(TOOL.xyz), "b": ToolSetup((0.0, 0.1, 0.2))},
    )
    problem = nominal_problem(learned.model.chains, keys, setup)
    model = CalibratedModel.create(problem, np.zeros(len(problem.given)))
    shift = np.arange(1.0, len(problem.given) + 1.0) * 1e-4
    model = with_learned(model, replace(network, shift=shift))
    data = encode_residual_model(model)
    assert data is not None
    file = tmp_path / RESIDUAL_MODEL
    file.write_bytes(data)
    found = with_learned(model, read_residual_model(file, model))
    q = model.chains.random_configurations(5, np.random.default_rng(0))
    for key in keys:
        np.testing.assert_array_equal(found.of(key).poses(q), model.of(key).poses(q))
    plain = model.without_corrections.of(keys[1]).poses(q)
    assert np.abs(plain - found.of(keys[1]).poses(q)).max() > 1e-5


def test_nothing_was_learned(learned: CalibrationResult) -> None:
    assert encode_residual_model(learned.model.without_corrections) is None


def test_it_is_plain_numbers(folder: Path) -> None:
    document = json.loads((folder / RESIDUAL_MODEL).read_text())
    keys = {"format", "version", "robot", "shift", "model", "sha256"}
    assert set(document) == keys

    def leaves(value: Any) -> None:
        if isinstance(value, dict | list):
            for item in value.values() if isinstance(value, dict) else value:
                leaves(item)
        else:
            assert isinstance(value, str | float | int)

    leaves(document)


@pytest.fixture
def bad(folder: Path, refused: Callable[..., Any]) -> Callable[..., None]:
    """The file beside the calibration cannot be used: `bad(reason="...", ...)`."""

    def bad(**fields: Any) -> None:
        with refused(InputError, file=str(folder / RESIDUAL_MODEL), **fields):
            read_calibration(folder / "calibration.json")

    return bad


def edit(folder: Path, change: Callable[[dict[str, Any]], None]) -> None:
    file = folder / RESIDUAL_MODEL
    document = json.loads(file.read_text())
    change(document)
    file.write_text(json.dumps(document))


def test_a_number_was_edited(folder: Path, bad: Callable[..., None]) -> None:
    def change(document: dict[str, Any]) -> None:
        document["model"]["typical"][0] *= 1.5

    edit(folder, change)
    bad(reason="checksum")


@pytest.mark.parametrize("part", [0.0, 0.3, 0.9, 0.9999])
def test_it_was_cut_off(folder: Path, bad: Callable[..., None], part: float) -> None:
    data = (folder / RESIDUAL_MODEL).read_bytes()
    (folder / RESIDUAL_MODEL).write_bytes(data[: int(part * len(data))])
    bad(reason="truncated")


@pytest.mark.parametrize("version", [2, 0, "1", None])
def test_another_version(
    folder: Path, bad: Callable[..., None], version: object
) -> None:
    edit(folder, lambda document: document.update(version=version))
    bad(value=version, reason="another version", allowed="1 to 1")


@pytest.mark.parametrize("content", [b"[]", b"{}", b'{"format": "something"}'])
def test_another_file(folder: Path, bad: Callable[..., None], content: bytes) -> None:
    (folder / RESIDUAL_MODEL).write_bytes(content)
    bad(reason="not a residual model")


def test_it_is_gone(folder: Path, bad: Callable[..., None]) -> None:
    (folder / RESIDUAL_MODEL).unlink()
    bad(reason="no such file")


def on_chain(model: CalibratedModel, chain: Chain) -> CalibratedModel:
    """A model whose only chain is another one."""
    part = model.only
    part = replace(part, error=replace(part.error, chain=chain))
    return model.with_parts({part.key: part})


def test_of_another_robot(
    learned: CalibrationResult, folder: Path, refused: Callable[..., Any]
) -> None:
    other = nominal_problem(calib_pin.load_chain("pa10"), "position", Setup())
    with refused(InputError, reason="another robot: 'space6'", allowed="'pa10'"):
        read_residual_model(folder / RESIDUAL_MODEL, other)
    # The same name with other numbers in it.
    chain = learned.model.chains[""]
    moved = replace(chain.robot, source=chain.robot.source + b"\n")
    other = on_chain(learned.model, Chain(moved, chain.base, chain.tip))
    with refused(InputError, reason="another robot: other content of its URDF"):
        read_residual_model(folder / RESIDUAL_MODEL, other)


def test_of_another_chain(
    learned: CalibrationResult, folder: Path, refused: Callable[..., Any]
) -> None:
    chain = learned.model.chains[""]
    links = [link for link in chain.robot.links if link != chain.tip]
    other = on_chain(learned.model, Chain(chain.robot, chain.base, links[-1]))
    with refused(InputError, reason="another robot: the chain"):
        read_residual_model(folder / RESIDUAL_MODEL, other)


def test_of_another_calibration(
    learned: CalibrationResult, folder: Path, bad: Callable[..., None]
) -> None:
    """Its checksum is right, but this calibration was written with another one."""
    part = learned.model.only
    network = part.error.learned
    assert isinstance(network, LearnedCorrection)
    changed = replace(network, shift=2.0 * network.shift)
    part = replace(part, error=replace(part.error, learned=changed))
    data = encode_residual_model(learned.model.with_parts({part.key: part}))
    assert data is not None
    (folder / RESIDUAL_MODEL).write_bytes(data)
    bad(reason="not the file that this calibration was written with")


def test_of_other_parameters(
    learned: CalibrationResult, folder: Path, refused: Callable[..., Any]
) -> None:
    chain = learned.model.chains
    other = nominal_problem(chain, "position", Setup(parameters=("placement",)))
    with refused(InputError, reason="'shift' has the shape"):
        read_residual_model(folder / RESIDUAL_MODEL, other)


def test_the_file_of_a_calibration_stands_beside_it(
    folder: Path, refused: Callable[..., Any]
) -> None:
    file = folder / "calibration.json"
    document = json.loads(file.read_text())
    document["residual_model"]["file"] = "/etc/passwd"
    file.write_text(json.dumps(document))
    with refused(InputError, file=str(folder / "passwd"), reason="no such file"):
        read_calibration(file)


def test_models_are_those_of_the_calibration(folder: Path) -> None:
    model = read_calibration(folder / "calibration.json")
    assert isinstance(model, CalibratedModel)
    assert model.setup.learned == "network"


@pytest.mark.parametrize("change", ["null", "delete", "text"])
def test_what_was_learned_cannot_get_lost(
    folder: Path, refused: Callable[..., Any], change: str
) -> None:
    file = folder / "calibration.json"
    document = json.loads(file.read_text())
    if change == "delete":
        del document["residual_model"]
    else:
        document["residual_model"] = None if change == "null" else "network"
    file.write_text(json.dumps(document))
    with refused(InputError, reason="'residual_model'"):
        read_calibration(file)
