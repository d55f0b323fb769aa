"""Errors of the joints alone: typed into a controller, in motors, in transmissions.

A motor of LeRobot reads `position = encoder - homing_offset`, and its angle in degrees
is `(position - (range_min + range_max) / 2) 360 / 4095`. A SimpleTransmission of
ros2_control is `joint = actuator / mechanical_reduction + offset`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any
from xml.etree.ElementTree import Element, SubElement, fromstring, indent, tostring

import numpy as np

import calib_pin.io.exchange.base as base
from calib_pin.errors import enumerated
from calib_pin.io.dialects.lerobot import STEPS, read_motors
from calib_pin.io.exchange.base import Encoded, Exported, Format
from calib_pin.io.files import TEXT, read_bytes
from calib_pin.io.measurements import encode_table
from calib_pin.io.urdf_tree import parse_document
from calib_pin.units import DISPLAY, as_number
from calib_pin.validation.joint_errors import FoundOffset, encoder_steps, joint_offsets

HEADERS = "joint column offset sigma unit steps status offset_si unit_si sign"

USE = (
    "A joint is where its column reads plus the offset: add each offset to what the "
    "controller shows.",
    "A controller that asks what it shows where the joint is at zero gets the negative "
    "of it.",
)
"""Sentences that say how the table is used."""


def _estimates(exported: Exported) -> tuple[dict[str, FoundOffset], tuple[str, ...]]:
    """The offsets that are parameters, by column, and a sentence about unknown ones."""
    found = {of.column: of for of in joint_offsets(exported.result)}
    unknown = [f"{n} ({of.status})" for n, of in found.items() if of.sigma is None]
    about = "not known by themselves, only with the other values of the calibration: "
    return found, (about + enumerated(unknown),) if unknown else ()


@partial(Format, "joint-offsets", ".csv", (base.OFFSETS, base.SIGNS, *base.ROBOTS), "")
def offsets_table(exported: Exported, _: Path | None) -> Encoded:
    """Offsets of the joints, to be typed into a controller."""
    model = exported.result.model
    found = exported.joint_errors(model.setup.joints)
    stepped = encoder_steps(model.setup, model.chains.joints)
    (known, doubts), rows, offsets = _estimates(exported), [], found.offsets.copy()
    for k, column, joint in found.drives:
        turns, estimate = found.columns.revolute[k], known.get(column)
        si = "rad" if turns else "m"
        (unit, factor), offset = DISPLAY[si], float(offsets[k])
        numbers = [f"{factor * offset:+z.6f}", "", repr(offset)]
        if turns and joint in stepped:
            numbers[1] = f"{offset * stepped[joint] / (2.0 * np.pi):+z.1f}"
        sigma = ""
        if estimate is not None and estimate.sigma is not None:
            sigma = f"{factor * estimate.sigma:.6f}"
        elif estimate is not None:  # A zero would pass for a result.
            numbers, offsets[k] = ["", "", ""], 0.0
        shown, steps, exact = numbers
        status = "" if estimate is None else estimate.status
        sign = "-1" if joint in exported.reverses else "+1"
        rows.append((joint, column, shown, sigma, unit, steps, status, exact, si, sign))
    table = dict(zip(HEADERS.split(), zip(*rows, strict=True), strict=True))
    comments = [*USE, *exported.reverses.values(), *doubts]
    read = replace(found, offsets=offsets).poses
    return Encoded(encode_table(table, comments), doubts, read)


FARTHEST = 2047
"""Largest homing offset that a motor stores."""

FULL_TURN = "wrist_roll"
"""Motor that LeRobot gives the whole range of its encoder (`full_turn_motor`)."""


@partial(
    Format, "lerobot", ".json", (base.OFFSETS, base.MIMIC, base.SEVERAL), "required"
)
def lerobot(exported: Exported, template: Path | None) -> Encoded:
    """LeRobot's homing offsets and ranges.

    The zero is in the middle of the range, so the range keeps its middle and shrinks:
    the joint goes nowhere it did not go before.

    Raises:
        InputError: If that is no such file, lacks a motor, or one stores no such
            offset.
    """
    assert template is not None
    motors = read_motors(template)
    _check(motors, template)
    found = exported.joint_errors(exported.result.model.setup.joints)
    offsets, moved, seams = found.offsets.copy(), list[str](), list[str]()
    for k, column, joint in found.drives:
        names = (joint, column, joint.removesuffix("_joint"))
        name = next((name for name in names if name in motors), "")
        allowed = f"one of {', '.join(motors)}, mapped by 'joints' in the setup"
        reason = f"has no motor for joint '{joint}'"
        base.require(name != "", reason, template, None, allowed)
        steps = round(offsets[k] * STEPS / (2.0 * np.pi))
        offsets[k] = steps * 2.0 * np.pi / STEPS
        moved.append(f"{name} {-steps:+d}")
        i = exported.chains.joints.index(joint)
        travel = exported.chains.upper[i] - exported.chains.lower[i]
        degrees = np.degrees(travel) / abs(found.columns.factors[i, k])
        range_ = motors[name]["range_max"] - motors[name]["range_min"]
        # Nearer to a whole turn than to the travel of the joint.
        if name != FULL_TURN and range_ * 720.0 / STEPS > 360.0 + degrees:
            seams.append(
                f"the range of '{name}' is a whole turn, its joint turns {degrees:.0f} "
                "deg: it was recorded across the seam of the encoder. Home the motor "
                "in its middle and record it again"
            )
        _move(motors[name], name, steps, template)
    rounded = np.degrees(np.abs(offsets - found.offsets).max(initial=0.0))
    remarks = (
        f"homing offsets changed by motor steps: {', '.join(moved)}",
        f"whole steps leave up to {rounded:.3f} deg of a joint",
        *seams,
        *_estimates(exported)[1],
    )
    data = json.dumps(motors, indent=4).encode() + b"\n"
    return Encoded(data, remarks, replace(found, offsets=offsets).poses)


def _check(motors: Mapping[str, Mapping[str, Any]], template: Path) -> None:
    """Refuse what no calibration of LeRobot's can have."""
    ranges, ids = f"range_min below range_max, from 0 to {STEPS}", dict[object, str]()
    for name, motor in motors.items():
        low, high, own = motor["range_min"], motor["range_max"], motor.get("id")
        reason = f"the encoder of '{name}' has no such range"
        base.require(0 <= low < high <= STEPS, reason, template, [low, high], ranges)
        other = name if own is None else ids.setdefault(own, name)
        reason = f"motors '{other}' and '{name}' have one id"
        base.require(other == name, reason, template, own, "one for each")


def _move(motor: dict[str, Any], name: str, steps: int, template: Path) -> None:
    """Change the homing offset, and the range so that it keeps its middle.

    Raises:
        InputError: If a motor stores no such offset, or nothing is left of its range.
    """
    motor["homing_offset"] -= steps
    value, allowed = motor["homing_offset"], f"{-FARTHEST} to {FARTHEST}"
    reason = f"the homing offset of '{name}' has no room for {steps} steps; home this "
    reason += "motor nearer the middle of its range first"
    base.require(abs(value) <= FARTHEST, reason, template, value, allowed)
    if motor["range_max"] - motor["range_min"] < STEPS:
        motor["range_min"] += abs(steps)
        motor["range_max"] -= abs(steps)
    value, allowed = motor["range_max"] - motor["range_min"], "more than 0"
    reason = f"the range of '{name}' is smaller than its offset of {steps} steps"
    base.require(value > 0, reason, template, value, allowed)


PLUGIN = "transmission_interface/SimpleTransmission"

TAGS = {"mechanical_reduction": 1.0, "offset": 0.0}
"""Elements of a joint, and what they are where they are missing."""

NUMBERS = "one <mechanical_reduction>, not 0, and one <offset>"


@partial(
    Format, "ros2-control", ".xml", (base.OFFSETS, base.GAINS, *base.ROBOTS), "optional"
)
def ros2_control(exported: Exported, template: Path | None) -> Encoded:
    """Transmissions: mechanical reduction and offset.

    Those of the user's own description, or simple ones. Transmissions of other joints,
    and all else in it, stay as they are.

    Raises:
        InputError: If that is no XML, or has a transmission of another kind.
    """
    found = exported.joint_errors({}, gains=True)
    joints, root = (
        found.columns.joints,
        Element("robot", name=exported.nominal.robot.name),
    )
    if template is not None:
        source = parse_document(read_bytes(template, TEXT), str(template)).plain
        root = fromstring(source)
    stated = {e.get("name") for t in root.iter("transmission") for e in t.iter("joint")}
    for joint in (joint for joint in joints if joint not in stated):
        added = SubElement(root, "transmission", name=f"{joint}_transmission")
        SubElement(added, "actuator", name=f"{joint}_actuator")
        SubElement(added, "joint", name=joint)
    own = _own(root, joints, template)
    for joint, gain, offset in zip(joints, found.gains, found.offsets, strict=True):
        element, reduction, at_zero = own[joint]
        # The joint is at (1 + gain) of what was read, plus the offset.
        new = reduction / (1.0 + gain), (1.0 + gain) * at_zero + offset
        for tag, value in zip(TAGS, new, strict=True):
            SubElement(element, tag).text = repr(float(value))
    indent(root)
    return Encoded(tostring(root) + b"\n", _estimates(exported)[1], found.poses)


def _own(
    root: Element, joints: Sequence[str], template: Path | None
) -> dict[str, tuple[Element, float, float]]:
    """The joints of simple transmissions by name, and reduction and offset of these.

    The numbers are taken out; plugin and roles are spelled as ros2_control has them.

    Raises:
        InputError: If a transmission is none of one joint, or one that is not simple.
    """
    found = dict[str, tuple[Element, float, float]]()
    for element in root.iter("transmission"):
        inner, actuators = ([*element.iter(tag)] for tag in ("joint", "actuator"))
        moved = [joint.get("name", "") for joint in inner]
        if moved and not {*moved} & {*joints}:
            continue
        owner = f"transmission '{element.get('name', '')}'"
        for stated in [e for e in element if e.tag in ("plugin", "type")]:
            kind, reason = (stated.text or "").strip(), f"{owner} is of another kind"
            simple = kind.rpartition("/")[2] == PLUGIN.rpartition("/")[2]
            base.require(simple, reason, template, kind, PLUGIN)
            element.remove(stated)
        names = ", ".join([*moved, *(e.get("name", "") for e in actuators)])
        one = len(inner) == len(actuators) == 1 and moved[0] not in found
        reason = f"{owner} is not that of one joint with one actuator"
        base.require(one, reason, template, names, PLUGIN)
        found[moved[0]] = (inner[0], *_numbers(element, owner, template))
        SubElement(element, "plugin").text = PLUGIN
        inner[0].attrib.setdefault("role", "joint1")
        actuators[0].attrib.setdefault("role", "actuator1")
    return found


def _numbers(
    transmission: Element, owner: str, template: Path | None
) -> tuple[float, float]:
    """Take reduction and offset out, also as ROS 1 spells and places them.

    Raises:
        InputError: If one is no number, is stated twice, or is spelled otherwise.
    """
    stated = dict[str, float]()
    for parent in transmission:
        for element in list(parent):
            tag = re.sub(r"(?=[A-Z])", "_", element.tag).lower()
            if tag not in TAGS and not re.search("reduction|ratio", tag):
                continue
            value = float(np.array(as_number((element.text or "").strip()), float))
            usable = np.isfinite(value) and (value != 0.0 or tag == "offset")
            usable &= tag in TAGS and stated.setdefault(tag, value) == value
            reason = f"{owner} has a <{element.tag}> that cannot be used"
            base.require(bool(usable), reason, template, element.text, NUMBERS)
            parent.remove(element)
    reduction, offset = (TAGS | stated).values()
    return reduction, offset
