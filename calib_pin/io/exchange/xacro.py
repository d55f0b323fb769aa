"""An overlay of joint origins as xacro properties.

A description that takes `xyz="${<joint>_xyz}" rpy="${<joint>_rpy}"` in its joints is
corrected by including the file.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import escape, quoteattr

import pinocchio as pin

from calib_pin.io.exchange.base import (
    Encoded,
    Exported,
    Format,
    origin_of,
    require_read,
)
from calib_pin.io.urdf_bytes import parse_document

NAMESPACE = "http://www.ros.org/wiki/xacro"


def encode(exported: Exported, _: Path | None) -> Encoded:
    """The overlay."""
    properties = {}
    for name, origin in corrected_origins(exported).items():
        numbers = list(map(repr, origin_of(origin)))
        own = re.sub(r"\W", "_", name)  # A name that may stand in an expression.
        properties[f"{own}_xyz"] = " ".join(numbers[:3])
        properties[f"{own}_rpy"] = " ".join(numbers[3:])
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- joint origins of {escape(exported.robot.name)}, calibrated: "
        "include it, and take them as "
        '<origin xyz="${NAME_xyz}" rpy="${NAME_rpy}"/> -->',
        f'<robot xmlns:xacro="{NAMESPACE}">',
    ]
    for name, text in properties.items():
        lines.append(f'  <xacro:property name={quoteattr(name)} value="{text}"/>')
    data = "\n".join([*lines, "</robot>", ""]).encode()
    found = {e.get("name"): e.get("value") for e in ElementTree.fromstring(data)}
    require_read(found, properties, "the origins")
    return Encoded(data)


def corrected_origins(exported: Exported) -> dict[str, pin.SE3]:
    """Origins of the joints in the corrected URDF that differ from the nominal one.

    All of the chain stand among them, so that an overlay is complete.
    """
    document = parse_document(exported.robot.source, exported.robot.file)
    changed = {} if exported.geometry is None else exported.geometry.urdf_corrections()
    wanted = {*exported.nominal.joints, *changed}
    named = document.named("joint").items()
    return {name: document.origin(joint) for name, joint in named if name in wanted}


XACRO = Format("xacro", ".xacro", "joint origins as properties, to be included", encode)
