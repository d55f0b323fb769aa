"""`calib-pin evaluate`: accuracy on measurements that were not fitted."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib_pin.cli.options import (
    Base,
    Json,
    Model,
    SetupFile,
    Tip,
    open_chain,
    open_measurements,
    open_setup,
    show,
)

__all__ = ["evaluate"]


def evaluate(
    robot: Annotated[
        str,
        typer.Argument(
            metavar="ROBOT|calibration.json", help="A robot, or a calibration."
        ),
    ],
    measurements: Annotated[
        list[Path], typer.Argument(metavar="MEASUREMENTS...", help="CSV files.")
    ],
    setup: SetupFile = None,
    model: Model = None,
    base: Base = None,
    tip: Tip = None,
    register: Annotated[
        bool,
        typer.Option("--register", help="Fit base, tool and instrument to these rows."),
    ] = False,
    json: Json = False,
) -> int:
    """Print the accuracy of a robot or a calibration on measurements.

    A URDF knows neither base nor tool: they are registered on these rows, and the
    output says so. A calibration is taken as it is, unless --register is given.
    """
    from dataclasses import asdict, replace

    from calib_pin.calibration import evaluate as run
    from calib_pin.chain import Chain
    from calib_pin.errors import OptionError
    from calib_pin.io.results import encode, read_calibration
    from calib_pin.report.text import evaluation_report
    from calib_pin.result import CalibratedModel

    stated = open_setup(setup, base=base, tip=tip, model=model)
    subject: Chain | CalibratedModel
    if robot.endswith(".json"):
        if base is not None or tip is not None or model is not None:
            raise OptionError("a calibration has its own base, tip and model")
        subject = read_calibration(robot)
        chain = subject.chain
        stated = replace(stated, model=subject.measurement.name)
    else:
        subject = chain = open_chain(robot, stated)
    rows = open_measurements(measurements, chain, stated, quiet=json)
    evaluation = run(subject, rows, stated, registration=register)
    if json:
        errors = {
            name: {"unit": unit, **asdict(accuracy)}
            for name, unit, accuracy in evaluation.errors
        }
        document = {
            "rows": evaluation.rows,
            "registered": evaluation.registered,
            "errors": errors,
        }
        typer.echo(encode(document).decode(), nl=False)
    else:
        show(evaluation_report(evaluation))
    return 0
