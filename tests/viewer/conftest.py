"""What several tests of the viewer draw."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.estimation.terms import Frames, Term, assembled
from calib_pin.io.urdf import load_chain
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.shapes import Shape, Surface
from calib_pin.measurement_models import MeasurementModel
from calib_pin.measurement_models.position import Position
from calib_pin.observations import BlockKey, Labels, Measurements, Observations
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.setup import Setup
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.evaluation import registered_robot
from calib_pin.viewer.scene import Rows, Scene, bodies_of, stage_errors


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
        drawn = rng.uniform(-1.0, 1.0, len(error.screws))
        frames = (pin.exp6(rng.normal(size=6)) for _ in range(2))
        chains, key = Chains.of(chain), BlockKey(measurement.declaration.name)
        columns, index = chains.columns(""), np.zeros(0, np.intp)
        error = error.with_frames(*frames)
        part = Term(error, measurement, key, Frames(), columns, index)
        parts, given = assembled([part])
        theta = np.append(drawn, np.zeros(len(given) - len(drawn))) * given.scales
        theta[given.nuisance] = 0.0
        return CalibratedModel(chains, parts, given, theta, setup)

    return make


@pytest.fixture
def measured_rows() -> Callable[..., Observations]:
    """Rows of a calibration, off by a millimeter: `measured_rows(model, count)`."""

    def make(
        model: CalibratedModel, count: int, target: tuple[str, ...] = ()
    ) -> Observations:
        rng = np.random.default_rng(2)
        chain, measurement = model.of(), model.only.measurement
        q = chain.chain.random_configurations(count, rng)
        target = target or ("",) * count
        instrument = np.zeros(len(measurement.parameters))
        values = measurement.predict(chain.poses(q), instrument, Labels.of(target))
        noise = 1e-3 * rng.normal(size=(count, measurement.quantities[-1].columns.stop))
        return Observations.of(
            Measurements(
                joints=chain.chain.joints,
                q=q,
                model=model.only.key.model,
                values=measurement.disturb(values, noise),
                target=Labels.of(target),
            )
        )

    return make


@pytest.fixture
def scene(
    panda: Chain, calibrated: Callable[..., Any], measured_rows: Callable[..., Any]
) -> Scene:
    """Triangles for links: what is asked for is not their looks."""
    model = calibrated(panda, Position())
    rows = measured_rows(model, 6)
    errors = stage_errors(registered_robot(model, rows), panda.base)
    small = Surface(np.eye(3), np.array([[0, 1, 2]]))
    return Scene(
        title="arm",
        shapes=tuple(Shape(link, np.eye(4), small) for link in panda.robot.links[:9]),
        bodies=tuple(bodies_of(panda.robot, panda.base, model)),
        chains=model.chains,
        rows=Rows(rows, {"before": errors, "after": errors}),
        plan=rows.q[:3],
    )


@pytest.fixture
def viser_server() -> Iterator[Any]:
    import viser

    server = viser.ViserServer("127.0.0.1", 0, verbose=False)
    yield server
    server.stop()
