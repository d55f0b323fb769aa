"""`calib-pin plan`: which configurations to measure."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from functools import partial
from pathlib import Path
from typing import Annotated

import typer

import calib_pin.cli.options as options
from calib_pin.cli.acceptance_plan import CYCLES, plan_acceptance, refuse_others
from calib_pin.cli.collisions import (
    Clearance,
    Srdf,
    check_options,
    open_collisions,
    require_solids,
)
from calib_pin.cli.files import (
    check_outputs,
    open_chains,
    open_measurements,
    open_setup,
    require_distinct,
    stated_blocks,
    tell_limits,
)
from calib_pin.cli.older import PlannedStart, as_before, open_older
from calib_pin.cli.printing import (
    notice,
    progress_bar,
    say,
    say_written,
    show,
    stage,
    told_command,
)
from calib_pin.cli.results import (
    FigureFormat,
    Figures,
    draw,
    figure_contents,
    figure_files,
    told_figures,
)
from calib_pin.cli.workforce import ClusterAddress, WorkerCount, asked_workers
from calib_pin.errors import OptionError, require_known

plan_option = partial(options.option, "Plan")

COUNT = options.number(int, "--count", "1 to 1000", 1, 1000)


def plan(
    context: typer.Context,
    robot: options.RobotName,
    output: Annotated[
        Path, options.output("-o --output CSV", "File of configurations to write.")
    ],
    model: options.Model = None,
    count: Annotated[
        int | None, plan_option("--count N", "Number of configurations.", COUNT)
    ] = None,
    add: Annotated[
        str | None,
        plan_option(
            "--add [N]", "Number of configurations to add to the measurements of --to."
        ),
    ] = None,
    to: Annotated[
        list[Path] | None,
        plan_option("--to CSV", "Measurements that exist already; may be repeated."),
    ] = None,
    start: PlannedStart = None,
    accept: Annotated[
        bool,
        plan_option(
            "--accept",
            "Plan an acceptance test instead: five poses of a cube, and its schedule.",
        ),
    ] = False,
    cycles: Annotated[
        int | None,
        plan_option(
            "--cycles N",
            "Visits of each pose of an acceptance test; default 30.",
            options.number(int, "--cycles", "3 to 1000", 3, 1000),
        ),
    ] = None,
    criterion: Annotated[
        str,
        plan_option(
            "--criterion NAME",
            "prediction (default; the predicted tool-point uncertainty), "
            "condition, or O1 to O5.",
        ),
    ] = "prediction",
    method: Annotated[
        str,
        plan_option(
            "--method NAME",
            "auto (default; exchange, then gradient), exchange, greedy, pso, ga "
            "or gradient.",
        ),
    ] = "auto",
    candidates: Annotated[
        int,
        plan_option(
            "--candidates N",
            "Quasi-random configurations to choose from.",
            options.number(int, "--candidates", "1 to 100000", 1, 1e5),
        ),
    ] = 1000,
    tests: Annotated[
        Path | None,
        plan_option(
            "--tests CSV",
            "Configurations where the robot is to be accurate; by default everywhere.",
        ),
    ] = None,
    seed: Annotated[int, options.seed("Plan")] = 0,
    workers: WorkerCount = None,
    cluster: ClusterAddress = None,
    limits: Annotated[
        list[str] | None,
        options.constraints(
            "--limits JOINT=A:B",
            "Narrower joint limits, such as 'joint_*=-2:2' or "
            "'elbow=-120:120 [deg]'; may be repeated.",
        ),
    ] = None,
    distance: Annotated[
        float,
        options.constraints(
            "--distance D",
            "Least distance between configurations, as the largest movement of "
            "a joint [rad, m].",
            options.number(float, "--distance", "0 to 10", 0.0, 10.0),
        ),
    ] = 0.0,
    srdf: Srdf = None,
    clearance: Clearance = None,
    ignore_collisions: Annotated[
        bool, options.constraints("--ignore-collisions", "Check no collisions.")
    ] = False,
    motion: Annotated[
        Path | None,
        options.output(
            "--motion CSV",
            "File of the whole motion to write: the configurations, with via "
            "configurations where the straight way collides.",
        ),
    ] = None,
    package_dir: options.PackageDirs = None,
    setup: options.SetupFile = None,
    base: options.Base = None,
    tip: options.Tip = None,
    chain: options.ChainName = None,
    parameters: options.Parameters = None,
    figures: Figures = None,
    figure_format: FigureFormat = "png",
    degrees: options.Degrees = False,
    force: options.Force = False,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> int:
    """Choose optimal calibration configurations, or plan an acceptance test.

    They keep the joint limits, collide with nothing, lie in the region of the setup
    file, and are ordered for short travel. A table shows the accuracy that more or
    fewer of them would give. Ctrl-C ends the search with the best plan so far. Exit
    status 2: no free way was found for --motion, which is not written.
    """
    from dataclasses import replace

    import numpy as np

    from calib_pin.cli.documents import plan_document
    from calib_pin.io.files import write_files
    from calib_pin.io.json_text import encode
    from calib_pin.io.measurements import (
        encode_configurations,
        read_configurations,
    )
    from calib_pin.io.targets import ROW
    from calib_pin.observations import fitted_and_held_out
    from calib_pin.planning.plan import CRITERION_NAMES, sides_of
    from calib_pin.planning.plan import plan as run
    from calib_pin.planning.search import METHODS
    from calib_pin.planning.ways import VIA, Ways
    from calib_pin.planning.workspace import joint_limits
    from calib_pin.report.compensation_text import line_list
    from calib_pin.report.plan_text import plan_report
    from calib_pin.solvers import Status
    from calib_pin.validation.recalibration import expected_setup

    stated = open_setup(setup, base=base, tip=tip, model=model, parameters=parameters)
    older = open_older(start)
    stated = as_before(stated, older, planned=True)
    require_known("criterion", criterion, CRITERION_NAMES)
    require_known("method", method, METHODS)
    if accept:
        refuse_others(context)
        stated = replace(stated, model="position")
    elif cycles is not None:
        raise OptionError("--cycles belongs to --accept")
    wanted = 0 if accept else _count(count, add, to)
    require_distinct(to or [])
    pictures = figure_files(figures, figure_format, "plan")
    inputs = (robot, setup, srdf, tests, start, *(to or []))
    check_outputs([output, *filter(None, [motion]), *pictures], inputs, force)
    if motion is not None and ignore_collisions:
        raise OptionError("--ignore-collisions contradicts --motion")
    check_options(
        not ignore_collisions,
        srdf,
        None,
        clearance,
        "--ignore-collisions contradicts",
    )
    rows = None
    if to:
        with progress_bar(quiet=quiet) as bar:
            chains, rows = open_measurements(
                to,
                open_chains(robot, stated, chain, package_dir),
                stated,
                chain=chain,
                quiet=quiet,
                bar=bar,
            )
        rows = fitted_and_held_out(rows)[0]
        keys = rows.keys
    else:
        keys = stated_blocks(stated, *filter(None, [chain]))
        chains = open_chains(robot, stated, keys, package_dir)
    if older is not None:
        stated = expected_setup(chains, stated, older)
    if not quiet:
        tell_limits(chains)
    narrower = options.parse_limits(limits or [], chains)
    stated = replace(stated, limits={**stated.limits, **narrower})
    # Nothing of the file may turn out to be impossible after a long search.
    names = (*stated.planes, *stated.targets, *stated.anchors)
    still = np.zeros((len(names), len(chains.joints)))
    encode_configurations(chains, still, names, joints=stated.joints)
    collisions = None
    if not ignore_collisions:
        collisions = open_collisions(
            chains,
            stated.obstacles,
            srdf,
            package_dir,
            clearance,
            file=stated.file,
            quiet=quiet,
        )
    if accept:
        typed = [robot, str(output)]
        for option, value in (("--setup", setup), ("--base", base), ("--tip", tip)):
            typed += [] if value is None else [option, str(value)]
        return plan_acceptance(
            chains,
            stated,
            collisions,
            CYCLES if cycles is None else cycles,
            typed,
            output,
            told_command(context),
            degrees=degrees,
            force=force,
            quiet=quiet,
        )
    if motion is not None:
        require_solids("--motion", chains, collisions)
    poses = (
        None
        if tests is None
        else read_configurations(tests, chains, stated.joints, stated.columns)
    )
    with (
        asked_workers(workers, cluster) as several,
        progress_bar(quiet=quiet) as bar,
        _interruptible(bar) as progress,
    ):
        found = run(
            chains,
            keys,
            wanted,
            stated,
            criterion=criterion,
            method=method,
            measured=rows,
            collisions=collisions,
            candidates=candidates,
            distance=distance,
            tests=poses,
            seed=seed,
            progress=progress,
            workers=several,
        )
        drawn = draw("plan", bar, found) if pictures else []
        figured = figure_contents(drawn, pictures)
    table = encode_configurations(
        chains,
        found.q,
        found.target,
        places=found.places,
        sides=sides_of(found),
        joints=stated.joints,
        degrees=degrees,
        comments=[f"planned by: {told_command(context)}"],
    )
    contents = {output: table, **figured}
    shut: list[int] = []
    if motion is not None and collisions is not None:
        with progress_bar(quiet=quiet) as bar:
            ways = Ways(chains, collisions, *joint_limits(found.problem))
            rng = np.random.default_rng(seed)
            passage = ways.through(found.q, rng, stage(bar, "ways"))
        # A configuration is named by its line in the other file.
        first = table.count(b"\n") - len(found.q) + 1
        shut = [first + k for k in passage.blocked]
        lines = ["" if k == VIA else str(first + k) for k in passage.row]
        whole = encode_configurations(
            chains,
            passage.q,
            places={ROW: lines},
            joints=stated.joints,
            degrees=degrees,
            comments=[f"motion of: {told_command(context)}"],
        )
        contents |= {} if shut else {motion: whole}
    with write_files(contents, force=force):
        if json:
            say(encode(plan_document(found)).decode())
        elif not quiet:
            show(plan_report(found))
    pictured = told_figures(figured, pictures)
    if not (json or quiet):
        written = [f"wrote {len(found.q)} configurations to {output}"]
        if motion in contents:
            written.append(f"wrote {passage.vias} more on the way to {motion}")
        say_written([*written, *pictured])
    if shut:
        notice(f"no motion: no free way was found to {output}, {line_list(shut)}")
    if found.status is Status.STOPPED:
        notice("interrupted: this is the best plan found so far")
    return 2 if shut else 0


def _count(count: int | None, add: str | None, to: list[Path] | None) -> int:
    """Number of configurations: `--count N`, or `--add N --to CSV`."""
    if add is not None and not to:
        raise OptionError("--add needs the measurements to add to: --to CSV")
    if to and add is None:
        raise OptionError("--to names measurements; say how many to add with --add N")
    if add:
        added = options.number(int, "--add", "1 to 1000", 1, 1000)(add)
        if count is not None and count != added:
            raise OptionError(
                f"--add {added} and --count {count} contradict each other"
            )
        return added
    if count is None:
        raise OptionError("say how many configurations to plan with --count N")
    return count


@contextmanager
def _interruptible(
    bar: Callable[[str, float], None] | None,
) -> Iterator[Callable[[str, float], bool]]:
    """Progress that asks to stop after Ctrl-C; a second one ends the program."""
    asked = False

    def interrupt(signum: int, frame: object) -> None:
        nonlocal asked
        if asked:
            raise KeyboardInterrupt
        asked = True

    def progress(stage: str, part: float) -> bool:
        if bar is not None:
            bar(stage, part)
        return asked

    before = signal.signal(signal.SIGINT, interrupt)
    try:
        yield progress
    finally:
        signal.signal(signal.SIGINT, before)
