"""A commented setup file from a first look at a robot and its measurements."""

from __future__ import annotations

import textwrap
from math import inf
from typing import Any

from calib_pin.errors import enumerated
from calib_pin.io.first_look import Look
from calib_pin.io.setup import setup_document, yaml_text
from calib_pin.kinematics.robot import Robot
from calib_pin.measurement_models import declared
from calib_pin.units import DISPLAY

WIDTH = 88
"""Longest line of a comment."""

FAMILIES = (
    "Six errors at every joint, the usual choice. Others: joint-offset for zeros "
    "alone; transmission, compliance beside it for gears and loads."
)

HAND_SET = (
    "The zeros of the joints alone: {}. From 100 measurements on try placement: six "
    "errors at every joint."
)

EXTERNAL = """\
# The instrument may stand anywhere, and the target may sit anywhere
# on the tool: both are estimated. State them if you know them.
frames:
  base: {estimate: true}
  tool: {estimate: true}"""

INTERNAL = """\
# Tool and instrument are estimated; the base link is the frame of
# reference. State 'frames', 'targets' or 'planes' that you know."""
"""Lines on what is estimated of frames, by where the instrument stands."""

GAUGED = (
    " Readings of the gauge count. In 'dial' pushed in is positive; if yours counts "
    "the other way, name its column 'deviation' under 'columns'."
)

COMPUTED = (
    "The controller computed {} from the joints: no measurement, other columns are "
    "taken."
)

NO_FIT = (
    ". That is NO fit: a column has another meaning, or these are not measurements of "
    "this robot. Correct what is wrong below."
)

COMMENTS = {
    "base": "The chain starts here.",
    "tip": "The link that carries the tool.",
    "chains": "The links that the names in the column 'chain' stand for.",
    "model": "Measured: ",
    "parameters": "",
    "prior": "Zeros that were set by hand are off by about 5 degrees [rad].",
    "columns": "Our names of columns, and those of the file with their units.",
    "board": "The board; its points are known.",
    "camera": "The camera; a first guess that is estimated, but for the size of the "
    "images, 'size: [width, height]', which export to camera-info needs.",
    "distances": "Known distances [m]: they give the robot its size.",
}
"""Comments of keys, in the order of the file."""


def draft(robot: Robot, look: Look, command: str) -> str:
    """The setup file that a reading of measurements leads to.

    Args:
        robot: The robot.
        look: The reading.
        command: The command line that it comes from.
    """
    data, document = look.data, setup_document(look.setup)
    assert data is not None
    document["model"] = "+".join(data.models)
    models = [declared(name) for name in data.models]
    others = [link for link in look.joints.tips if link != look.setup.tip]
    gauged = any(declared(b.model).contact and b.values.shape[1] for b in data.blocks)
    more = {
        "tip": f" The same joints move {enumerated(others)}." if others else "",
        "model": "; ".join(m.help for m in models) + "." + GAUGED * gauged,
        "parameters": HAND_SET.format(why) if (why := look.hand_set) else FAMILIES,
    }
    parts = [_head(robot, look, command)]
    for key in filter(document.__contains__, COMMENTS):
        parts.append(_comment(COMMENTS[key] + more.get(key, "")))
        parts[-1] += f"\n{_lines(key, document[key], look)}"
    parts.append(EXTERNAL if any(m.external for m in models) else INTERNAL)
    quantity = next(iter(look.errors))
    unit, usual = ("px", "0.3") if quantity == "pixel" else ("m", "1.0e-4")
    parts[-1] += f"\n# State the noise of the instrument if you know it [{unit}]:"
    parts[-1] += f"\n# noise: {{{quantity}: {usual}}}\n"
    return "\n\n".join(parts)


def _head(robot: Robot, look: Look, command: str) -> str:
    """Comments on the whole, and on how well the nominal robot fits."""
    told = []
    for quantity, size in look.errors.items():
        unit = {"orientation": "rad", "pixel": "px"}.get(quantity, "m")
        shown, factor = DISPLAY[unit]
        told.append(f"{factor * size:.3g} {shown} ({quantity})")
    text = f"{len(look.data or ())} measurements of {robot.name}. The nominal robot "
    text += f"fits to {', '.join(told)} rms so"
    if look.next_share < inf:
        part, other = (f"{100 * k:.2g} %" for k in (look.share, look.next_share))
        text += f": {part} of its motion; in other units it is {other}"
    text += "." if look.fits else NO_FIT
    words = [f"Setup file of calib-pin, drafted by: {command}", text]
    if look.computed:
        words.append(COMPUTED.format(enumerated(look.computed)))
    if look.ignored:
        words.append(f"Columns without a meaning: {enumerated(look.ignored)}.")
    return "\n".join(map(_comment, words))


def _lines(key: str, value: Any, look: Look) -> str:
    """A key as it stands in the file, columns each on a line of its own."""
    if isinstance(value, str):
        return yaml_text({key: value}).strip("{}")
    if key != "columns":
        return yaml_text({key: value})
    order = look.joints.order
    found = f"# Joints are known by the order alone, {order}.\n" * bool(order)
    found += "columns:"
    for ours, theirs in value.items():
        told = "  # (unit by its numbers)" if ours in look.units else ""
        found += f"\n  {_lines(ours, theirs, look)}{told}"
    return found


def _comment(text: str) -> str:
    """A comment, of a long text in several lines."""
    line, more = f"# {text}", "#   "
    return textwrap.fill(line, WIDTH, subsequent_indent=more, break_long_words=False)
