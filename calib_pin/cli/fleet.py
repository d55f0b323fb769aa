"""`calib-pin fleet`: many calibrations, real or simulated."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import calib_pin.cli.options as options
from calib_pin.cli.files import check_outputs, exists
from calib_pin.cli.printing import (
    Bar,
    notice,
    progress_bar,
    say_json,
    say_written,
    show,
)
from calib_pin.cli.workforce import ClusterAddress, WorkerCount, asked_workers
from calib_pin.errors import OptionError

if TYPE_CHECKING:
    from calib_pin.cli.jobs import Job
    from calib_pin.estimation.statistics.population_prior import (
        Population,
        RobotEvidence,
    )
    from calib_pin.validation.fleet import FleetRow
    from calib_pin.workers import Workers

TABLE, PAGE, PRIOR = FILES = ("fleet.csv", "fleet.html", "fleet.json")
"""Files of a fleet beside the folders of its calibrations.

The last one is the prior that robots are for the next one of their type: `prior` in its
setup.
"""


def fleet(
    output: Annotated[
        Path, options.output("-o --output DIR", "Folder for all results.")
    ],
    jobs: Annotated[
        Path | None,
        typer.Argument(
            metavar="JOBS",
            help="Table of calibrations, CSV or YAML: robot, measurements, setup, "
            "serial_number, date, ...",
        ),
    ] = None,
    monte_carlo: Annotated[
        Path | None,
        options.option(
            "Study",
            "--monte-carlo SETUP",
            "Simulate robots instead, as 'monte_carlo' in this setup file says: how "
            "accurate will they be, against number of configurations?",
        ),
    ] = None,
    resume: Annotated[
        bool,
        options.output(
            "--resume", "Go on with what a stopped run has left, as far as it is whole."
        ),
    ] = False,
    no_pages: Annotated[
        bool,
        options.output(
            "--no-pages",
            "No report.html in the folders; 'calib-pin report' writes it later.",
        ),
    ] = False,
    workers: WorkerCount = None,
    cluster: ClusterAddress = None,
    seed: Annotated[int, options.seed("Study", "Random seed of the study.")] = 0,
    force: options.Force = False,
    quiet: options.Quiet = False,
    json: options.Json = False,
) -> int:
    """Calibrate a fleet of robots, or simulate one.

    Every job gets a folder of results as 'calibrate' writes it. fleet.csv and
    fleet.html list verdicts, accuracy before and after, and the drift since the last
    calibration of the same serial number, those that need attention first. A job that
    fails is a row with its reason and stops nothing. Workers of a cluster need to see
    the same files. Exit status 2: some calibration failed or must not be trusted.
    """
    if (jobs is None) == (monte_carlo is None):
        raise OptionError("give either a table of JOBS, or --monte-carlo SETUP")
    # A job may end the process that does it.
    patience = None if jobs is None else 0.0
    asked: dict[str, Any] = dict(resume=resume, force=force, quiet=quiet, json=json)
    with (
        asked_workers(workers, cluster, patience) as several,
        progress_bar(quiet=quiet) as bar,
    ):
        if monte_carlo is not None:
            from calib_pin.cli.monte_carlo import simulated

            return simulated(monte_carlo, output, several, seed=seed, bar=bar, **asked)
        assert jobs is not None
        return _calibrated(jobs, output, several, pages=not no_pages, bar=bar, **asked)


def _calibrated(
    table: Path,
    output: Path,
    workers: Workers,
    *,
    pages: bool,
    resume: bool,
    force: bool,
    quiet: bool,
    json: bool,
    bar: Bar | None,
) -> int:
    """Calibrate the robots of a table; returns the exit status."""
    from calib_pin.cli.fleet_jobs import Orders, Outcome, calibrate_job, lost_job
    from calib_pin.cli.jobs import read_jobs
    from calib_pin.io.files import write_files
    from calib_pin.io.json_text import plain
    from calib_pin.io.measurements import encode_table
    from calib_pin.report.figures import fleet_figures
    from calib_pin.report.fleet_text import MANY, fleet_report
    from calib_pin.report.html import blocks_page
    from calib_pin.validation.fleet import by_urgency, fleet_columns

    asked = read_jobs(table, notice)
    _check(output, asked, table, force or resume)
    orders = Orders(Path.cwd(), output, pages, resume)
    done: dict[str, Outcome] = {}
    for wave in _waves(asked):
        for outcome in workers.map(calibrate_job, orders, wave, lost_job):
            done[outcome.row.job] = outcome
            if bar is not None:
                bar(f"{len(done)} of {len(asked)}", len(done) / len(asked))
    found = [done[job.name] for job in asked]
    rows = _compared(orders, asked, [row for row, _ in found], workers, bar)
    if bar is not None:
        bar("types", None)
    populations, rows = types_of(asked, rows, [evidence for _, evidence in found])
    ordered = by_urgency(rows)
    columns = fleet_columns(ordered)
    contents = {
        output / TABLE: encode_table(columns, []),
        output / PAGE: blocks_page(
            "Calibrations of a fleet",
            [*fleet_report(ordered, populations, MANY)],
            [*fleet_figures(ordered)],
            TABLE,
        ),
        **priors(output, populations),
    }
    with write_files(contents, force=True):
        if json:
            lists = [plain(list(column)) for column in columns.values()]
            jobs = [
                dict(zip(columns, row, strict=True)) for row in zip(*lists, strict=True)
            ]
            say_json({"jobs": jobs}, contents)
        elif not quiet:
            show(fleet_report(ordered, populations))
    if not quiet and not json:
        folders = sum(row.fitted > 0 for row in ordered)
        written = [f"wrote {folders} folders to {output}"]
        say_written([*written, *(f"wrote {file}" for file in contents)])
    return 0 if all(row.trusted for row in ordered) else 2


def _waves(jobs: Sequence[Job]) -> Iterator[list[Job]]:
    """The jobs; one with a start comes behind that before of its serial number."""
    left = list(jobs)
    while left:
        names = {job.name for job in left}
        waiting = [job for job in left if job.stated.start and job.before in names]
        yield [job for job in left if job not in waiting]
        left = waiting


def _check(output: Path, jobs: Sequence[Job], table: Path, force: bool) -> None:
    """Refuse to replace what is there, and to write into what is read.

    Raises:
        OptionError: If something is there.
    """
    for job in jobs:
        if job.name.casefold() in FILES:
            raise OptionError(
                "a job cannot have this name", file=table, line=job.line, value=job.name
            )
        if not force and exists(folder := output / job.name):
            reason = "exists; --resume goes on, --force begins again"
            raise OptionError(reason, file=folder)
    check_outputs([output / name for name in FILES], [table], force)


def _compared(
    orders: Any,
    jobs: Sequence[Job],
    rows: Sequence[FleetRow],
    workers: Workers,
    bar: Bar | None,
) -> list[FleetRow]:
    """The rows with the drift of those robots that were calibrated before."""
    from calib_pin.cli.fleet_jobs import compare_job

    found = {row.job: row for row in rows}
    pairs = []
    for job, row in zip(jobs, rows, strict=True):
        if row.fitted and (previous := job.stated.previous):
            pairs.append((row, previous, str(previous)))
        elif row.fitted and job.before and found[job.before].fitted:
            pairs.append((row, orders.output / job.before, job.before))
    for k, row in enumerate(workers.map(compare_job, orders, pairs), 1):
        found[row.job] = row
        if bar is not None:
            bar("drift", k / len(pairs))
    return [found[row.job] for row in rows]


def types_of(
    jobs: Sequence[Job],
    rows: Sequence[FleetRow],
    evidences: Sequence[RobotEvidence | None],
) -> tuple[list[Population], list[FleetRow]]:
    """The types of a fleet; of a serial number its last calibration counts.

    Args:
        jobs: The jobs.
        rows: The row of each.
        evidences: The evidence of each; None where it tells nothing of a type.

    Returns:
        The types with robots enough, the largest first, and the rows, those of such
        types with their farthest joint.
    """
    from calib_pin.estimation.statistics.population_prior import (
        LEAST,
        joint_deviations,
        population_of,
    )
    from calib_pin.validation.fleet import with_joint

    earlier = {job.before for job in jobs}
    alike: list[dict[int, RobotEvidence]] = []
    for k, (job, own) in enumerate(zip(jobs, evidences, strict=True)):
        if own is None or job.name in earlier:
            continue
        for members in alike:
            first = next(iter(members.values()))
            if not first.robot.difference(own.robot) and first.names == own.names:
                members[k] = own
                break
        else:
            alike.append({k: own})
    found, result = [], list(rows)
    for members in sorted(alike, key=len, reverse=True):
        if len(members) < LEAST:
            continue
        found.append(population := population_of([*members.values()]))
        for k, joints in zip(members, joint_deviations(population), strict=True):
            result[k] = with_joint(result[k], joints)
    return found, result


def priors(folder: Path, populations: Sequence[Population]) -> dict[Path, bytes]:
    """The files of the priors; all but the first have the name of their robot."""
    from calib_pin.io.json_text import encode
    from calib_pin.io.population_prior import prior_document
    from calib_pin.io.results import urdf_name

    found: dict[Path, bytes] = {}
    for number, population in enumerate(populations, 1):
        robot = Path(urdf_name(population.evidences[0].robot.name)).stem
        path = folder / PRIOR
        for end in (f"-{robot}", f"-{number}"):  # Two types may have one name.
            path = path.with_stem(path.stem + end) if path in found else path
        found[path] = encode(prior_document(population.prior()))
    return found
