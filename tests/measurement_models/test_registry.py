"""What all measurement models share. Jacobians are compared in `test_jacobians`."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.errors import OptionError
from calib_pin.measurement_models import (
    MEASUREMENT_MODELS,
    MeasurementModel,
    measurement_model,
)
from calib_pin.measurements import Measurements
from calib_pin.setup import PlaneSetup, Setup
from calib_pin.spatial import Floats

SETUP = Setup(
    planes={
        "floor": PlaneSetup((0.1, 0.2, 1.0), 2.5),
        "wall": PlaneSetup((1.0, 0.3, 0.2), -3.0),
    }
)


def poses(seed: int = 0, count: int = 20) -> Floats:
    rng = np.random.default_rng(seed)
    return np.array([pin.exp6(rng.normal(size=6)).homogeneous for _ in range(count)])


def exact(model: MeasurementModel, T: Floats, own: Floats) -> Measurements:
    target = tuple(("floor", "wall")[i % 2] for i in range(len(T)))
    return Measurements(
        joints=("j",),
        q=np.zeros((len(T), 1)),
        model=model.name,
        values=model.predict(T, own, target),
        target=target,
    )


def parameters_of(model: MeasurementModel) -> Floats:
    return np.random.default_rng(1).normal(size=len(model.parameters)) * 0.1


@pytest.mark.parametrize("name", MEASUREMENT_MODELS)
def test_shapes_and_names(name: str) -> None:
    model = measurement_model(name, SETUP)
    assert model.name == name
    T, own = poses(), parameters_of(model)
    data = exact(model, T, own)
    linear = model.linearize(T, own, data)
    size = model.quantities[-1].columns.stop
    assert linear.residual.shape == (20, size)
    assert linear.by_twist.shape == (20, size, 6)
    assert linear.by_own.shape == (20, size, len(own))
    np.testing.assert_array_equal(linear.residual, model.residual(T, own, data))
    assert model.observable(T, own, data.target).shape == (20,)
    # The quantities cover the residual one after the other.
    edges = [0]
    for quantity in model.quantities:
        assert quantity.columns.start == edges[-1]
        edges.append(quantity.columns.stop)
        assert quantity.unit in ("m", "rad") and quantity.sigma == 1e-4
    for parameter in model.parameters:
        assert parameter.nuisance and parameter.scale == 1.0


@pytest.mark.parametrize("name", MEASUREMENT_MODELS)
def test_predictions_leave_no_residual(name: str) -> None:
    model = measurement_model(name, SETUP)
    T, own = poses(), parameters_of(model)
    residual = model.residual(T, own, exact(model, T, own))
    assert np.abs(residual).max() < 1e-14


@pytest.mark.parametrize("name", MEASUREMENT_MODELS)
def test_residual_of_a_disturbance_is_its_negative(name: str) -> None:
    model = measurement_model(name, SETUP)
    T, own = poses(), parameters_of(model)
    data = exact(model, T, own)
    size = model.quantities[-1].columns.stop
    noise = np.random.default_rng(2).normal(size=(20, size)) * 0.3
    kept = data.values.copy()
    disturbed = replace(data, values=model.disturb(data.values, noise))
    np.testing.assert_array_equal(data.values, kept)
    residual = model.residual(T, own, disturbed)
    np.testing.assert_allclose(residual, -noise, rtol=0, atol=1e-13)


@pytest.mark.parametrize("name", MEASUREMENT_MODELS)
def test_own_parameters_move_into_the_references(name: str) -> None:
    model = measurement_model(name, SETUP)
    T, own = poses(), parameters_of(model)
    moved = model.about(own)
    data = exact(model, T, own)
    again = moved.predict(T, np.zeros_like(own), data.target)
    np.testing.assert_allclose(again, data.values, rtol=1e-12, atol=1e-14)
    assert [p.name for p in moved.parameters] == [p.name for p in model.parameters]


@pytest.mark.parametrize("name", MEASUREMENT_MODELS)
def test_known_frames_stand(name: str) -> None:
    model = measurement_model(name, SETUP)
    T = poses()
    data = exact(model, T, np.zeros(len(model.parameters)))
    B, X = pin.exp6(np.full(6, 0.1)), pin.exp6(np.full(6, -0.2))
    F = np.array([(B.inverse() * pin.SE3(M) * X.inverse()).homogeneous for M in T])
    _, base, tool = model.register(F, data, B, X)
    assert base == B and tool == X


def test_errors_of_a_quantity() -> None:
    (quantity,) = measurement_model("position", Setup()).quantities
    np.testing.assert_allclose(quantity.errors(np.array([[3.0, 4.0, 0.0]])), [5.0])
    (distance,) = measurement_model("plane-distance", Setup()).quantities
    np.testing.assert_allclose(distance.errors(np.array([[-2.0]])), [2.0])
    position, orientation = measurement_model("pose", Setup()).quantities
    residual = np.array([[1.0, 2.0, 2.0, 0.0, 0.6, 0.8]])
    assert position.errors(residual) == pytest.approx([3.0])
    assert orientation.errors(residual) == pytest.approx([1.0])


def test_unknown_name() -> None:
    with pytest.raises(OptionError) as caught:
        measurement_model("plane-distence", Setup())
    text = str(caught.value)
    assert "unknown measurement model 'plane-distence'" in text
    assert "did you mean 'plane-distance'?" in text
    assert "allowed: position, pose, plane-distance" in text
