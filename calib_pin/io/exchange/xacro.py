"""An overlay of joint origins as xacro properties.

A description that takes `xyz="${<joint>_xyz}" rpy="${<joint>_rpy}"` in its joints is
corrected by including the file.
"""

from __future__ import annotations

import re
from pathlib import Path
from xml.etree import ElementTree
from xml.sax.saxutils import escape, quoteattr

import numpy as np
import pinocchio as pin

from calib_pin.errors import OutputError
from calib_pin.io.exchange.base import (
    EXACT,
    Encoded,
    Exported,
    Format,
    origin_of,
    placed,
)
from calib_pin.io.urdf_bytes import parse_document

NAMESPACE = "http://www.ros.org/wiki/xacro"


def encode(exported: Exported, _: Path | None) -> Encoded:
    """The overlay."""
    origins = corrected_origins(exported)
    lines = [
        '<?xml version="1.0"?>',
        f"<!-- joint origins of {escape(exported.robot.name)}, calibrated: "
        "include it, and take them as "
        '<origin xyz="${NAME_xyz}" rpy="${NAME_rpy}"/> -->',
        f'<robot xmlns:xacro="{NAMESPACE}">',
    ]
    for name, origin in origins.items():
        numbers = origin_of(origin)
        for key, values in (("xyz", numbers[:3]), ("rpy", numbers[3:])):
            text = " ".join(map(repr, values))
            lines.append(
                f"  <xacro:property name={quoteattr(f'{variable(name)}_{key}')} "
                f'value="{text}"/>'
            )
    data = "\n".join([*lines, "</robot>", ""]).encode()
    found = {
        element.get("name", ""): [
            float(word) for word in element.get("value", "").split()
        ]
        for element in ElementTree.fromstring(data)
    }
    for name, origin in origins.items():
        own = variable(name)
        read = placed([*found[f"{own}_xyz"], *found[f"{own}_rpy"]])
        if not np.abs(read.homogeneous - origin.homogeneous).max() < EXACT:
            raise OutputError(f"the origin of joint '{name}' does not read back")
    return Encoded(data)


def corrected_origins(exported: Exported) -> dict[str, pin.SE3]:
    """Origins of the joints in the corrected URDF that differ from the nominal one.

    All of the chain stand among them, so that an overlay is complete.
    """
    document = parse_document(exported.robot.source, exported.robot.file)
    changed = {} if exported.geometry is None else exported.geometry.urdf_corrections()
    wanted = {*exported.nominal.joints, *changed}
    joints = (e for e in document.root.children if e.tag == "joint")
    named = {joint.attributes["name"]: joint for joint in joints}
    return {
        name: document.origin(joint) for name, joint in named.items() if name in wanted
    }


def variable(name: str) -> str:
    """A name that may stand in an expression."""
    return re.sub(r"\W", "_", name)


XACRO = Format("xacro", ".xacro", "joint origins as properties, to be included", encode)
