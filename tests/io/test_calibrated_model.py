"""Robots with several stations, tools and chains come back from `calibration.json`."""

from __future__ import annotations

import json
from collections.abc import Callable
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.errors import InputError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.calibration_document import calibration_document
from calib_pin.io.json_text import encode
from calib_pin.io.results import read_calibration, write_urdf
from calib_pin.io.urdf import load_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import BlockKey, Observations
from calib_pin.setup import (
    AnchorSetup,
    CameraSetup,
    ChainSetup,
    FrameSetup,
    PointSetup,
    Setup,
    ToolSetup,
)
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.summaries import Provenance


def arm(side: str, y: float) -> str:
    """Three joints and a hand on the torso; the hand is the last joint's own link."""
    axes = ("0 0 1", "0 1 0", "1 0 0")
    links, joints, parent = "", "", "torso"
    for k, axis in enumerate(axes):
        child = f"{side}_hand" if k == 2 else f"{side}_{k}"
        links += f'<link name="{child}"/>'
        joints += f"""<joint name="{side}.{k}" type="revolute">
        <origin xyz="{0.1 + 0.3 * k} {0.02 if k else y} 0.1" rpy="0.1 0 {0.2 * k}"/>
        <parent link="{parent}"/><child link="{child}"/><axis xyz="{axis}"/>
        <limit lower="-1.5" upper="1.5" effort="1" velocity="1"/></joint>"""
        parent = child
    return links + joints


ROBOT = f"""<robot name="pair"><link name="base"/><link name="torso"/>
  <joint name="waist" type="revolute"><origin xyz="0 0 0.8"/>
    <parent link="base"/><child link="torso"/><axis xyz="0 0.6 0.8"/>
    <limit lower="-1" upper="1" effort="1" velocity="1"/></joint>
  {arm("left", 0.3)}{arm("right", -0.3)}
</robot>"""

CHAINS = {
    "left": ChainSetup(tip="left_hand"),
    "touch": ChainSetup(base="left_hand", tip="right_hand"),
}
AWAY = FrameSetup((2.0, 1.0, 0.3), (0.1, 0.2, 1.2))
NEAR = FrameSetup((-1.0, 0.5, 0.1), (0.0, -0.1, 0.4))
PROBE = ToolSetup((0.05, 0.02, 0.1))
ABOVE = FrameSetup((0.0, 0.0, 4.0), (np.pi, 0.0, 0.0))
BESIDE = FrameSetup((0.1, 0.3, 4.5), (np.pi - 0.1, 0.05, 0.3))
BOARD = {
    f"m{k}": PointSetup((0.08 * (k % 2), 0.08 * (k // 2), 0.02 * (k == 3)))
    for k in range(4)
}

CASES: dict[str, tuple[Setup, tuple[BlockKey, ...]]] = {
    "two stations and two tools": (
        Setup(
            stations={"day1": AWAY, "day2": NEAR},
            tools={"probe": PROBE, "ball": ToolSetup((0.0, 0.1, 0.05))},
        ),
        (
            BlockKey("position", "left", "day1", "probe"),
            BlockKey("position", "left", "day2", "probe"),
            BlockKey("pose", "left", "day2", "ball"),
        ),
    ),
    "a tool on another one": (
        Setup(
            tools={
                "flange": PROBE,
                "tip": ToolSetup((0.0, 0.0, 0.2), (0.4, 0.0, 0.1), on="flange"),
            },
            base_frame=AWAY,
        ),
        (
            BlockKey("position", "left", tool="tip"),
            BlockKey("position", "left", tool="flange"),
        ),
    ),
    "anchors of two stations": (
        Setup(
            stations={"day1": AWAY, "day2": NEAR},
            anchors={
                "a": AnchorSetup((1.5, 0.4, 0.9), 0.02, estimate_bias=True),
                "day1/b": AnchorSetup((-0.6, 1.1, 1.0)),
            },
            tool_frame=FrameSetup((0.0, 0.02, 0.1), estimate=False),
        ),
        (
            BlockKey("pose", "left", "day1"),
            BlockKey("point-distance", "left", "day1"),
            BlockKey("pose", "left", "day2"),
            BlockKey("point-distance", "left", "day2"),
        ),
    ),
    "cameras of two stations": (
        Setup(
            stations={"here": ABOVE, "there": BESIDE},
            targets=BOARD,
            camera=CameraSetup("world", (800.0, 810.0), (640.0, 480.0), estimate=True),
            tool_frame=FrameSetup((0.0, 0.0, 0.1)),
        ),
        (
            BlockKey("camera", "left", "here"),
            BlockKey("camera", "left", "there"),
            BlockKey("pose", "left", "here"),
        ),
    ),
    "two hands that touch": (
        Setup(
            base_frame=AWAY,
            tools={"ball": PROBE, "right_hand": ToolSetup((0.0, 0.05, 0.1))},
        ),
        (
            BlockKey("pose", "left"),
            BlockKey("pose", "right_hand"),
            BlockKey("position", "touch"),
        ),
    ),
    "a single block with names": (
        Setup(stations={"day1": AWAY}, tools={"probe": PROBE}),
        (BlockKey("pose", "left", "day1", "probe"),),
    ),
}
MANY = ["two stations and two tools", "two hands that touch"]


@pytest.fixture
def robot(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    monkeypatch.chdir(tmp_path)
    Path("pair.urdf").write_text(ROBOT)
    return Path("pair.urdf")


@cache
def solved(case: str) -> tuple[CalibrationResult, Observations]:
    """The calibration of a case, and measurements that were not fitted."""
    setup, keys = CASES[case]
    chains = Chains(
        load_robot("pair.urdf"),
        tip="left_hand",
        stated=CHAINS,
        names=tuple(key.chain for key in keys),
    )
    problem = nominal_problem(chains, keys, setup)
    rng = np.random.default_rng(4)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    data, new = (
        calib_pin.simulate(problem, theta, rng, count=k * len(keys), noise=1e-4)
        for k in (60, 10)
    )
    return calib_pin.calibrate(chains, data, setup, validate=False), new


def document_of(case: str) -> dict[str, Any]:
    made = Provenance(("calib-pin",), "2026-01-01", 0.5, {})
    return json.loads(encode(calibration_document(solved(case)[0], made)))


def stored(document: Any) -> CalibratedModel:
    Path("calibration.json").write_text(json.dumps(document))
    return read_calibration("calibration.json")


@pytest.mark.parametrize("case", CASES)
def test_all_parts_come_back(case: str, robot: Path) -> None:
    result, new = solved(case)
    model = result.model
    assert np.abs(model.theta).max() > 1e-5

    found = stored(document_of(case))

    assert found.chains.names == model.chains.names
    assert found.chains.joints == model.chains.joints
    assert found.given.names == model.given.names
    assert found.setup == model.setup
    for key, part in model.parts.items():
        there = found.parts[key]
        assert there.scope == part.scope
        np.testing.assert_array_equal(there.index, part.index)
    there, here = (m.problem(new).errors(m.theta) for m in (found, model))
    within = 1e-9 if "camera" in case else 1e-12  # [px], else [m, rad]
    np.testing.assert_allclose(there, here, rtol=0.0, atol=within)
    # They are no errors by chance: the measurements are met.
    sigma = model.problem(new).sigma
    assert np.sqrt(np.mean((here / sigma) ** 2)) < 2.0


def test_frames_stand_under_the_owners_of_their_parameters(robot: Path) -> None:
    frames = document_of("two stations and two tools")["frames"]
    assert list(frames) == ["day1.station", "day2.station", "probe.tool", "ball.tool"]
    assert [frame["link"] for frame in frames.values()] == [
        *("base", "base"),
        *("left_hand", "left_hand"),
    ]
    assert frames["day1.station"]["xyz"] == pytest.approx(AWAY.xyz, abs=0.05)
    assert frames["ball.tool"]["xyz"] == pytest.approx((0.0, 0.1, 0.05), abs=0.05)


def test_a_tool_on_another_one_has_no_frame_of_its_own(robot: Path) -> None:
    document = document_of("a tool on another one")
    assert list(document["frames"]) == ["base", "flange.tool"]
    found = stored(document)
    offset = (part.scope.offset for part in found.parts.values())
    known = pin.SE3(pin.rpy.rpyToMatrix(0.4, 0.0, 0.1), np.array([0.0, 0.0, 0.2]))
    assert next(offset).isApprox(known) and next(offset) == pin.SE3.Identity()


def test_what_stands_before_a_station_has_its_name(robot: Path) -> None:
    document = document_of("anchors of two stations")
    names = ["day1/a", "day1/day1/b", "day2/a", "day2/day1/b"]
    assert list(document["anchors"]) == names
    document = document_of("cameras of two stations")
    assert list(document["cameras"]) == ["here/camera", "there/camera"]
    assert "camera" not in document


def test_what_documents_say_of_blocks_and_chains(robot: Path) -> None:
    document = document_of("two hands that touch")
    assert document["measurements"]["model"] == "pose+position"
    assert [tuple(block.values()) for block in document["measurements"]["blocks"]] == [
        ("pose", "left", "", "", []),
        ("pose", "right_hand", "", "", []),
        ("position", "touch", "", "", []),
    ]
    about = document["robot"]
    assert about["chains"] == {
        "left": {"base": "base", "tip": "left_hand"},
        "right_hand": {"base": "base", "tip": "right_hand"},
        "touch": {"base": "left_hand", "tip": "right_hand"},
    }
    assert about["joints"][0] == "waist" and len(about["joints"]) == 7


@pytest.mark.parametrize("case", MANY)
def test_one_urdf_has_the_corrections_of_all_chains(case: str, robot: Path) -> None:
    model = solved(case)[0].model
    # The base frames take up the correction of the first joint.
    assert len(model.urdf_corrections()) == {MANY[0]: 3, MANY[1]: 6}[case]
    write_urdf(model, Path("corrected.urdf"))
    written, q = load_robot("corrected.urdf"), np.zeros((1, len(model.chains.joints)))
    q += 0.3
    for name in model.measured_chains:
        fitted, nominal = model.of(name), model.chains[name]
        own = q[:, model.chains.columns(name)]
        found = Chain(written, nominal.base, nominal.tip).poses(own)
        found = fitted.error.base.homogeneous @ found @ fitted.tool.homogeneous
        np.testing.assert_allclose(found, fitted.poses(own), rtol=0.0, atol=1e-12)


def edit(*path: str | int, to: object = ...) -> Callable[[Any], None]:
    def change(document: Any) -> None:
        for step in path[:-1]:
            document = document[step]
        if to is ...:
            del document[path[-1]]
        else:
            document[path[-1]] = to

    return change


@pytest.mark.parametrize(
    ("change", "message"),
    [
        (edit("frames", "day2.station"), "'day2.station' is missing"),
        (edit("anchors", "day2/a"), "'day2/a' is missing under 'anchors'"),
        (edit("measurements", "blocks", 3), "'a' is missing under 'anchors'"),
        (edit("measurements", "blocks", 3, "model"), "'model' is missing"),
        (edit("measurements", "blocks", 3, "station", to="day1"), "is here twice"),
        (edit("measurements", "blocks", 3, "station", to=7), "7 stands"),
        (edit("measurements", "blocks", 3, "chain", to="right"), "right"),
        (edit("measurements", "blocks", 3, "targets", to=["a"]), "have other targets"),
        (edit("frames", "day1.station", "estimated", to=False), "as in the setup"),
        (edit("robot", "chains"), "'left'"),
        (edit("robot", "chains", "left", "tip", to="torso"), "joints are not those"),
        (edit("robot", "joints", to=["waist"]), "joints are not those"),
    ],
)
def test_damage_is_told_in_one_line(
    change: Callable[[Any], None],
    message: str,
    robot: Path,
    refused: Callable[..., Any],
) -> None:
    document = document_of("anchors of two stations")
    change(document)
    with refused(InputError, file="calibration.json", reason=("damaged", message)):
        stored(document)


def test_an_older_calibration_has_no_waves_twice_per_turn(tmp_path: Path) -> None:
    """They are zero in what was fitted before there were such."""
    chain = calib_pin.load_chain("space6")
    setup = Setup(parameters=("placement", "transmission"), gear_ratios={"*": 80.0})
    problem = nominal_problem(chain, "pose", setup)
    rng = np.random.default_rng(0)
    theta = calib_pin.draw_errors(problem.parameters, rng)
    data = calib_pin.simulate(problem, theta, rng, count=60, noise=1e-5)
    result = calib_pin.calibrate(chain, data, setup, validate=False)
    made = Provenance(("calib-pin",), "2026-01-01", 0.5, {})
    document = json.loads(encode(calibration_document(result, made)))
    later = ("motor_sin2", "motor_cos2")
    document["parameters"] = [
        entry for entry in document["parameters"] if not entry["name"].endswith(later)
    ]
    (tmp_path / "nominal.urdf").write_bytes(chain.robot.source)
    file = tmp_path / "calibration.json"
    file.write_text(json.dumps(document))
    found, model = read_calibration(file), result.model
    assert found.given.names == model.given.names
    old = np.array([name.endswith(later) for name in model.given.names])
    np.testing.assert_array_equal(found.theta, np.where(old, 0.0, model.theta))
    # Others must be there.
    del document["parameters"][20]
    file.write_text(json.dumps(document))
    with pytest.raises(InputError, match="not those of this chain"):
        read_calibration(file)
