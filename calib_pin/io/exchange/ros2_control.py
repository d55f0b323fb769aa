"""Transmissions of ros2_control: reduction and offset of every joint.

A SimpleTransmission is `joint = actuator / mechanical_reduction + offset`.
"""

from __future__ import annotations

from pathlib import Path
from xml.etree import ElementTree

import numpy as np

from calib_pin.errors import InputError, OutputError
from calib_pin.io.exchange.base import EXACT, Encoded, Exported, Format
from calib_pin.io.exchange.joint_offsets import remarks
from calib_pin.io.files import TEXT, read_bytes
from calib_pin.io.urdf_bytes import parse_document

PLUGIN = "transmission_interface/SimpleTransmission"


def encode(exported: Exported, template: Path | None) -> Encoded:
    """The transmissions, about those of the user's own description.

    Raises:
        InputError: If that is no XML, or has a transmission of another kind.
    """
    own = {} if template is None else _stated(template)
    root = ElementTree.Element("robot", name=exported.robot.name)
    wanted = {}
    joints = exported.nominal.joints
    found = exported.transmissions
    for joint, gain, offset in zip(joints, found.gains, found.offsets, strict=True):
        name, actuator, reduction, at_zero = own.get(
            joint, (f"{joint}_transmission", f"{joint}_actuator", 1.0, 0.0)
        )
        # The joint is at (1 + gain) of what was read, plus the offset.
        new = reduction / (1.0 + gain), (1.0 + gain) * at_zero + float(offset)
        element = ElementTree.SubElement(root, "transmission", name=name)
        ElementTree.SubElement(element, "plugin").text = PLUGIN
        ElementTree.SubElement(element, "actuator", name=actuator, role="actuator1")
        stated = ElementTree.SubElement(element, "joint", name=joint, role="joint1")
        for tag, value in zip(("mechanical_reduction", "offset"), new, strict=True):
            ElementTree.SubElement(stated, tag).text = repr(float(value))
        wanted[joint] = new
    ElementTree.indent(root)
    data = ElementTree.tostring(root) + b"\n"
    for element in ElementTree.fromstring(data).iter("joint"):
        texts = (element.findtext(tag) for tag in ("mechanical_reduction", "offset"))
        read = np.array([float(text or "nan") for text in texts])
        if not np.abs(read - wanted[element.get("name", "")]).max() < EXACT:
            raise OutputError("a transmission does not read back")
    return Encoded(data, remarks(found, "offsets and gains"))


def _stated(template: Path) -> dict[str, tuple[str, str, float, float]]:
    """Name, actuator, reduction and offset of the transmissions by joint."""
    source = parse_document(read_bytes(template, TEXT), str(template)).plain
    found = {}
    for element in ElementTree.fromstring(source).iter("transmission"):
        name, plugin = element.get("name", ""), element.findtext("plugin", PLUGIN)
        joint, actuator = element.find("joint"), element.find("actuator")
        if plugin.strip() != PLUGIN:
            raise InputError(
                f"transmission '{name}' is of another kind",
                file=template,
                value=plugin.strip(),
                allowed=PLUGIN,
            )
        if joint is None or actuator is None:
            raise InputError(
                f"transmission '{name}' lacks a joint or an actuator", file=template
            )
        numbers = []
        for tag, default in (("mechanical_reduction", "1"), ("offset", "0")):
            text = joint.findtext(tag, default)
            try:
                numbers.append(float(text))
            except ValueError:
                raise InputError(
                    f"{tag} of transmission '{name}' is not a number",
                    file=template,
                    value=text,
                ) from None
        if not np.isfinite(numbers).all() or numbers[0] == 0.0:
            raise InputError(
                f"transmission '{name}' has a reduction or an offset that cannot be",
                file=template,
                value=numbers,
            )
        reduction, offset = numbers
        own = (name, actuator.get("name", ""), reduction, offset)
        found[joint.get("name", "")] = own
    return found


ROS2_CONTROL = Format(
    "ros2-control",
    ".xml",
    "transmissions: mechanical reduction and offset",
    encode,
    "optional",
)
