"""The parts of a report, wherever it is shown: lines, facts, tables, lists of names.

They are built once from a result; `terminal`, `html` and `pdf` only lay them out, so a
number is the same wherever it is read.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Literal, cast

Tone = Literal["plain", "good", "bad", "strong", "note"]


@dataclass(frozen=True)
class Line:
    """A sentence.

    Attributes:
        text: The words.
        tone: A verdict, a heading, or a remark on what stands above.
        indent: Whether it belongs to the block above.
        figure: Name of the figure that shows it; empty for none.
    """

    text: str
    tone: Tone = "plain"
    indent: bool = False
    figure: str = ""


def note(text: str) -> Line:
    """A remark on what stands above."""
    return Line(text, "note")


@dataclass(frozen=True)
class Code:
    """Lines to be copied into a file.

    Attributes:
        title: Heading, which names the file.
        text: The lines.
    """

    title: str
    text: str


@dataclass(frozen=True)
class Facts:
    """Names and their values, below each other.

    Attributes:
        title: Heading.
        entries: Name and words of each; an empty name continues the one above.
    """

    title: str
    entries: Sequence[tuple[str, str]]


@dataclass(frozen=True)
class Names:
    """A list under a heading.

    Attributes:
        title: Heading.
        entries: The members, one below the other.
    """

    title: str
    entries: Sequence[str]


Kind = Literal["name", "word", "number", "remark"]


@dataclass(frozen=True)
class Column:
    """A column of a table.

    Attributes:
        title: Heading.
        kind: `name` may be broken anywhere, `word` and `number` not at all, `remark`
            between words; numbers stand at the right.
    """

    title: str
    kind: Kind = "number"


@dataclass(frozen=True)
class Cell:
    """A cell of a table.

    Attributes:
        text: As people read it.
        value: The number behind it, in SI units, where there is one.
    """

    text: str
    value: float | None = None


@dataclass(frozen=True)
class Table:
    """A table.

    Attributes:
        title: Heading.
        columns: Its columns.
        rows: Cells of each row, as many as there are columns.
        emphasized: Positions of the rows that stand out.
    """

    title: str
    columns: Sequence[Column]
    rows: Sequence[Sequence[Cell]]
    emphasized: Sequence[int] = ()

    @property
    def headed(self) -> bool:
        """Whether any column has a heading."""
        return any(column.title for column in self.columns)


Block = Line | Code | Facts | Names | Table


def table(
    title: str,
    titles: Iterable[str],
    rows: Iterable[Iterable[object]],
    emphasized: Sequence[int] = (),
    grouped: int = 0,
) -> Table:
    """A table of cells, words and counts.

    Args:
        title: Its heading.
        titles: Headings of the columns, each with its kind where that is not the usual
            one: `unit|word`. Usually the first column has names, the others numbers.
        rows: The rows.
        emphasized: Positions of the rows that stand out.
        grouped: Leading columns of which a cell is left empty where it and those before
            it are as in the row above.
    """
    columns: list[Column] = []
    for head, _, kind in (name.partition("|") for name in titles):
        usual: Kind = "number" if columns else "name"
        columns.append(Column(head, cast("Kind", kind) or usual))
    cells = [[*map(_cell, row)] for row in rows]
    for above, row in reversed([*pairwise(cells)]):
        for k in range(grouped):
            if row[k] != above[k]:
                break
            row[k] = Cell("")
    return Table(title, columns, cells, emphasized)


def _cell(content: object) -> Cell:
    if isinstance(content, Cell):
        return content
    return Cell(str(content), content if isinstance(content, int) else None)
