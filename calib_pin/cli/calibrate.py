"""`calib-pin calibrate`: from a URDF and measurements to a corrected URDF."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import calib_pin.cli.options as options
from calib_pin.cli.older import ProcessNoise, Start
from calib_pin.cli.printing import (
    notice,
    progress_bar,
    say,
    say_json,
    say_written,
    show,
)
from calib_pin.cli.requests import Request, calibrated, opened
from calib_pin.cli.results import (
    FigureFormat,
    Figures,
    figure_files,
    told_figures,
    write_results,
)
from calib_pin.cli.workforce import ClusterAddress, WorkerCount, asked_workers


def calibrate(
    context: typer.Context,
    robot: options.RobotName,
    measurements: Annotated[
        list[Path],
        typer.Argument(
            metavar="MEASUREMENTS...",
            help="CSV or Parquet files with one row per measurement.",
        ),
    ],
    output: Annotated[
        Path | None,
        options.output(
            "-o --output DIR",
            "Folder for the results; without it they are only printed.",
        ),
    ] = None,
    package_dir: options.PackageDirs = None,
    setup: options.SetupFile = None,
    model: options.Model = None,
    base: options.Base = None,
    tip: options.Tip = None,
    parameters: options.Parameters = None,
    station_per_file: options.StationPerFile = False,
    solver: Annotated[
        str | None,
        options.fit(
            "--solver NAME",
            "gauss-newton (default), two-step (alternating: frames and "
            "instrument, then the robot), de (differential evolution), or hybrid: de, "
            "then gauss-newton, for errors of centimeters and degrees.",
        ),
    ] = None,
    loss: Annotated[
        str | None,
        options.fit(
            "--loss NAME",
            "auto (default) sets outliers aside where there are any; gnc always "
            "searches for them; huber gives them less weight; squared weights all "
            "measurements equally.",
        ),
    ] = None,
    learned: Annotated[
        str | None,
        options.fit(
            "--learned NAME",
            "Learn the errors that no parameter describes: network or "
            "gaussian-process; with --model-ladder the only one that is tried.",
        ),
    ] = None,
    model_ladder: Annotated[
        bool,
        options.fit(
            "--model-ladder",
            "Select the model: try joint offsets, geometry, transmission, "
            "compliance and learned corrections on held-out measurements, and take "
            "the simplest of the best.",
        ),
    ] = False,
    use: Annotated[
        str | None,
        options.fit(
            "--use WHERE",
            "Select the model that holds near the measured configurations, away "
            "from them, or both (default); implies --model-ladder.",
        ),
    ] = None,
    validation: Annotated[
        Path | None,
        options.fit(
            "--validation FILE", "Check the fit on the measurements of this file."
        ),
    ] = None,
    holdout: Annotated[
        float | None,
        options.fit(
            "--holdout PART",
            "Hold out this part of the measurements, such as 0.2, for the check.",
            options.number(float, "--holdout", "a number between 0 and 1"),
        ),
    ] = None,
    start: Start = None,
    process_noise: ProcessNoise = None,
    details: options.Details = False,
    figures: Figures = None,
    figure_format: FigureFormat = "png",
    seed: options.Seed = 0,
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

    request = Request(
        robot,
        tuple(measurements),
        setup,
        tuple(package_dir or ()),
        base,
        tip,
        model,
        parameters,
        solver,
        loss,
        learned,
        use or ("both" if model_ladder else None),
        station_per_file,
        validation,
        holdout,
        start,
        process_noise,
        seed,
    )
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
