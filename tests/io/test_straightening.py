"""Offsets along axes that cancel: the same robot, in frames that fit it."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pinocchio as pin
import pytest

from calib_pin.io.json_text import encode
from calib_pin.io.results import calibration_document, read_calibration
from calib_pin.io.straightening import straightened
from calib_pin.io.urdf import load_chain
from calib_pin.io.urdf_tree import origin_of, parse_robot, placed, words
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.robot import Robot
from tests.io.exchange.test_export import UR10
from tests.shared import joint, urdf_of

NAMES = [*UR10]
SLIDES = {"upper_arm": 300.0, "forearm": -98.7}
"""How far a factory has moved frames along their axes [m]."""


def origins(slides: Mapping[str, float]) -> list[pin.SE3]:
    """Origins of an arm with small errors, its frames moved along their axes."""
    rng = np.random.default_rng(3)
    plain = UR10 | {"forearm": (-0.612, 0, 0, 0, 0, 0)}
    plain |= {"wrist_1": (-0.5723, 0, 0.163941, 0, 0, 0)}
    moved, carried = [], pin.SE3.Identity()
    for name in NAMES:
        error = pin.exp6(pin.Motion(rng.normal(0.0, 3e-4, 6)))
        slide = pin.SE3(np.eye(3), slides.get(name, 0.0) * np.eye(3)[2])
        moved.append(carried.inverse() * placed(plain[name]) * error * slide)
        carried = slide
    return moved


def urdf(places: list[pin.SE3], inside: Mapping[int, str] | None = None) -> bytes:
    """An arm whose joints turn about z, with a camera on the forearm."""
    joints = []
    for k, place in enumerate(places, start=1):
        six, held = origin_of(place), (inside or {}).get(k, "")
        at = f"{words(six[:3])};{words(six[3:])}"
        joints.append(joint(f"joint{k}", f"link{k - 1} link{k}", at, inside=held))
    joints.append(joint("mount", "link3 camera", kind="fixed"))
    return urdf_of(*joints, name="arm").encode()


def arm(slides: Mapping[str, float], **about: Mapping[int, str]) -> Robot:
    return parse_robot(urdf(origins(slides), **about), "arm.urdf")


def lengths(robot: Robot) -> list[float]:
    return [float(np.linalg.norm(m.translation)) for m in robot.model.jointPlacements]


PAIR = {"upper_arm": 141.0, "forearm": -77.0}


@pytest.mark.parametrize(
    "slides",
    # Between parallel axes, behind the last of them, of the first, and in the wrist.
    [PAIR, SLIDES, {"wrist_1": 67.0}, {"shoulder": -40.0}, {"wrist_2": 12.0}],
)
def test_it_is_the_same_robot(slides: Mapping[str, float]) -> None:
    wild = arm(slides)
    found = straightened(wild)
    rng = np.random.default_rng(0)
    q = Chain(wild, tip="link6").random_configurations(20, rng)
    for tip in ("camera", "link6", *(("link1", "link4") if slides == PAIR else ())):
        old, new = (Chain(robot, tip=tip) for robot in (wild, found))
        own = q[:, : len(old.joints)]
        assert np.abs(old.poses(own) - new.poses(own)).max() < 1e-11
    assert max(lengths(wild)) > 10.0 and max(lengths(found)) < 0.7
    assert straightened(found) is found
    (remark,) = found.remarks
    assert "cancel" in remark and "'joint" in remark
    if slides == PAIR:
        # Feet of perpendiculars: as the description of the vendor has its frames.
        plain = [np.linalg.norm(UR10[name][:3]) for name in NAMES]
        plain[2:4] = 0.612, np.hypot(0.5723, 0.163941)
        assert np.allclose(lengths(found)[1:], plain, rtol=0, atol=3e-3)
        assert "'joint2', 'joint3'" in remark


def test_shapes_and_masses_stay_with_their_link() -> None:
    """Where their origin was meant for the frame, and where it made up for it."""
    shape = (
        '<visual><origin xyz="{}"/><geometry><box size="1 1 1"/></geometry></visual>'
    )
    mass = '<inertial><mass value="1"/>{}<inertia ixx="1" iyy="1" izz="1"/></inertial>'
    inside = {
        2: shape.format("0 0 0.2") + shape.format("0.1 0 -299.8") + mass.format(""),
        3: mass.format('<origin xyz="0.3 0 0.1"/>'),
    }
    found = straightened(arm(SLIDES, inside=inside))
    root = found.source.decode()
    assert 'xyz="0 0 0.2"' in root and "-299.8" not in root
    numbers = root.split('<origin xyz="0.1 0')[1].split('"')[0]
    assert abs(float(numbers) - 0.2) < 0.01
    assert np.allclose(found.model.inertias[3].lever, [0.3, 0.0, 0.1])
    assert np.allclose(found.model.inertias[2].lever, 0.0)


def test_what_does_not_cancel_stays() -> None:
    """A tall column, long shelves: large, but so is the robot."""
    far = origins({})
    far[1] = far[1] * pin.SE3(np.eye(3), np.array([0.0, 0.0, 20.0]))
    small = arm({"upper_arm": 0.7, "forearm": -0.2})
    for robot in (parse_robot(urdf(far), "arm.urdf"), small):
        assert straightened(robot) is robot


def test_it_is_recognized_where_it_came_from(tmp_path, monkeypatch, calibrated_robot):
    """By its own file, beside which its meshes are, or by the copy that was kept."""
    monkeypatch.chdir(tmp_path)
    Path("arm.urdf").write_bytes(urdf(origins(SLIDES)))
    chain = load_chain("arm.urdf", tip="link6")
    result = calibrated_robot("pose", count=30, robot=chain, validate=False)
    Path("out").mkdir()
    Path("out/nominal.urdf").write_bytes(chain.robot.source)
    file = Path("out/calibration.json")
    file.write_bytes(encode(calibration_document(result)))
    for place in ("arm.urdf", "out/nominal.urdf"):
        robot = read_calibration(file).chains.robot
        assert robot.file == place and max(lengths(robot)) < 0.7
        Path("arm.urdf").unlink(missing_ok=True)
