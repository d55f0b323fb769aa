"""Reports as PDF: a first page for the customer, and the tables as an annex.

Like `terminal` and `html` it only lays out the blocks, so the numbers are the same.
"""

from __future__ import annotations

import io
from collections.abc import Iterable, Sequence

from matplotlib.image import imread

from calib_pin.report.blocks import Block, Code, Line, Names, Table, Tone
from calib_pin.report.cover import Cover
from calib_pin.report.figures import Drawn
from calib_pin.report.figures.canvas import AFTER, BEFORE
from calib_pin.report.sheets import (
    BOTTOM,
    CARD,
    GRID,
    HEIGHT,
    INK,
    LEADING,
    LEFT,
    MUTED,
    RIGHT,
    TOP,
    Area,
    Face,
    Sheets,
    broken,
    fitting,
    width_of,
)
from calib_pin.report.table_sheets import set_table
from calib_pin.report.tiles import Tile

COLORS: dict[Tone, str] = {
    "plain": INK,
    "good": "#0b6b4f",
    "bad": "#a8200d",
    "strong": "#7a4f00",
    "note": MUTED,
}

PAPERS: dict[Tone, str] = {
    "good": "#e3f4ee",
    "bad": "#fdeae6",
    "strong": "#fdf3df",
}
"""Colors behind a verdict."""

SIZE, SMALL, RUNNING = 9.0, 8.0, 7.5
"""Sizes of the font: text, remarks, and what stands on every sheet [pt]."""

INDENT = 12.0
FACTS = 0.3
"""Largest part of the width that names of facts take."""

SIGNED = 86.0
"""Height of the room for a signature [pt]."""

SENTENCES = 6
"""Lines of the verdict's sentences on the first page; the annex has all of them."""

LEAST = 200.0
"""Least height that a picture and its words need [pt]."""

LARGE, CARDS = 12.5, 3
"""Size of the headline [pt], and its cards side by side."""


def pdf_report(cover: Cover, blocks: Iterable[Block]) -> bytes:
    """The PDF of a report; the same report of the same day is the same bytes.

    Args:
        cover: The first page.
        blocks: The report, for the annex.

    Raises:
        OptionError: If the extra is missing.
    """
    return laid_out(cover, blocks).pdf(f"{cover.title}: {cover.robot}", cover.day)


def laid_out(cover: Cover, blocks: Iterable[Block]) -> Sheets:
    """The sheets of a report."""
    sheets = Sheets()
    _first(sheets, cover)
    sheets.turn()
    sheets.write("Annex: statistics", LEFT, 14.0, "B")
    sheets.y += 26.0
    for block in blocks:
        _set(sheets, block)
    _running(sheets, cover)
    return sheets


def _first(sheets: Sheets, cover: Cover) -> None:
    sheets.write(cover.title, LEFT, 22.0, "B")
    sheets.y += 38.0
    _verdict(sheets, cover)
    _entries(sheets, cover)
    if cover.headline:
        _headline(sheets, cover)
    else:
        set_table(sheets, cover.numbers, 8.0, titled=False)
    foot = BOTTOM - SIGNED
    if cover.remark:
        lines = broken(cover.remark, RIGHT - LEFT, RUNNING)
        foot -= LEADING * RUNNING * len(lines) + 6.0
    rest = list(cover.figures)
    if rest and _picture(sheets, rest[0], foot - sheets.y - 12.0):
        del rest[0]
    sheets.y = foot
    if cover.remark:
        sheets.paragraph(cover.remark, RUNNING, color=MUTED)
    _signature(sheets)
    _pictures(sheets, rest)


def _verdict(sheets: Sheets, cover: Cover) -> None:
    """The verdict in large letters, and its sentences, on paper of its color."""
    inner, top = LEFT + 14.0, sheets.y
    lines = [
        (line, text)
        for line in cover.said
        for text in broken(line.text, RIGHT - 14.0 - inner, SIZE, _face(line))
    ]
    if len(lines) > SENTENCES:
        lines = lines[:SENTENCES]
        lines.append((Line("", "note"), "All of it stands in the annex."))
    height = 46.0 + LEADING * SIZE * len(lines) + (6.0 if lines else 0.0)
    sheets.area(LEFT, top, RIGHT - LEFT, height, PAPERS.get(cover.tone, CARD))
    sheets.area(LEFT, top, 4.0, height, COLORS[cover.tone])
    status = fitting(cover.status, RIGHT - 14.0 - inner, 24.0, "B")
    sheets.write(status, inner, 24.0, "B", COLORS[cover.tone], down=9.0)
    sheets.y += 44.0
    for line, text in lines:
        sheets.write(text, inner, SIZE, _face(line), COLORS[line.tone])
        sheets.y += LEADING * SIZE
    sheets.y = top + height + 16.0


def _entries(sheets: Sheets, cover: Cover) -> None:
    """The facts in two columns; what is not known is a line to write on."""
    count = (len(cover.facts) + 1) // 2
    width = (RIGHT - LEFT - 24.0) / 2
    top, lowest = sheets.y, sheets.y
    for k, column in enumerate((cover.facts[:count], cover.facts[count:])):
        sheets.y, left = top, LEFT + k * (width + 24.0)
        for name, value in column:
            sheets.write(name, left, SMALL, color=MUTED, down=1.0)
            start = left + 82.0
            lines = broken(value, left + width - start, SIZE) if value else []
            for line in lines:
                sheets.write(line, start, SIZE)
                sheets.y += LEADING * SIZE
            if not lines:
                sheets.area(start, sheets.y + 11.5, left + width - start, 0.6, MUTED)
                sheets.y += LEADING * SIZE
            sheets.y += 4.0
        lowest = max(lowest, sheets.y)
    sheets.y = lowest + 10.0


def _headline(sheets: Sheets, cover: Cover) -> None:
    """The key numbers on cards side by side; pale if they must not be trusted."""
    headline, count = cover.headline, min(len(cover.headline), CARDS)
    colors = (MUTED, MUTED) if cover.tone == "bad" else (BEFORE, AFTER)
    width = (RIGHT - LEFT - (count - 1) * INDENT) / count
    for first in range(0, len(headline), count):
        top, lowest = sheets.y, sheets.y
        row = headline[first : first + count]
        lefts = [LEFT + k * (width + INDENT) for k in range(len(row))]
        ground = len(sheets.sheets[-1])
        for tile, left in zip(row, lefts, strict=True):
            sheets.y = top + 6.0
            _card(sheets, tile, left + 8.0, left + width - 8.0, colors)
            lowest = max(lowest, sheets.y + 5.0)
        # The cards are as high as the highest, and below what stands on them.
        cards = [Area(left, top, width, lowest - top, CARD) for left in lefts]
        sheets.sheets[-1][ground:ground] = cards
        sheets.y = lowest + 8.0


def _card(
    sheets: Sheets, tile: Tile, left: float, right: float, colors: tuple[str, str]
) -> None:
    """Sizes before and after, their change, and remarks around them."""
    sheets.paragraph(tile.label, RUNNING, color=MUTED, left=left, right=right)
    for step in tile.steps:
        at = left
        change = f"{tile.unit} ({step.change})" if step.change else tile.unit
        for text, size, color in (
            (step.before.text, LARGE, colors[0]),
            ("→", SMALL, MUTED),
            (step.after.text, LARGE, colors[1]),
            (change, SMALL, MUTED),
        ):
            face: Face = "B" if size == LARGE else ""
            width = width_of(text, size, face)
            if at + width > right and at > left:
                sheets.y += LEADING * LARGE
                at = left
            sheets.write(text, at, size, face, color, down=LARGE - size)
            at += width + 4.0
        sheets.y += LEADING * LARGE
        if step.name:
            sheets.paragraph(step.name, RUNNING, color=MUTED, left=left, right=right)
    sheets.paragraph(tile.remark, RUNNING, color=MUTED, left=left, right=right)


def _pictures(sheets: Sheets, figures: Sequence[Drawn]) -> None:
    """The pictures that have no room on the first sheet, on others behind it."""
    for figure in figures:
        if figure is figures[0] or not _picture(sheets, figure, sheets.room):
            sheets.turn()
            _picture(sheets, figure, sheets.room)


def _picture(sheets: Sheets, figure: Drawn, height: float) -> bool:
    """A picture, its title and words, if there is room; whether there was."""
    if height < LEAST:
        return False
    sheets.y += 12.0
    sheets.write(figure.title, LEFT, SIZE, "B")
    sheets.y += 16.0
    png = figure.bare("png")
    down, across = imread(io.BytesIO(png)).shape[:2]
    reading = broken(figure.reading, RIGHT - LEFT, RUNNING)
    below = LEADING * RUNNING * len(reading)
    scale = min((RIGHT - LEFT) / across, (height - 28.0 - below) / down)
    width = scale * across
    sheets.picture((LEFT + RIGHT - width) / 2, width, scale * down, png)
    sheets.y += scale * down + 4.0
    for line in reading:
        sheets.write(line, LEFT, RUNNING, color=MUTED)
        sheets.y += LEADING * RUNNING
    return True


def _signature(sheets: Sheets) -> None:
    """Lines for name, date and signature."""
    sheets.y = BOTTOM - 26.0
    for name, left, right in (
        ("name", LEFT, LEFT + 190.0),
        ("date", LEFT + 206.0, LEFT + 296.0),
        ("signature", LEFT + 312.0, RIGHT),
    ):
        sheets.area(left, sheets.y, right - left, 0.6, INK)
        sheets.write(name, left, RUNNING, color=MUTED, down=4.0)


def _running(sheets: Sheets, cover: Cover) -> None:
    """Robot, serial number, date and number of each sheet."""
    serial = cover.entries.serial_number
    half = 0.42 * (RIGHT - LEFT)
    robot = fitting(cover.robot, half, RUNNING)
    number = fitting(f"serial number {serial or 'not stated'}", half, RUNNING)
    for k, sheet in enumerate(sheets.sheets):
        page = Sheets()
        page.y = 30.0
        page.write(robot, LEFT, RUNNING, color=MUTED)
        middle = LEFT + width_of(robot, RUNNING) + 14.0
        page.write(number, middle, RUNNING, color=MUTED)
        page.write(cover.day, 0.0, RUNNING, color=MUTED, right=RIGHT)
        page.area(LEFT, 44.0, RIGHT - LEFT, 0.5, GRID)
        page.y = HEIGHT - 40.0
        page.write(f"{cover.title}, made by {cover.made}", LEFT, RUNNING, color=MUTED)
        told = f"{k + 1} / {len(sheets.sheets)}"
        page.write(told, 0.0, RUNNING, color=MUTED, right=RIGHT)
        sheet += page.sheets[0]


def _set(sheets: Sheets, block: Block) -> None:
    """Place a block; a heading is never the last thing on a sheet."""
    if isinstance(block, Line):
        size = SMALL if block.tone == "note" else SIZE
        left = LEFT + (INDENT if block.indent else 0.0)
        lines = broken(block.text, RIGHT - left, size, _face(block))
        sheets.need(LEADING * size * min(len(lines), 3))
        for line in lines:
            sheets.need(LEADING * size)
            sheets.write(line, left, size, _face(block), COLORS[block.tone])
            sheets.y += LEADING * size
        sheets.y += 3.0
        return
    if sheets.y > TOP:
        sheets.y += 8.0
    if isinstance(block, Table):
        set_table(sheets, block, SMALL)
    else:
        sheets.need(60.0)
        if block.title:
            sheets.paragraph(block.title, SIZE, "B")
            sheets.y += 2.0
        if isinstance(block, Code):
            _code(sheets, block)
        elif isinstance(block, Names):
            for entry in block.entries:
                sheets.paragraph(entry, SMALL, left=LEFT + INDENT)
        else:
            _facts(sheets, block.entries)
    sheets.y += 8.0


def _code(sheets: Sheets, block: Code) -> None:
    for line in broken(
        block.text, RIGHT - LEFT - 2 * INDENT, SMALL, "M", anywhere=True
    ):
        sheets.need(LEADING * SMALL)
        sheets.area(LEFT, sheets.y, RIGHT - LEFT, LEADING * SMALL, CARD)
        sheets.write(line, LEFT + INDENT, SMALL, "M")
        sheets.y += LEADING * SMALL


def _facts(sheets: Sheets, entries: Iterable[tuple[str, str]]) -> None:
    entries = list(entries)
    widest = max((width_of(name, SMALL) for name, _ in entries), default=0.0)
    width = min(widest, FACTS * (RIGHT - LEFT)) + 1.0
    start = LEFT + INDENT + width + INDENT
    for name, value in entries:
        names = broken(name, width, SMALL)
        values = broken(value, RIGHT - start, SMALL)
        for k in range(max(len(names), len(values))):
            sheets.need(LEADING * SMALL)
            if k < len(names):
                sheets.write(names[k], LEFT + INDENT, SMALL, color=MUTED)
            if k < len(values):
                sheets.write(values[k], start, SMALL)
            sheets.y += LEADING * SMALL


def _face(line: Line) -> Face:
    return "B" if line.tone in ("good", "bad", "strong") else ""
