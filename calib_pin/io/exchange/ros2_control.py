"""Transmissions of ros2_control: reduction and offset of every joint.

A SimpleTransmission is `joint = actuator / mechanical_reduction + offset`.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from calib_pin.errors import InputError
from calib_pin.io.exchange.base import Encoded, Exported, Format, require_read
from calib_pin.io.exchange.joint_offsets import remarks
from calib_pin.io.files import TEXT, read_bytes
from calib_pin.io.urdf_bytes import parse_document
from calib_pin.units import as_number

PLUGIN = "transmission_interface/SimpleTransmission"

NUMBERS = {"mechanical_reduction": "1", "offset": "0"}
"""Elements of a joint, and what they are where they are missing."""


def encode(exported: Exported, template: Path | None) -> Encoded:
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


ROS2_CONTROL = Format(
    "ros2-control",
    ".xml",
    "transmissions: mechanical reduction and offset",
    encode,
    "optional",
)
