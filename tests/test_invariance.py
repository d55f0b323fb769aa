"""The same measurements, told otherwise, give the same robot.

In other units, in another order, from an instrument or a base that is turned, and with
joint frames that stand elsewhere on their axes: for every family of errors.
"""

from __future__ import annotations

import csv
import xml.etree.ElementTree as ET
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pinocchio as pin
import pytest

import calib_pin
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Conditions, Measurements
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.setup import FrameSetup, Setup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.validation.result import CalibrationResult
from calib_pin.validation.tip_drift import absorbed

TIP, COUNT, NOISE = "link_3", 30, 5e-5
ROBOT = calib_pin.robot_file("heavy6", "robot.urdf")
ARM = calib_pin.load_chain(str(ROBOT), tip=TIP)
FRAMES: Mapping[str, Any] = {
    "base_frame": FrameSetup((1.5, -0.4, 0.3), (0.3, 0.2, 2.0), estimate=True),
    "tool_frame": FrameSetup((0.05, 0.08, 0.12), (0.2, -0.3, 0.1), estimate=True),
}
RATIOS = {"joint_2": 50.0}
TURN, SHIFT = pin.exp3(np.array([0.4, -1.0, 0.7])), np.array([1.0, 2.0, -1.0])
STAND = pin.SE3(pin.exp3(np.array([0.5, -0.3, 1.0])), np.array([0.3, -1.0, 2.0]))
SLIDES = {"joint_1": -0.2, "joint_2": 0.35}
"""How far joint frames are moved along their axes [m]."""

AT = ARM.random_configurations(60, np.random.default_rng(9))
EXPECTED = 1e-3
"""Expected error of a robot [m]."""

LINEAR = 1e-2
"""What errors of some milliradians are more than linear."""

PLACED = ("dh", "dh-full", "cross-compliance", "thermal", "warm-up")
"""Families that say where a common normal or a bearing is, or how long a link."""

ALONE = ("placement", "link-transform", "dh", "dh-full", "joint-offset")
FAMILIES = tuple(
    (name,) if name in ALONE else ("placement", name)
    for name, family in PARAMETERIZATIONS.items()
    if family.__module__.startswith("calib_pin.")
)


RARE = {
    *("link-transform", "dh-full", "motor-ripple"),
    *("hysteresis", "cross-compliance", "thermal"),
}
"""Families of the slow tier: each is told like another that the quick one has."""

EACH = [
    pytest.param(family, marks=[pytest.mark.slow] if family[-1] in RARE else [])
    for family in FAMILIES
]
UNPLACED = [one for one in EACH if one.values[0][-1] not in PLACED]


def asked(family: tuple[str, ...]) -> Setup:
    ratios = RATIOS if {"transmission", "motor-ripple"} & {*family} else {}
    return Setup(parameters=family, gear_ratios=ratios)


def measured(family: tuple[str, ...], half: float | None = None) -> Measurements:
    """Positions of a robot with errors of a family, and its conditions.

    Args:
        family: Names of its parameters.
        half: Half the range of each joint [rad]; None for all of it.
    """
    rng = np.random.default_rng(1)
    warm = Conditions(temperature=20.0 + 5.0 * rng.uniform(size=COUNT))
    later = Conditions(time=np.linspace(0.0, 3600.0, COUNT))
    conditions = {"thermal": warm, "warm-up": later, "instrument-drift": later}
    setup = replace(asked(family), **FRAMES)
    problem = nominal_problem(ARM, "position", setup)
    q = ARM.random_configurations(COUNT, rng)
    if half is not None:
        q = q[0] + half * rng.uniform(-1.0, 1.0, q.shape)
    return simulate(
        problem,
        draw_errors(problem.parameters, rng),
        rng,
        q=q,
        noise=NOISE,
        conditions=conditions.get(family[-1], Conditions()),
    ).only


def moved(robot: ET.Element, joint: str, size: float) -> None:
    """Move the frame of a joint along its axis, and nothing else."""
    (element,) = (e for e in robot.iter("joint") if e.get("name") == joint)
    link = element.find("child").get("link")  # type: ignore[union-attr]
    axis = numbers(element.find("axis"), "xyz")
    behind = [
        other.find("origin")
        for other in robot.iter("joint")
        if (parent := other.find("parent")) is not None and parent.get("link") == link
    ]
    for body in robot.iter("link"):
        behind += body.iter("origin") if body.get("name") == link else ()
    origin = element.find("origin")
    along = pin.rpy.rpyToMatrix(numbers(origin, "rpy")) @ axis
    for place, way in [(origin, along), *((place, -axis) for place in behind)]:
        xyz = numbers(place, "xyz") + size * way
        place.set("xyz", " ".join(map(repr, xyz.tolist())))  # type: ignore[union-attr]


def numbers(element: ET.Element | None, name: str) -> Floats:
    assert element is not None
    return np.array([float(word) for word in element.attrib[name].split()])


def on_a_stand(robot: ET.Element, stand: pin.SE3) -> None:
    """Let the robot stand on another link."""
    ET.SubElement(robot, "link", name="stand")
    joint = ET.SubElement(robot, "joint", name="foot", type="fixed")
    values = (stand.translation, pin.rpy.matrixToRpy(stand.rotation))
    xyz, rpy = (" ".join(map(repr, value.tolist())) for value in values)
    ET.SubElement(joint, "origin", xyz=xyz, rpy=rpy)
    ET.SubElement(joint, "parent", link="stand")
    ET.SubElement(joint, "child", link="base_link")


def told_otherwise(file: Path, rng: np.random.Generator) -> None:
    """The file in mm and degrees, in another order, from a tracker that is turned."""
    with file.open(newline="") as lines:
        head, *rows = csv.reader(lines)
    columns = dict(zip(head, np.array(rows, float).T, strict=True))
    xyz = TURN @ [columns[name] for name in "xyz"] + SHIFT[:, None]
    columns |= dict(zip("xyz", xyz, strict=True))
    order, told = rng.permutation(len(rows)), {}
    for name, column in columns.items():
        unit, factor = "", 1.0
        if name in ARM.joints:
            unit, factor = " [deg]", np.degrees(1.0)
        elif name in "xyz" or name.startswith("sigma"):
            unit, factor = " [mm]", 1e3
        told[name + unit] = factor * column[order]
    with file.open("w", newline="") as lines:
        table = csv.writer(lines)
        table.writerows([list(told), *np.array(list(told.values())).T.tolist()])


def differs(first: CalibrationResult, second: CalibrationResult) -> float:
    """How far two robots put the tool apart, base and tool fitted away, rms [m]."""
    A, B = (result.model.of().poses(AT) for result in (first, second))
    apart = A[:, :3, 3] - absorbed(A, B)[:, :3, 3]
    return float(np.sqrt(np.mean(np.sum(apart**2, axis=1))))


def promised(result: CalibrationResult) -> float:
    workspace = result.accuracy.workspace
    assert workspace is not None
    return workspace.calibrated[0]


def robot_file(tmp_path: Path, robot: ET.Element) -> str:
    file = tmp_path / "robot.urdf"
    file.write_text(ET.tostring(robot, encoding="unicode"))
    return str(file)


@pytest.mark.parametrize("family", EACH, ids="+".join)
def test_units_order_instrument_and_base(family, tmp_path):
    """All at once: where one of them mattered, the tool would not be the same."""
    setup, file = asked(family), tmp_path / "measured.csv"
    calib_pin.write_measurements(file, measured(family))
    rows = calib_pin.read_measurements(file, ARM)
    told_otherwise(file, np.random.default_rng(3))
    robot, stand = ET.fromstring(ROBOT.read_text()), STAND
    if family[-1] in ("thermal", "warm-up"):
        # A stand that grows with the temperature is one link more.
        stand = pin.SE3(stand.rotation, np.zeros(3))
    on_a_stand(robot, stand)
    other = calib_pin.load_chain(robot_file(tmp_path, robot), base="stand", tip=TIP)
    turned = stand.rotation @ setup.gravity
    found = calib_pin.calibrate(ARM, rows, setup, validate=False)
    again = calib_pin.calibrate(
        other,
        calib_pin.read_measurements(file, other),
        replace(setup, gravity=tuple(turned.tolist())),
        validate=False,
    )
    # The last step of a solver that stops at the root of the machine's precision.
    tolerance = (
        EXPECTED * np.sqrt(np.finfo(float).eps) * found.identifiability.condition
    )
    assert differs(found, again) < tolerance
    assert again.identifiability.rank == found.identifiability.rank
    assert promised(again) == pytest.approx(promised(found), rel=1e-5)
    assert again.statistics.sigma0 == pytest.approx(found.statistics.sigma0, rel=1e-5)
    assert again.verdict == found.verdict


@pytest.fixture(scope="module")
def slid(tmp_path_factory: pytest.TempPathFactory) -> Chain:
    """The arm with frames elsewhere on their axes."""
    robot = ET.fromstring(ROBOT.read_text())
    for joint, size in SLIDES.items():
        moved(robot, joint, size)
    other = calib_pin.load_chain(
        robot_file(tmp_path_factory.mktemp("slid"), robot), tip=TIP
    )
    np.testing.assert_allclose(other.poses(AT), ARM.poses(AT), rtol=0, atol=1e-12)
    return other


def test_places_that_are_not_estimated_are_those_of_the_axes(slid: Chain) -> None:
    """What offsets alone leave, wherever on their axes the frames stand."""
    rows, setup = measured(("placement",), half=0.5), asked(("joint-offset",))
    found, again = (
        promised(calib_pin.calibrate(chain, rows, setup, validate=False))
        for chain in (ARM, slid)
    )
    assert found > 0.5 * EXPECTED
    assert again == pytest.approx(found, rel=LINEAR)


@pytest.mark.parametrize("family", UNPLACED, ids="+".join)
def test_where_on_its_axis_a_frame_stands(family: tuple[str, ...], slid: Chain) -> None:
    """In one region, where much is left to the expected size of errors."""
    rows, setup = measured(family, half=0.5), asked(family)
    found = calib_pin.calibrate(ARM, rows, setup, validate=False)
    again = calib_pin.calibrate(slid, rows, setup, validate=False)
    assert differs(found, again) < LINEAR * promised(found)
    assert promised(again) == pytest.approx(promised(found), rel=LINEAR)
    assert again.identifiability.rank == found.identifiability.rank
    assert again.verdict == found.verdict


def test_the_verdict_with_its_check(tmp_path: Path) -> None:
    """What was held out is in the same sentence, whatever the order of the file."""
    file = tmp_path / "measured.csv"
    calib_pin.write_measurements(file, measured(("placement",)))
    found = calib_pin.calibrate(ARM, calib_pin.read_measurements(file, ARM))
    told_otherwise(file, np.random.default_rng(3))
    again = calib_pin.calibrate(ARM, calib_pin.read_measurements(file, ARM))
    assert (again.verdict, again.reason) == (found.verdict, found.reason)
