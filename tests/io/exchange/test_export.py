"""What is exported moves the robot as the calibration does, read as consumers do."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
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
from calib_pin.io.exchange.axes import along
from calib_pin.io.urdf_tree import parse_robot
from calib_pin.kinematics.chain import Chain
from calib_pin.setup import CameraSetup, FrameSetup, JointMap, PointSetup, Setup
from calib_pin.simulation import draw_errors, simulate
from calib_pin.validation.calibrated_model import CalibratedModel

EXACT = 1e-9
ROBOTS = {
    "ur10": ("example:ur10_robot", "base_link", "tool0"),
    "xarm": ("example:xarm7", None, "link7"),
    "so101": ("example:so101", None, "gripper_frame_link"),
    "lift": ("example:tiago", "base_footprint", "arm_7_link"),
}


def calibrated(
    robot: str,
    base: str | None,
    tip: str | None,
    setup: Setup,
    model: str = "pose",
    count: int = 40,
) -> tuple[Exported, CalibratedModel]:
    """A calibration to export, and the true robot."""
    chain = calib_pin.load_chain(robot, base=base, tip=tip)
    problem = nominal_problem(chain, model, setup)
    rng = np.random.default_rng(4)
    theta = draw_errors(problem.parameters, rng)
    data = simulate(problem, theta, rng, count=count, noise=1e-6)
    result = calibrate(chain, data, setup, validate=True)
    assert result.verdict == "good", result.reason
    return Exported(result, Path("out")), CalibratedModel.create(problem, theta)


@pytest.fixture(scope="module")
def exported() -> Callable[..., Exported]:
    """Calibrations of the placements of some robots, each made once."""
    known: dict[str, Exported] = {}

    def of(name: str) -> Exported:
        if name not in known:
            known[name] = calibrated(*ROBOTS[name], Setup())[0]
        return known[name]

    return of


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
    frames = [pin.SE3(frame) for frame in nominal.joint_frames()]
    before = [pin.SE3.Identity(), *frames]
    own = [a.actInv(b) for a, b in zip(before, frames, strict=False)]
    template, file = tmp_path / "own.yaml", tmp_path / "xarm.yaml"
    names = [f"joint{k + 1}" for k in range(len(own))]
    six = [(*p.translation, *pin.rpy.matrixToRpy(p.rotation)) for p in own]
    template.write_text(
        kinematics({n: tuple(map(float, s)) for n, s in zip(names, six, strict=True)})
    )
    encoded = FORMATS["xarm-kinematics"].encode(of, template)
    file.write_bytes(encoded.data)
    found = vendor(file, names, 0.0).poses(of.configurations)
    same(of, found @ nominal.tip_placement.homogeneous)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda k: k.update(forearm=(-0.425, *k["forearm"][1:])), "of another robot"),
        (lambda k: k.pop("wrist_3"), "it lacks 'kinematics: wrist_3'"),
        (
            lambda k: k.update(wrist_2=("a", *k["wrist_2"][1:])),
            "'x' of 'wrist_2' is not",
        ),
        (
            lambda k: k.update(wrist_2=(1e9, *k["wrist_2"][1:])),
            "a number below 100000",
        ),
    ],
)
def test_templates_of_others_are_refused(exported, tmp_path, change, said):
    template, entries = tmp_path / "own.yaml", dict(UR10)
    change(entries)
    template.write_text(kinematics(entries))
    with pytest.raises(InputError, match=said):
        FORMATS["ur-kinematics"].encode(exported("ur10"), template)


def test_another_structure_is_refused(exported, tmp_path):
    template = tmp_path / "own.yaml"
    template.write_text(kinematics(UR10))
    with pytest.raises(OptionError, match="the chain has 7 joints"):
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


@pytest.mark.parametrize("name", [*ROBOTS])
@pytest.mark.parametrize("convention", ["standard", "modified"])
def test_tables_of_denavit_and_hartenberg_move_the_same(exported, name, convention):
    of = exported(name)
    text = FORMATS["dh"].encode(of, None).data.decode()
    lines = [line.split(",") for line in text.splitlines() if line[0] != "#"]
    rows = [line for line in lines if line[0] == convention]
    base, tip = (
        pin.SE3(
            pin.rpy.rpyToMatrix(np.array(row[11:], float)), np.array(row[8:11], float)
        ).homogeneous
        for row in (rows[0], rows[-1])
    )

    def turn(axis: str, angle: float) -> np.ndarray:
        return pin.SE3(pin.utils.rotate(axis, angle), np.zeros(3)).homogeneous

    def move(x: float, z: float) -> np.ndarray:
        return pin.SE3(np.eye(3), np.array([x, 0.0, z])).homogeneous

    poses = []
    for q in of.configurations:
        T = base
        for row, position in zip(rows[1:-1], q, strict=True):
            theta, d, a, alpha, beta = map(float, row[3:8])
            if row[2] == "prismatic":
                d += position
            else:
                theta += position
            about = turn("z", theta) @ move(0, d)
            across = move(a, 0) @ turn("x", alpha) @ turn("y", beta)
            T = T @ (about @ across if convention == "standard" else across @ about)
        poses.append(T @ tip)
    same(of, np.array(poses))
    assert all(abs(float(row[4])) < 2.0 for row in rows[1:-1])


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
    own = {
        f"m{k}": dict(
            id=k,
            drive_mode=0,
            homing_offset=100 * k,
            range_min=700 + k,
            range_max=3500 - 3 * k,
        )
        for k in range(5)
    } | {"gripper": dict(id=6, drive_mode=0, homing_offset=5, range_min=0, range_max=9)}
    template = tmp_path / "so101.json"
    template.write_text(json.dumps(own))
    encoded = FORMATS["lerobot"].encode(of, template)
    new = json.loads(encoded.data)
    assert new["gripper"] == own["gripper"]

    def shown(motor: dict[str, int], encoder: float) -> float:
        middle = (motor["range_min"] + motor["range_max"]) / 2
        position = encoder - motor["homing_offset"]
        return float(np.deg2rad((position - middle) * 360 / 4095))

    def encoder(motor: dict[str, int], angle: float) -> float:
        middle = (motor["range_min"] + motor["range_max"]) / 2
        return np.rad2deg(angle) * 4095 / 360 + middle + motor["homing_offset"]

    moved = np.array(
        [
            [-shown(new[f"m{k}"], encoder(own[f"m{k}"], -a)) for k, a in enumerate(q)]
            for q in of.configurations
        ]
    )
    truth = of.configurations + of.offsets.offsets
    assert np.abs(moved - truth).max() < np.deg2rad(360 / 4095) / 2 + 1e-9
    expected = true.of().poses(of.configurations)
    assert np.abs(of.nominal.poses(moved) - expected).max() < 2e-3
    for k in range(5):
        # Nothing that was out of reach is in reach.
        a, b = own[f"m{k}"], new[f"m{k}"]
        first, second = (m["range_min"] + m["homing_offset"] for m in (a, b))
        assert second >= first
        assert (
            b["range_max"] + b["homing_offset"] <= a["range_max"] + a["homing_offset"]
        )


@pytest.mark.parametrize(
    ("content", "said"),
    [
        ("{", "is not JSON"),
        ("[]", "holds no motors"),
        ('{"m0": {"homing_offset": 1}}', "motor 'm0' lacks one of"),
        (
            '{"x": {"homing_offset": 1, "range_min": 0, "range_max": 9}}',
            "has no motor for joint 'shoulder_pan'",
        ),
    ],
)
def test_other_motors_are_refused(offsets, tmp_path, content, said):
    template = tmp_path / "so101.json"
    template.write_text(content)
    with pytest.raises(InputError, match=said):
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


def test_frames_bring_measurements_into_the_base_link(exported):
    of = exported("ur10")
    text = FORMATS["tf"].encode(of, None).data.decode()
    found = {}
    for entry in yaml.safe_load(text)["transforms"]:
        t, r = (entry["transform"][key].values() for key in ("translation", "rotation"))
        pose = pin.SE3(pin.Quaternion(np.array([*r])).matrix(), np.array([*t]))
        found[entry["child_frame_id"]] = entry["header"]["frame_id"], pose.homogeneous
    assert found["measurement"][0] == "base_link" and found["tool"][0] == "tool0"
    q = of.configurations
    predicted = of.result.model.of().poses(q)
    written = of.chain.poses(q) @ found["tool"][1]
    assert np.abs(found["measurement"][1] @ predicted - written).max() < EXACT


@pytest.mark.parametrize("mount", ["hand", "world"])
def test_a_camera_is_told_with_its_place(mount):
    corners = {
        f"c{k}": PointSetup(xyz=(0.05 * (k % 3), 0.05 * (k // 3), 0.0), estimate=False)
        for k in range(6)
    }
    camera = CameraSetup(
        mount=mount,
        focal=(800.0, 805.0),
        center=(640.0, 360.0),
        distortion=(0.01, -0.02, 0.0, 0.0, 0.0),
        size=(1280, 720),
    )
    frames = dict(
        base_frame=FrameSetup(xyz=(0.0, 0.0, 1.5), rpy=(np.pi, 0.0, 0.0)),
        tool_frame=FrameSetup(xyz=(0.0, 0.0, 0.05), rpy=(0.0, 0.0, 0.0)),
    )
    setup = Setup(
        camera=camera, targets=corners, parameters=("joint-offset",), **frames
    )
    chain = calib_pin.load_chain("example:ur10_robot", base="base_link", tip="tool0")
    problem = nominal_problem(chain, "camera", setup)
    model = CalibratedModel.create(problem, np.zeros(len(problem.parameters)))
    of = Exported(_result(model), Path("out"))
    encoded = FORMATS["camera-info"].encode(of, None)
    told = yaml.safe_load(encoded.data)
    assert encoded.remarks == () and told["distortion_model"] == "plumb_bob"
    assert (told["image_width"], told["image_height"]) == (1280, 720)
    K = np.array(told["camera_matrix"]["data"]).reshape(3, 3)
    assert K.tolist() == [[800.0, 0.0, 640.0], [0.0, 805.0, 360.0], [0.0, 0.0, 1.0]]
    assert told["distortion_coefficients"]["data"] == [0.01, -0.02, 0.0, 0.0, 0.0]
    link = "tool0" if mount == "hand" else "base_link"
    assert f"# optical frame in {link}: xyz" in encoded.data.decode()


def _result(model: CalibratedModel) -> object:
    class Result:
        verdict, reason = "good", ""

    Result.model = model
    return Result()


def test_only_one_camera_is_exported(exported):
    with pytest.raises(OptionError, match="one camera"):
        FORMATS["camera-info"].encode(exported("ur10"), None)


def test_untrusted_calibrations_are_not_exported(exported):
    of = exported("ur10")
    with pytest.raises(OptionError, match="must not be trusted: because"):
        Exported(replace(of.result, verdict="untrusted", reason="because"), of.file)


def test_without_a_gain_the_nominal_robot_is_exported(exported):
    of = exported("ur10")
    plain = Exported(replace(of.result, verdict="no-gain"), of.file)
    assert plain.robot is plain.nominal.robot
    assert (
        np.abs(
            plain.robot.model.jointPlacements[1].translation
            - plain.nominal.robot.model.jointPlacements[1].translation
        ).max()
        < 1e-15
    )


def test_a_frame_that_lies_across_is_laid_on_the_axis():
    near = pin.SE3(pin.utils.rotate("y", np.pi / 2), np.ones(3))
    frame = along(np.zeros(3), np.array([0.0, 0.0, 1.0]), near)
    assert np.allclose(frame.rotation.T @ frame.rotation, np.eye(3))
    assert frame.translation.tolist() == [0.0, 0.0, 1.0]
