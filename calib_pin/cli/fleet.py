"""`calib-pin fleet`: many calibrations, real or simulated."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, cast

import typer

import calib_pin.cli.options as options
from calib_pin.cli.files import check_outputs, exists
from calib_pin.cli.printing import (
    Bar,
    notice,
    progress_bar,
)
from calib_pin.cli.request import SEED, Told
from calib_pin.cli.workforce import ClusterAddress, WorkerCount, asked_workers
from calib_pin.errors import OptionError

if TYPE_CHECKING:
    from calib_pin.cli.fleet_jobs import Orders
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


@dataclass(frozen=True, kw_only=True)
class Fleet(options.QuietAnswer):
    """Many calibrations as they are asked for.

    Attributes:
        monte_carlo: Simulate robots instead, as 'monte_carlo' in this setup file says:
            how accurate will they be, against number of configurations?
        seed: Random seed of the study.
        resume: Go on with what a stopped run has left, as far as it is whole.
        no_pages: No report.html in the folders; 'calib-pin report' writes it later.
    """

    monte_carlo: Annotated[Path | None, Told("SETUP", "Study")] = None
    seed: Annotated[int, Told("N", "Study", SEED)] = 0
    resume: Annotated[bool, Told("", "Output")] = False
    no_pages: Annotated[bool, Told("", "Output")] = False


@options.spread
def fleet(
    request: Fleet,
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
    workers: WorkerCount = None,
    cluster: ClusterAddress = None,
) -> int:
    """Calibrate a fleet of robots, or simulate one.

    Every job gets a folder of results as 'calibrate' writes it. fleet.csv and
    fleet.html list verdicts, accuracy before and after, and the drift since the last
    calibration of the same serial number, those that need attention first. A job that
    fails is a row with its reason and stops nothing. Workers of a cluster need to see
    the same files. Exit status 2: some calibration failed or must not be trusted.
    """
    study = request.monte_carlo
    if (jobs is None) == (study is None):
        raise OptionError("give either a table of JOBS, or --monte-carlo SETUP")
    # A job may end the process that does it.
    patience = None if jobs is None else 0.0
    with (
        asked_workers(workers, cluster, patience) as several,
        progress_bar(quiet=request.quiet) as bar,
    ):
        if jobs is None:
            from calib_pin.cli.monte_carlo import simulated

            seed, resume = request.seed, request.resume
            file = cast(Path, study)
            return simulated(file, output, request, several, bar, seed, resume)
        from calib_pin.cli.fleet_jobs import Orders

        orders = Orders(Path.cwd(), output, not request.no_pages, request.resume)
        rows, populations = _calibrated(jobs, orders, request.force, several, bar)
    from calib_pin.io.json_text import plain
    from calib_pin.io.measurements import encode_table
    from calib_pin.report.fleet_text import MANY, fleet_report
    from calib_pin.report.html import blocks_page
    from calib_pin.validation.fleet import fleet_columns

    columns = fleet_columns(rows)
    page = [*fleet_report(rows, populations, MANY)]
    contents = {
        output / TABLE: encode_table(columns, []),
        output / PAGE: blocks_page("Calibrations of a fleet", page, [], TABLE),
        **priors(output, populations),
    }

    def listed() -> dict[str, object]:
        cells = zip(*(plain(list(c)) for c in columns.values()), strict=True)
        jobs = [dict(zip(columns, row, strict=True)) for row in cells]
        return {"jobs": jobs, "written": [*map(str, contents)]}

    written = [f"wrote {sum(row.fitted > 0 for row in rows)} folders to {output}"]
    written += [f"wrote {file}" for file in contents]
    # Its own files were looked for before the work.
    answer = replace(request, force=True)
    answer.give(contents, listed, fleet_report(rows, populations), written)
    return 0 if all(row.trusted for row in rows) else 2


def _calibrated(
    table: Path, orders: Orders, force: bool, workers: Workers, bar: Bar | None
) -> tuple[Sequence[FleetRow], Sequence[Population]]:
    """Calibrate the robots of a table: rows by urgency, and the types of robots."""
    from calib_pin.cli.fleet_jobs import calibrate_job, compare_job, lost_job
    from calib_pin.cli.jobs import read_jobs
    from calib_pin.validation.fleet import by_urgency

    tell = bar or (lambda stage, part: None)
    asked = read_jobs(table, notice)
    _check(table, asked, orders.output, force or orders.resume)
    rows: dict[str, FleetRow] = {}
    evidences: dict[str, RobotEvidence | None] = {}
    for wave in _waves(asked):
        for row, evidence in workers.map(calibrate_job, orders, wave, lost_job):
            rows[row.job], evidences[row.job] = row, evidence
            tell(f"{len(rows)} of {len(asked)}", len(rows) / len(asked))
    pairs = []
    for job in asked:
        if rows[job.name].fitted and (previous := job.stated.previous):
            pairs.append((rows[job.name], previous, str(previous)))
        elif rows[job.name].fitted and job.before and rows[job.before].fitted:
            pairs.append((rows[job.name], orders.output / job.before, job.before))
    for k, row in enumerate(workers.map(compare_job, orders, pairs), 1):
        rows[row.job] = row
        tell("drift", k / len(pairs))
    tell("types", None)
    populations = types_of(asked, rows, evidences)
    return by_urgency([rows[job.name] for job in asked]), populations


def _waves(jobs: Sequence[Job]) -> Iterator[list[Job]]:
    """The jobs; one with a start comes behind that before of its serial number."""
    left = list(jobs)
    while left:
        names = {job.name for job in left}
        waiting = [job for job in left if job.stated.start and job.before in names]
        yield [job for job in left if job not in waiting]
        left = waiting


def _check(table: Path, jobs: Sequence[Job], output: Path, force: bool) -> None:
    """Refuse to replace what is there, and to write into what is read.

    Raises:
        OptionError: If something is there.
    """
    for job in jobs:
        if job.name.casefold() in FILES:
            reason = "a job cannot have this name"
            raise OptionError(reason, file=table, line=job.line, value=job.name)
        if not force and exists(folder := output / job.name):
            reason = "exists; --resume goes on, --force begins again"
            raise OptionError(reason, file=folder)
    check_outputs([output / name for name in FILES], [table], force)


def types_of(
    jobs: Sequence[Job],
    rows: dict[str, FleetRow],
    evidences: Mapping[str, RobotEvidence | None],
) -> list[Population]:
    """The types of a fleet; of a serial number its last calibration counts.

    Args:
        jobs: The jobs.
        rows: The row of each, by its name; those of the types get their farthest joint.
        evidences: The evidence of each; None where it tells nothing of a type.

    Returns:
        The types with robots enough, the largest first.
    """
    from calib_pin.estimation.statistics.population_prior import (
        LEAST,
        joint_deviations,
        population_of,
    )
    from calib_pin.validation.fleet import with_joint

    earlier = {job.before for job in jobs}
    alike: list[dict[str, RobotEvidence]] = []
    for job in jobs:
        own = evidences[job.name]
        if own is None or job.name in earlier:
            continue
        for members in alike:
            first = next(iter(members.values()))
            if not first.robot.difference(own.robot) and first.names == own.names:
                members[job.name] = own
                break
        else:
            alike.append({job.name: own})
    found = []
    for members in sorted(alike, key=len, reverse=True):
        if len(members) >= LEAST:
            found.append(population := population_of([*members.values()]))
            for name, far in zip(members, joint_deviations(population), strict=True):
                rows[name] = with_joint(rows[name], far)
    return found


def priors(folder: Path, populations: Sequence[Population]) -> dict[Path, bytes]:
    """The files of the priors; all but the first have the name of their robot."""
    from calib_pin.io.json_text import encode
    from calib_pin.io.results import urdf_name
    from calib_pin.io.setup import prior_document

    found: dict[Path, bytes] = {}
    for number, population in enumerate(populations, 1):
        robot = Path(urdf_name(population.evidences[0].robot.name)).stem
        path = folder / PRIOR
        for end in (f"-{robot}", f"-{number}"):  # Two types may have one name.
            path = path.with_stem(path.stem + end) if path in found else path
        found[path] = encode(prior_document(population.prior()))
    return found
