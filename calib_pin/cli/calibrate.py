"""`calib-pin calibrate`: from a URDF and measurements to a corrected URDF."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

import calib_pin.cli.options as options
from calib_pin.cli.files import (
    check_outputs,
    open_chains,
    open_measurements,
    open_setup,
    other_readings,
    require_distinct,
)
from calib_pin.cli.printing import notice, progress_bar, say_written, show
from calib_pin.cli.results import (
    FigureFormat,
    Figures,
    Run,
    check_results,
    draw_calibration,
    figure_contents,
    figure_files,
    result_contents,
    result_files,
    told_figures,
    write_results,
)


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
    figures: Figures = None,
    figure_format: FigureFormat = "png",
    seed: options.Seed = 0,
    force: options.Force = False,
    quiet: options.Quiet = False,
) -> int:
    """Fit a robot to measurements and write the corrected URDF.

    DIR receives <robot name>.urdf, nominal.urdf, calibration.json, measurements.csv
    (residuals), report.html (for the browser) and, with a learned correction,
    residual_model.json; it can be moved as a whole. Without --validation, --holdout or
    a column 'set' (train, validate), five-fold cross-validation checks the fit. Where
    there is nothing to correct, <robot name>.urdf is the nominal file. Exit status 2:
    the result is unchecked or must not be trusted; the reason comes first, and no
    <robot name>.urdf is written.
    """
    import time
    from dataclasses import replace

    from calib_pin.calibration import calibrate as run
    from calib_pin.estimation.evidence import TRUSTED
    from calib_pin.io.files import write_files
    from calib_pin.io.measured_columns import place_of
    from calib_pin.planning.suggestions import calibrated_setup, suggestions
    from calib_pin.report.text import report

    stated = open_setup(
        setup,
        base=base,
        tip=tip,
        model=model,
        parameters=parameters,
        solver=solver,
        loss=loss,
        learned=learned,
    )
    if stated.solver.evolution and stated.solver.name not in ("de", "hybrid"):
        name = stated.solver.name
        notice(f"{name} ignores the options of differential evolution in 'solver'")
    chains = open_chains(robot, stated, package_dirs=package_dir)
    inputs = [robot, setup, validation, *measurements]
    files = None if output is None else result_files(output, chains.robot.name)
    pictures = figure_files(figures, figure_format, "calibration")
    if files is None:
        check_outputs(pictures, inputs, force)
    else:
        check_results(files, pictures, chains.robot, inputs, force)
    require_distinct([*measurements, *([] if validation is None else [validation])])
    with progress_bar(quiet=quiet) as bar:
        chains, rows = open_measurements(
            measurements,
            chains,
            stated,
            station_per_file=station_per_file,
            quiet=quiet,
            bar=bar,
        )
    unseen = None
    if validation is not None:
        same = replace(stated, model="+".join(rows.models))
        sockets = map(place_of, rows.target.distinct)
        _, unseen = open_measurements(
            [validation],
            chains,
            same,
            station_per_file=station_per_file,
            quiet=True,
            sockets=sockets,
        )
    if rows.validate.any() and (unseen is not None or holdout is not None):
        option = "--holdout" if unseen is None else "--validation"
        notice(
            f"the measurements that 'set' marks for validation are not used with "
            f"{option}"
        )

    start = time.perf_counter()
    with progress_bar(quiet=quiet) as bar:
        result = run(
            chains,
            rows,
            stated,
            validation=unseen,
            holdout=holdout,
            ladder=model_ladder,
            seed=seed,
            progress=bar,
            others=other_readings(
                measurements, chains, stated, station_per_file=station_per_file
            ),
        )
        fitted = Run(("calib-pin", *context.obj), time.perf_counter() - start)
        stood = calibrated_setup(result.model)
        better = suggestions(chains, rows.keys, stood, result, seed=seed)
        shown = files is not None or figures is not None
        drawn = draw_calibration(result, bar) if shown else []
        contents = drawings = figure_contents(drawn, pictures)
        if files is not None:
            contents = result_contents(result, files, fitted, drawn, drawings, better)
    with (
        write_files(contents, force=force)
        if files is None
        else write_results(result, files, contents, force=force)
    ):
        if not quiet:
            show(report(result, better))
    pictured = told_figures(drawings, pictures)
    if not quiet:
        written = [path for path in files or () if path in contents]
        say_written([*(f"wrote {path}" for path in written), *pictured])
    elif result.verdict not in TRUSTED:
        notice(f"{result.verdict}: {result.reason}")
    return 0 if result.verdict in TRUSTED else 2
