"""Errors of the joints alone: typed into a controller, in motors, in transmissions.

A motor of LeRobot, one of Feetech, reads `position = encoder - homing_offset`, and its
angle in degrees is `(position - (range_min + range_max) / 2) 360 / 4095`. A simple
transmission of ros2_control is `joint = actuator / mechanical_reduction + offset`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, indent, tostring

import numpy as np

import calib_pin.io.exchange.base as base
from calib_pin.errors import enumerated
from calib_pin.io.dialects.lerobot import KEYS, STEPS, read_motors
from calib_pin.io.exchange.base import Encoded, Exported, Format
from calib_pin.io.files import TEXT, read_bytes
from calib_pin.io.measurements import encode_table
from calib_pin.io.urdf_tree import Document, parse_document
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.units import DISPLAY, as_number
from calib_pin.validation.joint_errors import encoder_steps, joint_offsets

OFFSET = "joint offset"
"""Kind of an error of the robot that is the offset of a joint."""

HEADERS = "joint column offset sigma unit steps status offset_si unit_si sign"

USE = (
    "A joint is where its column reads plus the offset: add each offset to what the "
    "controller shows.",
    "A controller that asks what it shows where the joint is at zero gets the negative "
    "of it.",
    f"This {base.ALREADY}.",
)
"""Sentences that say how the table is used."""

CLOSEST = "offsets make up for what else was found, and are not those of the report"
"""The meaning of offsets where a table of them does not hold all."""


def unknown_offsets(exported: Exported) -> dict[str, str]:
    """Why offsets are not known by themselves, by column.

    Be they parameters of the calibration or parts of a geometry.
    """
    result = exported.result
    offsets = {of.column: of for of in joint_offsets(result)}
    unknown = {name: of.status for name, of in offsets.items() if of.sigma is None}
    columns = JointColumns.of(result.model.chains, result.model.setup.joints)
    drives = dict(zip(columns.joints, columns.names, strict=True))
    for error in (e for e in result.robot_errors if e.kind == OFFSET):
        several = len(error.of) > 1
        for joint in error.of if several or error.sigma is None else ():
            # A minus is that of a difference, if it is not that of a name.
            column = drives.get(joint) or drives.get(joint.removeprefix("-"))
            if column and column not in offsets:
                unknown[column] = "coupled" if several else error.status
    return unknown


def doubts(unknown: Mapping[str, str]) -> tuple[str, ...]:
    """A sentence about offsets that are not known, if there are any, by column."""
    about = "not known by themselves, only with the other values of the calibration"
    names = [f"{name} ({why})" for name, why in unknown.items()]
    return (f"{about}: {enumerated(names)}",) if names else ()


@partial(Format, "joint-offsets", (base.OFFSETS, base.SIGNS, *base.ROBOTS), "")
def offsets_table(exported: Exported, _: Path | None) -> Encoded:
    """Offsets of the joints, to be typed into a controller."""
    model = exported.result.model
    errors = exported.joint_errors(model.setup.joints)
    stepped = encoder_steps(model.setup, model.chains.joints)
    known = {of.column: of for of in joint_offsets(exported.result)}
    unknown, rows, offsets = unknown_offsets(exported), [], errors.offsets.copy()
    for k, column, joint in errors.drives:
        turns, estimate = errors.columns.revolute[k], known.get(column)
        si = "rad" if turns else "m"
        (unit, factor), offset = DISPLAY[si], float(offsets[k])
        shown, steps, sigma, exact = f"{factor * offset:+z.6f}", "", "", repr(offset)
        if turns and joint in stepped:
            steps = f"{offset * stepped[joint] / (2.0 * np.pi):+z.1f}"
        status = unknown.get(column, "")
        if status:  # A zero would pass for a result.
            shown, steps, exact, offsets[k] = "", "", "", 0.0
        elif estimate is not None and estimate.sigma is not None:
            # An offset that makes up for what was found beside it is another one.
            if abs(offset - estimate.value) <= estimate.sigma:
                sigma = f"{factor * estimate.sigma:.6f}"
            status = estimate.status
        sign = "-1" if joint in exported.reverses else "+1"
        rows.append((joint, column, shown, sigma, unit, steps, status, exact, si, sign))
    table = dict(zip(HEADERS.split(), zip(*rows, strict=True), strict=True))
    remarks = doubts(unknown)
    if beside := [part for part in exported.parts if part != base.OFFSETS]:
        remarks += (f"{CLOSEST}: {enumerated(beside)}",)
    comments = [*USE, *exported.reverses.values(), *remarks]
    read = replace(errors, offsets=offsets).poses
    return Encoded(encode_table(table, comments), remarks, read)


FARTHEST = 2047
"""Largest homing offset that a motor stores."""

FEETECH = (
    "motors are taken for Feetech's, which subtract their homing offset; those of "
    "Dynamixel add it: change theirs the other way"
)
"""A remark on what the file does not say: the wrong sign would double the error."""

PARTS_OF_RANGE = (
    "degrees are corrected; positions of -100 to 100 count from the new ranges, so "
    "that those recorded before are other angles"
)

FULL_TURN = "wrist_roll"
"""Motor that LeRobot gives the whole range of its encoder (`full_turn_motor`)."""


@partial(Format, "lerobot", (base.OFFSETS, base.MIMIC, base.SEVERAL), "required")
def lerobot(exported: Exported, template: Path | None) -> Encoded:
    """LeRobot's homing offsets and ranges.

    The zero is in the middle of the range, so the range keeps its middle and shrinks:
    the joint goes nowhere it did not go before.

    Raises:
        InputError: If that is no such file, lacks a motor, or one stores no such
            offset.
    """
    assert template is not None
    motors, steps, seams = read_motors(template), dict[str, int](), list[str]()
    errors = exported.joint_errors(exported.result.model.setup.joints)
    offsets = errors.offsets.copy()
    for k, column, joint in errors.drives:
        names = (joint, column, joint.removesuffix("_joint"))
        name = next((name for name in names if name in motors), "")
        allowed = f"one of {', '.join(motors)}, mapped by 'joints' in the setup"
        reason = f"has no motor for joint '{joint}'"
        base.require(name != "", reason, template, None, allowed)
        steps[name] = round(offsets[k] * STEPS / (2.0 * np.pi))
        offsets[k] = steps[name] * 2.0 * np.pi / STEPS
        i = exported.chains.joints.index(joint)
        travel = exported.chains.upper[i] - exported.chains.lower[i]
        degrees = np.degrees(travel) / abs(errors.columns.factors[i, k])
        range_ = motors[name]["range_max"] - motors[name]["range_min"]
        # Nearer to a whole turn than to the travel of the joint.
        if name != FULL_TURN and range_ * 720.0 / STEPS > 360.0 + degrees:
            seams.append(
                f"'{name}' turns {degrees:.0f} deg, its range is a whole turn, across "
                "the seam of its encoder. Home it in its middle and record it again"
            )
    _move(motors, steps, template)
    moved = ", ".join(f"{name} {-count:+d}" for name, count in steps.items())
    rounded = np.degrees(np.abs(offsets - errors.offsets).max(initial=0.0))
    remarks = (
        f"homing offsets changed by motor steps: {moved}",
        FEETECH,
        PARTS_OF_RANGE,
        f"whole steps leave up to {rounded:.3f} deg of a joint",
        *seams,
        *doubts(unknown_offsets(exported)),
    )
    data = json.dumps(motors, indent=4).encode() + b"\n"
    return Encoded(data, remarks, replace(errors, offsets=offsets).poses)


def _move(
    motors: Mapping[str, dict[str, Any]], steps: Mapping[str, int], template: Path
) -> None:
    """Change homing offsets, and ranges so that they keep their middle.

    Raises:
        InputError: If no calibration of LeRobot's can have such motors, one stores no
            such offset, or nothing is left of its range.
    """
    ids, between = dict[object, str](), f"range_min below range_max, from 0 to {STEPS}"
    for name, motor in motors.items():
        (homing, low, high), motor_id = (motor[key] for key in KEYS), motor.get("id")
        reason = f"the encoder of '{name}' has no such range"
        base.require(0 <= low < high <= STEPS, reason, template, [low, high], between)
        other = name if motor_id is None else ids.setdefault(motor_id, name)
        reason = f"motors '{other}' and '{name}' have one id"
        base.require(other == name, reason, template, motor_id, "one for each")
        moved = steps.get(name, 0)
        homing, less = homing - moved, abs(moved) if high - low < STEPS else 0
        reason = f"the homing offset of '{name}' has no room for {moved} steps; home "
        reason += "this motor nearer the middle of its range first"
        allowed = f"{-FARTHEST} to {FARTHEST}"
        base.require(abs(homing) <= FARTHEST, reason, template, homing, allowed)
        motor |= zip(KEYS, (homing, low + less, high - less), strict=True)
        remaining = high - low - 2 * less
        reason = f"{moved} steps leave no range of '{name}'"
        base.require(remaining > 0, reason, template, remaining, "more than 0 steps")


PLUGIN = "transmission_interface/SimpleTransmission"

TAGS = {"mechanical_reduction": 1.0, "offset": 0.0}
"""Elements of a joint, and what they are where they are missing."""

OUTSIDE = "ros2_control reads transmissions in <ros2_control> only; move there those of"

NUMBERS = "one <mechanical_reduction>, not 0, and one <offset>"


@partial(Format, "ros2-control", (base.OFFSETS, base.GAINS, *base.ROBOTS), "optional")
def ros2_control(exported: Exported, template: Path | None) -> Encoded:
    """Transmissions: mechanical reduction and offset.

    Those of the user's own description, or simple ones. Transmissions of other joints,
    and all else in it, stay as they are.

    Raises:
        InputError: If that is no XML, is of another robot, or has a transmission of
            another kind.
    """
    fit = exported.joint_errors({}, gains=True)
    pairs = zip(fit.gains.tolist(), fit.offsets.tolist(), strict=True)
    errors = dict(zip(fit.columns.joints, pairs, strict=True))
    source, file = tostring(Element("robot", name=exported.nominal.robot.name)), None
    if template is not None:
        source, file = read_bytes(template, TEXT), str(template)
    document = parse_document(source, file, comments=True)
    root, joints = document.root, {*errors}
    theirs = {joint.get("name", "") for joint in root.findall("joint")}
    reason, allowed = "is of another robot", f"one with the joints {enumerated(errors)}"
    base.require(not theirs or bool(theirs & joints), reason, template, None, allowed)
    for element in root.findall(".//transmission"):
        moved = {joint.get("name", "") for joint in element.iter("joint")}
        if not moved or moved & joints:
            _correct(document, element, errors)
    blocks = {
        joint.get("name", ""): block
        for block in root.findall("ros2_control")
        for joint in block.findall("joint")
    }
    outside = [joint for joint in errors if joint not in blocks]
    for joint in [*errors]:
        block = blocks.get(joint, root)
        added = SubElement(block, "transmission", name=f"{joint}_transmission")
        SubElement(added, "actuator", name=f"{joint}_actuator")
        SubElement(added, "joint", name=joint)
        _correct(document, added, errors)
    indent(root)
    head = document.data[: document.places[root][1]]
    remarks = doubts(unknown_offsets(exported))
    if outside:
        remarks += (f"{OUTSIDE} {enumerated(outside)}",)
    return Encoded(head + tostring(root, "utf-8") + b"\n", remarks, fit.poses)


def _correct(
    document: Document, element: Element, errors: dict[str, tuple[float, float]]
) -> None:
    """Write reduction and offset of a simple transmission anew.

    Also where ROS 1 spells and places them; plugin and roles are spelled as
    ros2_control has them. Gain and offset of its joint are taken from the errors.

    Raises:
        RobotError: If it is not that of one joint with one actuator, or one of its
            numbers is none, is stated twice, or is spelled otherwise.
    """
    owner = f"transmission '{element.get('name', '')}'"
    for child in [e for e in element if e.tag in ("plugin", "type")]:
        kind, reason = (child.text or "").strip(), f"{owner} is of another kind"
        simple = kind.rpartition("/")[2] == PLUGIN.rpartition("/")[2]
        document.require(simple, child, reason, value=kind, allowed=PLUGIN)
        element.remove(child)
    inner, actuators = ([*element.iter(tag)] for tag in ("joint", "actuator"))
    names = [part.get("name", "") for part in (*inner, *actuators)]
    single = len(inner) == len(actuators) == 1 and names[0] in errors
    reason = f"{owner} is not that of one joint with one actuator"
    value = ", ".join(names)
    document.require(single, element, reason, value=value, allowed=PLUGIN)
    before = dict[str, float]()
    for parent in element:
        for part in [p for p in parent if isinstance(p.tag, str)]:  # No comments.
            tag = re.sub(r"(?=[A-Z])", "_", part.tag).lower()
            if tag in TAGS or re.search("reduction|ratio", tag):
                number = float(np.array(as_number((part.text or "").strip()), float))
                usable = np.isfinite(number) and (number != 0.0 or tag == "offset")
                usable &= tag in TAGS and before.setdefault(tag, number) == number
                reason = f"{owner} has a <{part.tag}> that cannot be used"
                details = {"value": part.text, "allowed": NUMBERS}
                document.require(usable, part, reason, **details)
                parent.remove(part)
    SubElement(element, "plugin").text = PLUGIN
    inner[0].attrib.setdefault("role", "joint1")
    actuators[0].attrib.setdefault("role", "actuator1")
    gain, offset = errors.pop(names[0])
    reduction, at_zero = (TAGS | before).values()
    # The joint is at (1 + gain) of what was read, plus the offset.
    SubElement(inner[0], "mechanical_reduction").text = repr(reduction / (1.0 + gain))
    SubElement(inner[0], "offset").text = repr((1.0 + gain) * at_zero + offset)
