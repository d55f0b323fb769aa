"""Errors of the joints alone: typed into a controller, in motors, in transmissions.

A motor of LeRobot reads `position = encoder - homing_offset`, and its angle in degrees
is `(position - (range_min + range_max) / 2) 360 / 4095`. A SimpleTransmission of
ros2_control is `joint = actuator / mechanical_reduction + offset`.
"""

from __future__ import annotations

import csv
import json
from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from calib_pin.errors import InputError, OptionError, enumerated
from calib_pin.io.dialects.lerobot import STEPS, read_motors
from calib_pin.io.exchange.base import (
    Encoded,
    Exported,
    Format,
    JointErrors,
    require_read,
)
from calib_pin.io.files import TEXT, read_bytes
from calib_pin.io.measurements import encode_table
from calib_pin.io.urdf_tree import parse_document
from calib_pin.kinematics.joint_columns import JointColumns
from calib_pin.units import DISPLAY, as_number
from calib_pin.validation.joint_offsets import encoder_steps
from calib_pin.validation.result import ParameterEstimate

ENOUGH = 1e-6
"""Error of the tip below which offsets alone are the whole correction [m]."""

ESTIMATED = ".joint-offset.q"
"""End of the names of offsets that were estimated as such."""

KNOWN = ("identifiable", "fixed")
"""Statuses of offsets that are known by themselves."""

HEADERS = "joint column offset sigma unit steps status offset_si unit_si"

USE = (
    "A joint is where its column reads plus the offset: add each offset to what the "
    "controller shows.",
    "A controller that asks what it shows where the joint is at zero gets the negative "
    "of it.",
)
"""Sentences that say how the table is used."""


def column_offsets(exported: Exported) -> list[tuple[str, str, float, float]]:
    """The offset of each measured column [rad, m].

    Returns:
        Joint, column, size of its gear, and what is added to what the column reads.
    """
    joints, setup = exported.nominal.joints, exported.result.model.setup
    found, columns = (
        exported.offsets.offsets.tolist(),
        JointColumns.of(exported.nominal, setup.joints).maps,
    )
    return [
        (joint, column, abs(given.gear), offset / (given.sign * given.gear))
        for joint, offset in zip(joints, found, strict=True)
        for column, given in [columns[joint]]
    ]


def remarks(found: JointErrors, what: str = "offsets") -> tuple[str, ...]:
    """A sentence about errors that those of the joints leave, if there are any."""
    if found.after < ENOUGH:
        return ()
    unit, factor = DISPLAY["m"]
    return (
        f"{what} alone leave {factor * found.after:.3g} of {factor * found.before:.3g} "
        f"{unit} of what was found (tip, rms over random configurations)",
    )


def estimates(exported: Exported) -> dict[str, ParameterEstimate]:
    """The estimated offsets by joint, where the calibration has them as parameters."""
    owners = ((p.name.removesuffix(ESTIMATED), p) for p in exported.result.parameters)
    return {joint: p for joint, p in owners if joint != p.name}


def doubts(exported: Exported) -> tuple[str, ...]:
    """A sentence about offsets that the measurements do not tell, if there are any."""
    estimated = estimates(exported).items()
    unknown = [f"{j} ({p.status})" for j, p in estimated if p.status not in KNOWN]
    about = "not known by themselves, only with the other values of the calibration: "
    return (about + enumerated(unknown),) if unknown else ()


def encode_offsets(exported: Exported, _: Path | None) -> Encoded:
    """A table, with the sentence that says how it is used."""
    known, rows = estimates(exported), []
    left = (*remarks(exported.offsets), *doubts(exported))
    stepped = encoder_steps(exported.result.model.setup, exported.nominal.joints)
    revolute, offsets = exported.nominal.revolute, column_offsets(exported)
    for (joint, column, gear, offset), turns in zip(offsets, revolute, strict=True):
        si = "rad" if turns else "m"
        (unit, factor), estimate = DISPLAY[si], known.get(joint)
        shown, steps, exact = f"{factor * offset:+z.6f}", "", repr(offset)
        status, sigma = "", ""
        if turns and joint in stepped:
            steps = f"{offset * stepped[joint] / (2.0 * np.pi):+z.1f}"
        if estimate is not None:
            status = estimate.status
            if estimate.sigma is not None:
                sigma = f"{factor * estimate.sigma / gear:.6f}"
            if status not in KNOWN:  # A zero would pass for a result.
                shown = steps = exact = ""
        rows.append([joint, column, shown, sigma, unit, steps, status, exact, si])
    table = dict(zip(HEADERS.split(), zip(*rows, strict=True), strict=True))
    data = encode_table(table, [*USE, *left])
    lines = [line for line in data.decode().splitlines() if line[:1] != "#"]
    require_read([*csv.reader(lines)], [HEADERS.split(), *rows], "the offsets")
    return Encoded(data, left)


FARTHEST = 2047
"""Largest homing offset that a motor stores."""


def encode_motors(exported: Exported, template: Path | None) -> Encoded:
    """The user's own file with other homing offsets.

    The zero is in the middle of the range, so the range keeps its middle and shrinks:
    the joint goes nowhere it did not go before.

    Raises:
        InputError: If that is no such file, or lacks a motor.
        OptionError: If a joint does not turn, or a motor stores no such offset.
    """
    assert template is not None
    motors = read_motors(template)
    if not exported.nominal.revolute.all():
        raise OptionError("a motor needs a joint that turns", file=exported.file)
    steps, rounded = dict[str, int](), 0.0
    for joint, column, _, offset in column_offsets(exported):
        names = (joint, column, joint.removesuffix("_joint"))
        name = next((name for name in names if name in motors), None)
        if name is None:
            raise InputError(
                f"has no motor for joint '{joint}'",
                file=template,
                allowed=f"one of {', '.join(motors)}, mapped by 'joints' in the setup",
            )
        motor, exact = motors[name], offset * STEPS / (2.0 * np.pi)
        steps[name] = moved = round(exact)
        rounded = max(rounded, abs(exact - moved) * 360.0 / STEPS)
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
    data = json.dumps(motors, indent=4).encode() + b"\n"
    told = ", ".join(f"{name} {-moved:+d}" for name, moved in steps.items())
    said = (
        f"homing offsets changed by motor steps: {told}",
        f"whole steps leave up to {rounded:.3f} deg of a joint",
    )
    return Encoded(data, (*said, *remarks(exported.offsets), *doubts(exported)))


PLUGIN = "transmission_interface/SimpleTransmission"

NUMBERS = {"mechanical_reduction": "1", "offset": "0"}
"""Elements of a joint, and what they are where they are missing."""


def encode_transmissions(exported: Exported, template: Path | None) -> Encoded:
    """The transmissions, about those of the user's own description.

    Raises:
        InputError: If that is no XML, or has a transmission of another kind.
    """
    own = {} if template is None else _stated(template)
    root = ElementTree.Element("robot", name=exported.robot.name)
    found, joints, wanted = (
        exported.joint_errors(gains=True),
        exported.nominal.joints,
        [],
    )
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
        for tag, value in zip(NUMBERS, new, strict=True):
            ElementTree.SubElement(stated, tag).text = repr(float(value))
        wanted.append([float(value) for value in new])
    ElementTree.indent(root)
    data = ElementTree.tostring(root) + b"\n"
    read = ElementTree.fromstring(data).iter("joint")
    numbers = [[float(joint.findtext(tag, "nan")) for tag in NUMBERS] for joint in read]
    require_read(numbers, wanted, "the transmissions")
    return Encoded(data, remarks(found, "offsets and gains"))


def _stated(template: Path) -> dict[str, tuple[str, str, float, float]]:
    """Name, actuator, reduction and offset of the transmissions by joint."""
    source = parse_document(read_bytes(template, TEXT), str(template)).plain
    found = {}
    for element in ElementTree.fromstring(source).iter("transmission"):
        name, plugin = element.get("name", ""), element.findtext("plugin", PLUGIN)
        joint, actuator = element.find("joint"), element.find("actuator")
        owner = f"transmission '{name}'"
        if (plugin := plugin.strip()) != PLUGIN:
            reason = f"{owner} is of another kind"
            raise InputError(reason, file=template, value=plugin, allowed=PLUGIN)
        if joint is None or actuator is None:
            raise InputError(f"{owner} lacks a joint or an actuator", file=template)
        texts = [joint.findtext(*about).strip() for about in NUMBERS.items()]
        reduction, offset = np.array([as_number(text) for text in texts], float)
        if not np.isfinite([offset, reduction]).all() or reduction == 0.0:
            reason = f"{owner} has a reduction or an offset that cannot be"
            raise InputError(reason, file=template, value=texts)
        own = (name, actuator.get("name", ""), float(reduction), float(offset))
        found[joint.get("name", "")] = own
    return found


JOINT_OFFSETS = Format(
    "joint-offsets",
    ".csv",
    "offsets of the joints, to be typed into a controller",
    encode_offsets,
)
LEROBOT = Format(
    "lerobot", ".json", "LeRobot's homing offsets and ranges", encode_motors, "required"
)
ROS2_CONTROL = Format(
    "ros2-control",
    ".xml",
    "transmissions: mechanical reduction and offset",
    encode_transmissions,
    "optional",
)
