"""`calib-pin identify`: the identifiability of a robot's parameters."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import calib_pin.cli.options as options
from calib_pin.cli.files import (
    open_chains,
    open_measurements,
    open_setup,
    require_distinct,
    stated_blocks,
    tell_limits,
)
from calib_pin.cli.printing import progress_bar, show

if TYPE_CHECKING:
    from calib_pin.observations import BlockKey


def identify(
    robot: options.RobotName,
    measurements: Annotated[
        list[Path] | None,
        typer.Argument(
            metavar="[MEASUREMENTS...]",
            help="CSV or Parquet files; without them identifiability is structural.",
        ),
    ] = None,
    package_dir: options.PackageDirs = None,
    setup: options.SetupFile = None,
    model: options.Model = None,
    base: options.Base = None,
    tip: options.Tip = None,
    parameters: options.Parameters = None,
    station_per_file: options.StationPerFile = False,
    seed: options.Seed = 0,
    details: options.Details = False,
    json: options.Json = False,
) -> int:
    """Print which parameters are identifiable, and which only in combinations.

    Without measurements: structural identifiability, from the robot and the measurement
    model alone. With measurements: practical identifiability. No file is written.
    """
    from dataclasses import replace
    from functools import partial

    from calib_pin.calibration import calibrate as run
    from calib_pin.cli.documents import identification_document
    from calib_pin.estimation.evidence import TRUSTED
    from calib_pin.io.json_text import encode
    from calib_pin.io.other_robots import other_robots
    from calib_pin.planning.suggestions import calibrated_setup, suggestions
    from calib_pin.report.identification import identified
    from calib_pin.report.trust import below, findings, judged
    from calib_pin.validation.assessment import identify as structural
    from calib_pin.validation.result import Identification

    stated = open_setup(setup, base=base, tip=tip, model=model, parameters=parameters)
    found: Identification
    keys: Sequence[BlockKey]
    if measurements:
        require_distinct(measurements)
        # What is learned has no parameters that could be known.
        stated = replace(stated, learned=None)
        with progress_bar() as bar:
            chains, rows = open_measurements(
                measurements,
                open_chains(robot, stated, package_dirs=package_dir),
                stated,
                station_per_file=station_per_file,
                bar=bar,
            )
            result = run(
                chains,
                rows,
                stated,
                validate=False,
                seed=seed,
                progress=bar,
                others=partial(other_robots, chains, stated),
            )
        stated, keys = calibrated_setup(result.model), rows.keys
        found, verdict, reason = result, result.verdict, result.reason
        faults = result.findings
    else:
        keys = stated_blocks(stated)
        chains = open_chains(robot, stated, keys, package_dir)
        found = structural(chains, keys, stated, seed=seed)
        verdict, reason, faults = "good", "", ()
    tell_limits(chains)
    better = suggestions(chains, keys, stated, found, seed=seed)
    if json:
        document = identification_document(found, better, verdict, reason, faults)
        typer.echo(encode(document).decode(), nl=False)
    else:
        said = judged(below(reason, faults), verdict)
        doubts = [] if verdict in TRUSTED else [said]
        told = identified(
            found, fitted=bool(measurements), suggestions=better, details=details
        )
        show([*doubts, *findings(faults, reason), *told])
    return 0 if verdict in TRUSTED else 2
