"""Gauges that count the other way, and what their readings are worth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.measurement_models.readings import read_otherwise
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import (
    DistanceSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    ReadingSetup,
    Setup,
    SphereSetup,
)
from calib_pin.validation.calibrated_model import CalibratedModel

ARM = calib_pin.load_chain("space6", tip="tool")
TOOL = FrameSetup((0.05, 0.08, 0.12), estimate=True)
NOISE = 2e-5
STATED: dict[str, dict[str, Any]] = {
    "sphere-contact": {
        "spheres": {
            "a": SphereSetup((0.6, 0.3, 0.4), 0.15),
            "b": SphereSetup((0.6, -0.4, 0.5), 0.1),
            "c": SphereSetup((-0.3, 0.5, 0.6), 0.12),
        },
    },
    "plane-contact": {
        "planes": {
            "a": PlaneSetup((0.0, 0.0, 1.0), -0.3),
            "b": PlaneSetup((0.0, 0.0, 1.0), -0.55),
            "c": PlaneSetup((1.0, 0.0, 0.0), 0.5),
            "d": PlaneSetup((0.0, 1.0, 0.0), -0.4),
        },
        "distances": (DistanceSetup(("a", "b"), 0.25, 1e-5),),
    },
    "fixed-point": {
        "sockets": {
            "a": PointSetup((0.6, 0.3, 0.4)),
            "b": PointSetup((0.5, -0.2, 0.6)),
        },
        "distances": (DistanceSetup(("a", "b"), 0.3**0.5, 1e-5),),
    },
}


@pytest.fixture(scope="module")
def gauged(simulated):
    """A job with readings of +-0.5 mm: measurements, setup and the true robot."""
    made: dict[str, Any] = {}

    def make(model: str) -> tuple[Measurements, Setup, CalibratedModel]:
        if model not in made:
            noise = {"contact": NOISE, "position": NOISE}
            setup = Setup(tool_frame=TOOL, noise=noise, gauge=5e-4, **STATED[model])
            problem, theta = simulated(model, setup, 160, 1.0, robot=ARM, noise=NOISE)
            true = CalibratedModel.create(problem, theta)
            made[model] = problem.data.only, setup, true
        return made[model]

    return make


def off(found: CalibratedModel, true: CalibratedModel) -> float:
    """Errors of the touching point over the workspace, but for a displacement [m]."""
    q = ARM.random_configurations(200, np.random.default_rng(9))
    a, b = (model.of().poses(q)[:, :3, 3] for model in (found, true))
    a, b = a - a.mean(axis=0), b - b.mean(axis=0)
    U, _, Vt = np.linalg.svd(a.T @ b)
    return float(np.sqrt(np.mean(np.sum((a @ U @ Vt - b) ** 2, axis=1))))


@pytest.mark.parametrize("model", STATED)
def test_readings_count(gauged, model: str) -> None:
    """With them the true error is of the size of the noise; without, of the readings.

    A contact tells one number at a configuration, and over the workspace its noise is
    a few times as large.
    """
    rows, setup, true = gauged(model)
    found = calib_pin.calibrate(ARM, rows, setup, validate=False)
    assert not {f.code for f in found.findings} & {"gauge-sign", "noise"}
    assert off(found.model, true) < 4.0 * NOISE
    blind = replace(rows, values=rows.values[:, :0])
    assert off(calib_pin.calibrate(ARM, blind, setup, validate=False).model, true) > (
        5.0 * off(found.model, true)
    )


@pytest.mark.parametrize("model", STATED)
def test_the_opposite_sign_is_told(gauged, model: str) -> None:
    rows, setup, _ = gauged(model)
    wrong = replace(rows, values=-rows.values)
    found = calib_pin.calibrate(ARM, wrong, setup, validate=False)
    (told,) = (f for f in found.findings if f.code == "gauge-sign")
    assert found.verdict == "untrusted" and told.setup == {
        "reading": {"opposite": True}
    }
    right = read_otherwise(Observations.of(wrong), ReadingSetup(opposite=True))
    np.testing.assert_array_equal(right.only.values, rows.values)


def test_a_normal_that_points_inwards_is_told(gauged) -> None:
    rows, setup, _ = gauged("plane-contact")
    plane = setup.planes["c"]
    turned = PlaneSetup(tuple(-k for k in plane.normal), -plane.offset)
    planes = {**setup.planes, "c": turned}
    found = calib_pin.calibrate(
        ARM, rows, replace(setup, planes=planes), validate=False
    )
    (told,) = (f for f in found.findings if f.code == "gauge-sign")
    assert " at c have " in told.message and "normals" in told.remedy
