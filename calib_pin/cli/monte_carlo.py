"""`calib-pin fleet --monte-carlo`: a study of simulated robots."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

from calib_pin.cli.files import (
    check_outputs,
    exists,
    open_chains,
    stated_blocks,
    tell_limits,
)
from calib_pin.cli.options import QuietAnswer
from calib_pin.cli.printing import Bar
from calib_pin.errors import OptionError

if TYPE_CHECKING:
    from calib_pin.monte_carlo import Study, Trial
    from calib_pin.setup import Setup
    from calib_pin.workers import Workers

TRIALS = "monte-carlo.csv"
FILES = ("monte-carlo.json", "monte-carlo.html")
"""Files of a study: its trials, and what they tell."""


def simulated(
    file: Path,
    output: Path,
    answer: QuietAnswer,
    workers: Workers,
    bar: Bar | None,
    seed: int,
    resume: bool,
) -> int:
    """Simulate the robots of a study; returns the exit status."""
    from calib_pin.cli.documents import outlook_document
    from calib_pin.io.json_text import encode
    from calib_pin.io.setup import read_setup
    from calib_pin.io.trials import kept, read_trials
    from calib_pin.monte_carlo import outlooks, try_robot
    from calib_pin.report.figures import Foreseen, drawn
    from calib_pin.report.fleet_text import outlook_report
    from calib_pin.report.html import blocks_page

    stated = read_setup(file)
    study, name = _study(file, stated, seed)
    trials, files = output / TRIALS, [output / name for name in FILES]
    replaced = answer.force or resume
    check_outputs([trials, *files], [file, stated.monte_carlo.plan], replaced)
    robots = stated.monte_carlo.robots
    known: list[tuple[Trial, ...]] = []
    if resume and exists(trials):
        known = read_trials(trials, name, len(study.counts))[:robots]
    further = workers.map(try_robot, study, range(len(known), robots))
    done = _told(kept(trials, name, known, further), robots, bar)
    found = outlooks((trial for own in done for trial in own), stated.limit)
    blocks = [*outlook_report(study, found, stated.limit)]
    title = f"Expected accuracy of {study.chains.robot.name}"
    document = outlook_document(study, found, stated.limit)
    figures = [*drawn("outlook", Foreseen(found, stated.limit))]
    contents = {
        files[0]: encode(document),
        files[1]: blocks_page(title, blocks, figures, files[0].name),
    }
    made = [str(path) for path in (trials, *files)]
    replace(answer, force=True).give(
        contents,
        lambda: {**document, "written": made},
        blocks,
        [f"wrote {path}" for path in made],
    )
    return 0


def _study(file: Path, stated: Setup, seed: int) -> tuple[Study, str]:
    """The study of a setup file, and a hash of everything its numbers depend on."""
    from calib_pin.io.files import sha256
    from calib_pin.io.json_text import encode
    from calib_pin.io.measurements import read_configurations
    from calib_pin.io.setup import setup_document
    from calib_pin.monte_carlo import study_of

    asked = stated.monte_carlo
    for key, value in (("monte_carlo.robot", asked.robot), ("model", stated.model)):
        if value is None:
            raise OptionError(f"'{key}' is missing", file=file)
    assert asked.robot is not None
    there = file.parent / asked.robot.split(" ")[0]
    robot = str(file.parent / asked.robot) if exists(there) else asked.robot
    keys = stated_blocks(stated)
    chains = open_chains(robot, stated, keys)
    tell_limits(chains)
    plan = None
    if asked.plan is not None:
        path = file.parent / asked.plan
        plan = read_configurations(path, chains, stated.joints, stated.columns)
    study = study_of(chains, keys, stated, plan, seed)
    # Of the same robots, more of them may be asked for.
    same = replace(stated, monte_carlo=replace(asked, robots=1, plan=None, robot=None))
    about = {
        "setup": setup_document(same),
        "robot": sha256(chains.robot.source),
        "plan": None if plan is None else plan.tolist(),
        "seed": seed,
    }
    return study, sha256(encode(about))


def _told(
    trials: Iterable[tuple[Trial, ...]], robots: int, bar: Bar | None
) -> Iterator[tuple[Trial, ...]]:
    for k, own in enumerate(trials, 1):
        if bar is not None:
            bar(f"{k} of {robots} robots", k / robots)
        yield own
