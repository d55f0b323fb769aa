"""What is exported moves the robot as the calibration does, read as consumers do."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from itertools import pairwise
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pinocchio as pin
import pytest
import xacro
import yaml

import calib_pin
from calib_pin.calibration import calibrate
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.exchange import FORMATS, Exported
from calib_pin.io.exchange.base import origin_of, placed
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.setup import FrameSetup, JointMap, Setup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.validation.calibrated_model import CalibratedModel

EXACT = 1e-9
ROBOTS = {
    "ur10": ("example:ur10_robot", "base_link", "tool0"),
    "xarm": ("example:xarm7", None, "link7"),
    "so101": ("example:so101", None, "gripper_frame_link"),
    "lift": ("example:tiago_no_hand", "base_footprint", "arm_7_link"),
}


def calibrated(
    robot: str, base: str | None, tip: str | None, setup: Setup
) -> tuple[Exported, CalibratedModel]:
    """A calibration to export, and the true robot."""
    chain = calib_pin.load_chain(robot, base=base, tip=tip)
    problem = nominal_problem(chain, "pose", setup)
    rng = np.random.default_rng(4)
    theta = draw_errors(problem.parameters, rng)
    data = simulate(problem, theta, rng, count=40, noise=1e-6)
    result = calibrate(chain, data, setup, validate=True)
    assert result.verdict == "good", result.reason
    return Exported(result, Path("out")), CalibratedModel.create(problem, theta)


@pytest.fixture(scope="module")
def exported() -> Callable[..., Exported]:
    """Calibrations of the placements of some robots, each made once."""
    return cache(lambda name: calibrated(*ROBOTS[name], Setup())[0])


def same(exported: Exported, poses: np.ndarray, tolerance: float = EXACT) -> None:
    found = poses - exported.chain.poses(exported.configurations)
    assert np.abs(found).max() < tolerance


# The structure of the vendor's description, as far as the kinematics goes.
STRUCTURE = """<?xml version="1.0"?>
<robot xmlns:xacro="http://www.ros.org/wiki/xacro" name="vendor">
  <xacro:arg name="file" default=""/>
  <xacro:property name="k" value="${xacro.load_yaml('$(arg file)')['kinematics']}"/>
  <xacro:macro name="joint" params="name number before">
    <link name="link_${number}"/>
    <joint name="joint_${number}" type="continuous">
      <parent link="${before}"/><child link="link_${number}"/>
      <origin xyz="${k[name]['x']} ${k[name]['y']} ${k[name]['z']}"
              rpy="${k[name]['roll']} ${k[name]['pitch']} ${k[name]['yaw']}"/>
      <axis xyz="0 0 1"/>
    </joint>
  </xacro:macro>
  <link name="base_link"/><link name="first"/>
  <joint name="base_joint" type="fixed">
    <parent link="base_link"/><child link="first"/><origin rpy="0 0 YAW"/>
  </joint>
  JOINTS
</robot>"""


def vendor(file: Path, names: list[str], yaw: float) -> Chain:
    """The chain of a description that loads a kinematics file."""
    lines = [
        f'<xacro:joint name="{name}" number="{k}" '
        f'before="{f"link_{k - 1}" if k else "first"}"/>'
        for k, name in enumerate(names)
    ]
    text = STRUCTURE.replace("YAW", repr(yaw)).replace("JOINTS", "".join(lines))
    source = file.with_suffix(".xacro")
    source.write_text(text)
    urdf = xacro.process_file(str(source), mappings={"file": str(file)}).toxml()
    return Chain(parse_robot(urdf.encode(), "vendor"), "base_link")


UR10 = {
    "shoulder": (0, 0, 0.1273, 0, 0, 0),
    "upper_arm": (0, 0, 0, 1.570796327, 0, 0),
    # A factory's offsets, which cancel between the parallel axes.
    "forearm": (-0.612, 0, 12.5, 0, 0, 0),
    "wrist_1": (-0.5723, 0, 0.163941 - 12.5, 0, 0, 0),
    "wrist_2": (0, -0.1157, 0, 1.570796327, 0, 0),
    "wrist_3": (0, 0.0922, 0, 1.570796327, 3.14159265359, 3.14159265359),
}
NUMBERS = ("x", "y", "z", "roll", "pitch", "yaw")


def kinematics(entries: dict[str, tuple[float, ...]], **more: str) -> str:
    named = {
        name: dict(zip(NUMBERS, six, strict=True)) for name, six in entries.items()
    }
    return yaml.safe_dump({"kinematics": named | more}, sort_keys=False)


def test_a_vendor_loads_its_kinematics(exported, tmp_path):
    of = exported("ur10")
    template, file = tmp_path / "own.yaml", tmp_path / "ur10.yaml"
    template.write_text(kinematics(UR10, hash="calib_77"))
    encoded = FORMATS["ur-kinematics"].encode(of, template)
    file.write_bytes(encoded.data)
    assert yaml.safe_load(encoded.data)["kinematics"]["hash"] == "calib_77"
    assert "calib_77" in encoded.remarks[0] and len(encoded.remarks) == 1
    same(of, vendor(file, [*UR10], np.pi).poses(of.configurations))
    # Frames stay where the vendor has them, as far as the axes allow.
    forearm = yaml.safe_load(encoded.data)["kinematics"]["forearm"]
    assert forearm["z"] == pytest.approx(12.5, abs=0.01)


def test_a_numbered_vendor_loads_its_kinematics(exported, tmp_path):
    of = exported("xarm")
    nominal = of.nominal
    frames = [pin.SE3.Identity(), *map(pin.SE3, nominal.joint_frames())]
    own = {
        f"joint{k + 1}": origin_of(a.actInv(b))
        for k, (a, b) in enumerate(pairwise(frames))
    }
    template, file = tmp_path / "own.yaml", tmp_path / "xarm.yaml"
    template.write_text(kinematics(own))
    encoded = FORMATS["xarm-kinematics"].encode(of, template)
    file.write_bytes(encoded.data)
    found = vendor(file, [*own], 0.0).poses(of.configurations)
    same(of, found @ nominal.tip_placement.homogeneous)


def test_templates_of_others_are_refused(exported, tmp_path, refused):
    template, forearm, wrist = tmp_path / "own.yaml", UR10["forearm"], UR10["wrist_2"]
    for entries in (
        UR10 | {"forearm": (-0.425, *forearm[1:])},
        {name: six for name, six in UR10.items() if name != "wrist_3"},
        UR10 | {"wrist_2": ("a", *wrist[1:])},
        UR10 | {"wrist_2": (1e9, *wrist[1:])},
    ):
        template.write_text(kinematics(entries))
        with refused(InputError, file=str(template)):
            FORMATS["ur-kinematics"].encode(exported("ur10"), template)
    template.write_text(kinematics(UR10))
    with refused(OptionError):  # It has seven joints.
        FORMATS["ur-kinematics"].encode(exported("xarm"), template)


@pytest.mark.parametrize("name", [*ROBOTS])
def test_mujoco_moves_the_same(exported, tmp_path, name):
    of = exported(name)
    file = tmp_path / "robot.xml"
    file.write_bytes(FORMATS["mjcf"].encode(of, None).data)
    model = pin.buildModelFromMJCF(str(file))
    data = model.createData()
    for q, expected in zip(
        of.configurations, of.chain.poses(of.configurations), strict=True
    ):
        whole = pin.neutral(model)
        for joint, position in zip(of.nominal.joints, q, strict=True):
            whole[model.joints[model.getJointId(joint)].idx_q] = position
        pin.framesForwardKinematics(model, data, whole)
        ends = of.nominal.base, of.nominal.tip
        base, tip = (
            data.oMf[model.getFrameId(end)]
            if model.existFrame(end)
            else pin.SE3.Identity()
            for end in ends
        )
        assert np.abs(base.actInv(tip).homogeneous - expected).max() < EXACT


def motion(axis: str, angle: float, x: float = 0.0, z: float = 0.0) -> np.ndarray:
    """A translation along x and z, then a turn about an axis."""
    place = np.array([x, 0.0, z])
    return pin.SE3(pin.utils.rotate(axis, angle), place).homogeneous


@pytest.mark.parametrize("name", [*ROBOTS])
def test_tables_of_denavit_and_hartenberg_move_the_same(exported, name):
    of = exported(name)
    text = FORMATS["dh"].encode(of, None).data.decode()
    lines = [line.split(",") for line in text.splitlines() if line[0] != "#"]
    for convention in ("standard", "modified"):
        first, *rows, last = (line for line in lines if line[0] == convention)
        base, tip = (placed(np.array(row[8:], float)) for row in (first, last))
        poses = []
        for q in of.configurations:
            T = base.homogeneous
            for row, position in zip(rows, q, strict=True):
                theta, d, a, alpha, beta = map(float, row[3:8])
                if row[2] == "prismatic":
                    d += position
                else:
                    theta += position
                about = motion("z", theta, z=d)
                across = motion("x", alpha, x=a) @ motion("y", beta)
                T = T @ (about @ across if convention == "standard" else across @ about)
            poses.append(T @ tip.homogeneous)
        same(of, np.array(poses))
        assert all(abs(float(row[4])) < 2.0 for row in rows)


def test_a_description_takes_the_origins_by_property(exported, tmp_path):
    of = exported("ur10")
    overlay = tmp_path / "origins.xacro"
    overlay.write_bytes(FORMATS["xacro"].encode(of, None).data)
    root = ElementTree.fromstring(of.nominal.robot.source)
    for joint in root.findall("joint"):
        name, origin = joint.get("name"), joint.find("origin")
        if name in of.nominal.joints:
            assert origin is not None
            for key in ("xyz", "rpy"):
                origin.set(key, f"${{{name}_{key}}}")
    ElementTree.register_namespace("xacro", "http://www.ros.org/wiki/xacro")
    include = ElementTree.Element("{http://www.ros.org/wiki/xacro}include")
    include.set("filename", str(overlay))
    root.insert(0, include)
    source = tmp_path / "robot.xacro"
    source.write_bytes(ElementTree.tostring(root))
    urdf = xacro.process_file(str(source)).toxml()
    chain = Chain(parse_robot(urdf.encode(), "x"), of.nominal.base, of.nominal.tip)
    same(of, chain.poses(of.configurations))


OFFSETS = Setup(
    parameters=("joint-offset",),
    base_frame=FrameSetup(estimate=False),
    tool_frame=FrameSetup(estimate=False),
)


@pytest.fixture(scope="module")
def offsets() -> tuple[Exported, CalibratedModel]:
    """The SO-101 with joint offsets alone, its columns counted the other way."""
    setup = replace(
        OFFSETS,
        joints={f"m{k}": JointMap(n, sign=-1) for k, n in enumerate(JOINTS)},
    )
    return calibrated("example:so101", None, "gripper_frame_link", setup)


JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")


def test_a_controller_takes_the_offsets(offsets):
    of, true = offsets
    encoded = FORMATS["joint-offsets"].encode(of, None)
    assert encoded.remarks == ()
    rows = [line.split(",") for line in encoded.data.decode().splitlines()[3:]]
    assert [row[1] for row in rows] == ["m0", "m1", "m2", "m3", "m4"]
    shown = -of.configurations  # What the columns read.
    shown = shown + np.deg2rad([float(row[2]) for row in rows])
    expected = true.of().poses(of.configurations)
    assert np.abs(of.nominal.poses(-shown) - expected).max() < 2e-5


def test_a_motor_takes_its_offset(offsets, tmp_path):
    of, true = offsets
    keys = ("id", "drive_mode", "homing_offset", "range_min", "range_max")
    rows = {f"m{k}": (k, 0, 100 * k, 700 + k, 3500 - 3 * k) for k in range(5)}
    rows["gripper"] = (6, 0, 5, 0, 9)
    own = {name: dict(zip(keys, row, strict=True)) for name, row in rows.items()}
    template = tmp_path / "so101.json"
    template.write_text(json.dumps(own))
    encoded = FORMATS["lerobot"].encode(of, template)
    new = json.loads(encoded.data)
    assert new["gripper"] == own["gripper"]

    def zero(motor: dict[str, int]) -> float:
        """What the encoder reads where the motor is shown in its middle."""
        return (motor["range_min"] + motor["range_max"]) / 2 + motor["homing_offset"]

    turned = [zero(new[f"m{k}"]) - zero(own[f"m{k}"]) for k in range(5)]
    moved = of.configurations + np.deg2rad(np.array(turned) * 360 / 4095)
    truth = of.configurations + of.offsets.offsets
    assert np.abs(moved - truth).max() < np.deg2rad(360 / 4095) / 2 + 1e-9
    expected = true.of().poses(of.configurations)
    assert np.abs(of.nominal.poses(moved) - expected).max() < 2e-3
    for k in range(5):
        # Nothing that was out of reach is in reach.
        a, b = own[f"m{k}"], new[f"m{k}"]
        moved = b["homing_offset"] - a["homing_offset"]
        assert b["range_min"] + moved >= a["range_min"]
        assert b["range_max"] + moved <= a["range_max"]


def test_other_motors_are_refused(offsets, tmp_path, refused):
    template = tmp_path / "so101.json"
    for content in (
        "{",
        "[]",
        '{"m0": {"homing_offset": 1}}',
        '{"x": {"homing_offset": 1, "range_min": 0, "range_max": 9}}',
    ):
        template.write_text(content)
        with refused(InputError, file=str(template)):
            FORMATS["lerobot"].encode(offsets[0], template)


def test_a_transmission_takes_gain_and_offset(tmp_path):
    setup = replace(
        OFFSETS,
        parameters=("joint-offset", "transmission"),
        fixed=("*.transmission.sin*", "*.transmission.cos*"),
    )
    of, true = calibrated("example:ur10_robot", "base_link", "tool0", setup)
    template = tmp_path / "own.xml"
    own = {joint: (100.0 - k, 0.1 * k) for k, joint in enumerate(of.nominal.joints)}
    template.write_text(
        "<ros2_control>"
        + "".join(
            f'<transmission name="t_{joint}"><plugin>transmission_interface/'
            f'SimpleTransmission</plugin><actuator name="a_{joint}" role="actuator1"/>'
            f'<joint name="{joint}" role="joint1"><mechanical_reduction>{reduction}'
            f"</mechanical_reduction><offset>{offset}</offset></joint></transmission>"
            for joint, (reduction, offset) in own.items()
        )
        + "</ros2_control>"
    )
    data = FORMATS["ros2-control"].encode(of, template).data
    q, k = of.configurations.copy(), -1
    for k, transmission in enumerate(ElementTree.fromstring(data).iter("transmission")):
        joint = transmission.find("joint")
        assert (
            joint is not None and transmission.get("name") == f"t_{joint.get('name')}"
        )
        reduction, offset = own[joint.get("name", "")]
        actuator = (q[:, k] - offset) * reduction
        new = [float(joint.findtext(t, "")) for t in ("mechanical_reduction", "offset")]
        q[:, k] = actuator / new[0] + new[1]
    assert k == 5
    expected = true.of().poses(of.configurations)
    assert np.abs(of.nominal.poses(q) - expected).max() < 1e-4


def test_what_is_not_exported(exported, refused):
    of = exported("ur10")
    with refused(OptionError):  # There is no camera.
        FORMATS["camera-info"].encode(of, None)
    with refused(OptionError, reason="because"):
        Exported(replace(of.result, verdict="untrusted", reason="because"), of.file)
    # Without a gain it is the nominal robot.
    plain = Exported(replace(of.result, verdict="no-gain"), of.file)
    assert plain.robot is plain.nominal.robot
