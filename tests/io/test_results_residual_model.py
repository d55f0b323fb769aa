"""Residual models in a result: they come back as they were, or not at all."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import calib_pin
import calib_pin.io.results as results
from calib_pin.errors import InputError, OptionError
from calib_pin.io.json_text import encode
from calib_pin.residual_models import LearnedCorrection
from calib_pin.setup import FrameSetup, Setup
from calib_pin.validation.result import CalibrationResult, Provenance
from tests.shared import refused, simulated

TOOL = FrameSetup((0.05, 0.02, 0.1), (0.0, 0.0, 0.0))


@pytest.fixture(scope="module")
def learned() -> CalibrationResult:
    """A calibration of space6 with harmonics that only a network can describe."""
    truth = Setup(parameters=("joint-offset", "transmission"), tool_frame=TOOL)
    problem, _ = simulated("position", truth, 30, 1.0, seed=2, noise=2e-5)
    setup = Setup(parameters=("joint-offset",), learned="network")
    chain = problem.chains[""]
    return calib_pin.calibrate(chain, problem.data, setup, validate=False)


@pytest.fixture
def file(learned: CalibrationResult, tmp_path: Path) -> Path:
    file = tmp_path / "calibration.json"
    file.write_bytes(encode(results.calibration_document(learned, Provenance())))
    return file


def test_it_predicts_as_before(learned: CalibrationResult, file: Path) -> None:
    model = results.read_calibration(file)
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
    assert results.learned_record(model.without_corrections) is None
    with refused(OptionError):
        results.write_urdf(model, file.with_name("corrected.urdf"))
    results.write_urdf(model.without_corrections, file.with_name("corrected.urdf"))


def test_what_was_edited_is_refused(file: Path) -> None:
    """Nobody can see from its numbers that one of them is another."""
    good = json.loads(file.read_text())
    there = good["residual_model"]
    model, (shift, *others) = there["model"], there["shift"]
    larger = [1.5 * size for size in model["held_out"]]
    for part in (
        None,
        "net",
        there | {"model": model | {"held_out": larger}},
        there | {"shift": [shift + 1e-6, *others]},
        there | {"shift": others},
        there | {"model": {}},
        there | {"sha256": "0" * 64},
    ):
        file.write_text(json.dumps(good | {"residual_model": part}))
        with refused(
            InputError, "residual_model" * isinstance(part, dict), file=str(file)
        ):
            results.read_calibration(file)
