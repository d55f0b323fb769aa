"""`calib-pin simulate`: measurements of a robot with known errors."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import typer

import calib_pin.cli.options as options
from calib_pin.cli.files import (
    check_outputs,
    open_chains,
    open_setup,
    stated_blocks,
    tell_limits,
)
from calib_pin.cli.printing import (
    notice,
    progress_bar,
    say_json,
    say_written,
    stage,
    told_command,
)
from calib_pin.errors import InputError, OptionError

if TYPE_CHECKING:
    from calib_pin.observations import BlockKey, Booleans, Labels

study_option = partial(options.option, "Simulation")

PLACES = ("chain", "station", "tool")
"""Columns of a file that say which block measures a configuration."""


def simulate(
    context: typer.Context,
    robot: options.RobotName,
    output: Annotated[
        Path, options.output("-o --output CSV", "Measurement file to write.")
    ],
    model: Annotated[
        str | None,
        study_option(
            "--model NAME",
            "Measurement model; 'list' prints all.",
            callback=options.listed,
        ),
    ] = None,
    count: Annotated[
        int | None,
        study_option(
            "--count N",
            "Number of random configurations, or",
            options.number(int, "--count", "1 to 1000000", 1, 1e6),
        ),
    ] = None,
    configurations: Annotated[
        Path | None,
        study_option("--configurations CSV", "the configurations of this file."),
    ] = None,
    errors: Annotated[
        Path | None,
        study_option(
            "--errors YAML", "True errors by parameter name [m, rad]; by default drawn."
        ),
    ] = None,
    seed: Annotated[
        int,
        options.seed("Simulation", "Random seed of errors, configurations and noise."),
    ] = 0,
    noise: Annotated[
        float | None,
        study_option(
            "--noise S",
            "Standard deviation of every component [m, rad]; by default that of "
            "the setup file, or 0.1 mm and 0.1 mrad.",
            options.number(float, "--noise", "0 to 1 m or rad", 0.0, 1.0),
        ),
    ] = None,
    repeats: Annotated[
        int,
        study_option(
            "--repeats K",
            "Readings per configuration.",
            options.number(int, "--repeats", "1 to 1000000", 1, 1e6),
        ),
    ] = 1,
    average: Annotated[
        bool,
        study_option(
            "--average", "Average the readings of a configuration into one measurement."
        ),
    ] = False,
    all_targets: Annotated[
        bool,
        study_option(
            "--all-targets",
            "Measure all targets that the instrument sees at each configuration, as "
            "the corners of a board in an image.",
        ),
    ] = False,
    truth: Annotated[
        Path | None,
        options.output("--truth URDF", "Write the robot with its true errors."),
    ] = None,
    package_dir: options.PackageDirs = None,
    setup: options.SetupFile = None,
    base: options.Base = None,
    tip: options.Tip = None,
    parameters: options.Parameters = None,
    force: options.Force = False,
    json: options.Json = False,
) -> int:
    """Simulate measurements of a robot with true errors, given or drawn.

    Errors that are not given are drawn uniformly within the expected size of each
    parameter, such as plus and minus 1 mm and 3 mrad for a placement. Frames and planes
    are taken from the setup file. Its chains, stations and tools share the
    configurations, unless columns 'chain', 'station' and 'tool' of --configurations say
    what is measured at each. Of a board each image shows all corners in sight.
    """
    import numpy as np

    from calib_pin.estimation.formulation import nominal_problem
    from calib_pin.io.calibrated_model import encode_urdf
    from calib_pin.io.files import write_files
    from calib_pin.io.measurements import (
        encode_table,
        read_configurations,
        read_held,
        read_names,
    )
    from calib_pin.io.setup import read_true_errors
    from calib_pin.io.written_columns import measurement_columns
    from calib_pin.observations import Observations
    from calib_pin.simulation import draw_errors
    from calib_pin.simulation import simulate as run
    from calib_pin.validation.calibrated_model import CalibratedModel

    stated = open_setup(setup, base=base, tip=tip, model=model, parameters=parameters)
    keys = stated_blocks(stated)
    if (count is None) == (configurations is None):
        raise OptionError("give either --count or --configurations")
    check_outputs((output, truth), (robot, setup, configurations, errors), force)
    if configurations is not None:
        named = read_names(configurations, "chain", stated.columns).distinct
        keys = stated_blocks(stated, *named)
    chains = open_chains(robot, stated, keys, package_dir)
    problem = nominal_problem(chains, keys, stated)
    rng = np.random.default_rng(seed)
    if errors is None:
        theta = draw_errors(problem.parameters, rng)
    else:
        given = read_true_errors(errors, problem.parameters.names)
        theta = problem.parameters.vector(given)
    measure = partial(
        run,
        problem,
        theta,
        rng,
        # An image shows all corners of a board.
        per_configuration=all_targets or stated.board is not None,
        noise=noise,
        repeats=repeats,
        average=average,
    )
    comment = f"simulated by: {told_command(context)}"
    with progress_bar() as bar:
        stage(bar, "measure")
        if configurations is None:
            tell_limits(chains)
            rows = measure(count=count)
        else:
            q = read_configurations(
                configurations, chains, stated.joints, stated.columns
            )
            target = read_names(configurations, "target", stated.columns)
            held = read_held(configurations, chains.joints, q, stated.columns)
            places = {
                kind: read_names(configurations, kind, stated.columns)
                for kind in PLACES
            }
            if not any(map(len, (target, *places.values()))):
                rows = measure(q=q, conditions=held)
            else:
                rows = Observations.of(
                    *(
                        measure(
                            key=key,
                            q=q[at],
                            target=target[at] if len(target) else target,
                            conditions=held.rows(at),
                        )
                        for key, at in _shared(configurations, keys, places, len(q))
                    )
                )
        tell = stage(bar, "write")
        columns = dict(measurement_columns(rows))
        contents = {output: encode_table(columns, [comment], tell)}
        true = CalibratedModel.create(problem, theta)
        if truth is not None:
            contents[truth] = encode_urdf(true.without_corrections, truth)
        with write_files(contents, force=force):
            pass
    told = [f"wrote {len(rows)} measurements to {output}"]
    if truth is not None:
        if any(true.of(name).tool_carries_tip for name in true.measured_chains):
            notice(f"{truth} lacks the error behind the last joint: no link holds it")
        if not true.geometric:
            notice(f"{truth} holds the geometry only; a URDF cannot hold other errors")
        told.append(f"wrote the true robot to {truth}")
    if json:
        document = {"measurements": len(rows), "models": list(rows.models)}
        say_json(document, contents)
    else:
        say_written(told)
    return 0


def _shared(
    file: Path, keys: Sequence[BlockKey], places: Mapping[str, Labels], count: int
) -> Iterator[tuple[BlockKey, Booleans]]:
    """The blocks that measure configurations of a file, and which, shape (count,).

    Raises:
        InputError: If a configuration is of none of them.
    """
    import numpy as np

    left = np.ones(count, bool)
    for key in keys:
        at = np.ones(count, bool)
        for kind, labels in places.items():
            if len(labels):
                at &= labels.where(getattr(key, kind))
        left &= ~at
        if at.any():
            yield key, at
    if left.any():
        raise InputError(
            f"configuration {int(np.argmax(left)) + 1} is of no chain, station and "
            "tool that the setup states",
            file=file,
            allowed="; ".join(map(str, keys)),
        )
