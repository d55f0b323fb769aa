"""Frames and cameras as ROS takes them: right where known, absent where not."""

from __future__ import annotations

import shlex
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pinocchio as pin
import pytest
import yaml

import calib_pin
from calib_pin.errors import OptionError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.exchange import FORMATS, Encoded, Exported
from calib_pin.io.exchange.descriptions import inertia_of
from calib_pin.io.urdf_tree import parse_document
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey
from calib_pin.setup import CameraSetup, FrameSetup, PointSetup, Setup, ToolSetup
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import CalibrationResult
from tests.shared import refused, simulated

FRAMES = Setup(
    base_frame=FrameSetup((0.3, -0.2, 0.5), (0.1, -0.05, 0.4)),
    tool_frame=FrameSetup((0.1, 0.05, 0.2)),
)
NAMES = ("x", "y", "z", "rx", "ry", "rz")


def of(result: CalibrationResult) -> Exported:
    assert result.verdict == "good"
    return Exported(result, Path("out"))


def transforms(encoded: Encoded) -> dict[str, tuple[str, Floats]]:
    """Parent and pose of each child, as a listener of ROS has them."""
    found = {}
    for entry in yaml.safe_load(encoded.data)["transforms"]:
        t, r = (entry["transform"][key].values() for key in ("translation", "rotation"))
        pose = pin.SE3(pin.Quaternion(np.array([*r])).matrix(), np.array([*t]))
        found[entry["child_frame_id"]] = entry["header"]["frame_id"], pose.homogeneous
    assert len(found) == len(yaml.safe_load(encoded.data)["transforms"])
    return found


def said(encoded: Encoded) -> list[str]:
    """Remarks on frames, not on the geometry that other files hold."""
    return [remark for remark in encoded.remarks if "holds no" not in remark]


def without(result: CalibrationResult, kind: str, *unknown: str) -> CalibrationResult:
    """The same, with parts of the only station or tool that nobody knows."""
    (frame,) = getattr(result, kind)
    sigma = [np.nan if name in unknown else 1e-4 for name in NAMES]
    return replace(result, **{kind: (replace(frame, sigma=tuple(sigma)),)})


@pytest.fixture(scope="module")
def posed(scara, calibrated_robot: Callable[..., CalibrationResult]) -> Exported:
    """A robot whose tip link is called as the tool, made as if all were known."""
    found = calibrated_robot("pose", FRAMES, 40, 1.0, 1, robot=scara, noise=5e-5)
    known = without(without(found, "stations"), "tools")
    return of(replace(known, unknown=()))


def of_model(model: CalibratedModel, **unknown: Any) -> Exported:
    """A calibration of which there is no more than the model, and what is unknown."""
    told: dict[str, Any] = dict.fromkeys(("model", "described", "applied"), model)
    told |= {"verdict": "good", "reason": "", "unknown": ()} | unknown
    told.setdefault("unknown_of", lambda *_: ())
    return Exported(SimpleNamespace(**told), Path("out"))


def test_several_each_have_a_name(posed, scara):
    """Of a tool that is known on another, too; none has that of a link."""
    only = FORMATS["tf"].encode(posed, None)
    parents = [(name, parent) for name, (parent, _) in transforms(only).items()]
    assert parents == [("measurement", "l0"), ("measured_point", "tool")]
    assert said(only) == []
    place = FrameSetup((0.1, 0.2, 0.3))
    setup = Setup(
        stations=dict.fromkeys(("s.0", "s/1"), place),
        tools={"t 0": place, "t1": ToolSetup((0.0, 0.0, 0.1), on="t 0")},
    )
    keys = [BlockKey("pose", "", *ends) for ends in (("s.0", "t 0"), ("s/1", "t1"))]
    problem = nominal_problem(scara, keys, setup)
    model = CalibratedModel.create(problem, np.zeros(len(problem.parameters)))
    encoded = FORMATS["tf"].encode(of_model(model), None)
    found, lines = transforms(encoded), encoded.data.decode().splitlines()
    assert [*found] == ["s_0_station", "t 0_tool", "s_1_station", "t1_tool"]
    # A shell takes each name as one word.
    published = [shlex.split(line)[-1] for line in lines if "# ros2" in line]
    assert published == [*found]
    assert found["t1_tool"][1][2, 3] == pytest.approx(0.4, abs=1e-12)


@pytest.mark.parametrize(
    "parameters, size, verdict",
    [(("placement",), 0.0, "no-gain"), (("placement", "transmission"), 0.5, "good")],
)
def test_frames_are_those_of_the_urdf(parameters, size, verdict, calibrated_robot):
    """Where the fit has more than the file: no other base and tool fit it better."""
    setup = Setup(parameters=parameters)
    job = ("position", setup, 40, size)
    result = calibrated_robot(*job, noise=2e-4)
    problem, _ = simulated(*job, noise=2e-4)
    exported = Exported(result, Path("out"))
    assert result.verdict == verdict
    if verdict == "good":  # The URDF alone is less accurate than all that was fitted.
        (alone,), (whole,) = result.urdf.errors, result.errors
        assert alone.validation_after.rms > 1.5 * whole.validation_after.rms
    (_, base), (_, tool) = transforms(FORMATS["tf"].encode(exported, None)).values()
    (rows,) = problem.data.blocks
    T = np.linalg.inv(base) @ exported.chain.poses(rows.q) @ tool
    left = rows.values[:, :3] - T[:, :3, 3]
    turns = -np.array([pin.skew(p) for p in T[:, :3, 3]])
    A = np.concatenate(
        [np.tile(np.eye(3), (len(T), 1, 1)), turns, T[:, :3, :3]], axis=2
    )
    least = np.linalg.lstsq(A.reshape(-1, 9), left.reshape(-1), rcond=None)[1]
    assert np.sum(left**2) == pytest.approx(float(least[0]), rel=1e-3)


@pytest.mark.parametrize("inertia", ["", '<inertia ixx="0" iyy="0" izz="0"/>'])
def test_a_mass_without_an_inertia_is_kept(inertia):
    """Such as a payload that is a point."""
    mass = '<origin xyz="0.1 0 0"/><mass value="0.5"/>'
    text = f'<robot><link name="l"><inertial>{mass}{inertia}</inertial></link></robot>'
    document = parse_document(text.encode())
    stated = inertia_of(document, document.named("link")["l"])
    assert (stated["mass"], stated["pos"]) == ("0.5", "0.1 0.0 0.0")
    # MuJoCo refuses moving bodies with less.
    assert min(map(float, stated["fullinertia"].split()[:3])) > 0.0


@pytest.mark.parametrize("axis", NAMES)
def test_a_transform_that_is_not_known_is_not_written(posed, axis):
    unknown = without(posed.result, "tools", axis)
    encoded = FORMATS["tf"].encode(of(unknown), None)
    assert [*transforms(encoded)] == ["measurement"]
    first, second = said(encoded)
    assert first == f"{axis} of tool -> measured_point unknown"
    assert "fixed: [tool.frame.z]" in second
    for remark in (first, second):
        assert f"# {remark}\n" in encoded.data.decode()


def test_the_position_of_a_point_is_enough(posed):
    point = without(posed.result, "tools", "rx", "ry", "rz")
    encoded = FORMATS["tf"].encode(of(point), None)
    assert [*transforms(encoded)] == ["measurement", "measured_point"]
    (remark,) = said(encoded)
    assert "orientation" in remark
    station = without(posed.result, "stations", "rx", "ry", "rz")
    assert [*transforms(FORMATS["tf"].encode(of(station), None))] == ["measured_point"]


def test_nothing_known_is_refused(scara, calibrated_robot):
    """Base and tool along parallel axes: only what they add up to is known."""
    found = calibrated_robot("pose", FRAMES, 40, 1.0, 1, robot=scara, noise=5e-5)
    reason = "z of tool -> measured_point", "fixed:"
    with refused(OptionError, reason=reason, file="out"):
        FORMATS["tf"].encode(of(found), None)


def looking(mount: str, **camera: Any) -> CalibratedModel:
    """A nominal robot with a camera whose place is stated."""
    seen = CameraSetup(
        mount=mount,
        focal=(800.0, 805.0),
        center=(640.0, 360.0),
        distortion=(0.01, -0.02, 0.0, 0.0, 0.0),
        **{"size": (1280, 720), **camera},
    )
    setup = Setup(
        camera=seen,
        targets={"c": PointSetup(xyz=(0.0, 0.0, 0.0), estimate=False)},
        parameters=("joint-offset",),
        base_frame=FrameSetup(xyz=(0.0, 0.1, 1.5), rpy=(3.0, 0.2, 0.0)),
        tool_frame=FrameSetup(xyz=(0.0, 0.0, 0.05), rpy=(0.1, 0.0, -0.3)),
    )
    chain = calib_pin.load_chain("example:ur10_robot", base="base_link", tip="tool0")
    problem = nominal_problem(chain, "camera", setup)
    return CalibratedModel.create(problem, np.zeros(len(problem.parameters)))


@pytest.mark.parametrize("mount", ["hand", "world"])
def test_a_camera_is_told_with_its_place(mount):
    model = looking(mount)

    def encoded(**unknown: Any) -> Encoded:
        return FORMATS["camera-info"].encode(of_model(model, **unknown), None)

    told = yaml.safe_load(encoded().data)
    assert encoded().remarks == () and told["distortion_model"] == "plumb_bob"
    assert (told["image_width"], told["image_height"]) == (1280, 720)
    K = np.array(told["camera_matrix"]["data"]).reshape(3, 3)
    assert K.tolist() == [[800.0, 0.0, 640.0], [0.0, 805.0, 360.0], [0.0, 0.0, 1.0]]
    assert told["distortion_coefficients"]["data"] == [0.01, -0.02, 0.0, 0.0, 0.0]
    link = "tool0" if mount == "hand" else "base_link"
    assert f"# optical frame in {link}: xyz" in encoded().data.decode()
    # The intrinsics do not depend on where it is.
    vague = encoded(unknown_of=lambda *_: ("z",))
    assert vague.data.startswith(f"# optical frame: z of {link} -> camera".encode())
    assert b"xyz" not in vague.data and len(vague.remarks) == 2
    assert yaml.safe_load(vague.data) == told
    with refused(OptionError, reason="camera.intrinsics.fx unknown", file="out"):
        encoded(unknown=("camera.intrinsics.fx", "base.frame.x"))
    sizeless = of_model(looking(mount, size=None))
    with refused(OptionError, reason="size: [width, height]", file="out"):
        FORMATS["camera-info"].encode(sizeless, None)
