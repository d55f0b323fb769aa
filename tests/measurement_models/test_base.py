"""What all measurement models share. Jacobians are compared in `test_jacobians`."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.errors import OptionError
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import (
    MEASUREMENT_MODELS,
    MeasurementModel,
    measurement_model,
)
from calib_pin.observations import Measurements
from calib_pin.setup import PlaneSetup, Setup
from tests.shared import EQUIPPED, rows_of

SETUP = Setup(
    planes={
        "floor": PlaneSetup((0.1, 0.2, 1.0), 2.5),
        "wall": PlaneSetup((1.0, 0.3, 0.2), -3.0),
    }
)
FREE = ("position", "pose", "plane-distance")
"""Models whose rows need not name anything."""

CASES = {**{name: name for name in MEASUREMENT_MODELS}, "named points": "position"}


@pytest.fixture(params=CASES)
def model(request: pytest.FixtureRequest) -> MeasurementModel:
    """Each model, with all that its rows can name; the board hangs before a camera."""
    setup = SETUP if request.param in FREE else EQUIPPED
    if request.param == "camera":
        board = {
            name: replace(point, xyz=(x, y, z + 8.0))
            for name, point in EQUIPPED.targets.items()
            for x, y, z in [point.xyz]
        }
        setup = replace(EQUIPPED, targets=board)
    return measurement_model(CASES[request.param], setup)


def poses(model: MeasurementModel, seed: int = 0, count: int = 20) -> Floats:
    rng = np.random.default_rng(seed)
    # What a camera looks at must stay before it.
    size = 0.2 if model.name == "camera" else 1.0
    twists = size * rng.normal(size=(count, 6))
    return np.array([pin.exp6(twist).homogeneous for twist in twists])


def exact(model: MeasurementModel, T: Floats, instrument: Floats) -> Measurements:
    names = tuple(model.targets) or ("",)
    target = tuple(names[i % len(names)] for i in range(len(T)))
    return rows_of(model.name, model.predict(T, instrument, target), *names)


def parameters_of(model: MeasurementModel) -> Floats:
    scales = np.array([parameter.scale for parameter in model.parameters])
    return np.random.default_rng(1).normal(size=len(scales)) * 0.1 * scales


def test_shapes_and_names(model: MeasurementModel, request: Any) -> None:
    assert model.name == CASES[request.node.callspec.params["model"]]
    T, instrument = poses(model), parameters_of(model)
    data = exact(model, T, instrument)
    linear = model.linearize(T, instrument, data)
    size = model.quantities[-1].columns.stop
    assert data.values.shape == (20, model.width)
    assert linear.residual.shape == (20, size)
    assert linear.J_pose.shape == (20, size, 6)
    assert linear.J_instrument.shape == (20, size, len(instrument))
    np.testing.assert_array_equal(linear.residual, model.residual(T, instrument, data))
    assert model.observable(T, instrument, data.target).shape == (20,)
    # The quantities cover the residual one after the other.
    edges = [0]
    for quantity in model.quantities:
        assert quantity.columns.start == edges[-1]
        edges.append(quantity.columns.stop)
        expected = {"m": 1e-4, "rad": 1e-4, "px": 0.5}
        assert quantity.sigma == expected[quantity.unit]
    for parameter in model.parameters:
        assert parameter.nuisance
        assert parameter.scale == 1.0 or ".intrinsics." in parameter.name
    assert not model.missing


def test_residual_of_a_disturbance_is_its_negative(model: MeasurementModel) -> None:
    """And predictions leave none, but where a tool should touch something."""
    T, instrument = poses(model), parameters_of(model)
    data = exact(model, T, instrument)
    size = model.quantities[-1].columns.stop
    noise = np.random.default_rng(2).normal(size=(20, size)) * 0.3
    kept = data.values.copy()
    disturbed = replace(data, values=model.disturb(data.values, noise))
    np.testing.assert_array_equal(data.values, kept)
    before, residual = (model.residual(T, instrument, d) for d in (data, disturbed))
    contact = model.declaration.contact
    largest = max(1.0, np.abs(data.values).max(initial=0.0))
    assert (np.abs(before).max() < 1e-12 * largest) != contact
    # A contact has no value that noise could be in.
    expected = np.zeros_like(noise) if contact else -noise
    np.testing.assert_allclose(
        residual - before, expected, rtol=0, atol=1e-12 * largest
    )


def test_instrument_parameters_move_into_the_references(
    model: MeasurementModel,
) -> None:
    T, instrument = poses(model), parameters_of(model)
    moved = model.rebased(instrument)
    data = exact(model, T, instrument)
    zero = np.zeros_like(instrument)
    again = moved.predict(T, zero, data.target)
    np.testing.assert_allclose(again, data.values, rtol=1e-11, atol=1e-13)
    residual = model.residual(T, instrument, data)
    size = max(1.0, np.abs(data.values).max(initial=0.0))
    np.testing.assert_allclose(
        moved.residual(T, zero, data), residual, rtol=0, atol=1e-12 * size
    )
    assert [p.name for p in moved.parameters] == [p.name for p in model.parameters]


def test_known_frames_stand(model: MeasurementModel) -> None:
    T = poses(model)
    data = exact(model, T, np.zeros(len(model.parameters)))
    B, X = pin.exp6(np.full(6, 0.1)), pin.exp6(np.full(6, -0.2))
    F = np.array([(B.inverse() * pin.SE3(M) * X.inverse()).homogeneous for M in T])
    registered, base, tool = model.register(F, data, B, X)
    assert base == B and tool == X
    # So do places and points that are given.
    for one, other in zip(registered.references, model.references, strict=True):
        assert one.stated() == other.stated()


def test_errors_of_a_quantity() -> None:
    position, orientation = measurement_model("pose", Setup()).quantities
    residual = np.array([[1.0, 2.0, 2.0, 0.0, 0.6, 0.8]])
    assert position.errors(residual) == pytest.approx([3.0])
    assert orientation.errors(residual) == pytest.approx([1.0])
    (distance,) = measurement_model("plane-distance", Setup()).quantities
    np.testing.assert_allclose(distance.errors(np.array([[-2.0]])), [2.0])
    with pytest.raises(OptionError, match="'plane-distance'"):
        measurement_model("plane-distence", Setup())
