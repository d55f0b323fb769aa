"""What is exported moves the robot as the calibration does, read as consumers do."""

from __future__ import annotations

import csv
import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest
import yaml

import calib_pin
from calib_pin.errors import InputError
from calib_pin.io.exchange import FORMATS, Exported
from calib_pin.io.urdf_tree import ORIGIN, placed
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.report.text import format_report
from calib_pin.setup import FrameSetup, JointMap, Setup
from calib_pin.validation.joint_errors import configurations, reversals
from calib_pin.validation.result import CalibrationResult
from tests.io.exchange.test_descriptions import of
from tests.shared import refused

EXACT = 1e-9


@pytest.fixture(scope="module")
def exported(calibrated_robot: Callable[..., CalibrationResult]) -> Exported:
    """A calibration of the placements of a UR10."""
    chain = calib_pin.load_chain("example:ur10_robot", base="base_link", tip="tool0")
    return of(calibrated_robot("pose", Setup(), 40, robot=chain, noise=1e-6))


UR10 = {
    "shoulder": (0, 0, 0.1273, 0, 0, 0),
    "upper_arm": (0, 0, 0, 1.570796327, 0, 0),
    # A factory's offsets, which cancel between the parallel axes.
    "forearm": (-0.612, 0, 12.5, 0, 0, 0),
    "wrist_1": (-0.5723, 0, 0.163941 - 12.5, 0, 0, 0),
    "wrist_2": (0, -0.1157, 0, 1.570796327, 0, 0),
    "wrist_3": (0, 0.0922, 0, 1.570796327, 3.14159265359, 3.14159265359),
}


def kinematics(entries: dict[str, tuple[float, ...]], **more: str) -> str:
    named = {name: dict(zip(ORIGIN, six, strict=True)) for name, six in entries.items()}
    return yaml.safe_dump({"kinematics": named | more}, sort_keys=False)


def test_a_vendor_loads_its_kinematics(exported, tmp_path):
    """Behind `base_link_inertia`, half a turn from `base_link`."""
    template = tmp_path / "own.yaml"
    template.write_text(kinematics(UR10, hash="calib_77"))
    encoded = FORMATS["ur-kinematics"].encode(exported, template)
    entries = yaml.safe_load(encoded.data)["kinematics"]
    assert entries.pop("hash") == "calib_77" and [*entries] == [*UR10]
    assert "calib_77" in encoded.remarks[0] and "tf" in encoded.remarks[1]
    q = configurations(exported.nominal)
    for row, expected in zip(q, exported.chain.poses(q), strict=True):
        T = placed((0, 0, 0, 0, 0, np.pi))
        for entry, angle in zip(entries.values(), row, strict=True):
            T = T * placed([entry[key] for key in ORIGIN])
            T = T * placed((0, 0, 0, 0, 0, angle))
        assert np.abs(T.homogeneous - expected).max() < EXACT
    # Frames stay where the vendor has them, as far as the axes allow.
    assert entries["forearm"]["z"] == pytest.approx(12.5, abs=0.01)


def test_offsets_that_hardly_correct_a_robot_say_so(calibrated_robot, exported):
    """A forearm that is longer is longer with any zeros of the joints."""
    longer = {"wrist_1_joint.placement.x": 5e-3}
    more = {"robot": exported.nominal, "noise": 1e-6, "changes": longer}
    of_length = of(calibrated_robot("pose", Setup(), 40, 0.01, **more))
    for one, useless in ((of_length, True), (exported, False)):
        about, _ = FORMATS["joint-offsets"].encode(one, None).remarks[-2:]
        assert "mm of what was found are missing" in about
        assert ("hardly more accurate" in about) == useless


def test_offsets_that_frames_absorb_are_no_numbers(exported):
    """Of a whole geometry, too; and nobody corrects the corrected robot again."""
    encoded = FORMATS["joint-offsets"].encode(exported, None)
    text = encoded.data.decode()
    rows = [*csv.DictReader(line for line in text.splitlines() if line[:1] != "#")]
    blank = [row["joint"] for row in rows if not row["offset"] and not row["offset_si"]]
    assert blank == ["shoulder_pan_joint", "wrist_3_joint"]
    assert "shoulder_pan_joint (absorbed), wrist_3_joint (absorbed)" in text
    assert "nominal URDF" in text
    for name in ("joint-offsets", "ros2-control", "mjcf"):
        remarks = " ".join(FORMATS[name].encode(exported, None).remarks)
        assert ("has the joint offsets already" in remarks) == (name != "mjcf"), name


def test_a_sigma_belongs_to_the_offset_beside_it(calibrated_robot):
    """Where offsets make up for gains they are no estimates, and have none."""
    setup = Setup(
        parameters=("joint-offset", "transmission"),
        base_frame=FrameSetup(estimate=False),
        tool_frame=FrameSetup(estimate=False),
    )
    gain = {"joint_2.transmission.gain": 0.001}
    result = calibrated_robot("pose", setup, 60, 0.0, noise=1e-4, changes=gain)
    encoded = FORMATS["joint-offsets"].encode(of(result), None)
    lines = [x for x in encoded.data.decode().splitlines() if x[:1] != "#"]
    found = {estimate.name: estimate for estimate in result.parameters}
    blank = []
    for row in csv.DictReader(lines):
        estimate = found[f"{row['joint']}.joint-offset.q"]
        off = abs(float(row["offset_si"]) - estimate.value)
        assert (row["sigma"] == "") == (off > estimate.sigma), row
        blank.append(row["sigma"] == "")
    assert any(blank)
    assert "not those of the report: gains, transmission" in " ".join(encoded.remarks)


def test_a_reversed_joint_is_told_with_its_couplings(exported):
    joints = {"a": JointMap("elbow_joint", -1, gear=2.0, coupled={"b": 0.5})}
    told = reversals(JointColumns.of(exported.chain, joints))
    said = "elbow_joint is reversed: q = -2 (reading + offset +0.5 b)"
    assert told == {"elbow_joint": said}


def test_templates_of_others_are_refused(exported, tmp_path):
    template, forearm, wrist = tmp_path / "own.yaml", UR10["forearm"], UR10["wrist_2"]
    for entries in (
        UR10 | {"forearm": (-0.425, *forearm[1:])},
        {name: six for name, six in UR10.items() if name != "wrist_3"},
        UR10 | {"wrist_2": ("a", *wrist[1:])},
        UR10 | {"wrist_2": (1e9, *wrist[1:])},
    ):
        template.write_text(kinematics(entries))
        with refused(InputError, file=str(template)):
            FORMATS["ur-kinematics"].encode(exported, template)


JOINTS = ("shoulder_pan", "shoulder_lift", "elbow_flex", "wrist_flex", "wrist_roll")


@pytest.fixture(scope="module")
def offsets(calibrated_robot: Callable[..., CalibrationResult]) -> Exported:
    """The SO-101 with joint offsets alone, its columns counted the other way."""
    setup = Setup(
        parameters=("joint-offset",),
        base_frame=FrameSetup(estimate=False),
        tool_frame=FrameSetup(estimate=False),
        joints={
            f"m{k}": JointMap(n, -1, offset=0.5 * np.pi * (k == 1))
            for k, n in enumerate(JOINTS)
        },
    )
    chain = calib_pin.load_chain("example:so101", tip="gripper_frame_link")
    return of(calibrated_robot("pose", setup, 40, robot=chain, noise=1e-6))


def test_reversed_joints_are_told_by_every_export(offsets, tmp_path):
    """In the table, by the report, and by formats that have no place for it."""
    text = FORMATS["joint-offsets"].encode(offsets, None).data.decode()
    lines = [line for line in text.splitlines() if line[:1] != "#"]
    assert [row["sign"] for row in csv.DictReader(lines)] == ["-1"] * 5
    told = format_report(offsets.result)
    for joint in JOINTS:
        zero = " +90 deg" * (joint == JOINTS[1])
        assert f"# {joint} is reversed: q = -(reading + offset){zero}\n" in text
        assert f"{joint} is reversed: q = -(reading + offset){zero}." in told
    # Last, where people look for what is to be typed in.
    assert told.index("Joint offsets") > told.index("Identifiability")
    (tmp_path / "own.json").write_text(motors())
    for name in ("lerobot", "ros2-control", "xacro", "mjcf", "dh"):
        template = tmp_path / "own.json" if name == "lerobot" else None
        remarks = FORMATS[name].encode(offsets, template).remarks
        assert any("elbow_flex is reversed" in remark for remark in remarks), name


def motors(**changes: dict[str, int]) -> str:
    """A calibration file of the five motors, with other entries for some."""
    found = {
        f"m{k}": {"id": k, "homing_offset": 5, "range_min": 700, "range_max": 3400}
        for k in range(5)
    }
    return json.dumps({name: of | changes.get(name, {}) for name, of in found.items()})


@pytest.mark.parametrize(
    "content",
    [
        motors(m1={"range_max": 4096}),
        motors(m1={"range_min": -1}),
        motors(m2={"range_min": 3400}),
        motors(m4={"id": 0}),
        *("{", "[]", '{"m0": {"homing_offset": 1}}'),
        '{"x": {"homing_offset": 1, "range_min": 0, "range_max": 9}}',
        motors(**{f"m{k}": {"homing_offset": 2047} for k in range(5)}),
        motors(**{f"m{k}": {"range_max": 701} for k in range(5)}),
    ],
)
def test_other_motors_are_refused(offsets, tmp_path, content):
    """And those without room for the steps by which theirs change."""
    template = tmp_path / "so101.json"
    template.write_text(content)
    with refused(InputError, file=str(template)):
        FORMATS["lerobot"].encode(offsets, template)


@pytest.mark.parametrize("name", ["m1", "wrist_roll"])
def test_a_range_across_the_seam_is_told(offsets, tmp_path, name):
    """But not of the motor that LeRobot gives the whole turn."""
    template, whole = tmp_path / "so101.json", {"range_min": 3, "range_max": 4095}
    content = motors(m1=whole) if name == "m1" else motors(m4=whole)
    template.write_text(content.replace("m4", "wrist_roll"))
    remarks = FORMATS["lerobot"].encode(offsets, template).remarks
    assert sum("seam" in remark for remark in remarks) == (name == "m1")


TRANSMISSION = """<robot><transmission name="t"><{tag}>{kind}</{tag}>
  <joint name="shoulder_pan">{joint}</joint><actuator name="m">{actuator}</actuator>
</transmission><transmission name="jaw"><type>Four</type><joint name="gripper"/>
</transmission></robot>"""
ROS_1 = "<mechanicalReduction>40</mechanicalReduction>"
ROS_2 = "<mechanical_reduction> 40.0 </mechanical_reduction>"


@pytest.mark.parametrize("tag", ["type", "plugin"])
@pytest.mark.parametrize("number", [ROS_1, ROS_2])
@pytest.mark.parametrize("place", ["joint", "actuator", "both"])
def test_a_reduction_is_kept_however_it_is_spelled(
    offsets, tmp_path, tag, number, place
):
    template, kind = tmp_path / "own.xml", "transmission_interface/SimpleTransmission"
    inner = {
        at: number if place in (at, "both") else "" for at in ("joint", "actuator")
    }
    template.write_text(TRANSMISSION.format(tag=tag, kind=kind, **inner))
    encoded = FORMATS["ros2-control"].encode(offsets, template)
    root = ElementTree.fromstring(encoded.data)
    (found,) = root.findall("transmission[@name='t']/joint/mechanical_reduction")
    assert float(found.text or "") == 40.0
    # What belongs to none of the joints stays as it is.
    assert [e.text for e in root.findall("transmission[@name='jaw']/type")] == ["Four"]


@pytest.mark.parametrize(
    ("tag", "kind", "joint", "actuator"),
    [
        ("type", "transmission_interface/DifferentialTransmission", ROS_2, ""),
        ("type", "a/SimpleTransmission", ROS_2, ROS_1.replace("40", "50")),
        ("type", "a/SimpleTransmission", "<gear_ratio>3</gear_ratio>", ""),
        ("type", "a/SimpleTransmission", ROS_1.replace("40", "0"), ""),
        ("type", "a/SimpleTransmission", ROS_1.replace("40", "${k}"), ""),
        ("type", "a/SimpleTransmission", '</joint><joint name="elbow_flex">', ""),
    ],
)
def test_other_transmissions_are_refused(offsets, tmp_path, tag, kind, joint, actuator):
    template = tmp_path / "own.xml"
    about = {"tag": tag, "kind": kind, "joint": joint, "actuator": actuator}
    template.write_text(TRANSMISSION.format(**about))
    with refused(InputError, reason="transmission 't'", file=str(template)):
        FORMATS["ros2-control"].encode(offsets, template)
    template.write_text('<robot name="b"><joint name="b_1" type="fixed"/></robot>')
    with refused(InputError, reason="another robot"):
        FORMATS["ros2-control"].encode(offsets, template)


def test_transmissions_stand_where_ros2_control_reads_them(offsets, tmp_path):
    """Within the block of their joint; comments of the user's own file stay."""
    template, drives = tmp_path / "own.xml", JOINTS[1:3]
    own = f'<joint name="{drives[0]}"/><!-- mine --><joint name="{drives[1]}"/>'
    template.write_text(
        f"<!-- top -->\n<robot><ros2_control>{own}</ros2_control></robot>"
    )
    encoded = FORMATS["ros2-control"].encode(offsets, template)
    assert encoded.data.startswith(b"<!-- top -->\n<robot>")
    assert b"<!-- mine -->" in encoded.data
    root = ElementTree.fromstring(encoded.data)
    for path, joints in (("ros2_control/", drives), ("", (JOINTS[0], *JOINTS[3:]))):
        inside = root.findall(f"{path}transmission/joint")
        assert [joint.get("name") for joint in inside] == [*joints]
    told = [remark for remark in encoded.remarks if "<ros2_control> only" in remark]
    assert len(told) == 1 and told[0].endswith(
        "those of shoulder_pan, wrist_flex, wrist_roll"
    )


def test_of_motors_it_is_told_what_their_file_does_not_say(offsets, tmp_path):
    template = tmp_path / "own.json"
    template.write_text(motors())
    told = " ".join(FORMATS["lerobot"].encode(offsets, template).remarks)
    assert "Dynamixel add it" in told and "-100 to 100" in told


def test_without_a_gain_it_is_the_nominal_robot(exported):
    plain = Exported(replace(exported.result, verdict="no-gain"), exported.file)
    assert plain.robot is plain.nominal.robot


def test_without_a_gain_nothing_is_corrected(calibrated_robot):
    """Neither offsets nor commands: what the fit has found is noise."""
    result = calibrated_robot("position", Setup(), 40, 0.0, noise=2e-4)
    assert result.verdict == "no-gain" and np.abs(result.model.theta).max() > 1e-5
    plain = Exported(result, Path("out"))
    assert np.abs(plain.joint_errors({}).offsets).max() < EXACT
    encoded = FORMATS["joint-offsets"].encode(plain, None)
    assert "without a gain this is of the nominal robot" in encoded.remarks
    assert not any("missing" in remark for remark in encoded.remarks)
    assert not result.applied.theta[~result.model.given.nuisance].any()
