"""The option `--figures` and the pictures that it asks for."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib_pin.cli.files import exists
from calib_pin.cli.options import OUTPUT
from calib_pin.cli.printing import Bar, notice

if TYPE_CHECKING:
    from calib_pin.comparison import Comparison
    from calib_pin.planning.plan import Plan
    from calib_pin.report.figures import Drawn
    from calib_pin.result import CalibrationResult

__all__ = [
    "FigureFormat",
    "Figures",
    "draw_calibration",
    "draw_comparison",
    "draw_plan",
    "figure_files",
    "write_figures",
]

FORMATS = ("png", "pdf", "svg")
"""Formats of pictures by the ending of their names."""


def _format(word: str) -> str:
    from calib_pin.errors import require_known

    require_known("figure format", word, FORMATS)
    return word


Figures = Annotated[
    Path | None,
    typer.Option(
        "--figures",
        metavar="DIR",
        help="Folder of the figures as pictures.",
        rich_help_panel=OUTPUT,
    ),
]
FigureFormat = Annotated[
    str,
    typer.Option(
        "--figure-format",
        metavar="FORMAT",
        help="png (default), pdf or svg.",
        parser=_format,
        rich_help_panel=OUTPUT,
    ),
]


def figure_files(folder: Path | None, kind: str, of: str) -> list[Path]:
    """The files that figures may be written to; none without a folder.

    Args:
        folder: The folder.
        kind: One of `FORMATS`.
        of: What they are figures of, `calibration`, `plan` or `comparison`.

    Raises:
        OptionError: If there can be no such folder.
    """
    import os

    from calib_pin.errors import OptionError

    if folder is None:
        return []
    # Known before the work, not after it.
    place = next(filter(exists, (folder, *folder.absolute().parents)))
    if not place.is_dir():
        raise OptionError("is a file, not a folder", file=place)
    if not os.access(place, os.W_OK):
        raise OptionError("is a folder in which nothing can be written", file=place)
    # It takes half a second to load what draws.
    from calib_pin.report.figures import NAMES

    return [folder / f"{name}.{kind}" for name in NAMES[of]]


def draw_calibration(result: CalibrationResult, bar: Bar | None) -> list[Drawn]:
    """The figures of a calibration."""
    from calib_pin.report.figures import NAMES, calibration_figures

    return _told(calibration_figures(result), len(NAMES["calibration"]), bar)


def draw_plan(plan: Plan, bar: Bar | None) -> list[Drawn]:
    """The figures of a plan."""
    from calib_pin.report.figures import NAMES, plan_figures

    return _told(plan_figures(plan), len(NAMES["plan"]), bar)


def draw_comparison(found: Comparison) -> list[Drawn]:
    """The figures of a comparison."""
    from calib_pin.report.figures import comparison_figures

    return list(comparison_figures(found.drift))


def _told(drawn: Iterator[Drawn], count: int, bar: Bar | None) -> list[Drawn]:
    """All figures, with progress."""
    result = []
    for figure in drawn:
        result.append(figure)
        if bar is not None:
            bar("figures", len(result) / count)
    return result


def write_figures(
    drawn: Sequence[Drawn], files: Sequence[Path], force: bool
) -> list[str]:
    """Write figures, and tell of those that may pass for some of this run.

    Args:
        drawn: The figures.
        files: What `figure_files` gave; nothing is written where that is empty.
        force: Whether existing files may be replaced.

    Returns:
        What was written, in words.
    """
    from calib_pin.io.files import write_atomically

    figures = {figure.name: figure for figure in drawn}
    for path in files:
        figure = figures.get(path.stem)
        if figure is not None:
            write_atomically(path, figure.picture(path.suffix[1:]), force=force)
        elif exists(path):
            notice(f"{path} is not of this run, which has no such figure")
    count = f"{len(drawn)} figure{'s' if len(drawn) != 1 else ''}"
    return [f"wrote {count} to {files[0].parent}"] if files else []
