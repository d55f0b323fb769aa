"""`calib-pin compare`: the difference between two calibrations of a robot."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import calib_pin.cli.options as options
from calib_pin.cli.files import check_outputs, require_distinct, require_file
from calib_pin.cli.printing import say, say_written, show
from calib_pin.cli.results import (
    FigureFormat,
    Figures,
    draw,
    figure_contents,
    figure_files,
    told_figures,
)


def compare(
    first: Annotated[
        Path, typer.Argument(metavar="A.json", help="A calibration of a robot.")
    ],
    second: Annotated[
        Path,
        typer.Argument(
            metavar="B.json", help="A later one, or another model of the robot."
        ),
    ],
    seed: Annotated[
        int,
        options.seed(
            "Workspace", "Random seed of the configurations that are compared."
        ),
    ] = 0,
    figures: Figures = None,
    figure_format: FigureFormat = "png",
    force: options.Force = False,
    json: options.Json = False,
) -> int:
    """Print the difference between two calibrations, beyond their uncertainty.

    Tool points are compared in the base link. Where base and tool were estimated, a
    displacement of them is removed by a fit: a tracker at another station is no drift
    of the robot, nor is another tool. Parameters and combinations are listed where they
    differ by more than three standard deviations. Exit status 2: one of the
    calibrations must not be trusted, or they are of different robots.
    """
    from calib_pin.cli.documents import comparison_document
    from calib_pin.estimation.evidence import TRUSTED
    from calib_pin.io.files import write_files
    from calib_pin.io.json_text import encode
    from calib_pin.io.results import read_result
    from calib_pin.report.comparison import comparison_report
    from calib_pin.validation.comparison import compare as run
    from calib_pin.validation.comparison import faults

    files = (first, second)
    for file in files:
        require_file(file)
    require_distinct(files)
    pictures = figure_files(figures, figure_format, "comparison")
    check_outputs(pictures, files, force)
    A, B = map(read_result, files)
    found = run(A, B, seed=seed)
    drawn = draw("comparison", None, found.drift) if pictures else []
    contents = figure_contents(drawn, pictures)
    with write_files(contents, force=force):
        if json:
            say(encode(comparison_document(found)).decode())
        else:
            show(comparison_report(found))
    pictured = told_figures(contents, pictures)
    if not json:
        say_written(pictured)
    trusted = {A.verdict, B.verdict} <= set(TRUSTED)
    different = any(fault.severity == "error" for fault in faults(found))
    return 0 if trusted and not different else 2
