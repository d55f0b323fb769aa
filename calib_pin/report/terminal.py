"""Reports on a terminal: colored where it can be, and at most 80 columns wide."""

from __future__ import annotations

import io
from collections.abc import Iterable, Iterator

from rich import table as rich_table
from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.text import Text

from calib_pin.errors import printable
from calib_pin.report.blocks import Block, Code, Line, Names, Table

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
        line = _text(block.text, style=STYLES[block.tone])
        yield Padding(line, INDENT) if block.indent else line
        return
    if block.title:
        yield _text(block.title, style="bold")
    if isinstance(block, Table):
        yield _table(block)
    elif isinstance(block, Code):
        yield Padding(Text(printable(block.text), overflow="fold"), INDENT)
    elif isinstance(block, Names):
        yield from (Padding(_text(entry), INDENT) for entry in block.entries)
    else:
        grid = rich_table.Table.grid(padding=(0, 2))
        # A long path is broken; rich would cut it.
        grid.add_column(overflow="fold")
        grid.add_column(overflow="fold")
        for name, words in block.entries:
            grid.add_row(_text(f"  {name}"), _text(words))
        yield grid


def _text(words: str, style: str = "") -> Text:
    """Text in which the names of users cannot steer the terminal."""
    return Text(printable(words), style)


def _table(table: Table) -> rich_table.Table:
    result = rich_table.Table(box=None, pad_edge=False, show_header=table.headed)
    for column in table.columns:
        result.add_column(
            _text(column.title),
            justify="right" if column.kind == "number" else "left",
            no_wrap=column.kind in ("word", "number"),
            overflow="fold",
        )
    for k, row in enumerate(table.rows):
        style = "bold" if k in table.emphasized else ""
        result.add_row(*(_text(cell.text) for cell in row), style=style)
    return result
