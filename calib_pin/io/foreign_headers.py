"""The meaning of columns with foreign names, by their words, numbers and units.

A file of another software says `J1 (deg)`, `TCP_x` or `Achse 3 [Grad]`. The meaning is
read off the last word, the unit off brackets or an ending; several columns of the same
meaning are told apart by words such as *measured* and *goal*.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib_pin.io.columns import ANGLE, LENGTH, Column, split_header

UNITS = {
    "m": ("m", "meter", "meters", "metre", "metres"),
    "mm": ("mm", "millimeter", "millimeters", "millimetre", "millimetres"),
    "um": ("um", "µm", "μm", "micrometer", "micron"),
    "in": ("in", "inch", "inches"),
    "rad": ("rad", "radian", "radians"),
    "deg": ("deg", "degree", "degrees", "grad", "°"),
    "mrad": ("mrad",),
    "gon": ("gon",),
    "px": ("px", "pixel", "pixels"),
    "s": ("s", "sec", "second", "seconds"),
}
"""Ways of writing each unit; *Grad* is German for degrees."""

MEANINGS: Mapping[str, str] = {
    **{axis: rf"(?:pos|p|t|position|tcp)?{axis}" for axis in "xyz"},
    **{f"q{axis}": rf"(?:quat(?:ernion)?|q){axis}" for axis in "xyzw"},
    **{f"r{axis}": rf"(?:rot|rv|r){axis}" for axis in "xyz"},
    **{name: name for name in ("roll", "pitch", "yaw")},
    "distance": "distance|dist|abstand|entfernung|range|length",
    **{axis: rf"(?:pixel|px|p)?{axis}" for axis in "uv"},
    "target": "target|point|punkt|ziel|socket|marker|corner|feature|targetid|pointid",
    "station": "station|standpunkt|setupid",
    "tool": "tool|werkzeug",
    "chain": "chain|arm|kette",
    "payload": "payload|nutzlast",
    "time": "time|timestamp|zeit|stamp|times",
    "temperature": "temperature|temperatur|temp|temperaturec|tempc",
    "set": "set",
}
"""Last words, without spaces, of headers with a meaning, as patterns."""

VECTORS = (
    ("x", "y", "z"),
    ("qx", "qy", "qz", "qw"),
    ("rx", "ry", "rz"),
    ("roll", "pitch", "yaw"),
    ("u", "v"),
)
"""Columns that mean something together only."""

SPREAD = re.compile(r"(?:sigma|std|stdev|dev|var|cov|err|diff|delta)")
"""Beginning of names that are those of uncertainties and differences."""

MEASURED = re.compile(r"meas|mess|track|actual|observ|\bist\b|real|reflector|smr")
COMMANDED = re.compile(
    r"goal|soll|nominal|cmd|command|desired|\bset|ref|target|diff?\b"
)

NUMBERED = re.compile(
    r"^(.*?)[ _.\-#]*(\d+)(?:[ _.\-]*(?:pos|position|angle|winkel))?$"
)
JOINTED = re.compile(r"j|a|q|theta|axis|axe|achse|gelenk|joint|phi|motor|servo")


@dataclass(frozen=True)
class Foreign:
    """A column as another software names it.

    Attributes:
        name: Name in the file, without a unit in square brackets.
        words: The name in lower case without its unit.
        unit: Its unit as calib-pin writes it; None where it states none.
        column: The column.
    """

    name: str
    words: str
    unit: str | None
    column: Column

    def stated(self, unit: str | None) -> str:
        """How `columns` in a setup file names it with a unit."""
        if self.column.unit in (*ANGLE.units, *LENGTH.units):
            return self.name  # Its header says so already.
        return self.column.header if unit is None else f"{self.name} [{unit}]"

    @property
    def largest(self) -> float:
        """Largest absolute number; zero where there is none."""
        numbers = self.column.numbers[np.isfinite(self.column.numbers)]
        return float(np.abs(numbers).max(initial=0.0))

    @property
    def moves(self) -> bool:
        """Whether it holds numbers that are not all the same."""
        numbers = self.column.numbers[np.isfinite(self.column.numbers)]
        return numbers.size > 1 and float(np.ptp(numbers)) > 0.0


def foreign(columns: Mapping[str, Column]) -> tuple[Foreign, ...]:
    """The columns of a file with their units, however these are written."""
    return tuple(_split(name, column) for name, column in columns.items())


def _split(name: str, column: Column) -> Foreign:
    bare, unit = split_header(column.header)
    words, stated = bare, _unit(unit or "")
    endings = (r"\(([^()]*)\)$", r"[ _/](?:in )?([^\W\d_]+|°)$")
    for ending in endings if stated is None else ():
        found = re.search(ending, words.strip())
        if found and (stated := _unit(found[1])) is not None:
            words = words.strip()[: found.start()]
            break
    spaced = re.sub(r"(?<=[a-z])(?=[A-Z])", " ", words)
    return Foreign(name, spaced.strip(" _-/").lower(), stated, column)


def _unit(text: str) -> str | None:
    text = text.strip().lower()
    return next((unit for unit, ways in UNITS.items() if text in ways), None)


def measured(columns: Sequence[Foreign]) -> dict[str, list[Foreign]]:
    """The columns that may be each of ours, the likeliest first.

    Vectors are whole, and their columns are alike but for the last word.
    """
    found = dict[str, list[Foreign]]()
    columns = [one for one in columns if not SPREAD.match(one.words)]
    for ours, pattern in MEANINGS.items():
        ending = re.compile(rf"(?:^|.*[^a-z])(?:{pattern})$")
        alike = [one for one in columns if ending.match(one.words)]
        found[ours] = sorted(alike, key=_likelihood)
    for vector in VECTORS:
        sets = [dict(_by_stem(found[ours])) for ours in vector]
        whole = [stem for stem in sets[0] if all(stem in one for one in sets)]
        for ours, by_stem in zip(vector, sets, strict=True):
            found[ours] = [by_stem[stem] for stem in whole]
    return {ours: choices for ours, choices in found.items() if choices}


def _by_stem(columns: Sequence[Foreign]) -> Iterator[tuple[str, Foreign]]:
    """Columns by their name without the last letters, which name the axis."""
    for one in columns:
        yield re.sub(r"[a-z]{1,5}$", "", one.words).strip(" _-."), one


def _likelihood(one: Foreign) -> int:
    """Order in which columns of the same meaning are tried."""
    return bool(COMMANDED.search(one.words)) - bool(MEASURED.search(one.words))


def joints_by_name(
    columns: Sequence[Foreign], joints: Collection[str]
) -> dict[str, Foreign]:
    """Columns that are called like joints of the robot, but for case and signs."""
    by_name = {one.name: one for one in columns}
    plain = {_plain(one.words): one for one in columns}
    found = {joint: by_name.get(joint, plain.get(_plain(joint))) for joint in joints}
    return {joint: one for joint, one in found.items() if one is not None}


def _plain(text: str) -> str:
    return re.sub(r"[^a-z0-9]", "", text.lower())


def numbered(columns: Sequence[Foreign]) -> list[list[Foreign]]:
    """Families of columns with the same name and numbers one after the other.

    Those whose name is that of joints come first, then measured before commanded ones.
    """
    families = dict[str, dict[int, Foreign]]()
    for one in columns:
        match = NUMBERED.match(one.words)
        if match and one.column.numbers.size:
            families.setdefault(match[1].strip(" _-."), {})[int(match[2])] = one
    whole = [
        (stem, [family[k] for k in sorted(family)])
        for stem, family in families.items()
        if len(family) > 1 and max(family) - min(family) == len(family) - 1
    ]

    def order(item: tuple[str, list[Foreign]]) -> tuple[bool, int]:
        stem, family = item
        word = re.split(r"[ _.\-]", stem)[-1] if stem else ""
        return not JOINTED.fullmatch(word), _likelihood(family[0])

    return [family for _, family in sorted(whole, key=order)]
