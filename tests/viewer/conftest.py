"""What several tests of the viewer draw."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.measurement_models import MeasurementModel
from calib_pin.observations import Measurements
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.setup import Setup
from calib_pin.validation.calibrated_model import CalibratedModel


@pytest.fixture(scope="session")
def panda() -> Chain:
    return load_chain("example:panda", tip="panda_hand")


@pytest.fixture
def calibrated() -> Callable[..., CalibratedModel]:
    """A calibration with random errors: `calibrated(chain, measurement, ...)`.

    Base and tool stand somewhere; names of parameterizations may follow.
    """

    def make(
        chain: Chain, measurement: MeasurementModel, *names: str, **settings: Any
    ) -> CalibratedModel:
        rng = np.random.default_rng(1)
        setup = Setup(parameters=names or ("placement",), **settings)
        error = ErrorModel.create(chain, setup.parameters, setup=setup)
        theta = error.parameters.scales * rng.uniform(-1.0, 1.0, len(error.screws))
        theta[error.parameters.nuisance] = 0.0
        frames = (pin.exp6(rng.normal(size=6)) for _ in range(2))
        return CalibratedModel(error.with_frames(*frames), measurement, theta, setup)

    return make


@pytest.fixture
def measured_rows() -> Callable[..., Measurements]:
    """Rows of a calibration, off by a millimeter: `measured_rows(model, count)`."""

    def make(
        model: CalibratedModel, count: int, target: tuple[str, ...] = ()
    ) -> Measurements:
        rng = np.random.default_rng(2)
        chain, measurement = model.chain, model.measurement
        q = chain.random_configurations(count, rng)
        target = target or ("",) * count
        instrument = np.zeros(len(measurement.parameters))
        values = measurement.predict(model.poses(q), instrument, target)
        noise = 1e-3 * rng.normal(size=(count, measurement.quantities[-1].columns.stop))
        return Measurements(
            joints=chain.joints,
            q=q,
            model=measurement.name,
            values=measurement.disturb(values, noise),
            target=target,
        )

    return make


@pytest.fixture
def write(tmp_path: Path) -> Callable[[str, str], Path]:
    """Write a file in a temporary folder: `write(name, text)`."""

    def make(name: str, text: str) -> Path:
        file = tmp_path / name
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text)
        return file

    return make
