"""`calib-pin plan`: which configurations to measure."""

from __future__ import annotations

import signal
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from functools import partial
from typing import TYPE_CHECKING

import typer

import calib_pin.cli.options as options
from calib_pin.cli.acceptance_plan import plan_acceptance
from calib_pin.cli.collisions import require_solids
from calib_pin.cli.files import (
    check_outputs,
    open_measurements,
    require_distinct,
    stated_blocks,
    tell_limits,
)
from calib_pin.cli.older import as_before, open_older
from calib_pin.cli.plan_request import PlanRequest
from calib_pin.cli.printing import notice, progress_bar, stage, told_command
from calib_pin.cli.results import (
    draw,
    figure_contents,
    figure_files,
    told_figures,
)
from calib_pin.cli.workforce import asked_workers

if TYPE_CHECKING:
    from calib_pin.kinematics.chains import Chains
    from calib_pin.observations import BlockKey, Observations
    from calib_pin.setup import Setup
    from calib_pin.validation.result import CalibrationResult


@options.spread
def plan(asked: PlanRequest, context: typer.Context) -> int:
    """Choose optimal calibration configurations, or plan an acceptance test.

    They keep the joint limits, collide with nothing, lie in the region of the setup
    file, and are ordered for short travel. A table shows the accuracy that more or
    fewer of them would give. Ctrl-C ends the search with the best plan so far. Exit
    status 2: no free way was found for --motion, which is not written.
    """
    import numpy as np

    from calib_pin.cli.documents import plan_document
    from calib_pin.io.measurements import encode_configurations, read_configurations
    from calib_pin.io.targets import ROW
    from calib_pin.planning.plan import plan as run
    from calib_pin.planning.plan import sides_of
    from calib_pin.planning.travel import VIA, Ways
    from calib_pin.planning.workspace import joint_limits
    from calib_pin.report.compensation_text import line_list
    from calib_pin.report.plan_text import plan_report
    from calib_pin.solvers import Status

    older = open_older(asked.start)
    stated = as_before(asked.stated(), older, planned=True)
    asked.check()
    require_distinct(asked.to or [])
    pictures = figure_files(asked.figures, asked.figure_format, "plan")
    inputs = [asked.robot, asked.setup, asked.srdf, asked.tests, asked.start]
    inputs += asked.to or []
    check_outputs([asked.output, asked.motion, *pictures], inputs, asked.force)
    if asked.accept:
        stated = replace(stated, model="position")
    chains, keys, rows, stated = _opened(asked, stated, older)
    collisions = None
    if not asked.ignore_collisions:
        collisions = asked.collisions(chains, stated.obstacles, stated.file)
    if asked.accept:
        return plan_acceptance(asked, chains, stated, collisions, told_command(context))
    if asked.motion is not None:
        require_solids("--motion", chains, collisions)
    poses = None
    if asked.tests is not None:
        poses = read_configurations(asked.tests, chains, stated.joints, stated.columns)
    with (
        asked_workers(asked.workers, asked.cluster) as several,
        progress_bar(quiet=asked.quiet) as bar,
        _interruptible(bar) as progress,
    ):
        found = run(
            chains,
            keys,
            asked.wanted(),
            stated,
            criterion=asked.criterion,
            method=asked.method,
            measured=rows,
            collisions=collisions,
            candidates=asked.candidates,
            distance=asked.distance,
            tests=poses,
            seed=asked.seed,
            progress=progress,
            workers=several,
        )
        figures = figure_contents(
            draw("plan", bar, found) if pictures else [], pictures
        )
    command = told_command(context)
    encode = partial(
        encode_configurations, chains, joints=stated.joints, degrees=asked.degrees
    )
    table = encode(
        found.q,
        found.target,
        places=found.places,
        sides=sides_of(found),
        comments=[f"planned by: {command}"],
    )
    contents, shut = {asked.output: table, **figures}, list[int]()
    written = [f"wrote {len(found.q)} configurations to {asked.output}"]
    if asked.motion is not None and collisions is not None:
        with progress_bar(quiet=asked.quiet) as bar:
            ways = Ways(chains, collisions, *joint_limits(found.problem))
            rng = np.random.default_rng(asked.seed)
            passage = ways.through(found.q, rng, stage(bar, "ways"))
        # A configuration is named by its line in the other file.
        first = table.count(b"\n") - len(found.q) + 1
        shut = [first + k for k in passage.blocked]
        lines = ["" if k == VIA else str(first + k) for k in passage.row]
        if not shut:
            contents[asked.motion] = encode(
                passage.q, places={ROW: lines}, comments=[f"motion of: {command}"]
            )
            written.append(f"wrote {passage.vias} more on the way to {asked.motion}")
    written += told_figures(figures, pictures)
    asked.give(contents, lambda: plan_document(found), plan_report(found), written)
    if shut:
        notice(f"no motion: no free way was found to {asked.output}, {line_list(shut)}")
    if found.status is Status.STOPPED:
        notice("interrupted: this is the best plan found so far")
    return 2 if shut else 0


def _opened(
    asked: PlanRequest, stated: Setup, older: CalibrationResult | None
) -> tuple[Chains, Sequence[BlockKey], Observations | None, Setup]:
    """The chains, what is measured there, what was measured before, and the setup."""
    import numpy as np

    from calib_pin.io.measurements import encode_configurations
    from calib_pin.observations import fitted_and_held_out
    from calib_pin.validation.robot_state import expected_setup

    rows = None
    if asked.to:
        with progress_bar(quiet=asked.quiet) as bar:
            chains, rows = open_measurements(
                asked.to,
                asked.chains(stated, asked.chain),
                stated,
                chain=asked.chain,
                quiet=asked.quiet,
                bar=bar,
            )
        rows = fitted_and_held_out(rows)[0]
        keys = rows.keys
    else:
        keys = stated_blocks(stated, *filter(None, [asked.chain]))
        chains = asked.chains(stated, keys)
    if older is not None:
        stated = expected_setup(chains, stated, older)
    if not asked.quiet:
        tell_limits(chains)
    narrower = options.parse_limits(asked.limits or [], chains)
    # Nothing of the file may turn out to be impossible after a long search.
    names = (*stated.planes, *stated.targets, *stated.anchors)
    still = np.zeros((len(names), len(chains.joints)))
    encode_configurations(chains, still, names, joints=stated.joints)
    limits = {**stated.limits, **narrower}
    return chains, keys, rows, replace(stated, limits=limits)


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
