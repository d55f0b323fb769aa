"""Columns of CSV files: what they hold, what they may hold, and their headers."""

from __future__ import annotations

import re
from array import array
from collections import defaultdict
from collections.abc import Callable, Collection, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import compress, count

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import nearest
from calib_pin.setup.values import LARGEST_ANGLE, LARGEST_LENGTH
from calib_pin.units import as_number


def read_numbers(cells: Sequence[str]) -> NDArray[np.float64]:
    """The numbers in some cells, to the last bit as Python's `float` has them.

    Args:
        cells: Untrimmed text, N strings.

    Returns:
        The numbers, shape (N,); infinite or not-a-number where a cell says so or holds
        none.
    """
    if (numbers := _decimals(cells, len(cells))) is not None:
        return numbers
    text = "".join(cells)
    if text.isascii() and "_" not in text:
        with suppress(ValueError):
            return np.fromiter(map(float, cells), np.float64, len(cells))
    known = {cell: _number(cell) for cell in set(cells)}
    return np.array([known[cell] for cell in cells])


def read_lines(lines: Sequence[str], width: int) -> NDArray[np.float64] | None:
    """The numbers in lines of cells between commas, as `read_numbers` has them.

    Args:
        lines: Lines, N strings.
        width: Cells in each.

    Returns:
        The numbers by column, shape (width, N); None unless all cells are decimal
        fractions, which are read three times as fast at once.
    """
    if {line.count(",") for line in lines} != {width - 1}:
        return None
    numbers = _decimals(lines, len(lines) * width)
    if numbers is None or not np.isfinite(numbers).all():
        return None
    return numbers.reshape(-1, width).T


def _decimals(cells: Sequence[str], count: int) -> NDArray[np.float64] | None:
    """The numbers of so many cells, shape (count,), where all are decimal fractions."""
    # Importing it takes time, and most of the commands have done so before.
    from pydantic_core import from_json

    # A JSON reader is four times faster than `float` with all digits of a number, and
    # rounds to the nearest number as well. What it reads as anything but a decimal
    # fraction is not left to it (JSON's integers have no -0).
    with suppress(ValueError):
        numbers = from_json(f"[{','.join(cells)}]", allow_inf_nan=False)
        if len(numbers) == count and set(map(type, numbers)) == {float}:
            return np.array(numbers)
    return None


def with_points(cells: Sequence[str]) -> list[str]:
    """Cells whose numbers have a decimal comma, with a point instead."""
    return [
        cell.replace(",", ".") if "," in cell and _COMMA.fullmatch(cell) else cell
        for cell in cells
    ]


def what_is_wrong(cell: str, value: float) -> str:
    """The reason why a cell cannot be used.

    Args:
        cell: Its trimmed text.
        value: The number in it, as `read_numbers` reads it.
    """
    if cell.lower() in MISSING:
        return NO_READING if cell else "the cell is empty"
    if np.isfinite(value):
        return "not positive"
    if np.isinf(value):
        return "not a finite number"
    if THOUSANDS.fullmatch(cell):
        return "not a number (thousands are not to be separated)"
    if _COMMA.fullmatch(cell):
        return "not a number (between commas the decimal mark must be a point)"
    return "not a number"


HUGE = 1e9
"""Numbers from here on are none of a length or an angle, in any unit."""

NO_READING = "the reading is missing"

MISSING = frozenset(
    ["", "nan", "n/a", "na", "#n/a", "missing", "null", "none", "*", "-", "--", "?"]
)
"""Texts of cells that have no reading, in any case."""

THOUSANDS = re.compile(r"[+-]?\d{1,3}(?:([.,' ])\d{3})(?:\1\d{3})*(?:[.,]\d*)?")
"""Numbers that may have signs between thousands."""

_COMMA = re.compile(r"\s*[+-]?(\d+,\d*|,\d+)([eE][+-]?\d+)?\s*")


def _number(cell: str) -> float:
    number = as_number(cell.strip())
    return float("nan") if number is None else number


Floats = NDArray[np.float64]


@dataclass(frozen=True)
class Kind:
    """A physical kind of number and the units it may be written in.

    Attributes:
        si: Unit inside calib-pin and where a header states none; empty if pure.
        units: Factor to `si` of each unit.
        smaller: The unit that is likely meant when a value is far too large in another.
        largest: Largest absolute value that can be meant, in `si`.
    """

    si: str
    units: Mapping[str, float]
    smaller: Mapping[str, str]
    largest: float


LENGTH = Kind(
    "m",
    {"m": 1.0, "mm": 1e-3, "um": 1e-6, "in": 0.0254},
    {"m": "mm", "in": "mm", "mm": "um"},
    LARGEST_LENGTH,
)
ANGLE = Kind(
    "rad",
    {"rad": 1.0, "deg": np.pi / 180.0, "mrad": 1e-3, "gon": np.pi / 200.0},
    {"rad": "deg", "deg": "mrad"},
    LARGEST_ANGLE,
)
PIXEL = Kind("px", {"px": 1.0}, {}, 1e5)
PURE = Kind("", {}, {}, np.inf)


@dataclass(frozen=True)
class Column:
    """One column as it was written.

    Attributes:
        header: Header cell, with its unit.
        unit: Unit in square brackets, or None.
        place: Number of columns before it in the file.
        numbers: Number in each row, shape (N,); not finite where there is none.
        words: Untrimmed texts of the cells that hold no finite number, each once.
        codes: Position among these of the text of each cell, shape (N,); -1 in rows
            with a number, of shape (0,) where all rows have one.
    """

    header: str
    unit: str | None
    place: int
    numbers: Floats
    words: tuple[str, ...]
    codes: NDArray[np.int64]

    def rows(self, index: NDArray[np.int64] | slice) -> Column:
        """Some of the rows, in this order."""
        codes = self.codes[index] if self.words else self.codes
        return replace(self, numbers=self.numbers[index], codes=codes)

    def blank(self) -> NDArray[np.bool_]:
        """Whether each cell is blank, shape (N,)."""
        return self._holds(lambda word: not word.strip())

    def missing(self) -> NDArray[np.bool_]:
        """Whether each cell says that there is no reading, shape (N,)."""
        return self._holds(lambda word: word.strip().lower() in MISSING)

    @property
    def sentinel(self) -> float | None:
        """A number that stands for no reading: nines, or huge, in several rows."""
        values, counts = np.unique(np.abs(self.numbers), return_counts=True)
        values, counts = values[np.isfinite(values)], counts[np.isfinite(values)]
        if len(values) < 2 or counts[-1] < 2 or values[-1] < 2.0 * values[-2]:
            return None
        nines = {*f"{values[-1]:.6f}".rstrip("0").replace(".", "")} == {"9"}
        far = self.numbers[np.argmax(np.abs(self.numbers) == values[-1])]
        return float(far) if nines or values[-1] >= HUGE else None

    @property
    def numeric(self) -> bool:
        """Whether it is one of numbers: most of its cells that are not missing."""
        found = np.count_nonzero(np.isfinite(self.numbers))
        return bool(2 * found > len(self.numbers) - np.count_nonzero(self.missing()))

    def _holds(self, matches: Callable[[str], bool]) -> NDArray[np.bool_]:
        if not self.words:
            return np.zeros(len(self.numbers), bool)
        # The last entry is that of the code -1.
        return np.array([*map(matches, self.words), False])[self.codes]


class GrowingColumn:
    """Numbers and words of a column, see `Column`, while the file is read.

    Attributes:
        numbers: The numbers so far.
        marks: Decimal marks of the numbers, of a file in which commas may be some: the
            first row with each.
        thousands: Whether each point in them may be one that separates thousands.
    """

    def __init__(self) -> None:
        """A column without rows."""
        self.numbers = array("d")
        self.marks = dict[str, int]()
        self.thousands = True
        self._codes, self._words = array("q"), Numbering()

    def extend(self, cells: Sequence[str], *, commas: bool = False) -> None:
        """Add rows.

        Args:
            cells: Their untrimmed texts.
            commas: Whether a decimal mark may be a comma.
        """
        numbers = read_numbers(with_points(cells) if commas else cells)
        finite = np.isfinite(numbers)
        for row, cell in enumerate(cells) if commas else ():
            for mark in ",.":
                if mark in cell and finite[row]:
                    self.marks.setdefault(mark, len(self.numbers) + row)
                    self.thousands &= bool(THOUSANDS.fullmatch(cell.strip()))
        self.add(numbers, list(compress(cells, ~finite)))

    def add(self, numbers: Floats, words: Sequence[str]) -> None:
        """Add rows that were no text.

        Args:
            numbers: Their numbers.
            words: Texts of those that are not finite.
        """
        if words or self._words.known:
            codes = np.full(len(numbers), -1)
            codes[~np.isfinite(numbers)] = self._words.of(words)
            missing = len(self.numbers) - len(self._codes)
            self._codes.extend(array("q", [-1]) * missing)
            self._codes.frombytes(codes.tobytes())
        self.numbers.frombytes(numbers.tobytes())

    def grown(self, header: str, unit: str | None, place: int) -> Column:
        """The column; see its attributes."""
        numbers = np.frombuffer(self.numbers)
        numbers.setflags(write=False)
        codes = np.frombuffer(self._codes, np.int64)
        return Column(header, unit, place, numbers, tuple(self._words.known), codes)


class Numbering:
    """Numbers of texts in the order in which they come.

    Attributes:
        known: Number of each text; asked for a new one, it gets the next number.
    """

    def __init__(self) -> None:
        """No texts yet."""
        self.known = defaultdict[str, int](count().__next__)

    def of(self, cells: Sequence[str]) -> NDArray[np.int64]:
        """The number of each of some texts, shape (N,)."""
        return np.fromiter(map(self.known.__getitem__, cells), np.int64, len(cells))


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
    near = [
        other
        for other in candidates
        if other.lower().startswith(name.lower())
        and not other[len(name) : len(name) + 1].isalnum()
    ]
    near = near or [other for other in candidates if nearest(name, [other])]
    return f" (did you mean '{near[0]}'?)" if len(near) == 1 else ""


def split_header(cell: str) -> tuple[str, str | None]:
    """Split a header cell into name and unit; None where no unit is stated.

    Examples:
        >>> split_header("x [mm]"), split_header("q[0] [deg]"), split_header("q[0]")
        (('x', 'mm'), ('q[0]', 'deg'), ('q[0]', None))
    """
    text = cell.strip()
    name, mark, unit = text.removesuffix("]").rpartition("[")
    # A number in brackets counts the elements of a list.
    stated = mark and text.endswith("]") and "]" not in unit and not unit.isdecimal()
    return (name.rstrip(), unit.strip()) if stated else (text, None)
