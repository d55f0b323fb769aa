"""A commented setup file from a first look at a robot and its measurements."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from math import inf

from calib_pin.io.first_look import Look
from calib_pin.io.setup import setup_document, yaml_text
from calib_pin.kinematics.robot import Robot
from calib_pin.measurement_models import declared
from calib_pin.units import DISPLAY

WIDTH = 88
"""Longest line of a comment."""

SHOWN = 6
"""Links and columns that a comment names."""

FAMILIES = (
    "Six errors at every joint, the usual choice. Others: joint-offset for zeros "
    "alone; transmission, compliance beside it for gears and loads."
)

HAND_SET = (
    "The zeros of the joints alone: {}. From 100 measurements on try placement: six "
    "errors at every joint."
)

EXTERNAL = """
# The instrument may stand anywhere, and the target may sit anywhere
# on the tool: both are estimated. State them if you know them.
frames:
  base: {estimate: true}
  tool: {estimate: true}"""

INTERNAL = """
# Tool and instrument are estimated; the base link is the frame of
# reference. State 'frames', 'targets' or 'planes' that you know."""
"""Lines on what is estimated of frames, by where the instrument stands."""

GAUGED = (
    "Readings of the gauge count. In 'dial' pushed in is positive; if yours counts the "
    "other way, name its column 'deviation' under 'columns'."
)

COMMENTS = {
    "chains": "The links that the names in the column 'chain' stand for.",
    "prior": "Zeros that were set by hand are off by about 5 degrees [rad].",
    "board": "The board; its points are known.",
    "camera": "The camera; a first guess that is estimated, but for the size of the "
    "images, 'size: [width, height]', which export to camera-info needs.",
    "distances": "Known distances [m]: they give the robot its size.",
}
"""Comments of keys that are written as they are."""


def draft(robot: Robot, look: Look, command: str) -> str:
    """The setup file that a reading of measurements leads to.

    Args:
        robot: The robot.
        look: The reading.
        command: The command line that it comes from.
    """
    return "\n".join(_lines(robot, look, command)) + "\n"


def _lines(robot: Robot, look: Look, command: str) -> Iterator[str]:
    data, document = look.data, setup_document(look.setup)
    assert data is not None

    def stated(key: str) -> Iterator[str]:
        if key in document:
            yield f"\n{_comment(COMMENTS[key])}\n{yaml_text({key: document[key]})}"

    yield _comment(f"Setup file of calib-pin, drafted by: {command}")
    yield _comment(f"{len(data)} measurements of {robot.name}. {_fit(look)}")
    if look.computed:
        yield _comment(
            f"The controller computed {_few(look.computed)} from the joints: no "
            "measurement, other columns are taken."
        )
    if look.ignored:
        yield _comment(f"Columns without a meaning: {_few(look.ignored)}.")
    if "base" in document:
        yield f"{_entry('base', document['base'])}  # the chain starts here"
    if "tip" in document:
        others = [link for link in look.joints.tips if link != look.setup.tip]
        more = f" The same joints move {_few(others)}." if others else ""
        yield "\n" + _comment(f"The link that carries the tool.{more}")
        yield _entry("tip", document["tip"])
    yield from stated("chains")
    helps = "; ".join(declared(name).help for name in data.models)
    yield "\n" + _comment(f"Measured: {helps}.")
    if any(declared(b.model).contact and b.values.shape[1] for b in data.blocks):
        yield _comment(GAUGED)
    yield f"model: {'+'.join(data.models)}"
    yield _comment(HAND_SET.format(why) if (why := look.hand_set) else FAMILIES)
    yield yaml_text({"parameters": document["parameters"]})
    yield from stated("prior")
    if "columns" in document:
        yield "\n# Our names of columns, and those of the file with their units."
        if look.joints.order:
            yield f"# Joints are known by the order alone, {look.joints.order}."
        yield "columns:"
        for ours, theirs in document["columns"].items():
            told = "  # (unit by its numbers)" if ours in look.units else ""
            yield f"  {_entry(ours, theirs)}{told}"
    for key in ("board", "camera", "distances"):
        yield from stated(key)
    external = any(declared(name).external for name in data.models)
    yield EXTERNAL if external else INTERNAL
    quantity = next(iter(look.errors))
    unit, usual = ("px", "0.3") if quantity == "pixel" else ("m", "1.0e-4")
    yield f"# State the noise of the instrument if you know it [{unit}]:"
    yield f"# noise: {{{quantity}: {usual}}}"


def _fit(look: Look) -> str:
    """How well the nominal robot fits to the measurements, in words."""
    told = []
    for quantity, size in look.errors.items():
        unit = {"orientation": "rad", "pixel": "px"}.get(quantity, "m")
        shown, factor = DISPLAY[unit]
        told.append(f"{factor * size:.3g} {shown} ({quantity})")
    text = f"The nominal robot fits to {', '.join(told)} rms so"
    if look.next_share < inf:
        part, other = (f"{100 * k:.2g} %" for k in (look.share, look.next_share))
        text += f": {part} of its motion; in other units it is {other}"
    if look.fits:
        return f"{text}."
    return (
        f"{text}. That is NO fit: a column has another meaning, or these are not "
        "measurements of this robot. Correct what is wrong below."
    )


def _entry(key: str, word: str) -> str:
    return yaml_text({key: word}).strip("{}")


def _few(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more


def _comment(text: str) -> str:
    """A comment, of a long text in several lines."""
    line, more = f"# {text}", "#   "
    return textwrap.fill(line, WIDTH, subsequent_indent=more, break_long_words=False)
