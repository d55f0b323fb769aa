"""Tables on sheets: as wide as they are, smaller, broken or halved, but never cut."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

from calib_pin.errors import printable
from calib_pin.report.blocks import Cell, Column, Table
from calib_pin.report.sheets import (
    BOTTOM,
    GRID,
    INK,
    LEADING,
    LEFT,
    MUTED,
    RIGHT,
    TOP,
    Face,
    Sheets,
    broken,
    width_of,
)

GAP, WIDEST_GAP = 9.0, 26.0
"""Distance of columns: the least, and the largest one [pt]."""

SMALLEST = 6.0
"""Smallest font [pt]."""

STEP = 0.5

HEADING = 58.0
"""Width up to which a heading is not broken [pt]."""

NARROWEST = 70.0
"""Width to which columns of names and remarks may shrink before the font does [pt]."""

SPACE = 2.0
"""Room above and below the letters of a row [pt]."""


def set_table(
    sheets: Sheets, table: Table, size: float, *, titled: bool = True
) -> None:
    """Place a table, with its headings again on every sheet.

    Args:
        sheets: The sheets.
        table: The table.
        size: Size of the font, if the table is not too wide [pt].
        titled: Whether its title stands above.
    """
    fitted = _widths(table, size)
    if fitted is None:
        for part in _halves(table):
            set_table(sheets, part, size, titled=titled)
            sheets.y += 8.0
        return
    size, widths = fitted
    gap = GAP
    if len(widths) > 1:
        free = RIGHT - LEFT - sum(widths)
        gap = max(GAP * size / 8.0, min(WIDEST_GAP, free / (len(widths) - 1)))
        gap = min(gap, max(free / (len(widths) - 1), 0.0))
    heads = [
        _lines(Cell(c.title), Column("", "remark"), w, size, "B")
        for c, w in zip(table.columns, widths, strict=True)
    ]
    # The title, the headings and two rows stay together.
    sheets.need(LEADING * (9.0 + size * (max(map(len, heads)) + 2)) + 8 * SPACE)
    if titled and table.title:
        sheets.paragraph(table.title, 9.0, "B")
        sheets.y += 2.0

    def put(lines: Sequence[Sequence[str]], k: int, face: Face, color: str) -> None:
        """The k-th line of each cell."""
        left = LEFT
        for column, width, cell in zip(table.columns, widths, lines, strict=True):
            if k < len(cell) and cell[k]:
                right = left + width if column.kind == "number" else None
                sheets.write(cell[k], left, size, face, color, right)
            left += width + gap
        sheets.y += LEADING * size

    across = sum(widths) + gap * (len(widths) - 1)

    def head() -> None:
        if not table.headed:
            return
        height = max(map(len, heads))
        # Headings of one line stand above the numbers, beside longer ones.
        low = [[""] * (height - len(lines)) + list(lines) for lines in heads]
        for k in range(height):
            put(low, k, "B", MUTED)
        sheets.y += SPACE
        sheets.area(LEFT, sheets.y, across, 0.9, MUTED)

    def again() -> None:
        """The headings on a new sheet."""
        if titled and table.title:
            sheets.paragraph(f"{table.title}, continued", size, color=MUTED)
            sheets.y += 2.0
        head()

    head()
    for k, row in enumerate(table.rows):
        face: Face = "B" if k in table.emphasized else ""
        cells = [
            _lines(cell, column, width, size, face)
            for cell, column, width in zip(row, table.columns, widths, strict=True)
        ]
        count = max(map(len, cells))
        height = LEADING * size * count + 2 * SPACE
        # The last row would look lost on a sheet of its own.
        rows = 2 if k == len(table.rows) - 2 else 1
        if height < (BOTTOM - TOP) / 4 and sheets.need(rows * height):
            again()
        sheets.y += SPACE
        for line in range(count):
            if sheets.need(LEADING * size):
                again()
                sheets.y += SPACE
            put(cells, line, face, INK)
        sheets.y += SPACE
        sheets.area(LEFT, sheets.y, across, 0.4, GRID)
    sheets.y += SPACE


def _halves(table: Table) -> Iterator[Table]:
    """The columns of a table that is too wide, each half behind the first one."""
    middle = (len(table.columns) + 1) // 2
    for kept in (slice(1, middle), slice(middle, None)):
        yield replace(
            table,
            columns=[table.columns[0], *table.columns[kept]],
            rows=[[row[0], *row[kept]] for row in table.rows],
        )


def _widths(table: Table, size: float) -> tuple[float, list[float]] | None:
    """The font and the widths of the columns with which a table fits.

    None where it does not without breaking numbers, but its halves may.
    """
    across = RIGHT - LEFT
    heading = across  # Headings are broken before the font shrinks.
    while True:
        most = [_natural(table, k, size, heading) for k in range(len(table.columns))]
        room = across - GAP * size / 8.0 * (len(most) - 1)
        if sum(most) <= room:
            return size, most
        if heading > HEADING:
            heading = HEADING
            continue
        least = [
            min(width, NARROWEST) if column.kind in ("name", "remark") else width
            for column, width in zip(table.columns, most, strict=True)
        ]
        spare = room - sum(least)
        if spare >= 0.0:
            lacking = sum(most) - sum(least)
            return size, [
                low + spare * (high - low) / lacking
                for low, high in zip(least, most, strict=True)
            ]
        if size <= SMALLEST and len(most) > 2:
            return None
        if size <= SMALLEST:
            return size, [room * low / sum(least) for low in least]
        size -= STEP


def _natural(table: Table, k: int, size: float, most: float) -> float:
    """Width of a column in which nothing is broken but a heading that is too long."""
    title = printable(table.columns[k].title)
    words = [width_of(word, size, "B") for word in title.split()]
    heading = width_of(title, size, "B")
    if words and heading > most:
        heading = max(*words, most)
    cells = [
        width_of(line, size, "B" if n in table.emphasized else "")
        for n, row in enumerate(table.rows)
        for line in printable(row[k].text).split("\n")
    ]
    # What just fits must not be broken by rounding.
    return max([heading, *cells, 4.0]) + 0.01


def _lines(
    cell: Cell, column: Column, width: float, size: float, face: Face
) -> list[str]:
    if not cell.text:
        return []
    return broken(cell.text, width, size, face, anywhere=column.kind == "name")
