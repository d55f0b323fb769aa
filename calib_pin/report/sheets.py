"""Sheets of paper: what stands where on them, and how they become a PDF.

Everything is placed first, in points from the upper left corner, and then drawn. So the
number of sheets is known to each of them, and tests see that nothing overlaps.
"""

from __future__ import annotations

import logging
import warnings
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import UTC, datetime
from functools import cache, lru_cache
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Literal

from calib_pin.errors import OptionError, printable

if TYPE_CHECKING:
    from fpdf import FPDF

WIDTH, HEIGHT = 595.28, 841.89
"""Size of a sheet, A4 [pt]."""

LEFT, RIGHT = 42.0, WIDTH - 42.0
TOP, BOTTOM = 62.0, HEIGHT - 56.0
"""Edges of what stands between the running header and the number of the sheet."""

LEADING = 1.36
"""Distance of lines in sizes of the font."""

Face = Literal["", "B", "M"]
"""Plain, bold, or of equal width."""

FACES: dict[Face, str] = {
    "": "DejaVuSans.ttf",
    "B": "DejaVuSans-Bold.ttf",
    "M": "DejaVuSansMono.ttf",
}

_FAMILY: dict[Face, tuple[str, Literal["", "B"]]] = {
    "": ("sans", ""),
    "B": ("sans", "B"),
    "M": ("mono", ""),
}

INK, MUTED, GRID, CARD = "#1f2328", "#5a626c", "#d8dce1", "#f3f5f7"

MISSING = "a PDF needs fpdf2, which is missing: pip install 'calib-pin[pdf]'"


@dataclass(frozen=True)
class Words:
    """Letters on one line.

    Attributes:
        x: Left end [pt].
        y: Line on which they stand [pt].
        width: Their width [pt].
        text: The letters.
        size: Size of the font [pt].
        face: Face of the font.
        color: Color, hexadecimal.
    """

    x: float
    y: float
    width: float
    text: str
    size: float
    face: Face
    color: str


@dataclass(frozen=True)
class Area:
    """A filled rectangle, or a rule if it is thin; upper left corner first [pt]."""

    x: float
    y: float
    width: float
    height: float
    color: str


@dataclass(frozen=True)
class Picture:
    """A PNG file, scaled to a rectangle [pt]."""

    x: float
    y: float
    width: float
    height: float
    png: bytes = field(repr=False)


Item = Words | Area | Picture


class Sheets:
    """Sheets that fill from above.

    Attributes:
        sheets: What stands on each of them.
        y: Upper edge of what is still free on the last one [pt].
    """

    def __init__(self) -> None:
        """One empty sheet."""
        self.sheets: list[list[Item]] = [[]]
        self.y = TOP

    @property
    def room(self) -> float:
        """Height that is left [pt]."""
        return BOTTOM - self.y

    def need(self, height: float) -> bool:
        """Turn to a new sheet unless there is this much room; whether it was."""
        if height <= self.room or self.y == TOP:
            return False
        self.turn()
        return True

    def turn(self) -> None:
        """Begin a new sheet."""
        self.sheets.append([])
        self.y = TOP

    def area(self, x: float, y: float, width: float, height: float, color: str) -> None:
        """Fill a rectangle; what is placed later stands on it."""
        self.sheets[-1].append(Area(x, y, width, height, color))

    def picture(self, x: float, width: float, height: float, png: bytes) -> None:
        """A picture at the upper edge."""
        self.sheets[-1].append(Picture(x, self.y, width, height, png))

    def write(
        self,
        text: str,
        x: float,
        size: float,
        face: Face = "",
        color: str = INK,
        right: float | None = None,
        down: float = 0.0,
    ) -> None:
        """Letters in the line at the upper edge.

        Args:
            text: The letters; nothing is broken.
            x: Left end [pt].
            size: Size of the font [pt].
            face: Face of the font.
            color: Color, hexadecimal.
            right: Right end, instead of the left one [pt].
            down: Distance of the line from the upper edge [pt].
        """
        width = width_of(text, size, face)
        x = x if right is None else right - width
        y = self.y + down + size
        self.sheets[-1].append(Words(x, y, width, text, size, face, color))

    def paragraph(
        self,
        text: str,
        size: float,
        face: Face = "",
        color: str = INK,
        *,
        left: float = LEFT,
        right: float = RIGHT,
    ) -> None:
        """Lines below each other, on as many sheets as it takes."""
        for line in broken(text, right - left, size, face):
            self.need(LEADING * size)
            self.write(line, left, size, face, color)
            self.y += LEADING * size

    def pdf(self, title: str, day: str) -> bytes:
        """The file: the same sheets and the same day are the same bytes.

        Args:
            title: Title of the document.
            day: Its date, year-month-day.
        """
        with _quiet():
            document = _document()
            document.set_title(printable(title))
            document.set_creator("calib-pin")
            document.set_producer("calib-pin")
            document.set_creation_date(datetime.fromisoformat(day).replace(tzinfo=UTC))
            for sheet in self.sheets:
                document.add_page()
                for item in sheet:
                    _draw(document, item)
            return bytes(document.output())


def require_pdf() -> None:
    """Complain if PDF cannot be written.

    Raises:
        OptionError: If the extra is missing.
    """
    if not can_write_pdf():
        raise OptionError(MISSING)


def can_write_pdf() -> bool:
    """Whether the extra is installed."""
    return find_spec("fpdf") is not None


@lru_cache(1 << 16)
def width_of(text: str, size: float, face: Face = "") -> float:
    """Width of letters on one line [pt]."""
    document = _measure()
    _set_font(document, size, face)
    return float(document.get_string_width(text))


def broken(
    text: str, width: float, size: float, face: Face = "", *, anywhere: bool = False
) -> list[str]:
    """Lines that are no wider than this: broken between words, or within long ones.

    Args:
        text: The words; control characters are written as escapes.
        width: Width that there is [pt].
        size: Size of the font [pt].
        face: Face of the font.
        anywhere: Break within words too where a line is full.
    """
    lines: list[str] = []
    for part in printable(text).split("\n"):
        line = ""
        for word in [part] if anywhere else part.split(" "):
            longer = f"{line} {word}" if line else word
            if width_of(longer, size, face) <= width:
                line = longer
                continue
            if line:
                lines.append(line)
            *full, line = _pieces(word, width, size, face)
            lines += full
        lines.append(line)
    return lines


def _pieces(word: str, width: float, size: float, face: Face) -> list[str]:
    """A word, or its parts if it is wider than a line."""
    pieces = []
    while width_of(word, size, face) > width and len(word) > 1:
        low, high = 1, len(word) - 1
        while low < high:
            middle = (low + high + 1) // 2
            if width_of(word[:middle], size, face) <= width:
                low = middle
            else:
                high = middle - 1
        # Names are read better if they break behind a joint of theirs.
        joints = (
            word.rfind(" ", 0, low) + 1,
            max(word.rfind(sign, 0, low) for sign in "._-/") + 1,
        )
        low = next((joint for joint in joints if joint > low // 2), low)
        pieces.append(word[:low])
        word = word[low:]
    return [*pieces, word]


def fitting(text: str, width: float, size: float, face: Face = "") -> str:
    """Letters that are cut to a width, with an ellipsis where some are missing."""
    text = " ".join(printable(text).split("\n"))
    if width_of(text, size, face) <= width:
        return text
    return _pieces(text, width - width_of("…", size, face), size, face)[0] + "…"


@cache
def _measure() -> FPDF:
    """A document that only knows its fonts."""
    return _document()


def _document() -> FPDF:
    require_pdf()
    import matplotlib
    from fpdf import FPDF

    fonts = Path(matplotlib.get_data_path()) / "fonts" / "ttf"
    with _quiet():
        document = FPDF(unit="pt", format="A4")
        document.set_auto_page_break(False)
        for face, file in FACES.items():
            document.add_font(*_FAMILY[face], fonts / file)
    return document


def _set_font(document: FPDF, size: float, face: Face) -> None:
    document.set_font(*_FAMILY[face], size)


def _draw(document: FPDF, item: Item) -> None:
    if isinstance(item, Picture):
        size = item.width, item.height
        document.image(item.png, item.x, item.y, *size)
        return
    red, green, blue = bytes.fromhex(item.color[1:])
    if isinstance(item, Area):
        document.set_fill_color(red, green, blue)
        document.rect(item.x, item.y, item.width, item.height, style="F")
        return
    _set_font(document, item.size, item.face)
    document.set_text_color(red, green, blue)
    document.text(item.x, item.y, item.text)


@contextmanager
def _quiet() -> Iterator[None]:
    """No remarks of libraries: a letter that the font lacks is drawn as a box."""
    loggers: Sequence[logging.Logger] = [
        logging.getLogger(name) for name in ("fpdf", "fontTools")
    ]
    before = [logger.level for logger in loggers]
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", DeprecationWarning)
        for logger in loggers:
            logger.setLevel(logging.CRITICAL)
        try:
            yield
        finally:
            for logger, level in zip(loggers, before, strict=True):
                logger.setLevel(level)
