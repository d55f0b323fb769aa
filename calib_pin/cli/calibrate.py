"""`calib-pin calibrate`: from a URDF and measurements to a corrected URDF."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

from calib_pin.cli.options import (
    Base,
    Force,
    Model,
    Parameters,
    Quiet,
    RobotName,
    Seed,
    SetupFile,
    Tip,
    open_chain,
    open_measurements,
    open_setup,
    show,
)

if TYPE_CHECKING:
    from calib_pin.result import CalibrationResult

__all__ = ["calibrate"]


def calibrate(
    robot: RobotName,
    measurements: Annotated[
        list[Path], typer.Argument(metavar="MEASUREMENTS...", help="CSV files.")
    ],
    output: Annotated[
        Path | None,
        typer.Option("-o", "--output", metavar="DIR", help="Where results go."),
    ] = None,
    setup: SetupFile = None,
    model: Model = None,
    base: Base = None,
    tip: Tip = None,
    parameters: Parameters = None,
    solver: Annotated[
        str, typer.Option("--solver", metavar="NAME", help="gauss-newton.")
    ] = "gauss-newton",
    validation: Annotated[
        Path | None,
        typer.Option("--validation", metavar="FILE", help="Rows to check with."),
    ] = None,
    holdout: Annotated[
        float | None,
        typer.Option("--holdout", metavar="PART", help="Part of rows to check with."),
    ] = None,
    seed: Seed = 0,
    force: Force = False,
    quiet: Quiet = False,
) -> int:
    """Calibrate a robot and write the corrected URDF and calibration.json to DIR.

    Without --validation, --holdout or a `set` column the fit is checked by five-fold
    cross-validation. Exit status 2: the result must not be trusted.
    """
    import time

    from calib_pin.calibration import calibrate as run
    from calib_pin.errors import OptionError
    from calib_pin.report.text import report

    if solver != "gauss-newton":
        raise OptionError("unknown solver", value=solver, allowed="gauss-newton")
    stated = open_setup(setup, base=base, tip=tip, model=model, parameters=parameters)
    chain = open_chain(robot, stated)
    rows = open_measurements(measurements, chain, stated, quiet=quiet)
    unseen = None
    if validation is not None:
        unseen = open_measurements([validation], chain, stated, quiet=True)
    files = None if output is None else _outputs(output, chain.robot.name, force)

    start = time.perf_counter()
    result = run(chain, rows, stated, validation=unseen, holdout=holdout, seed=seed)
    seconds = time.perf_counter() - start
    written = [] if files is None else _write(result, files, seconds, force)
    if not quiet:
        show(report(result))
        for path in written:
            typer.echo(f"wrote {path}")
    return 0 if result.verdict == "good" else 2


def _outputs(folder: Path, robot: str, force: bool) -> tuple[Path, Path]:
    """Paths of URDF and JSON; complains before the work, not after it."""
    import re

    from calib_pin.errors import OptionError

    # The name comes from the file: it must not lead out of the folder.
    name = re.sub(r"[^\w.-]", "_", robot).lstrip(".") or "robot"
    files = folder / f"{name}.urdf", folder / "calibration.json"
    if folder.exists() and not folder.is_dir():
        raise OptionError("is a file, not a folder", file=folder)
    for path in files:
        if path.exists() and not force:
            raise OptionError("exists already; --force replaces it", file=path)
    return files


def _write(
    result: CalibrationResult, files: tuple[Path, Path], seconds: float, force: bool
) -> list[Path]:
    """Write the corrected URDF, if it can be trusted, and calibration.json."""
    import sys
    from datetime import UTC, datetime
    from importlib.metadata import version

    from calib_pin.io.files import write_atomically
    from calib_pin.io.results import (
        Provenance,
        calibration_document,
        encode,
        write_urdf,
    )

    urdf, json = files
    provenance = Provenance(
        command=("calib-pin", *sys.argv[1:]),
        created=datetime.now(UTC).isoformat(timespec="seconds"),
        seconds=seconds,
        versions={
            "calib_pin": version("calib-pin"),
            "pinocchio": version("pin"),
            "numpy": version("numpy"),
        },
    )
    document = encode(calibration_document(result, provenance))
    written = [json]
    if result.verdict == "good":
        write_urdf(result.model, urdf, force=force)
        written.insert(0, urdf)
    write_atomically(json, document, force=force)
    return written
