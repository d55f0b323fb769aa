"""What all reports are made of: tables, numbers and lists of names."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Iterator, Sequence

from rich.console import Console, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from calib_pin.result import CoupledGroup, ParameterEstimate
from calib_pin.units import DISPLAY

__all__ = [
    "ESTIMATE",
    "WIDTH",
    "group_table",
    "listed",
    "number",
    "parameter_table",
    "plain_text",
    "table",
]

WIDTH = 80
"""Columns of the report where it is not printed to a terminal."""

ESTIMATE = ("value", "std. dev.", "unit")
"""Columns that can stand beside a parameter or a group."""


def plain_text(content: RenderableType) -> str:
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
    console.print(content)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines()) + "\n"


def table(title: str, columns: Iterable[str]) -> Table:
    """A table with a column of names before those that are given; text at the left."""
    result = Table(
        title=title, title_justify="left", title_style="bold", box=None, pad_edge=False
    )
    result.add_column("", overflow="fold")
    for column in columns:
        left = column in ("unit", "rows", "robot")
        result.add_column(column, justify="left" if left else "right", no_wrap=True)
    return result


def parameter_table(
    parameters: Sequence[ParameterEstimate], columns: Sequence[str] = ESTIMATE
) -> RenderableType:
    """Identifiable parameters.

    Args:
        parameters: The parameters.
        columns: What stands beside them, some of `ESTIMATE`.
    """
    result = table("Identifiable parameters", columns)
    for parameter in parameters:
        result.add_row(parameter.name, *_cells(parameter, columns))
    return result


def group_table(
    groups: Sequence[CoupledGroup], columns: Sequence[str] = ESTIMATE
) -> RenderableType:
    """Coupled groups as formulae.

    Args:
        groups: The groups.
        columns: What stands beside them, some of `ESTIMATE`; nothing where empty.
    """
    result = Table(
        title="Coupled groups: only the sums are known (coefficients in SI units)",
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
        show_header=bool(columns),
    )
    result.add_column("", justify="right")
    result.add_column("sum", overflow="fold")
    for column in columns:
        left = column == "unit"
        result.add_column(column, justify="left" if left else "right", no_wrap=True)
    for group in groups:
        result.add_row(str(group.number), group.expression, *_cells(group, columns))
    return result


def _cells(
    item: ParameterEstimate | CoupledGroup, columns: Sequence[str]
) -> Iterator[str]:
    """Value, standard deviation and unit of a parameter or a group, as asked for."""
    unit, factor = DISPLAY.get(item.unit, (item.unit, 1.0))
    sigma = "-" if item.sigma is None else f"{factor * item.sigma:.4f}"
    value = f"{factor * item.value:+.4f}"
    cells = dict(zip(ESTIMATE, (value, sigma, unit), strict=True))
    return (cells[column] for column in columns)


def number(value: float) -> str:
    """Four significant digits, plain where that is short."""
    if not math.isfinite(value):
        return "inf" if value > 0 else "unknown"
    size = abs(value)
    if size == 0.0 or 1e-3 <= size < 1.0:
        return f"{value:.4f}"
    if 1.0 <= size < 1e5:
        return f"{value:.{max(0, 3 - int(math.log10(size)))}f}"
    return f"{value:.1e}"


def listed(meaning: str, names: Sequence[str]) -> Iterator[RenderableType]:
    """Names under a heading, if there are any."""
    if names:
        yield ""
        yield Text(f"{meaning}:", style="bold")
        for line in _compressed(names):
            yield Padding(line, (0, 0, 0, 2))


def _compressed(names: Sequence[str]) -> Iterator[str]:
    """Names with the components of one owner and kind on one line."""
    together: dict[str, list[str]] = {}
    for name in names:
        stem, component = name.rsplit(".", 1)
        together.setdefault(stem, []).append(component)
    for stem, components in together.items():
        yield f"{stem}.{'|'.join(components)}"
