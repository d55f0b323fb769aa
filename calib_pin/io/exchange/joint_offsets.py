"""Errors of the joints alone: typed into a controller, in motors, in transmissions.

A motor of LeRobot reads `position = encoder - homing_offset`, and its angle in degrees
is `(position - (range_min + range_max) / 2) 360 / 4095`. A SimpleTransmission of
ros2_control is `joint = actuator / mechanical_reduction + offset`.
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import numpy as np

from calib_pin.errors import InputError, OptionError, enumerated
from calib_pin.io.dialects.lerobot import STEPS, read_motors
from calib_pin.io.exchange.base import (
    GAINS,
    MIMIC,
    OFFSETS,
    ROBOTS,
    SEVERAL,
    SIGNS,
    Encoded,
    Exported,
    Format,
    require_read,
)
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


def doubts(known: Mapping[str, FoundOffset]) -> tuple[str, ...]:
    """A sentence about offsets that the measurements do not tell, if there are any."""
    unknown = [
        f"{name} ({of.status})" for name, of in known.items() if of.sigma is None
    ]
    about = "not known by themselves, only with the other values of the calibration: "
    return (about + enumerated(unknown),) if unknown else ()


def estimates(exported: Exported) -> dict[str, FoundOffset]:
    """The estimated offsets by column, where the calibration has them as parameters."""
    return {found.column: found for found in joint_offsets(exported.result)}


def encode_offsets(exported: Exported, _: Path | None) -> Encoded:
    """A table, with the sentence that says how it is used."""
    model = exported.result.model
    found = exported.joint_errors(model.setup.joints)
    offsets, rows, known = found.offsets.copy(), [], estimates(exported)
    stepped = encoder_steps(model.setup, model.chains.joints)
    for k, column, joint in found.drives:
        turns, sigma, status, steps = found.columns.revolute[k], "", "", ""
        si = "rad" if turns else "m"
        unit, factor = DISPLAY[si]
        shown, exact = f"{factor * offsets[k]:+z.6f}", repr(float(offsets[k]))
        if turns and joint in stepped:
            steps = f"{offsets[k] * stepped[joint] / (2.0 * np.pi):+z.1f}"
        if (estimate := known.get(column)) is not None:
            status = estimate.status
            if estimate.sigma is not None:
                sigma = f"{factor * estimate.sigma:.6f}"
            else:  # A zero would pass for a result.
                shown, steps, exact, offsets[k] = "", "", "", 0.0
        sign = "-1" if joint in exported.reverses else "+1"
        cells = [joint, column, shown, sigma, unit, steps, status, exact, si, sign]
        rows.append(cells)
    table = dict(zip(HEADERS.split(), zip(*rows, strict=True), strict=True))
    left = doubts(known)
    comments = [*USE, *exported.reverses.values(), *left]
    data = encode_table(table, comments)
    lines = data.decode().splitlines()[len(comments) :]
    require_read([*csv.reader(lines)], [HEADERS.split(), *rows], "the offsets")
    return Encoded(data, left, replace(found, offsets=offsets).poses)


FARTHEST = 2047
"""Largest homing offset that a motor stores."""

FULL_TURN = "wrist_roll"
"""Motor that LeRobot gives the whole range of its encoder (`full_turn_motor`)."""


def encode_motors(exported: Exported, template: Path | None) -> Encoded:
    """The user's own file with other homing offsets.

    The zero is in the middle of the range, so the range keeps its middle and shrinks:
    the joint goes nowhere it did not go before.

    Raises:
        InputError: If that is no such file, or lacks a motor.
        OptionError: If a joint does not turn, or a motor stores no such offset.
    """
    assert template is not None
    motors, chains = read_motors(template), exported.chains
    _check_motors(motors, template)
    found = exported.joint_errors(exported.result.model.setup.joints)
    offsets, steps = found.offsets.copy(), dict[str, int]()
    seams, rounded = list[str](), 0.0
    for k, column, joint in found.drives:
        names = (joint, column, joint.removesuffix("_joint"))
        name = next((name for name in names if name in motors), None)
        if name is None:
            raise InputError(
                f"has no motor for joint '{joint}'",
                file=template,
                allowed=f"one of {', '.join(motors)}, mapped by 'joints' in the setup",
            )
        exact = offsets[k] * STEPS / (2.0 * np.pi)
        steps[name] = moved = round(exact)
        rounded = max(rounded, abs(exact - moved) * 360.0 / STEPS)
        offsets[k] = moved * 2.0 * np.pi / STEPS
        i = chains.joints.index(joint)
        factor = abs(found.columns.factors[i, k])
        degrees = np.degrees(chains.upper[i] - chains.lower[i]) / factor
        range_ = motors[name]["range_max"] - motors[name]["range_min"]
        # Nearer to a whole turn than to the travel of the joint.
        if name != FULL_TURN and range_ * 720.0 / STEPS > 360.0 + degrees:
            seams.append(
                f"the range of '{name}' is a whole turn, its joint turns {degrees:.0f} "
                "deg: it was recorded across the seam of the encoder. Home the motor "
                "in its middle and record it again"
            )
        _move(motors[name], name, moved, template)
    data = json.dumps(motors, indent=4).encode() + b"\n"
    told = ", ".join(f"{name} {-moved:+d}" for name, moved in steps.items())
    said = (
        f"homing offsets changed by motor steps: {told}",
        f"whole steps leave up to {rounded:.3f} deg of a joint",
    )
    read = replace(found, offsets=offsets).poses
    return Encoded(data, (*said, *seams, *doubts(estimates(exported))), read)


def _check_motors(motors: Mapping[str, dict[str, Any]], template: Path) -> None:
    """Refuse what no calibration of LeRobot's can have written.

    Raises:
        InputError: If a range is none of the encoder, or two motors have one id.
    """
    owners = dict[object, str]()
    for name, motor in motors.items():
        ends = motor["range_min"], motor["range_max"]
        if not 0 <= ends[0] < ends[1] <= STEPS:
            reason, value = f"the encoder of '{name}' has no such range", [*ends]
            allowed = f"range_min below range_max, from 0 to {STEPS}"
            raise InputError(reason, file=template, value=value, allowed=allowed)
        if "id" in motor and (other := owners.setdefault(motor["id"], name)) != name:
            reason, value = f"motors '{other}' and '{name}' have one id", motor["id"]
            raise InputError(reason, file=template, value=value, allowed="one for each")


def _move(motor: dict[str, Any], name: str, moved: int, template: Path) -> None:
    """Change the homing offset, and the range so that it keeps its middle.

    Raises:
        OptionError: If a motor stores no such offset, or nothing is left of its range.
    """
    motor["homing_offset"] -= moved
    if abs(motor["homing_offset"]) > FARTHEST:
        raise OptionError(
            f"the homing offset of '{name}' would be {motor['homing_offset']}; "
            "home this motor nearer the middle of its range first",
            file=template,
            allowed=f"{-FARTHEST} to {FARTHEST}",
        )
    if motor["range_max"] - motor["range_min"] < STEPS:
        motor["range_min"] += abs(moved)
        motor["range_max"] -= abs(moved)
    if motor["range_min"] >= motor["range_max"]:
        reason = f"the range of '{name}' is smaller than its offset of {moved} steps"
        raise OptionError(reason, file=template)


PLUGIN = "transmission_interface/SimpleTransmission"

TAGS = {"mechanical_reduction": 1.0, "offset": 0.0}
"""Elements of a joint, and what they are where they are missing."""


def encode_transmissions(exported: Exported, template: Path | None) -> Encoded:
    """The transmissions, about those of the user's own description.

    Transmissions of other joints stay as they are.

    Raises:
        InputError: If that is no XML, or has a transmission of another kind.
    """
    found = exported.joint_errors({}, gains=True)
    joints = found.columns.joints
    own, others = ({}, []) if template is None else _stated(template, joints)
    root, wanted = ElementTree.Element("robot", name=exported.nominal.robot.name), []
    for joint, gain, offset in zip(joints, found.gains, found.offsets, strict=True):
        name, actuator, reduction, at_zero = own.get(
            joint, (f"{joint}_transmission", f"{joint}_actuator", 1.0, 0.0)
        )
        # The joint is at (1 + gain) of what was read, plus the offset.
        new = reduction / (1.0 + gain), (1.0 + gain) * at_zero + offset
        element = ElementTree.SubElement(root, "transmission", name=name)
        ElementTree.SubElement(element, "plugin").text = PLUGIN
        ElementTree.SubElement(element, "actuator", name=actuator, role="actuator1")
        stated = ElementTree.SubElement(element, "joint", name=joint, role="joint1")
        for tag, value in zip(TAGS, new, strict=True):
            ElementTree.SubElement(stated, tag).text = repr(float(value))
        wanted.append([float(value) for value in new])
    root.extend(others)
    ElementTree.indent(root)
    data = ElementTree.tostring(root) + b"\n"
    read = [*ElementTree.fromstring(data).iter("joint")][: len(wanted)]
    numbers = [[float(joint.findtext(tag, "nan")) for tag in TAGS] for joint in read]
    require_read(numbers, wanted, "the transmissions")
    return Encoded(data, doubts(estimates(exported)), found.poses)


Transmission = tuple[str, str, float, float]
"""Name, actuator, reduction and offset."""


def _stated(
    template: Path, joints: Sequence[str]
) -> tuple[dict[str, Transmission], list[ElementTree.Element]]:
    """The transmissions of some joints by joint, and those of others."""
    source = parse_document(read_bytes(template, TEXT), str(template)).plain
    found, others = dict[str, Transmission](), list[ElementTree.Element]()
    for element in ElementTree.fromstring(source).iter("transmission"):
        moved = [joint.get("name", "") for joint in element.iter("joint")]
        if moved and not {*moved} & {*joints}:
            others.append(element)
            continue
        owner = f"transmission '{element.get('name', '')}'"
        kinds = [e.text or "" for tag in ("plugin", "type") for e in element.iter(tag)]
        for kind in map(str.strip, kinds):
            if kind.rpartition("/")[2] != PLUGIN.rpartition("/")[2]:
                reason = f"{owner} is of another kind"
                raise InputError(reason, file=template, value=kind, allowed=PLUGIN)
        actuators = [e.get("name", "") for e in element.iter("actuator")]
        if len(moved) != 1 or len(actuators) != 1 or moved[0] in found:
            reason = f"{owner} is not that of one joint with one actuator"
            value = ", ".join([*moved, *actuators])
            raise InputError(reason, file=template, value=value, allowed=PLUGIN)
        numbers = _numbers(element, owner, template)
        found[moved[0]] = (element.get("name", ""), actuators[0], *numbers)
    return found, others


def _numbers(
    transmission: ElementTree.Element, owner: str, template: Path
) -> tuple[float, float]:
    """Reduction and offset of a transmission, also as ROS 1 spells and places them.

    Raises:
        InputError: If one is no number, is stated twice, or is spelled otherwise.
    """
    stated = dict[str, float]()
    for element in transmission.iterfind("*/*"):
        tag = re.sub(r"(?=[A-Z])", "_", element.tag).lower()
        if tag not in TAGS and not re.search("reduction|ratio", tag):
            continue
        value = float(np.array(as_number((element.text or "").strip()), float))
        usable = np.isfinite(value) and (value != 0.0 or tag == "offset")
        if tag not in TAGS or not usable or stated.setdefault(tag, value) != value:
            raise InputError(
                f"{owner} has a <{element.tag}> that cannot be used",
                file=template,
                value=element.text,
                allowed="one <mechanical_reduction>, not 0, and one <offset>",
            )
    reduction, offset = (TAGS | stated).values()
    return reduction, offset


JOINT_OFFSETS = Format(
    "joint-offsets",
    ".csv",
    "offsets of the joints, to be typed into a controller",
    encode_offsets,
    holds=(OFFSETS, SIGNS, *ROBOTS),
)
LEROBOT = Format(
    "lerobot",
    ".json",
    "LeRobot's homing offsets and ranges",
    encode_motors,
    "required",
    (OFFSETS, MIMIC, SEVERAL),
)
ROS2_CONTROL = Format(
    "ros2-control",
    ".xml",
    "transmissions: mechanical reduction and offset",
    encode_transmissions,
    "optional",
    (OFFSETS, GAINS, *ROBOTS),
)
