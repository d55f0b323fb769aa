"""The option `--figures` and the pictures that it asks for."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

from calib_pin.cli.files import exists
from calib_pin.cli.options import OUTPUT, option
from calib_pin.cli.printing import Bar, notice

if TYPE_CHECKING:
    from calib_pin.planning.plan import Plan
    from calib_pin.report.figures import Drawn
    from calib_pin.validation.comparison import Comparison
    from calib_pin.validation.result import CalibrationResult

FORMATS = ("png", "pdf", "svg")
"""Formats of pictures by the ending of their names."""


def _format(word: str) -> str:
    from calib_pin.errors import require_known

    require_known("figure format", word, FORMATS)
    return word


Figures = Annotated[
    Path | None, option(OUTPUT, "--figures", "DIR", "Folder for the figures.")
]
FigureFormat = Annotated[
    str,
    option(OUTPUT, "--figure-format", "FORMAT", "png (default), pdf or svg.", _format),
]


def figure_files(folder: Path | None, kind: str, of: str) -> list[Path]:
    """The files that figures may be written to; none without a folder.

    Args:
        folder: The folder.
        kind: One of `FORMATS`.
        of: Their subject, `calibration`, `plan` or `comparison`.

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


def figure_contents(drawn: Sequence[Drawn], files: Sequence[Path]) -> dict[Path, bytes]:
    """Figures as pictures.

    Args:
        drawn: The figures.
        files: What `figure_files` gave; there are no pictures where that is empty.
    """
    figures = {figure.name: figure for figure in drawn}
    return {
        path: figures[path.stem].picture(path.suffix[1:])
        for path in files
        if path.stem in figures
    }


def told_figures(pictures: Collection[Path], files: Sequence[Path]) -> list[str]:
    """Figures that were written, in words, and a note on those of an earlier run.

    Args:
        pictures: Those that were written.
        files: What `figure_files` gave.
    """
    for path in files:
        if path not in pictures and exists(path):
            notice(f"{path} is not from this run, which has no such figure")
    count = f"{len(pictures)} figure{'s' if len(pictures) != 1 else ''}"
    return [f"wrote {count} to {files[0].parent}"] if files else []
