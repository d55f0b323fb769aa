"""`calib-pin simulate`: measurements of a robot with known errors."""

from __future__ import annotations

from pathlib import Path
from typing import Annotated

import typer

from calib_pin.cli.options import (
    Base,
    Force,
    Parameters,
    RobotName,
    SetupFile,
    Tip,
    open_chain,
    open_setup,
)

__all__ = ["simulate"]


def simulate(
    robot: RobotName,
    output: Annotated[
        Path, typer.Option("-o", "--output", metavar="CSV", help="Measurement file.")
    ],
    model: Annotated[
        str | None,
        typer.Option("--model", metavar="NAME", help="How the robot is measured."),
    ] = None,
    count: Annotated[
        int | None,
        typer.Option("--count", metavar="N", help="Random configurations.", min=1),
    ] = None,
    configurations: Annotated[
        Path | None,
        typer.Option("--configurations", metavar="CSV", help="Or these ones."),
    ] = None,
    errors: Annotated[
        Path | None,
        typer.Option(
            "--errors", metavar="YAML", help="True errors by parameter name (SI)."
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option("--seed", metavar="N", help="Seed; draws errors.", min=0)
    ] = 0,
    noise: Annotated[
        float | None,
        typer.Option("--noise", metavar="S", help="Standard deviation [m, rad]."),
    ] = None,
    repeats: Annotated[
        int, typer.Option("--repeats", metavar="K", help="Readings per configuration.")
    ] = 1,
    average: Annotated[
        bool, typer.Option("--average", help="Average the readings into one row.")
    ] = False,
    truth: Annotated[
        Path | None,
        typer.Option("--truth", metavar="URDF", help="Write the true robot."),
    ] = None,
    setup: SetupFile = None,
    base: Base = None,
    tip: Tip = None,
    parameters: Parameters = None,
    force: Force = False,
) -> int:
    """Simulate measurements of a robot with true errors, given or drawn.

    Errors that are not given are drawn uniformly within plus and minus 1 mm and
    3 mrad of every parameter. Frames and planes are those of the setup file.
    """
    import numpy as np

    from calib_pin.calibration import nominal_problem
    from calib_pin.cli.options import notice
    from calib_pin.errors import OptionError
    from calib_pin.io.measurements import read_configurations, write_measurements
    from calib_pin.io.results import write_urdf
    from calib_pin.io.true_errors import read_true_errors
    from calib_pin.result import CalibratedModel
    from calib_pin.simulation import draw_errors
    from calib_pin.simulation import simulate as run

    stated = open_setup(setup, base=base, tip=tip, model=model, parameters=parameters)
    if stated.model is None:
        raise OptionError(
            "name how the robot is measured with --model",
            allowed="position, pose, plane-distance",
        )
    if (count is None) == (configurations is None):
        raise OptionError("give either --count or --configurations")
    for path in (output, truth):
        if path is not None and path.exists() and not force:
            raise OptionError("exists already; --force replaces it", file=path)
    chain = open_chain(robot, stated)
    problem = nominal_problem(chain, stated.model, stated)
    rng = np.random.default_rng(seed)
    theta = (
        draw_errors(problem.parameters, rng)
        if errors is None
        else problem.parameters.vector(read_true_errors(errors))
    )
    rows = run(
        problem,
        theta,
        rng,
        q=None
        if configurations is None
        else read_configurations(configurations, chain, stated.joints),
        count=count,
        noise=noise,
        repeats=repeats,
        average=average,
    )
    source = "drawn" if errors is None else f"from {errors}"
    write_measurements(
        output,
        rows,
        comments=[
            f"simulated by calib-pin: {robot}, {stated.model}, errors {source}, "
            f"seed {seed}, {repeats} readings{' averaged' if average else ''}"
        ],
        force=force,
    )
    notice(f"wrote {len(rows)} rows to {output}")
    if truth is not None:
        write_urdf(CalibratedModel.create(problem, theta), truth, force=force)
        notice(f"wrote the true robot to {truth}")
    return 0
