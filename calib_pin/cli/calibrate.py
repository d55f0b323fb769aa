"""`calib-pin calibrate`: from a URDF and measurements to a corrected URDF."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

from calib_pin.cli import options, printing, requests, results

if TYPE_CHECKING:
    from calib_pin.report.blocks import Block


@dataclass(frozen=True, kw_only=True)
class Calibrate(
    options.QuietAnswer,
    options.Shared,
    options.Pictured,
    options.Detailed,
    options.Request,
):
    """A calibration with what is to be left of it.

    Attributes:
        output: Folder for the results; without it they are only printed.
    """

    output: Annotated[Path | None, options.Told("DIR", "Output")] = None


@options.spread
def calibrate(asked: Calibrate, context: typer.Context) -> int:
    """Fit a robot to measurements and write the corrected URDF.

    DIR receives <robot name>.urdf, nominal.urdf, calibration.json, measurements.csv
    (residuals) and report.html (for the browser); it can be moved as a whole. Without
    --validation, --holdout or a column 'set' (train, validate), five-fold
    cross-validation checks the fit. Where there is nothing to correct, <robot
    name>.urdf is the nominal file. Exit status 2: the result is unchecked or must not
    be trusted; the reason comes first, and no <robot name>.urdf is written.
    """
    from calib_pin.estimation.evidence import TRUSTED
    from calib_pin.io.results import calibration_document
    from calib_pin.report import blocks, text

    force, quiet, details = asked.force, asked.quiet, asked.details
    pictures = results.figure_files(asked.figures, asked.figure_format, "calibration")
    with printing.progress_bar(quiet=quiet) as bar:
        given = requests.opened(
            asked, asked.output, pictures, force=force, quiet=quiet, bar=bar
        )
    with (
        printing.progress_bar(quiet=quiet) as bar,
        options.asked_workers(asked.workers, asked.cluster) as several,
    ):
        words = ("calib-pin", *context.obj)
        found = requests.calibrated(given, words, pictures, bar=bar, workers=several)
    result, files, contents = found.result, given.files, found.contents

    def said() -> Iterator[Block]:
        yield from text.report(result, found.suggestions, details=details)
        if not details:
            more = f"{files.report}, or --details" if files else "--details"
            yield blocks.Line(f"Statistics and all parameters: {more}")

    def document() -> Mapping[str, Any] | bytes:
        if files is None:
            return calibration_document(result, suggestions=found.suggestions)
        return contents[files.json]

    def written() -> Iterator[str]:
        yield from (f"wrote {path}" for path in files or () if path in contents)
        yield from results.told_figures(found.pictures, pictures)

    writing = None
    if files is not None:
        writing = results.write_results(result, files, contents, force=force)
    asked.give(contents, document, said(), written(), writing)
    if (quiet or asked.json) and result.verdict not in TRUSTED:
        printing.notice(f"{result.verdict}: {result.reason}")
    return 0 if result.verdict in TRUSTED else 2
