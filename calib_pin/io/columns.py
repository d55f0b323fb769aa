"""A column of a table: its cells, the unit of its header, and what it may hold."""

from __future__ import annotations

import re
from collections.abc import Collection, Mapping
from dataclasses import dataclass, field, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import nearest
from calib_pin.observations import BlockKey, Labels
from calib_pin.setup.values import LARGEST_ANGLE, LARGEST_LENGTH
from calib_pin.units import MINUS, steps_of

Floats = NDArray[np.float64]

NAMES = (*BlockKey._fields, "target", "payload", "set")
"""Columns of names; the first tell blocks apart."""

OURS = {"image", "pose", "cycle"}
"""Columns that our commands write for people, or for one another."""


@dataclass(frozen=True)
class Kind:
    """A physical kind of number and the units it may be written in.

    Attributes:
        si: Unit inside calib-pin and where a header states none; empty if pure.
        units: Factor to `si` of each unit, the likelier ones first.
        largest: Largest absolute value that can be meant, in `si`.
        least: Least value that can be meant, in `si`.
    """

    si: str
    units: Mapping[str, float]
    largest: float
    least: float = -np.inf

    def smaller(self, unit: str) -> list[str]:
        """Units that may be meant where a number is too large in another one."""
        factor = self.units.get(unit, 0.0)  # None is smaller than steps of a servo.
        return [other for other, size in self.units.items() if size < factor]


class _Angles(dict[str, float]):
    """Factors of units of angles, those of steps of any size among them."""

    def __contains__(self, unit: object) -> bool:
        return super().__contains__(unit) or bool(steps_of(str(unit)))

    def __missing__(self, unit: str) -> float:
        if (steps := steps_of(unit)) is None:
            raise KeyError(unit)
        return 2.0 * np.pi / steps[0]


_LENGTHS = {"m": 1.0, "mm": 1e-3, "um": 1e-6, "in": 0.0254, "cm": 0.01}
LENGTH = Kind("m", _LENGTHS, LARGEST_LENGTH)
STEPS = "steps/4096"
"""The usual steps of a servo."""

TURNED = 2.2 * np.pi
"""Angles beyond this are in no rad, but in degrees or smaller units [rad]."""

_DEG = np.pi / 180.0
_TURN = 2.0 * np.pi
_ANGLES = {"rad": 1.0, "deg": _DEG, "mrad": 1e-3, "gon": 0.9 * _DEG, "turn": _TURN}
ANGLE = Kind("rad", _Angles(_ANGLES | {STEPS: _TURN / 4096.0}), LARGEST_ANGLE)
PIXEL = Kind("px", {"px": 1.0}, 1e5)
PURE = Kind("", {}, np.inf)

KINDS: Mapping[str, Kind] = {kind.si: kind for kind in (LENGTH, ANGLE, PIXEL)}
"""How numbers of a unit may be written."""


UNITS = {
    "m": ("m", "meter", "meters", "metre", "metres"),
    "mm": ("mm", "millimeter", "millimeters", "millimetre", "millimetres"),
    "cm": ("cm", "centimeter", "centimeters", "centimetre", "centimetres"),
    "um": ("um", "µm", "μm", "micrometer", "micron"),
    "in": ("in", "inch", "inches"),
    "rad": ("rad", "radian", "radians"),
    "deg": ("deg", "degree", "degrees", "°"),
    "px": ("px", "pixel", "pixels"),
    "turn": ("turn", "turns", "rev", "revolution", "revolutions"),
    "s": ("s", "sec", "second", "seconds"),
    "degC": ("degc", "°c", "celsius"),
}
"""Ways of writing units. Others of angles have one."""


GRAD = "grad"
"""A German degree, elsewhere a gon: no header of ours has it."""


def unit_called(text: str) -> str | None:
    """The unit of ours that is written so; None for other texts."""
    text = text.strip().lower()
    if text in ANGLE.units:
        return text
    return next((unit for unit, texts in UNITS.items() if text in texts), None)


def kind_of_unit(unit: str | None) -> Kind:
    """The kind of numbers in a unit; a pure one where the unit is none of ours."""
    return next((kind for kind in KINDS.values() if unit in kind.units), PURE)


COUNTERS = {1023: "steps/1228.8@512", 4095: STEPS}
"""Units of servos by the largest position that they count: those of 10 bits turn by 300
degrees (Dynamixel AX), those of 12 bits by a whole turn."""


def counted(numbers: Floats) -> str:
    """The unit of joints that servos have counted, shape (N,); empty for others.

    Whole numbers that are none of degrees, for half of them are beyond a turn.
    """
    numbers = numbers[np.isfinite(numbers)]
    whole = not (numbers % 1.0).any() and numbers.min(initial=0.0) >= 0.0
    if not len(numbers) or not whole or np.median(numbers) <= 360.0:
        return ""
    return next((unit for top, unit in COUNTERS.items() if numbers.max() <= top), "")


HUGE, BEYOND = 1e9, 1e20
"""Numbers from here on are none of a length or an angle, in any unit; and are none at
all, as trackers write them."""

NO_READING = "the reading is missing"

MISSING = re.compile(
    r"[-*?]*|#.*|n\W?a\W?|null|none|[-+]?\.?(?:nan|inf(?:inity)?)(?:\(.*\))?|[-+]?1\.#.*"
    r"|(?:.*\W)?(?:missing|lost|no|not|out of|invalid|blocked|failed)(?:\W.*)?",
    re.IGNORECASE,
)
"""Trimmed texts of cells that have no reading, as spreadsheets (`#N/A`, `#DIV/0!`),
printf of Windows (`1.#QNAN`, `-nan(ind)`) and trackers (`no target`) write them."""

THOUSANDS = re.compile(
    rf"[-+{MINUS}]?\d{{1,3}}(?:([.,'\u2019_\s])\d{{3}})(?:\1\d{{3}})*(?:[.,]\d*)?"
)
"""Numbers that may have signs between thousands."""

COMMA = re.compile(rf"\s*[-+{MINUS}]?(\d+,\d*|,\d+)([eE][-+{MINUS}]?\d+)?\s*")
"""Numbers with a decimal comma."""


@dataclass(frozen=True)
class Column:
    """One column as it was written.

    Attributes:
        header: Header cell, with its unit.
        unit: Unit in square brackets, or None.
        numbers: Number in each row, shape (N,); not finite where there is none.
        words: Untrimmed texts of cells, each once; some may not occur.
        codes: Position among these of the text of each cell, shape (N,); -1 for a
            number in a column of no names; of shape (0,) where all are such.
        theirs: Its name in the file; empty where the file has no such column.
    """

    header: str
    unit: str | None
    numbers: Floats
    words: tuple[str, ...] = ()
    codes: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    theirs: str = ""

    def rows(self, index: NDArray[np.int64] | slice) -> Column:
        """Some of the rows, in this order."""
        codes = self.codes[index] if self.words else self.codes
        return replace(self, numbers=self.numbers[index], codes=codes)

    def text(self, row: int) -> str:
        """Trimmed text of a cell, or its number."""
        if self.words and self.codes[row] >= 0:
            return self.words[int(self.codes[row])].strip()
        number = float(self.numbers[row])
        return "" if np.isnan(number) else repr(number).removesuffix(".0")

    def texts(self) -> Labels:
        """Texts of the cells, untrimmed where they are known, N strings."""
        if self.words and (self.codes >= 0).all():
            return Labels(self.words, self.codes)
        return Labels.of([self.text(row) for row in range(len(self.numbers))])

    def missing(self) -> NDArray[np.bool_]:
        """Whether each cell is blank or says that it has no reading, shape (N,)."""
        lost: NDArray[np.bool_] = self.numbers == self.sentinel
        if not self.words:
            return lost | np.isnan(self.numbers)
        blank = [bool(MISSING.fullmatch(word.strip())) for word in self.words]
        # The last entry is that of the code -1.
        lost |= np.array([*blank, False])[self.codes]
        return lost | (np.isnan(self.numbers) & (self.codes < 0))

    def fault(self, row: int) -> str:
        """The reason why a cell is no finite number."""
        cell, reason = self.text(row), "not a number"
        if MISSING.fullmatch(cell):
            return NO_READING if cell else "the cell is empty"
        if not np.isnan(self.numbers[row]):
            return "not a finite number"
        if THOUSANDS.fullmatch(cell):
            return f"{reason} (thousands are not to be separated)"
        comma = " (between commas the decimal mark must be a point)"
        return reason + comma * bool(COMMA.fullmatch(cell))

    @property
    def sentinel(self) -> float:
        """A number that stands for no reading, or else one that is not a number.

        It is of nines, or huge, far larger than all others, and in several rows; in one
        it is beyond all that can be measured.
        """
        size = np.where(np.isfinite(self.numbers), np.abs(self.numbers), -1.0)
        largest = size.max(initial=0.0)
        rows = np.flatnonzero(size == largest)
        others = np.delete(size, rows).max(initial=-1.0)
        several = len(rows) > 1 or largest >= BEYOND
        far = several and 0.0 <= 2.0 * others < largest
        nines = {*f"{largest:.6f}".rstrip("0").replace(".", "")} == {"9"}
        return self.numbers[rows[0]] if far and (nines or largest >= HUGE) else np.nan

    @property
    def numeric(self) -> bool:
        """Whether it is one of numbers: most of its cells that are not missing."""
        count = np.count_nonzero(np.isfinite(self.numbers))
        return bool(2 * count > len(self.numbers) - np.count_nonzero(self.missing()))


ELSEWHERE = "; 'calib-pin init' finds columns with other names"
"""The advice where a file says it in its own way."""


def closest(name: str, candidates: Collection[str]) -> str:
    """Hint at the one column that may have been meant by a missing name.

    A column that continues the name with something other than a letter or digit
    (`x (mm)`, `elbow_joint_deg`) is near, whatever its length. With several near
    columns a guess would mislead.

    Args:
        name: The missing name.
        candidates: Columns without another meaning.

    Returns:
        A hint with a leading space, or an empty string.
    """
    begins = re.compile(rf"{re.escape(name)}(?![^\W_])", re.IGNORECASE)
    near = [other for other in candidates if begins.match(other)]
    near = near or [other for other in candidates if nearest(name, [other])]
    return f" (did you mean '{near[0]}'?)" if len(near) == 1 else ""


def split_header(cell: str) -> tuple[str, str | None]:
    """Split a header cell into name and unit; None where no unit is stated.

    Units are spelled as calib-pin does, where it has them.

    Examples:
        >>> split_header("x [mm]"), split_header("q[0] [°]"), split_header("q[0]")
        (('x', 'mm'), ('q[0]', 'deg'), ('q[0]', None))
    """
    text = cell.strip()
    name, mark, unit = text.removesuffix("]").rpartition("[")
    # A number in brackets counts the elements of a list.
    has_unit = mark and text.endswith("]") and "]" not in unit and not unit.isdecimal()
    if not has_unit:
        return text, None
    return name.rstrip(), unit_called(unit) or unit.strip() or None
