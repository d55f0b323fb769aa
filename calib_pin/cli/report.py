"""`calib-pin report`: page and figures of a calibration again, from its files alone."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import calib_pin.cli.options as options
from calib_pin.cli.files import check_outputs
from calib_pin.cli.printing import notice, progress_bar, say_written, show
from calib_pin.cli.results import (
    FigureFormat,
    Figures,
    draw_calibration,
    figure_contents,
    figure_files,
    told_figures,
)


def report(
    calibration: Annotated[
        Path,
        typer.Argument(
            metavar="DIR|CALIBRATION", help="Folder of the results, or its .json file."
        ),
    ],
    output: Annotated[
        Path | None,
        options.output(
            "-o --output PAGE",
            "The page; default report.html of the folder, which is replaced.",
        ),
    ] = None,
    figures: Figures = None,
    figure_format: FigureFormat = "png",
    force: options.Force = False,
    quiet: options.Quiet = False,
) -> int:
    """Write the page and the figures of a calibration again, from its files alone.

    calibration.json, measurements.csv and the robot are all that it takes. Of a
    calibration without measurements.csv, as older versions wrote it, there are no
    figures of single measurements. Exit status 2: the calibration must not be trusted.
    """
    from calib_pin.estimation.evidence import TRUSTED
    from calib_pin.io.files import write_files
    from calib_pin.io.result_file import document_file, read_suggestions, read_written
    from calib_pin.io.result_folder import MEASUREMENTS, REPORT
    from calib_pin.report.html import html_report
    from calib_pin.report.text import report as blocks

    file = document_file(calibration)
    result, document = read_written(file)
    page = output or file.parent / REPORT
    own = output is None and REPORT in document.get("files", {})
    pictures = figure_files(figures, figure_format, "calibration")
    inputs: list[str | Path | None] = [file, file.parent / MEASUREMENTS]
    inputs.append(result.model.chains.robot.file)
    check_outputs([page, *pictures], inputs, force or own)
    if MEASUREMENTS not in document.get("files", {}):
        notice(f"{file} has no {MEASUREMENTS}: nothing is known of single measurements")
    suggestions = read_suggestions(document)
    with progress_bar(quiet=quiet) as bar:
        drawn = draw_calibration(result, bar)
        contents = figure_contents(drawn, pictures)
        text = html_report(result, document, figures=drawn, suggestions=suggestions)
    with write_files({page: text, **contents}, force=force or own):
        if not quiet:
            show(blocks(result, suggestions))
    told = told_figures(contents, pictures)
    if not quiet:
        say_written([f"wrote {page}", *told])
    elif result.verdict not in TRUSTED:
        notice(f"{result.verdict}: {result.reason}")
    return 0 if result.verdict in TRUSTED else 2
