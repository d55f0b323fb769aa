"""calibration.json: what comes back is the robot that was calibrated, or an error."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib_pin.calibration import calibrate
from calib_pin.errors import InputError, OptionError, RobotError
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.io.calibration_document import calibration_document
from calib_pin.io.json_text import encode
from calib_pin.io.results import read_accuracy, read_calibration, write_urdf
from calib_pin.io.setup import setup_document, setup_of
from calib_pin.io.urdf import load_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.measurement_models import measurement_model
from calib_pin.observations import Measurements, Observations
from calib_pin.parameterizations import frame_pose
from calib_pin.setup import (
    AnchorSetup,
    CameraSetup,
    FrameSetup,
    JointMap,
    Payload,
    PlaneSetup,
    PointSetup,
    Setup,
    SphereSetup,
)
from calib_pin.simulation import simulate
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.evaluation import evaluate
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.summaries import Provenance

ARM = """<robot name="arm">
  <link name="base"/><link name="a"/><link name="b"/><link name="c"/>
  <link name="d"/><link name="tool"/>
  <joint name="j.1" type="revolute">
    <origin xyz="0 0 0.4"/><parent link="base"/><child link="a"/><axis xyz="0 0 1"/>
    <limit lower="-2.5" upper="2.5" effort="1" velocity="1"/>
  </joint>
  <joint name="j.2" type="revolute">
    <origin xyz="0.1 0 0" rpy="0.1 0 0"/>
    <parent link="a"/><child link="b"/><axis xyz="0 1 0"/>
    <limit lower="-2" upper="2" effort="1" velocity="1"/>
  </joint>
  <joint name="plane" type="revolute">
    <origin xyz="0.5 0 0.05"/><parent link="b"/><child link="c"/><axis xyz="0 1 0"/>
    <limit lower="-2.5" upper="2.5" effort="1" velocity="1"/>
  </joint>
  <joint name="tool" type="prismatic">
    <origin xyz="0.4 0 0" rpy="0.3 0.2 0"/>
    <parent link="c"/><child link="d"/><axis xyz="0 0 -1"/>
    <limit lower="0" upper="0.4" effort="1" velocity="1"/>
  </joint>
  <joint name="flange" type="fixed">
    <origin xyz="0.1 0.02 0.05" rpy="0 1.4 0"/>
    <parent link="d"/><child link="tool"/>
  </joint>
</robot>
"""

WALL = {"my.wall": PlaneSetup((1.0, 0.2, 0.3), -1.8)}
KNOWN = FrameSetup((0.1, 0.2, 0.3), (0.4, 0.5, 0.6), estimate=False)
LOADED: dict[str, Any] = {
    "gravity": (1.5, -0.5, -9.6),
    "payloads": {"gripper": Payload(4.0, (0.1, -0.05, 0.2))},
    "gear_ratios": {"j.*": 80.0, "plane": -31.5},
}
PROVENANCE = Provenance(("calib-pin",), "2026-01-01", 0.5, {"numpy": "2"})

SLOW = pytest.mark.slow

CASES: dict[str, tuple[str, Setup]] = {
    "position": ("position", Setup()),
    "position without a tool joint": ("position", Setup(tip="d")),
    "position, joint-offset": ("position", Setup(parameters=("joint-offset",))),
    "pose, dh": ("pose", Setup(parameters=("dh",))),
    "pose, dh without a tool joint": ("pose", Setup(parameters=("dh",), tip="d")),
    "pose, dh-full": ("pose", Setup(parameters=("dh-full",))),
    "pose, link-transform": ("pose", Setup(parameters=("link-transform",))),
    "pose, joint-offset": ("pose", Setup(parameters=("joint-offset",))),
    "pose, offset first": ("pose", Setup(parameters=("joint-offset", "placement"))),
    "pose, offset last": ("pose", Setup(parameters=("placement", "joint-offset"))),
    "pose, dh and placement": ("pose", Setup(parameters=("dh", "placement"))),
    "pose, backwards": ("pose", Setup(base="tool", tip="base")),
    "pose, dh backwards": ("pose", Setup(base="tool", tip="a", parameters=("dh",))),
    "pose, known base": ("pose", Setup(base_frame=KNOWN)),
    "pose, known tool": ("pose", Setup(tool_frame=KNOWN)),
    "pose, known tool without a joint": ("pose", Setup(tip="d", tool_frame=KNOWN)),
    "pose, everything": (
        "pose",
        Setup(
            fixed=("*.placement.rz", "base.frame.z"),
            bounds={"j.1.placement.x": 0.01, "j.2.*": (-0.1, 0.2)},
            prior={"*.placement.*": 0.01},
            noise={"position": 1e-3, "orientation": 1e-5},
            joints={"J1": JointMap("j.1", -1, 2.0, 0.1, {"J2": 0.5})},
        ),
    ),
    "pose, joint corrections": (
        "pose",
        Setup(parameters=("placement", "transmission", "compliance"), **LOADED),
    ),
    "pose, corrections first": (
        "pose",
        Setup(parameters=("compliance", "transmission", "joint-offset"), **LOADED),
    ),
    "position, corrections alone": (
        "position",
        Setup(
            parameters=("compliance",),
            payloads={"p": Payload(6.0, (0.0, 0.0, 0.0))},
            tool_frame=FrameSetup((0.1, 0.0, 0.2)),
        ),
    ),
    "plane-distance": (
        "plane-distance",
        Setup(planes=WALL, parameters=("joint-offset",)),
    ),
    "plane-distance, known plane": (
        "plane-distance",
        Setup(
            planes={"my.wall": replace(WALL["my.wall"], estimate=False)},
            parameters=("dh",),
            tool_frame=KNOWN,
        ),
    ),
}

BALLS = {"ball": PointSetup((0.05, 0.0, 0.1)), "a.b": PointSetup((0.0, 0.1, 0.1))}
SOCKETS = {
    "front/0": PointSetup((0.6, 0.1, 0.3)),
    "front/1": PointSetup((0.6, -0.2, 0.35)),
    "top": PointSetup((0.5, 0.0, 0.6), estimate=False),
}
PLATES = {
    "shelf": PlaneSetup((0.1, 0.2, 1.0), -0.7),
    "floor": PlaneSetup((0.0, 0.0, 2.0), -0.8, estimate=False),
}
BOARD = {
    f"m{k}": PointSetup((0.1 * (k % 3), 0.1 * (k // 3), 0.03 * (k % 2)))
    for k in range(9)
}
WORLD = CameraSetup(
    mount="world",
    focal=(800.0, 810.0),
    center=(640.0, 480.0),
    distortion=(0.01, 0.0, 0.0, 0.0, 0.0),
    size=(1280.0, 960.0),
)
ABOVE = FrameSetup((0.0, 0.0, 4.0), (np.pi, 0.0, 0.0))
PROBE = FrameSetup((0.0, 0.02, 0.1), estimate=False)
OFFSET = ("joint-offset",)

INSTRUMENTS: dict[str, tuple[str, Setup, tuple[str, ...]]] = {
    "position, named points": (
        "position",
        Setup(parameters=OFFSET, targets=BALLS),
        ("ball", "a.b"),
    ),
    "position, some points named": (
        "position",
        Setup(parameters=OFFSET, targets=BALLS),
        ("", "ball"),
    ),
    "fixed-point": (
        "fixed-point",
        Setup(parameters=OFFSET, targets=BALLS, sockets=SOCKETS),
        ("ball@front/0", "ball@front/1", "ball@top", "a.b@top"),
    ),
    "plane-contact": (
        "plane-contact",
        Setup(parameters=OFFSET, planes=PLATES, targets=BALLS),
        ("ball@shelf", "ball@floor", "a.b@shelf"),
    ),
    "sphere-contact": (
        "sphere-contact",
        Setup(
            parameters=OFFSET,
            tool_frame=PROBE,
            spheres={
                "s.1": SphereSetup((0.6, 0.1, 0.4), 0.05),
                "s.2": SphereSetup((0.5, 0.3, 0.3), 0.04, estimate_radius=True),
            },
        ),
        ("s.1", "s.2"),
    ),
    "point-distance": (
        "point-distance",
        Setup(
            parameters=OFFSET,
            targets=BALLS,
            anchors={
                "wire": AnchorSetup((1.5, 0.1, 0.4), 0.05, estimate_bias=True),
                "rope": AnchorSetup((0.6, 1.3, 0.3)),
                "bar": AnchorSetup((0.6, -1.3, 1.3), -0.1, estimate=False),
            },
        ),
        ("ball@wire", "ball@rope", "ball@bar"),
    ),
    "relative-distance": (
        "relative-distance",
        Setup(parameters=OFFSET, tool_frame=FrameSetup((0.1, 0.0, 0.1))),
        ("1",),
    ),
    "relative-distance, a named point": (
        "relative-distance",
        Setup(parameters=OFFSET, targets=BALLS),
        ("ball@1", "2"),
    ),
    "camera in the world": (
        "camera",
        Setup(parameters=OFFSET, targets=BOARD, camera=WORLD, base_frame=ABOVE),
        tuple(BOARD),
    ),
    "camera on the hand": (
        "camera",
        Setup(
            parameters=OFFSET,
            targets=BOARD,
            camera=replace(WORLD, mount="hand"),
            base_frame=FrameSetup((0.0, 0.0, 1.5)),
        ),
        tuple(BOARD),
    ),
    "camera, estimated": (
        "camera",
        Setup(
            parameters=OFFSET,
            targets={**BOARD, "m4": PointSetup((0.1, 0.1, 0.0), estimate=True)},
            camera=replace(WORLD, estimate=True),
            base_frame=ABOVE,
        ),
        tuple(BOARD),
    ),
    "position+fixed-point": (
        "position+fixed-point",
        Setup(
            parameters=OFFSET,
            targets={**BALLS, "unseen": PointSetup((0.0, 0.0, 1.0))},
            sockets={k: replace(v, estimate=None) for k, v in SOCKETS.items()},
            base_frame=KNOWN,
        ),
        ("", "a.b", "ball@front/0", "ball@top"),
    ),
    "plane-distance+plane-contact": (
        "plane-distance+plane-contact",
        Setup(parameters=OFFSET, planes={**WALL, **PLATES}, targets=BALLS),
        ("my.wall", "ball@shelf"),
    ),
    "position+camera": (
        "position+camera",
        Setup(parameters=OFFSET, targets=BOARD, camera=WORLD, base_frame=ABOVE),
        ("", *BOARD),
    ),
}


def calibrated(
    file: Path, model: str, setup: Setup, targets: tuple[str, ...] = ()
) -> tuple[CalibrationResult, Observations]:
    """A calibration of the arm, and rows that were not fitted."""
    chain = Chain(load_robot(file), setup.base, setup.tip)
    if targets:
        problem = naming(chain, model, setup, targets)
    else:
        problem = nominal_problem(chain, model, replace(setup, fixed=(), prior={}))
    rng = np.random.default_rng(3)
    moved = problem.parameters.free & ~problem.parameters.nuisance
    theta = np.where(moved, rng.uniform(-2e-3, 2e-3, len(moved)), 0.0)
    count = max(60, 15 * len(targets))  # Of a camera alone every point takes some.
    rows, new = (
        without_sigmas(simulate(problem, theta, rng, count=k, noise=1e-4))
        for k in (count, 15)
    )
    return calibrate(chain, rows, setup, validate=False), new


def without_sigmas(data: Observations) -> Observations:
    return Observations(tuple(replace(block, sigma=None) for block in data.blocks))


@cache
def solved(case: str) -> tuple[CalibrationResult, Observations]:
    """The calibration of a case, for tests that ask for `arm`; made once."""
    return calibrated(Path("arm.urdf"), *(CASES | INSTRUMENTS)[case])


def naming(chain: Chain, model: str, setup: Setup, targets: tuple[str, ...]) -> Problem:
    """A problem whose rows name targets, about what the setup gives.

    Of several models with a plus between them each has the targets that it can look at.
    """
    blocks = []
    for name, seen in split(model, targets).items():
        width = measurement_model(name, setup, seen).width
        rows = Measurements(
            joints=chain.joints,
            q=np.zeros((len(seen), len(chain.joints))),
            model=name,
            values=np.zeros((len(seen), width)),
            target=seen,
        )
        blocks.append(rows)
    problem = make_problem(chain, Observations.of(*blocks), setup)
    parts = {}
    for key, part in problem.parts.items():
        frames = setup.base_frame, setup.tool_frame
        if "+" in model and key.model == "camera":
            frames = ABOVE, PROBE
        error = part.error.with_frames(*map(frame_pose, frames))
        parts[key] = replace(part, error=error)
    return replace(problem, parts=parts)


def split(model: str, targets: tuple[str, ...]) -> dict[str, tuple[str, ...]]:
    """The targets of each model."""
    first, _, second = model.partition("+")
    if not second:
        return {first: targets}
    count = 2 if second == "fixed-point" else 1
    return {first: targets[:count], second: targets[count:]}


def write(result: CalibrationResult, folder: Path) -> Path:
    folder.mkdir(exist_ok=True)
    file = folder / "calibration.json"
    file.write_bytes(encode(calibration_document(result, PROVENANCE)))
    return file


@pytest.fixture
def arm(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_text(ARM)
    return Path("arm.urdf")


@pytest.fixture
def stored(arm: Path) -> tuple[CalibrationResult, Path]:
    result, _ = solved("position, joint-offset")
    return result, write(result, Path("out"))


def predict(model: CalibratedModel, rows: Observations) -> Any:
    """Tool poses, values and errors."""
    problem, theta = model.problem(rows), model.theta
    T = [
        block.part.poses(theta[block.part.index], block.data)
        for block in problem.blocks
    ]
    values = [problem.predict(theta, block).reshape(-1) for block in rows.blocks]
    return np.concatenate(T), np.concatenate(values), problem.errors(theta)


def assert_equal_accuracy(
    found: CalibratedModel, model: CalibratedModel, rows: Observations
) -> None:
    for registration in (False, True):
        there, here = (
            evaluate(subject, rows, registration=registration)
            for subject in (found, model)
        )
        assert there.registered == here.registered == registration
        for a, b in zip(there.errors, here.errors, strict=True):
            assert a[:2] == b[:2]
            assert a[2].rms == pytest.approx(b[2].rms, rel=1e-6)


# --- what comes back ---------------------------------------------------------------


@pytest.mark.parametrize("case", CASES)
def test_predictions_come_back(case, arm):
    result, rows = solved(case)
    model = result.model
    # Something must have been estimated, or the test would show nothing.
    assert np.abs(model.theta).max() > 1e-5

    found = read_calibration(write(result, Path("out")))

    assert found.chains.joints == model.chains.joints
    assert found.given.names == model.given.names
    for there, here in zip(predict(found, rows), predict(model, rows), strict=True):
        np.testing.assert_allclose(there, here, rtol=0.0, atol=1e-12)
    corrections = model.urdf_corrections()
    assert found.urdf_corrections().keys() == corrections.keys()
    for joint, correction in found.urdf_corrections().items():
        assert correction.isApprox(corrections[joint], 1e-12)
    np.testing.assert_allclose(
        found.of().tool.homogeneous, model.of().tool.homogeneous, atol=1e-12
    )
    assert found.setup == model.setup
    assert_equal_accuracy(found, model, rows)


@pytest.mark.parametrize("case", INSTRUMENTS)
def test_what_rows_refer_to_comes_back(case, arm):
    result, rows = solved(case)
    model = result.model
    assert np.abs(model.theta).max() > 1e-5

    found = read_calibration(write(result, Path("out")))

    assert found.setup == model.setup
    assert found.parts.keys() == model.parts.keys()
    for there, here in zip(found.parts.values(), model.parts.values(), strict=True):
        assert there.measurement.targets == here.measurement.targets
    assert found.given.parameters == model.given.parameters
    # A frame is written as angles: poses come back to some eps, 1e-14. A camera of
    # 800 px has points from 0.1 m on before it, and so 8000 px/m: 1e-10 px.
    within = 1e-10 if "camera" in case else 1e-12
    for a, b in zip(predict(found, rows), predict(model, rows), strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=within)
    assert_equal_accuracy(found, model, rows)


def document_of(case: str) -> dict[str, Any]:
    return json.loads(encode(calibration_document(solved(case)[0], PROVENANCE)))


def test_planes_are_written_as_ever(arm):
    result, _ = solved("plane-distance")
    document = json.loads(encode(calibration_document(result, PROVENANCE)))
    planes = [m.only.measurement.planes[0] for m in (result.model, result.reference)]
    fitted, reference = (
        {"normal": plane.normal.tolist(), "offset": plane.offset} for plane in planes
    )
    assert fitted != reference
    entry = {**fitted, "estimated": True, "reference": reference}
    assert json.dumps(document["planes"]) == json.dumps({"my.wall": entry})
    assert document["targets"] == {}
    assert document["measurements"]["targets"] == ["my.wall"]
    assert {"sockets", "spheres", "anchors", "camera"}.isdisjoint(document)


def test_the_sections_of_points_and_sockets(arm):
    document = document_of("fixed-point")
    assert list(document["targets"]) == list(BALLS)
    assert list(document["sockets"]) == list(SOCKETS)
    ball, top = document["targets"]["ball"], document["sockets"]["top"]
    assert list(ball) == ["xyz", "estimated", "reference"]
    assert ball["estimated"] and not top["estimated"]
    assert top["xyz"] == top["reference"]["xyz"] == [0.5, 0.0, 0.6]
    assert ball["xyz"] == pytest.approx(BALLS["ball"].xyz, abs=0.01)
    (x,) = [p for p in document["parameters"] if p["name"] == "ball.target.x"]
    assert ball["xyz"][0] == pytest.approx(ball["reference"]["xyz"][0] + x["value"])
    assert document["planes"] == {}


def test_the_sections_of_spheres_and_anchors(arm):
    spheres = document_of("sphere-contact")["spheres"]
    keys = ["xyz", "radius", "estimated", "estimated_radius", "reference"]
    assert [list(sphere) for sphere in spheres.values()] == [keys, keys]
    assert spheres["s.1"]["radius"] == 0.05
    assert [s["estimated_radius"] for s in spheres.values()] == [False, True]
    anchors = document_of("point-distance")["anchors"]
    assert list(anchors["bar"]) == [
        "xyz",
        "bias",
        *keys[2:3],
        "estimated_bias",
        keys[4],
    ]
    assert [a["estimated"] for a in anchors.values()] == [True, True, False]
    assert [a["estimated_bias"] for a in anchors.values()] == [True, False, False]
    assert anchors["bar"]["bias"] == -0.1


def test_the_section_and_the_frames_of_a_camera(arm):
    document = document_of("position+camera")
    camera = document["camera"]
    stated = {k: v for k, v in camera.items() if k not in ("estimated", "reference")}
    assert stated == camera["reference"]
    assert stated["mount"] == "world"
    assert stated["distortion"] == [0.01, 0.0, 0.0, 0.0, 0.0]
    assert stated["size"] == [1280.0, 960.0]
    assert camera["estimated"] is False
    assert list(document["targets"]) == list(BOARD)
    frames = document["frames"]
    assert list(frames) == ["base", "camera.station", "tool", "camera.tool"]
    for frame in frames.values():
        assert {"xyz", "rpy", "estimated"} < frame.keys()
        assert frame["reference"].keys() == {"xyz", "rpy"}
    assert frames["camera.station"]["xyz"] == pytest.approx([0.0, 0.0, 4.0], abs=0.1)


@pytest.mark.parametrize(
    ("case", "path", "message"),
    [
        ("fixed-point", ("sockets",), "'front/0' is missing under 'sockets'"),
        ("fixed-point", ("sockets", "top"), "'top' is missing under 'sockets'"),
        ("fixed-point", ("targets",), "'ball' is missing under 'targets'"),
        ("plane-contact", ("planes",), "'shelf' is missing under 'planes'"),
        ("sphere-contact", ("spheres",), "'s.1' is missing under 'spheres'"),
        ("sphere-contact", ("spheres", "s.1", "radius"), "'radius' is missing"),
        ("point-distance", ("anchors",), "'wire' is missing under 'anchors'"),
        ("point-distance", ("anchors", "bar", "estimated_bias"), "is missing"),
        ("camera, estimated", ("camera",), "'camera' is missing"),
        ("camera, estimated", ("camera", "mount"), "'mount' is missing"),
        ("position+camera", ("camera",), "'camera' is missing"),
        ("position+camera", ("frames", "camera.tool"), "'camera.tool' is missing"),
        ("position+camera", ("targets", "m3"), "'m3' is missing under 'targets'"),
        (
            "position+camera",
            ("measurements", "blocks", 1, "targets", 2),
            "no measurement refers to 'm2'",
        ),
    ],
)
def test_what_is_missing(case, path, message, arm, refused):
    document = document_of(case)
    part = document
    for step in path[:-1]:
        part = part[step]
    del part[path[-1]]
    Path("damaged.json").write_text(json.dumps(document))
    with refused(InputError, file="damaged.json", reason=("damaged", message)):
        read_calibration("damaged.json")


def test_files_without_what_came_later(arm):
    result, rows = solved("plane-distance")
    document = json.loads(write(result, Path("out")).read_text())
    del document["measurements"]["targets"]
    del document["distances"], document["predicted"], document["setup_file"]
    del document["findings"], document["validation"], document["covariance"]
    del document["rotation_to_base"], document["rejected_residual_model"]
    for later in ("stations", "tools", "chains", "blocks", "coupled_frames"):
        del document[later]
    for later in ("noise", "gains", "displaced"):
        del document["statistics"][later]
    assert document.keys() == {
        *("format", "version", "verdict", "robot", "measurements", "parameters"),
        *("identifiability", "errors", "statistics", "solver", "frames", "targets"),
        *("planes", "residual_model", "model_ladder", "urdf", "setup", "provenance"),
    }
    Path("old.json").write_text(json.dumps(document))
    found = read_calibration("old.json")
    for a, b in zip(predict(found, rows), predict(result.model, rows), strict=True):
        np.testing.assert_allclose(a, b, rtol=0.0, atol=1e-12)


def test_the_accuracy_of_pixels_is_passed_over(arm):
    document = document_of("position+camera")
    accuracy = {"mean": 1.0, "rms": 2.0, "max": 3.0}
    assert [error["unit"] for error in document["errors"].values()] == ["m", "px"]
    for error in document["errors"].values():
        error["validation"] = {"method": "set", "before": accuracy, "after": accuracy}
    Path("calibration.json").write_text(json.dumps(document))
    stated = {"unit": "m", "mean": 1.0, "max": 3.0, "method": "set"}
    assert read_accuracy("calibration.json") == {"position": stated}


@pytest.mark.parametrize("case", CASES)
def test_the_corrected_robot_is_the_calibrated_one(case, arm):
    result, rows = solved(case)
    model = result.model
    geometry = model if result.urdf is None else result.urdf.model
    if geometry is None:
        assert case == "position, corrections alone"
        assert "nothing of this calibration has a place" in result.urdf.reason
        assert result.geometry is None
        return
    write_urdf(geometry, Path("corrected.urdf"))
    nominal, fitted = model.chains[""], geometry.of()
    chain = Chain(load_robot("corrected.urdf"), nominal.base, nominal.tip)
    tool = fitted.tool.homogeneous
    found = fitted.error.base.homogeneous @ chain.poses(rows.q) @ tool
    np.testing.assert_allclose(found, fitted.poses(rows.q), atol=1e-12)
    if model.geometric:
        np.testing.assert_array_equal(fitted.poses(rows.q), model.of().poses(rows.q))
    else:
        # What is left of a fit with corrections fits worse than geometry alone.
        measured = rows.only.values[:, :3]
        errors = [
            m.poses(rows.q)[:, :3, 3] - measured
            for m in (fitted, model.without_corrections.of())
        ]
        assert np.sum(errors[0] ** 2) < np.sum(errors[1] ** 2)


def test_a_urdf_holds_the_geometry_alone(arm):
    result, rows = solved("pose, joint corrections")
    model = result.model
    beyond = [
        p for p in result.parameters if p.name.split(".")[-2] in model.setup.parameters
    ]
    assert {p.name.split(".")[-2] for p in beyond if abs(p.value) > 1e-5} == {
        *("placement", "transmission", "compliance")
    }
    geometry = model.without_corrections
    assert np.abs(geometry.of().poses(rows.q) - model.of().poses(rows.q)).max() > 1e-3
    kept = ~np.isin(np.arange(len(model.theta)), model.only.error.joint_corrections)
    np.testing.assert_array_equal(geometry.theta[kept], model.theta[kept])
    assert (geometry.theta[~kept] == 0.0).all()
    # How good it is without them is a part of the result.
    (alone, *_) = result.urdf.errors
    (errors, *_) = result.errors
    assert (alone.name, alone.unit) == (errors.name, errors.unit) == ("position", "m")
    assert errors.after.rms < 0.2 * alone.after.rms
    document = json.loads(encode(calibration_document(result, PROVENANCE)))
    stated = document["urdf"]["errors"]["position"]["training"]["after"]
    assert stated["rms"] == alone.after.rms


def test_nothing_is_said_of_a_urdf_that_holds_it_all(stored):
    result, file = stored
    assert result.urdf is None and result.geometry is result.model
    assert json.loads(file.read_text())["urdf"] is None


def test_what_was_learned_is_no_geometry(stored, refused):
    @dataclass(frozen=True)
    class Bent:
        space: str = "joint"
        shift: Any = 0.0

        def __call__(self, q: Any) -> Any:
            return 0.01 * np.cos(q)

        def weight(self, q: Any) -> Any:
            return np.ones(len(q))

    model = stored[0].model
    parts = {
        key: replace(part, error=replace(part.error, learned=Bent()))
        for key, part in model.parts.items()
    }
    bent = model.with_parts(parts)
    q = model.chains.random_configurations(5, np.random.default_rng(0))
    plain = model.of().poses(q)
    assert np.abs(bent.of().poses(q) - plain).max() > 1e-3
    np.testing.assert_array_equal(bent.without_corrections.of().poses(q), plain)
    with refused(OptionError, reason="a URDF cannot hold"):
        write_urdf(bent, Path("bent.urdf"))
    write_urdf(bent.without_corrections, Path("bent.urdf"))
    write_urdf(model, Path("model.urdf"))
    assert Path("bent.urdf").read_bytes() == Path("model.urdf").read_bytes()


def test_what_the_contract_does_not_ask_for_may_be_missing(arm):
    result, rows = calibrated(arm, "pose", Setup(base_frame=KNOWN))
    file = write(result, Path("out"))
    document = json.loads(file.read_text())
    del document["setup"]
    document["later"] = {"unknown": 1}
    document["parameters"][0]["note"] = "unknown"
    file.write_text(json.dumps(document))
    found = read_calibration(file)
    np.testing.assert_allclose(
        found.of().poses(rows.q), result.model.of().poses(rows.q)
    )
    for registration in (False, True):
        there = evaluate(found, rows, registration=registration)
        here = evaluate(result.model, rows, registration=registration)
        for a, b in zip(there.errors, here.errors, strict=True):
            assert a[2].rms == pytest.approx(b[2].rms, rel=1e-9)


@pytest.mark.parametrize("case", [*CASES, *INSTRUMENTS])
def test_a_setup_comes_back(case):
    setup = (CASES | INSTRUMENTS)[case][1]
    text = json.dumps(setup_document(setup))
    assert setup_of(json.loads(text)) == setup


def test_numbers_that_are_not_finite_become_null(arm):
    result, _ = calibrated(arm, "position", Setup())
    odd = replace(
        result,
        statistics=replace(result.statistics, sigma0=float("nan"), chi2=float("inf")),
    )
    text = encode(calibration_document(odd, PROVENANCE)).decode()
    assert json.loads(text)["statistics"]["sigma0"] is None
    assert json.loads(text)["statistics"]["chi2"] is None
    assert "NaN" not in text
    assert "Infinity" not in text


def test_any_file_name_can_be_encoded():
    # Bytes of a file name that are no UTF-8 arrive as lone surrogates.
    text = encode({"file": "ä\udcff\n"})
    assert json.loads(text) == {"file": "ä\udcff\n"}
    assert "ä".encode() in text


def test_the_notice_of_an_untrusted_one(stored):
    result, _ = stored
    notes: list[str] = []
    bad = replace(result, verdict="untrusted", reason="too few rows")
    read_calibration(write(bad, Path("out")), notice=notes.append)
    assert notes == ["out/calibration.json must not be trusted: too few rows"]


# --- where the robot is ------------------------------------------------------------


def test_a_moved_folder_finds_the_robot_beside(stored, tmp_path, monkeypatch):
    result, _ = stored
    Path("arm.urdf").rename("out/arm.urdf")
    Path("out").rename("moved")
    assert read_calibration("moved/calibration.json").theta == pytest.approx(
        result.model.theta
    )
    monkeypatch.chdir(tmp_path / "moved")
    assert read_calibration("calibration.json").chains.robot.name == "arm"


def test_the_robot_is_found_from_the_folder_of_the_file(arm, tmp_path, monkeypatch):
    Path("robots").mkdir()
    Path("arm.urdf").rename("robots/arm.urdf")
    result, _ = calibrated(Path("robots/arm.urdf"), "position", Setup())
    write(result, tmp_path)
    elsewhere = tmp_path / "elsewhere"
    elsewhere.mkdir()
    monkeypatch.chdir(elsewhere)
    assert read_calibration("../calibration.json").chains.robot.name == "arm"


def test_the_corrected_robot_beside_is_not_taken_for_it(stored, refused):
    result, file = stored
    # Both have the same name, as the commands write them.
    write_urdf(result.model, Path("out/arm.urdf"))
    assert read_calibration(file).chains.robot.file == "arm.urdf"
    Path("arm.urdf").unlink()
    with refused(InputError, reason="'out/arm.urdf' is not the robot"):
        read_calibration(file)
    # With the original back at its side, a wrong one at the stated place is passed.
    Path("out/arm.urdf").write_text(ARM)
    Path("arm.urdf").write_text(ARM.replace("0.4", "0.41"))
    assert read_calibration(file).chains.robot.file == "out/arm.urdf"


def test_a_changed_robot_is_refused(stored, refused):
    _, file = stored
    Path("arm.urdf").write_text(ARM + "\n")
    with refused(InputError, reason="content differs"):
        read_calibration(file)


def test_a_robot_that_is_gone(stored, refused):
    _, file = stored
    Path("arm.urdf").unlink()
    with refused(RobotError, reason="'arm.urdf' that was calibrated is neither"):
        read_calibration(file)


# --- the corrected URDF ------------------------------------------------------------


def test_the_original_is_never_replaced(stored, refused):
    result, _ = stored
    with refused(OptionError, reason="own URDF"):
        write_urdf(result.model, Path("arm.urdf"), force=True)
    write_urdf(result.model, Path("new.urdf"))
    with refused(OptionError, file="new.urdf", reason="--force"):
        write_urdf(result.model, Path("new.urdf"))
    write_urdf(result.model, Path("new.urdf"), force=True)
    assert Path("arm.urdf").read_text() == ARM


# --- damage ------------------------------------------------------------------------


def places(value: Any, path: tuple[Any, ...] = ()) -> Iterator[tuple[Any, ...]]:
    """The path of everything in a document."""
    if path:
        yield path
    items: Any = ()
    if isinstance(value, dict):
        items = value.items()
    elif isinstance(value, list):
        items = enumerate(value)
    for key, item in items:
        yield from places(item, (*path, key))


USED = ("format", "version", "robot", "parameters", "frames", "planes", "setup")
JUNK = (None, True, -1, 7.5, 10**400, float("nan"), "x", "", [], {}, [[0]], ["a"] * 3)


# The quick tier damages one entry in thirty, which ones differs from case to case.
AMOUNTS = [pytest.param(30, id="some"), pytest.param(1, id="all", marks=SLOW)]


@pytest.mark.parametrize("every", AMOUNTS)
@pytest.mark.parametrize("parameters", ["joint-offset", "compliance"])
def test_no_damage_passes_unnoticed_or_crashes(parameters, every, arm):
    setup = Setup(planes=WALL, parameters=(parameters,), noise={"distance": 1e-3})
    if parameters == "compliance":
        setup = replace(setup, **LOADED)
    result, rows = calibrated(arm, "plane-distance", setup)
    assert_no_damage_passes(result, rows, (*USED, "measurements"), every)


@pytest.mark.parametrize("every", AMOUNTS)
@pytest.mark.parametrize(
    "case", ["sphere-contact", "point-distance", "position+camera"]
)
def test_no_damage_of_an_instrument_passes_unnoticed(case, every, arm):
    result, rows = solved(case)
    sections = ("measurements", "frames", "targets", "spheres", "anchors", "camera")
    assert_no_damage_passes(result, rows, sections, every)


def assert_no_damage_passes(
    result: CalibrationResult, rows: Observations, keys: tuple[str, ...], step: int
) -> None:
    file = write(result, Path("out"))
    good = json.loads(file.read_text())
    expected = predict(read_calibration(file), rows)[2]
    rng = np.random.default_rng(0)
    every = [path for path in places(good) if path[0] in keys]
    # One point of a board is like the other.
    every = [path for path in every if "m0" in path or not BOARD.keys() & set(path)]
    for path in every[::step]:
        for junk in ("delete", *rng.choice(np.array(JUNK, object), 1)):
            document = json.loads(json.dumps(good))
            part = document
            for step in path[:-1]:
                part = part[step]
            if junk == "delete":
                del part[path[-1]]
            else:
                part[path[-1]] = junk
            file.write_text(json.dumps(document))
            try:
                found = read_calibration(file)
            except InputError as error:
                assert error.file == str(file)
                assert len(str(error)) < 400
                continue
            # What was accepted predicts finite numbers, and others only where a
            # number stands in the place of a number.
            values = predict(found, rows)[2]
            assert np.isfinite(values).all(), (path, junk)
            if not np.allclose(values, expected):
                assert isinstance(junk, int | float), (path, junk)


@pytest.mark.parametrize(
    ("data", "reason"),
    [
        (b"", "not a calibration"),
        (b"\xff\xfe", "not a calibration"),
        (b"[]", "not a calibration"),
        (b"null", "not a calibration"),
        (b'{"format": "calib-pin/calibration"}', "another version"),
        (b'{"format": "calib-pin/calibration", "version": true}', "another version"),
        (b'{"format": "calib-pin/calibration", "version": 0}', "another version"),
        (b'{"format": "calib-pin/calibration", "version": 1}', "names no robot"),
        (b"[" * 100_000, "not a calibration"),
        (b'{"version": ' + b"1" * 5000 + b"}", "not a calibration"),
    ],
)
def test_files_that_are_no_calibration(data, reason, tmp_path, refused):
    file = tmp_path / "calibration.json"
    file.write_bytes(data)
    with refused(InputError, file=str(file), reason=reason):
        read_calibration(file)


def test_a_byte_order_mark_is_no_damage(stored):
    _, file = stored
    file.write_bytes(b"\xef\xbb\xbf" + file.read_bytes())
    read_calibration(file)


@pytest.mark.parametrize("cut", [0.1, 0.5, 0.9, 0.999])
def test_a_file_that_was_cut_off(cut, stored, refused):
    _, file = stored
    data = file.read_bytes().rstrip()
    file.write_bytes(data[: int(cut * len(data))])
    with refused(InputError, file=str(file), reason="not a calibration"):
        read_calibration(file)
