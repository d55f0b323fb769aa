"""`calib-pin calibrate`: from a URDF and measurements to a corrected URDF."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import calib_pin.cli.options as options
from calib_pin.cli.printing import (
    notice,
    progress_bar,
    say,
    say_json,
    say_written,
    show,
)
from calib_pin.cli.request import Request
from calib_pin.cli.requests import calibrated, opened
from calib_pin.cli.results import (
    FigureFormat,
    Figures,
    figure_files,
    told_figures,
    write_results,
)
from calib_pin.cli.workforce import ClusterAddress, WorkerCount, asked_workers


@options.spread
def calibrate(
    request: Request,
    context: typer.Context,
    output: Annotated[
        Path | None,
        options.output(
            "-o --output DIR",
            "Folder for the results; without it they are only printed.",
        ),
    ] = None,
    details: options.Details = False,
    figures: Figures = None,
    figure_format: FigureFormat = "png",
    workers: WorkerCount = None,
    cluster: ClusterAddress = None,
    force: options.Force = False,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> int:
    """Fit a robot to measurements and write the corrected URDF.

    DIR receives <robot name>.urdf, nominal.urdf, calibration.json, measurements.csv
    (residuals) and report.html (for the browser); it can be moved as a whole. Without
    --validation, --holdout or a column 'set' (train, validate), five-fold
    cross-validation checks the fit. Where there is nothing to correct, <robot
    name>.urdf is the nominal file. Exit status 2: the result is unchecked or must not
    be trusted; the reason comes first, and no <robot name>.urdf is written.
    """
    from calib_pin.estimation.evidence import TRUSTED
    from calib_pin.io.files import write_files
    from calib_pin.report.text import report

    pictures = figure_files(figures, figure_format, "calibration")
    with progress_bar(quiet=quiet) as bar:
        given = opened(request, output, pictures, force=force, quiet=quiet, bar=bar)
    with progress_bar(quiet=quiet) as bar, asked_workers(workers, cluster) as several:
        words = ("calib-pin", *context.obj)
        found = calibrated(given, words, pictures, bar=bar, workers=several)
    result, files, contents = found.result, given.files, found.contents
    with (
        write_files(contents, force=force)
        if files is None
        else write_results(result, files, contents, force=force)
    ):
        if json and files is not None:
            say(contents[files.json].decode())
        elif json:
            from calib_pin.io.results import calibration_document

            say_json(calibration_document(result, suggestions=found.suggestions))
        elif not quiet:
            show(report(result, found.suggestions, details=details))
            if not details:
                more = f"{files.report}, or --details" if files else "--details"
                say(f"Statistics and all parameters: {more}\n")
    pictured = told_figures(found.pictures, pictures)
    if not quiet and not json:
        written = [path for path in files or () if path in contents]
        say_written([*(f"wrote {path}" for path in written), *pictured])
    elif result.verdict not in TRUSTED:
        notice(f"{result.verdict}: {result.reason}")
    return 0 if result.verdict in TRUSTED else 2
