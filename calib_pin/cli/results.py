"""The files that commands leave: those of a calibration, and figures."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING

from calib_pin.cli.files import exists
from calib_pin.cli.options import Pictured
from calib_pin.cli.printing import Bar, notice, stage
from calib_pin.errors import counted
from calib_pin.io.files import write_files
from calib_pin.report.folder import outdated, result_files
from calib_pin.setup import ReportSetup
from calib_pin.validation.result import CalibrationResult

if TYPE_CHECKING:  # Drawing loads slowly, and is not always asked for.
    from calib_pin.report.figures import Drawn


@contextmanager
def write_results(
    result: CalibrationResult,
    folder: Path | None,
    contents: Mapping[Path, bytes],
    *,
    force: bool,
) -> Iterator[None]:
    """Put the files of a result in place when the block ends well.

    Files of an earlier run that are not rewritten would pass for a result of this
    one, so they are removed.
    """
    old = [] if folder is None else outdated(folder, contents)
    with write_files(contents, force=force, folder=folder, removed=old):
        yield
    if folder is None:
        return
    for path in old:
        notice(f"removed {path} of an earlier run")
    corrected, *_, page = result_files(folder, result.model.chains.robot)
    _tell_others((corrected, page), contents, "file")
    if (geometry := result.geometry) is None:
        return
    for chain in map(geometry.of, geometry.measured_chains):
        if chain.tool_carries_tip:
            text = "moves with the last joint: the error behind that is in frames.tool"
            notice(f"'{chain.chain.tip}' {text} of calibration.json")


def _tell_others(files: Sequence[Path], written: Collection[Path], kind: str) -> None:
    """Remark on files of an earlier run that stay where this one has none."""
    for path in files:
        if path not in written and exists(path):
            notice(f"{path} is not from this run, which has no such {kind}")


# --- figures ------------------------------------------------------------------------


def figure_files(asked: Pictured) -> list[Path]:
    """The files of the figures of a calibration, as far as they are asked for."""
    if (folder := asked.figures) is None:
        return []
    # It takes half a second to load what draws.
    from calib_pin.report.figures import NAMES

    return [folder / f"{name}.{asked.figure_format}" for name in NAMES["calibration"]]


def draw_calibration(
    subject: CalibrationResult, bar: Bar | None, packages: Sequence[Path] | None
) -> list[Drawn]:
    """The figures of a calibration, with the meshes of these packages."""
    from calib_pin.io.robot_shapes import robot_shapes
    from calib_pin.report.figures import drawn

    stage(bar, "figures")
    shapes = robot_shapes(subject.model.chains.robot, packages or ()).parts
    return [*drawn("calibration", subject, shapes=shapes)]


def figure_contents(drawn: Sequence[Drawn], files: Sequence[Path]) -> dict[Path, bytes]:
    """Figures as pictures, as far as `figure_files` gave files for them."""
    figures = {figure.name: figure for figure in drawn}
    return {
        path: figures[path.stem].picture(path.suffix[1:])
        for path in files
        if path.stem in figures
    }


def figure_notes(contents: Collection[Path], files: Sequence[Path]) -> list[str]:
    """Figures among what was written, in words, and a note on those before."""
    _tell_others(files, contents, "figure")
    count = sum(file in contents for file in files)
    return [f"wrote {counted(count, 'figure')} to {files[0].parent}"] if files else []


def dated(entries: ReportSetup) -> ReportSetup:
    """The entries of a report with their date, by default today."""
    return replace(entries, date=entries.date or date.today().isoformat())
