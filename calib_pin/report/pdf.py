"""Reports as PDF: a first page for the customer, and the tables as an annex.

Like `terminal` and `html` it only lays out the blocks, so the numbers are the same. The
layout is the template `page/report.typ`, which typst fills.
"""

from __future__ import annotations

import json
from collections.abc import Iterable, Sequence
from dataclasses import is_dataclass
from datetime import UTC, datetime
from importlib.resources import files

from calib_pin import __version__
from calib_pin.errors import printable, require_package
from calib_pin.report.blocks import Block, Cell
from calib_pin.report.cover import Cover
from calib_pin.report.figures.canvas import AFTER, BEFORE, Drawn


def require_pdf() -> None:
    """Complain if PDF cannot be written.

    Raises:
        OptionError: If the extra is missing.
    """
    require_package("typst", "a PDF needs typst", "pdf")


def pdf_report(cover: Cover, blocks: Iterable[Block]) -> bytes:
    """The PDF of a report; the same report of the same day is the same bytes.

    Args:
        cover: The first page.
        blocks: The report, for the annex.

    Raises:
        OptionError: If the extra is missing.
    """
    require_pdf()
    import typst

    day = datetime.fromisoformat(cover.entries.date or "").replace(tzinfo=UTC)
    # With the fonts of the machine the bytes would be others.
    data = typst.compile(
        sources(cover, blocks), ignore_system_fonts=True, timestamp=day
    )
    return bytes(data)


def sources(cover: Cover, blocks: Iterable[Block]) -> dict[str, bytes]:
    """The template, its data and its figures, as files in memory by their names.

    Words of users are strings in the data, which the template shows and never runs.
    """
    template = files("calib_pin.report") / "page" / "report.typ"
    shown = {
        "cover": _plain(cover),
        "blocks": [_plain(block) for block in blocks],
        "made": f"calib-pin {__version__}",
        "before": BEFORE,
        "after": AFTER,
    }
    return {
        "main.typ": template.read_bytes(),
        "report.json": json.dumps(shown).encode(),
        **{f"{drawn.name}.svg": drawn.bare() for drawn in cover.figures},
    }


def _plain(item: object) -> object:
    """A block as JSON: of a cell its text, of a figure its words."""
    if isinstance(item, Cell):
        item = item.text
    if isinstance(item, str):
        return printable(item)
    if isinstance(item, Sequence):
        return [_plain(member) for member in item]
    if isinstance(item, Drawn):
        item = {name: getattr(item, name) for name in ("name", "title", "reading")}
    elif is_dataclass(item):
        item = {"kind": type(item).__name__, **vars(item)}
    if isinstance(item, dict):
        return {name: _plain(value) for name, value in item.items()}
    return item
