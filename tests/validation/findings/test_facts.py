"""Facts that measurements show: steps, copies, ranges, gauges that count backwards."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError
from calib_pin.measurement_models.orientations import numbers_of, quaternions
from calib_pin.measurement_models.readings import read_otherwise
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import (
    AnchorSetup,
    DistanceSetup,
    FrameSetup,
    PlaneSetup,
    PointSetup,
    ReadingSetup,
    Setup,
    SphereSetup,
)
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.findings.facts import (
    coarse_step,
    require_distances,
    require_motion,
)
from tests.shared import simulated

RANDOM = np.random.default_rng(0).uniform(-2.0, 2.0, 60)


@pytest.mark.parametrize("step", [1e-3, 2.54e-3, 1e-6])
def test_the_largest_step_of_all_values(step: float) -> None:
    assert coarse_step(step * np.round(RANDOM / step), "m") == pytest.approx(step)


def test_no_step() -> None:
    assert coarse_step(RANDOM, "m") == 0.0
    shown = np.array([float(f"{1e3 * value:.2E}") for value in RANDOM])
    sizes = 10.0 ** (np.floor(np.log10(np.abs(shown))) - 2.0)
    rms = 1e-3 * np.sqrt(np.mean(sizes**2))
    assert coarse_step(1e-3 * shown, "m") == pytest.approx(rms)
    # Ten of them may stand on a grid because someone wanted them there.
    assert coarse_step(np.repeat(np.arange(10.0), 6), "m") == 0.0
    degrees = np.radians(0.1 * np.round(np.degrees(RANDOM) / 0.1))
    assert coarse_step(degrees, "rad") == pytest.approx(np.radians(0.1))


@pytest.mark.parametrize(("configurations", "jitter"), [(1, 0.0), (1, 1e-4), (2, 0.0)])
def test_joints_that_do_not_follow_the_robot(ur10, configurations, jitter) -> None:
    """Of one configuration at rest, what is measured rests as well."""
    rng = np.random.default_rng(1)
    moved, few = ur10(q=rng.uniform(-2.0, 2.0, (20, 6))), rng.normal(size=(2, 6))
    stood = few[np.arange(20) % configurations] + rng.uniform(-jitter, jitter, (20, 6))
    wrong = replace(moved.only, q=stood)
    with pytest.raises(InputError, match="did not follow the robot"):
        require_motion(Observations.of(wrong))
    require_motion(ur10(q=few[np.arange(20) % configurations]))
    require_motion(moved)


@pytest.mark.parametrize("model", ["point-distance", "plane-distance"])
def test_distances_below_zero(model: str) -> None:
    """Of an instrument that counts the other way, or is zero somewhere else."""
    joints, q = ("j",), np.arange(30.0)[:, None]
    rows = Measurements(joints, q, model, 1.0 + np.arange(30.0)[:, None])
    with pytest.raises(InputError, match=r"scale: -1"):
        require_distances(Observations.of(replace(rows, values=-rows.values)), Setup())
    zeroed = Observations.of(replace(rows, values=rows.values - 15.0))
    with pytest.raises(InputError, match=r"14 of 30 .* was not zero where"):
        require_distances(zeroed, Setup())
    require_distances(Observations.of(replace(rows, values=rows.values - 2.5)), Setup())
    wire = replace(zeroed.only, target=("w",) * 30)
    biased = Setup(anchors={"w": AnchorSetup(estimate_bias=True)})
    require_distances(Observations.of(wire), biased)


@pytest.fixture(scope="module")
def judged(ur10):
    """Findings of a whole calibration by the configurations that were measured."""

    def of(q):
        chain = calib_pin.load_chain(
            "example:ur10_robot", base="base_link", tip="tool0"
        )
        result = calib_pin.calibrate(chain, ur10(q=q), Setup(), validate=False)
        return {f.code: f for f in result.findings}

    return of


@pytest.mark.parametrize(("beside", "hidden"), [(0.0, ["joint_7"]), (0.05, [])])
def test_a_target_on_the_axis_of_the_last_joint(erring, beside, hidden) -> None:
    """Nothing tells how the tool turns about it; beside it the target does."""
    setup = Setup(tool_frame=FrameSetup((beside, 0.0, 0.1)))
    rows = erring("pa10", setup, 3, count=40)
    result = calib_pin.calibrate("pa10", rows, Setup(), validate=False)
    said = [f for f in result.findings if f.code == "hidden-joints"]
    assert [f.evidence["joints"] for f in said] == hidden


def test_a_third_of_the_range_is_a_warning_where_far_more_is_expected(judged) -> None:
    q = np.random.default_rng(2).uniform(-1.0, 1.0, (60, 6))
    assert judged(q)["small-range"].severity == "warning"
    q = np.random.default_rng(2).uniform(-np.pi, np.pi, (60, 6))
    assert judged(q * [1, 1, 1, 1, 1, 0.2])["small-range"].severity == "info"
    # Of the whole range the order does not matter, also if it is that of a path.
    assert judged(q[np.argsort(q[:, 0])]) == {}


def test_few_configurations_are_too_few_and_nothing_else(judged) -> None:
    """Three anywhere lie in a tenth of a joint's range, and move in two directions."""
    q = np.random.default_rng(3).uniform(-np.pi, np.pi, (3, 6))
    q[:, 5] = 0.5 + 0.3 * q[:, 5]
    assert set(judged(np.repeat(q, 20, axis=0))) == {"few-configurations"}


ARM = calib_pin.load_chain("space6", tip="tool")
TOOL = FrameSetup((0.05, 0.08, 0.12), estimate=True)
NOISE = 2e-5
STATED: dict[str, dict[str, Any]] = {
    "sphere-contact": {
        "spheres": {
            "a": SphereSetup((0.6, 0.3, 0.4), 0.15),
            "b": SphereSetup((0.6, -0.4, 0.5), 0.1),
            "c": SphereSetup((-0.3, 0.5, 0.6), 0.12),
        }
    },
    "plane-contact": {
        "planes": {
            "a": PlaneSetup((0.0, 0.0, 1.0), -0.3, False),
            "b": PlaneSetup((0.0, 0.0, 1.0), -0.55, False),
            "c": PlaneSetup((1.0, 0.0, 0.0), 0.5, False),
            "d": PlaneSetup((0.0, 1.0, 0.0), -0.4, False),
        },
        "base_frame": FrameSetup(estimate=True),
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
def gauged():
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


@pytest.mark.parametrize(
    "model",
    [
        "fixed-point",
        pytest.param("plane-contact", marks=pytest.mark.slow),
        pytest.param("sphere-contact", marks=pytest.mark.slow),
    ],
)
def test_readings_count(gauged, model: str) -> None:
    """With them the true error is the promised one, of the noise; without, far more."""
    rows, setup, true = gauged(model)
    found = calib_pin.calibrate(ARM, rows, setup, validate=False)
    assert not {f.code for f in found.findings} & {"gauge-sign", "noise"}
    promised = found.accuracy.workspace.calibrated.position
    assert promised < 4.0 * NOISE and off(found.model, true) < 2.0 * promised
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


def test_coarse_joint_positions(told) -> None:
    step = np.radians(0.02)
    found = told(lambda rows: {"q": step * np.round(rows.q / step)})
    assert found["coarse-steps"].severity == "warning"
    assert " 0.02 deg" in found["coarse-steps"].message


def test_coarse_orientations(told) -> None:
    def change(block):
        angles = numbers_of(block.values[:, 3:], "roll-pitch-yaw")[0]
        coarse = quaternions(np.round(angles, 3), "roll-pitch-yaw")
        return {"values": np.hstack([block.values[:, :3], coarse])}

    found = told(change, model="pose")["coarse-steps"]
    assert found.evidence["step"] == pytest.approx(1e-3)
    assert "orientations" in found.message


def test_fine_steps_of_a_robot_that_bends_are_no_copies(unsought) -> None:
    """Readings repeat on a grid of 1 um, beside 0.3 mm that no fit explains."""
    chain = calib_pin.load_chain("space6")
    rng = np.random.default_rng(4)
    q = np.repeat(chain.random_configurations(25, rng), 4, axis=0)
    bent = np.repeat(rng.normal(0.0, 3e-4, (25, 3)), 4, axis=0)
    points = chain.poses(q)[:, :3, 3] + bent + rng.normal(0.0, 3e-7, (100, 3))
    values = np.round(points, 6)

    def codes(values):
        rows = calib_pin.Measurements(chain.joints, q, "position", values)
        result = calib_pin.calibrate(chain, rows, validate=False)
        return {finding.code for finding in result.findings}

    assert "copied-measurements" not in codes(values)
    values = points + rng.normal(0.0, 3e-5, (100, 3))
    values[[1, 42]] = values[[0, 41]]
    assert "copied-measurements" in codes(values)
