"""A commented setup file from a first look at a robot and its measurements."""

from __future__ import annotations

import textwrap
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
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


@dataclass(frozen=True)
class Draft:
    """The content of a setup file, and what is worth a comment.

    Attributes:
        robot: The robot.
        look: The reading of the measurements.
    """

    robot: Robot
    look: Look

    def text(self, command: str) -> str:
        """The file.

        Args:
            command: The command line that it comes from.
        """
        lines = (part for line in self._lines(command) for part in _folded(line))
        return "\n".join(lines) + "\n"

    def _lines(self, command: str) -> Iterator[str]:
        look, data = self.look, self.look.data
        assert data is not None
        document = setup_document(look.setup)
        model = "+".join(data.models)
        yield f"# Setup file of calib-pin, drafted by: {command}"
        yield f"# {len(data)} measurements of {self.robot.name}. {self._fit()}"
        if look.computed:
            yield (
                f"# The controller computed {_few(look.computed)} from the joints: no "
                "measurement, other columns are taken."
            )
        if look.ignored:
            yield f"# Columns without a meaning: {_few(look.ignored)}."
        if "base" in document:
            yield _line("base", document, "the chain starts here")
        if "tip" in document:
            yield ""
            yield from self._about_tip()
            yield _line("tip", document)
        if "chains" in document:
            yield ""
            yield "# The links that the names in the column 'chain' stand for."
            yield yaml_text({"chains": document["chains"]})
        yield ""
        helps = "; ".join(declared(name).help for name in data.models)
        yield f"# Measured: {helps}."
        yield f"model: {model}"
        yield f"# {FAMILIES}"
        yield yaml_text({"parameters": document["parameters"]})
        if "columns" in document:
            yield ""
            yield "# Our names of columns, and those of the file with their units."
            if look.joints.order:
                yield f"# Joints are known by the order alone, {look.joints.order}."
            yield "columns:"
            for ours, theirs in document["columns"].items():
                told = " (unit by its numbers)" if ours in look.units else ""
                comment = f"  #{told}" if told else ""
                yield f"  {yaml_text({ours: theirs}).strip('{}')}{comment}"
        for key, comment in (
            ("board", "The board; its points are known."),
            ("camera", "The camera; a first guess that is estimated."),
            ("distances", "Known distances [m]: they give the robot its size."),
        ):
            if key in document:
                yield ""
                yield f"# {comment}"
                yield yaml_text({key: document[key]})
        yield ""
        yield from self._frames(data.models)
        quantity = next(iter(look.errors))
        unit, usual = ("px", "0.3") if quantity == "pixel" else ("m", "1.0e-4")
        yield f"# State the noise of the instrument if you know it [{unit}]:"
        yield f"# noise: {{{quantity}: {usual}}}"

    def _fit(self) -> str:
        """How well the nominal robot fits to the measurements, in words."""
        look, told = self.look, []
        for quantity, size in look.errors.items():
            unit = "rad" if quantity == "orientation" else "m"
            unit = "px" if quantity == "pixel" else unit
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

    def _about_tip(self) -> Iterator[str]:
        others = [link for link in self.look.joints.tips if link != self.look.setup.tip]
        if others:
            more = f"The same joints move {_few(others)}."
            yield f"# The link that carries the tool. {more}"
        else:
            yield "# The link that carries the tool."

    def _frames(self, models: Sequence[str]) -> Iterator[str]:
        """Lines on what is estimated of frames."""
        if any(declared(name).external for name in models):
            yield "# The instrument may stand anywhere, and the target may sit anywhere"
            yield "# on the tool: both are estimated. State them if you know them."
            yield "frames:"
            yield "  base: {estimate: true}"
            yield "  tool: {estimate: true}"
        else:
            yield "# Tool and instrument are estimated; the base link is the frame of"
            yield "# reference. State 'frames', 'targets' or 'planes' that you know."


def _few(names: Sequence[str]) -> str:
    more = f" and {len(names) - SHOWN} more" if len(names) > SHOWN else ""
    return ", ".join(names[:SHOWN]) + more


def _line(key: str, document: dict[str, object], comment: str = "") -> str:
    text = yaml_text({key: document[key]}).strip("{}")
    return f"{text}  # {comment}" if comment else text


def _folded(line: str) -> list[str]:
    """A line, or of a long comment several."""
    if not line.startswith("# ") or len(line) <= WIDTH:
        return [line]
    return textwrap.wrap(line, WIDTH, subsequent_indent="#   ", break_long_words=False)
