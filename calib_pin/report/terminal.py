"""Reports on a terminal: colored where it can be, and at most 80 columns wide."""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Iterator, Sequence

from rich.cells import cell_len
from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.text import Text

from calib_pin.errors import printable
from calib_pin.report.blocks import Block, Code, Line, Names, Table, table

WIDTH = 80
"""Columns of the report where it is not printed to a terminal."""

STYLES = {
    "plain": "",
    "good": "bold green",
    "bad": "bold red",
    "strong": "bold",
    "note": "dim",
}

INDENT = (0, 0, 0, 2)

NARROW = 24
"""Width of a column of names below which headings are rather broken."""

WORDS, PARTS = re.compile(r"\s*\S+\s*"), re.compile(r"[^._/|-]*[._/|-]*")
"""Words, and parts of a name between which a line may end."""


def plain_text(blocks: Iterable[Block]) -> str:
    """Render without colors, at most 80 columns wide."""
    stream = io.StringIO()
    console = Console(
        file=stream,
        width=WIDTH,
        color_system=None,
        # A notebook would show what is meant for the stream.
        force_jupyter=False,
        # Names are what they are: no markup and no emoji codes in them.
        highlight=False,
        markup=False,
        emoji=False,
    )
    console.print(laid_out(blocks))
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines()) + "\n"


def laid_out(blocks: Iterable[Block]) -> RenderableType:
    """The blocks below each other; an empty line before whatever has a heading."""
    parts: list[RenderableType] = []
    for block in blocks:
        if isinstance(block, Line) and block.figure:
            continue  # It leads to a figure, and there are none here.
        if parts and not isinstance(block, Line):
            parts.append("")
        parts += _rendered(block)
    return Group(*parts)


def _rendered(block: Block) -> Iterator[RenderableType]:
    if isinstance(block, Line):
        line = Text(printable(block.text), STYLES[block.tone])
        yield Padding(line, INDENT) if block.indent else line
        return
    if block.title:
        yield Text(printable(block.title), "bold")
    if isinstance(block, Table):
        yield from _lines(block, WIDTH)
    elif isinstance(block, Code):
        yield Padding(Text(printable(block.text), overflow="fold"), INDENT)
    else:
        rows = [[e] if isinstance(e, str) else e for e in block.entries]
        titles = ["|remark"] if isinstance(block, Names) else ["|word", "|remark"]
        lines = _lines(table("", titles, rows), WIDTH - 2)
        yield from (Padding(line, INDENT) for line in lines)


def _lines(table: Table, room: int) -> Iterator[Text]:
    """The rows of a table, with its headings if there are any."""
    heads = [printable(column.title) for column in table.columns]
    rows = [[printable(cell.text) for cell in row] for row in table.rows]
    widths = _widths(table, heads, rows, room - 2 * (len(heads) - 1))
    if any(heads):
        yield from _row(table, heads, widths, "bold")
    for k, row in enumerate(rows):
        yield from _row(table, row, widths, "bold" if k in table.emphasized else "")


def _widths(
    table: Table, heads: Sequence[str], rows: Sequence[Sequence[str]], room: int
) -> list[int]:
    """Widths of the columns: names and remarks are broken, and headings if need be."""
    soft = [k for k, c in enumerate(table.columns) if c.kind in ("name", "remark")]
    for least, parts in ((NARROW, lambda head: [head]), (1, str.split)):
        widths = [
            max(map(cell_len, (*parts(head), "", *(row[k] for row in rows))))
            for k, head in enumerate(heads)
        ]
        while sum(widths) > room and any(widths[k] > least for k in soft):
            widths[max(soft, key=widths.__getitem__)] -= 1
        if sum(widths) <= room:
            break
    return widths


def _row(
    table: Table, cells: Sequence[str], widths: Sequence[int], style: str
) -> Iterator[Text]:
    """The lines of a row, whose cells may be broken."""
    broken = [wrapped(text, width) for text, width in zip(cells, widths, strict=True)]
    for k in range(max(map(len, broken), default=0)):
        line = []
        for of, width, column in zip(broken, widths, table.columns, strict=True):
            part = of[k].rstrip() if k < len(of) else ""
            room = " " * (width - cell_len(part))
            line.append(room + part if column.kind == "number" else part + room)
        yield Text("  ".join(line).rstrip(), style, no_wrap=True, overflow="ignore")


def wrapped(text: str, width: int) -> list[str]:
    """Lines of a text, broken between words; long ones at their joints, or anywhere.

    Examples:
        >>> wrapped("shoulder_lift_joint, elbow_joint", 16)
        ['shoulder_lift_', 'joint, ', 'elbow_joint']
    """
    lines = [""]
    for word in WORDS.findall(text):
        whole = cell_len(word.rstrip()) <= width
        for part in [word] if whole else PARTS.findall(word):
            if cell_len(lines[-1] + part.rstrip()) <= width:
                lines[-1] += part
            else:
                lines += [part[k : k + width] for k in range(0, len(part), width)]
    return [line for line in lines if line.strip()] or [""]
