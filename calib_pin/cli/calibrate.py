"""`calib-pin calibrate`: from a URDF and measurements to a corrected URDF."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated, NamedTuple

import typer

from calib_pin.cli.files import (
    check_outputs,
    exists,
    open_chain,
    open_measurements,
    open_setup,
    require_distinct,
)
from calib_pin.cli.options import (
    FIT,
    OUTPUT,
    Base,
    Force,
    Model,
    Parameters,
    Quiet,
    RobotName,
    Seed,
    SetupFile,
    Tip,
    number,
)
from calib_pin.cli.printing import notice, progress_bar, show

if TYPE_CHECKING:
    from calib_pin.result import CalibrationResult

__all__ = ["calibrate"]


def calibrate(
    context: typer.Context,
    robot: RobotName,
    measurements: Annotated[
        list[Path],
        typer.Argument(
            metavar="MEASUREMENTS...", help="CSV files, one row per measurement."
        ),
    ],
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            metavar="DIR",
            help="Folder of the results; without it they are only printed.",
            rich_help_panel=OUTPUT,
        ),
    ] = None,
    setup: SetupFile = None,
    model: Model = None,
    base: Base = None,
    tip: Tip = None,
    parameters: Parameters = None,
    solver: Annotated[
        str | None,
        typer.Option(
            "--solver",
            metavar="NAME",
            help="gauss-newton (default), two-step (frames and instrument, then the "
            "robot, by turns), de (differential evolution), or hybrid: de, then "
            "gauss-newton, for errors of centimeters and degrees.",
            rich_help_panel=FIT,
        ),
    ] = None,
    learned: Annotated[
        str | None,
        typer.Option(
            "--learned",
            metavar="NAME",
            help="Learn what the parameters leave: network, or gaussian-process; the "
            "only one that --model-ladder tries.",
            rich_help_panel=FIT,
        ),
    ] = None,
    model_ladder: Annotated[
        bool,
        typer.Option(
            "--model-ladder",
            help="Try joint offsets, geometry, transmission, compliance and learned "
            "corrections on unseen rows; keep the simplest of the best.",
            rich_help_panel=FIT,
        ),
    ] = False,
    validation: Annotated[
        Path | None,
        typer.Option(
            "--validation",
            metavar="FILE",
            help="Check the fit on the rows of this file.",
            rich_help_panel=FIT,
        ),
    ] = None,
    holdout: Annotated[
        float | None,
        typer.Option(
            "--holdout",
            metavar="PART",
            help="Check the fit on this part of the rows, such as 0.2.",
            parser=number(float, "--holdout", "a number between 0 and 1"),
            rich_help_panel=FIT,
        ),
    ] = None,
    seed: Seed = 0,
    force: Force = False,
    quiet: Quiet = False,
) -> int:
    """Fit a robot to measurements and write the corrected URDF.

    DIR gets <robot name>.urdf and calibration.json, and residual_model.json where
    something was learned. Without --validation, --holdout
    or a column 'set' (train, validate) the fit is checked by five-fold
    cross-validation. Exit status 2: the result must not be trusted, the reason comes
    first, and no URDF is written.
    """
    import time
    from dataclasses import replace

    from calib_pin.calibration import calibrate as run
    from calib_pin.measurements import AT
    from calib_pin.remedies import remedies
    from calib_pin.report.text import report

    stated = open_setup(
        setup,
        base=base,
        tip=tip,
        model=model,
        parameters=parameters,
        solver=solver,
        learned=learned,
    )
    if stated.solver.evolution and stated.solver.name not in ("de", "hybrid"):
        name = stated.solver.name
        notice(f"{name} does not use the options of the evolution in 'solver'")
    chain = open_chain(robot, stated)
    inputs = [robot, setup, validation, *measurements]
    files = None if output is None else _outputs(output, chain.robot.name)
    check_outputs(files or (), inputs, force)
    require_distinct([*measurements, *([] if validation is None else [validation])])
    rows = open_measurements(measurements, chain, stated, quiet=quiet)
    unseen = None
    if validation is not None:
        same = replace(stated, model=rows.model)
        sockets = {name.rpartition(AT)[2] for name in rows.of("fixed-point")}
        unseen = open_measurements(
            [validation], chain, same, quiet=True, sockets=sockets
        )
    if rows.validate.any() and (unseen is not None or holdout is not None):
        option = "--holdout" if unseen is None else "--validation"
        notice(f"the rows that 'set' marks for validation are not used with {option}")

    start = time.perf_counter()
    with progress_bar(quiet=quiet) as bar:
        result = run(
            chain,
            rows,
            stated,
            validation=unseen,
            holdout=holdout,
            ladder=model_ladder,
            seed=seed,
            progress=bar,
        )
    seconds = time.perf_counter() - start
    tool = result.model.tool
    better = remedies(chain, rows.model, stated, result, tool=tool, seed=seed)
    written = []
    if files is not None:
        words = ("calib-pin", *context.obj)
        written = _write(result, files, words, seconds, force)
    if not quiet:
        show(report(result, better))
        for path in written:
            typer.echo(f"wrote {path}")
    elif result.verdict != "good":
        notice(f"untrusted: {result.reason}")
    return 0 if result.verdict == "good" else 2


class _Outputs(NamedTuple):
    """Paths of the results."""

    urdf: Path
    json: Path
    residual_model: Path


def _outputs(folder: Path, robot: str) -> _Outputs:
    """Where the results go."""
    import re

    from calib_pin.errors import OptionError
    from calib_pin.io.residual_model import FILE_NAME

    if exists(folder) and not folder.is_dir():
        raise OptionError("is a file, not a folder", file=folder)
    # The name comes from the file: it must not lead out of the folder.
    name = re.sub(r"[^\w.-]", "_", robot).lstrip(".") or "robot"
    return _Outputs(
        folder / f"{name}.urdf", folder / "calibration.json", folder / FILE_NAME
    )


def _write(
    result: CalibrationResult,
    files: _Outputs,
    words: tuple[str, ...],
    seconds: float,
    force: bool,
) -> list[Path]:
    """Write the corrected URDF, if it can be trusted, calibration and residual model.

    What is there of an earlier run and not written now would pass for a result of this
    one, so it is removed.
    """
    from datetime import UTC, datetime
    from importlib.metadata import version

    from calib_pin.io.documents import Provenance, calibration_document, encode
    from calib_pin.io.files import write_atomically
    from calib_pin.io.residual_model import encode_residual_model, reference
    from calib_pin.io.results import write_urdf

    provenance = Provenance(
        command=words,
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        seconds=seconds,
        versions={
            "calib_pin": version("calib-pin"),
            "pinocchio": version("pin"),
            "numpy": version("numpy"),
        },
    )
    learned = encode_residual_model(result.model)
    refers = None if learned is None else reference(learned)
    document = encode(calibration_document(result, provenance, refers))
    written = []
    if result.geometry is not None:
        write_urdf(result.geometry, files.urdf, force=force)
        written.append(files.urdf)
    if learned is not None:
        write_atomically(files.residual_model, learned, force=force)
        written.append(files.residual_model)
    write_atomically(files.json, document, force=force)
    written.append(files.json)
    for path in files:
        if path not in written and exists(path):
            path.unlink()
            notice(f"removed {path} of an earlier run")
    if result.geometry is not None and result.geometry.tool_carries_tip:
        notice(
            f"'{result.model.chain.tip}' is the link of the last joint itself: the "
            "error behind that joint stands in frames.tool of calibration.json"
        )
    return written
