"""`calib-pin fleet`: many calibrations, real or simulated."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import calib_pin.cli.files as files
import calib_pin.cli.jobs as jobs
import calib_pin.estimation.statistics.population_prior as population_prior
from calib_pin.cli.asked import Fleet
from calib_pin.cli.jobs import Job, Outcome
from calib_pin.cli.options import OfRobot, asked_workers
from calib_pin.cli.printing import notice, progress_bar, stage
from calib_pin.errors import OptionError, counted
from calib_pin.estimation.statistics.population_prior import RobotEvidence
from calib_pin.io import json_text, measurements, results
from calib_pin.io.files import sha256
from calib_pin.io.json_text import Json, encode, format_keys
from calib_pin.io.measurements import read_configurations
from calib_pin.io.results import model_name
from calib_pin.io.setup import prior_document, read_setup, setup_document
from calib_pin.io.trials import read_trials, written_trials
from calib_pin.monte_carlo import Study, Trial, outlooks, study_of, try_robot
from calib_pin.monte_carlo.summary import LEVELS
from calib_pin.report import fleet_text, html
from calib_pin.report.figures import drawn
from calib_pin.setup import Setup
from calib_pin.setup.population import PopulationPrior
from calib_pin.validation.fleet import by_urgency, fleet_columns

TABLE, PAGE, PRIOR = FILES = ("fleet.csv", "fleet.html", "fleet.json")
"""Files of a fleet beside the folders of its calibrations.

The last one is the prior that robots are for the next one of their type: `prior` in its
setup.
"""

TRIALS, NUMBERS, CURVES = (f"monte-carlo.{kind}" for kind in ("csv", "json", "html"))
"""Files of a study: its trials, and what they tell."""


def fleet(asked: Fleet) -> int:
    """Do what `Fleet` asks for."""
    if asked.table is not None:
        return _calibrate(asked, asked.table)
    if asked.monte_carlo is not None:
        return _simulate(asked, asked.monte_carlo)
    raise OptionError("give either a table of JOBS, or --monte-carlo SETUP")


# --- calibrations -------------------------------------------------------------------


def _calibrate(asked: Fleet, table: Path) -> int:
    """Calibrate the robots of a table."""
    output, every = asked.output, jobs.read_jobs(table, notice)
    force, tables = asked.force or asked.resume, [output / name for name in FILES]
    for job in every:
        if not force and files.exists(folder := output / job.name):
            reason = "exists; --resume goes on, --force begins again"
            raise OptionError(reason, file=folder)
    files.check_outputs(tables, [table], force)
    done = dict[str, Outcome]()
    with (
        # A job may end the process that does it, so none is done here.
        asked_workers(asked.workers, asked.cluster, patience=0.0) as workers,
        progress_bar(quiet=asked.quiet) as bar,
    ):
        for wave in _waves(every):
            fitted = {name for name, (row, _) in done.items() if row.fitted}
            known = [j if j.before in fitted else replace(j, before="") for j in wave]
            shared = Path.cwd(), asked
            for entry in workers.map(jobs.calibrate_job, shared, known, jobs.lost_job):
                done[entry.row.job] = entry
                if bar is not None:
                    bar(f"{len(done)} of {len(every)}", len(done) / len(every))
        stage(bar, "types")
        populations = types_of(every, done)
    urgent = by_urgency([done[job.name].row for job in every])
    columns = fleet_columns(urgent)
    page = [*fleet_text.fleet_report(urgent, populations, fleet_text.MANY)]
    title = "Calibrations of a fleet"
    contents = {
        output / TABLE: measurements.encode_table(columns, []),
        output / PAGE: html.blocks_page(title, page, [], TABLE),
        **priors(output, populations),
    }
    folders = sum(row.fitted > 0 for row in urgent)
    written = [f"wrote {counted(folders, 'folder')} to {output}"]
    written += [f"wrote {file}" for file in contents]
    report = fleet_text.fleet_report(urgent, populations)
    # What is there was looked for before the work.
    replace(asked, force=True).give(contents, report, written)
    return 0 if all(row.trusted for row in urgent) else 2


def _waves(jobs: Sequence[Job]) -> Iterator[list[Job]]:
    """The jobs; each comes behind that before of its serial number."""
    remaining = list(jobs)
    while remaining:
        names = {job.name for job in remaining}
        waiting = [job for job in remaining if job.before in names]
        yield [job for job in remaining if job not in waiting]
        remaining = waiting


def types_of(jobs: Sequence[Job], done: Mapping[str, Outcome]) -> list[PopulationPrior]:
    """The priors of a fleet's types; of a serial number its last calibration counts.

    Args:
        jobs: The jobs.
        done: Their outcomes by their names.

    Returns:
        Those of types with robots enough, the largest first.
    """
    earlier = {job.before for job in jobs}
    last = (done[job.name].evidence for job in jobs if job.name not in earlier)
    groups: list[list[RobotEvidence]] = []
    for entry in filter(None, last):
        for group in groups:
            of_type = not group[0].robot.difference(entry.robot)
            if of_type and group[0].names == entry.names:
                group.append(entry)
                break
        else:
            groups.append([entry])
    large = [group for group in groups if len(group) >= population_prior.LEAST]
    large.sort(key=len, reverse=True)
    return [population_prior.prior_of_type(group) for group in large]


def priors(folder: Path, populations: Sequence[PopulationPrior]) -> dict[Path, bytes]:
    """The files of the priors; all but the first have the name of their robot."""
    contents: dict[Path, bytes] = {}
    for number, population in enumerate(populations, 1):
        robot = Path(results.urdf_name(population.robot.name)).stem
        path = folder / PRIOR
        for end in (f"-{robot}", f"-{number}"):  # Two types may have one name.
            path = path.with_stem(path.stem + end) if path in contents else path
        contents[path] = json_text.encode(prior_document(population))
    return contents


# --- simulations --------------------------------------------------------------------


def _simulate(asked: Fleet, file: Path) -> int:
    """Simulate the robots of a study; its trials are written as they come."""
    setup, resume = read_setup(file), asked.resume
    study, name = _study(file, setup, asked.seed)
    trials, *made = (asked.output / name for name in (TRIALS, NUMBERS, CURVES))
    inputs = [file, setup.monte_carlo.plan]
    files.check_outputs([trials, *made], inputs, asked.force or resume)
    robots, limit = setup.monte_carlo.robots, setup.limit
    known: list[tuple[Trial, ...]] = []
    if resume and files.exists(trials):
        known = read_trials(trials, name, len(study.counts))[:robots]

    def done(further: Iterable[tuple[Trial, ...]]) -> Iterator[Trial]:
        for k, runs in enumerate(written_trials(trials, name, known, further), 1):
            if bar is not None:
                bar(f"{k} of {robots} robots", k / robots)
            yield from runs

    with (
        asked_workers(asked.workers, asked.cluster) as workers,
        progress_bar(quiet=asked.quiet) as bar,
    ):
        further = workers.map(try_robot, study, range(len(known), robots))
        accuracies = outlooks(done(further), limit)
    blocks = [*fleet_text.outlook_report(study, accuracies, limit)]
    title = f"Expected accuracy of {study.chains.robot.name}"
    # In SI units; quantiles are those of `levels`.
    document: Json = {
        **format_keys("calib-pin/monte-carlo"),
        "robot": study.chains.robot.name,
        "model": model_name(study.truth),
        "seed": study.seed,
        "limit": limit,
        "levels": LEVELS,
        "outlooks": accuracies,
    }
    figures = [*drawn("outlook", accuracies, limit)]
    data = json_text.encode(document), html.blocks_page(title, blocks, figures, NUMBERS)
    contents = dict(zip(made, data, strict=True))
    written = [f"wrote {file}" for file in (trials, *made)]
    replace(asked, force=True).give(contents, blocks, written)
    return 0


def _study(file: Path, setup: Setup, seed: int) -> tuple[Study, str]:
    """The study of a setup file, and a hash of everything its numbers depend on."""
    asked = setup.monte_carlo
    for key, value in (("monte_carlo.robot", asked.robot), ("model", setup.model)):
        if value is None:
            raise OptionError(f"'{key}' is missing", file=file)
    assert asked.robot is not None
    keys, robot = files.block_keys(setup), files.beside(file, asked.robot)
    chains = files.open_chains(OfRobot(robot=robot), setup, keys)
    files.tell_limits(chains)
    plan = None
    if asked.plan is not None:
        path = file.parent / asked.plan
        plan = read_configurations(path, chains, setup.joints, setup.columns)
    study = study_of(chains, keys, setup, plan, seed)
    # Of the same robots, more of them may be asked for.
    same = replace(setup, monte_carlo=replace(asked, robots=1, plan=None, robot=None))
    about = {
        "setup": setup_document(same),
        "robot": sha256(chains.robot.source),
        "plan": None if plan is None else plan.tolist(),
        "seed": seed,
    }
    return study, sha256(encode(about))
