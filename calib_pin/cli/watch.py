"""`calib-pin watch`: a job that is guided while it is measured."""

from __future__ import annotations

import json as plain
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any

import typer

import calib_pin.cli.options as options
from calib_pin.cli.calibrate import calibrate
from calib_pin.cli.options import Request, Told, number
from calib_pin.cli.printing import say, taken_notices
from calib_pin.cli.requests import opened

if TYPE_CHECKING:
    from calib_pin.guidance import Event, Watch
    from calib_pin.kinematics.chains import Chains
    from calib_pin.kinematics.spatial import Floats
    from calib_pin.setup import Setup

PAUSE = 0.2
"""Time between two looks at the files [s]."""

LIMIT = number(float, "--limit", "1e-6 to 1 m", 1e-6, 1.0)


def watched(
    request: Request,
    plan: Path | None = None,
    limit: float | None = None,
    *,
    srdf: Path | None = None,
) -> Watch:
    """The watch of a calibration as `calibrate` takes it.

    Args:
        request: The calibration.
        plan: File of configurations that are planned.
        limit: Expected error of the tool point that is to be reached [m].
        srdf: Pairs of links that need no collision check.
    """
    from calib_pin.guidance import Watch
    from calib_pin.io.collision import load_collisions
    from calib_pin.io.urdf import other_robots

    def read() -> Any:
        try:
            return opened(request, None)
        finally:
            taken_notices()

    def solids(chains: Chains, setup: Setup) -> Any:
        folders = request.package_dir or ()
        return load_collisions(chains, setup.obstacles, srdf=srdf, package_dirs=folders)

    files = [*request.measurements, *filter(None, [request.setup])]
    return Watch(
        read,
        files,
        None if plan is None else partial(_planned, plan),
        limit,
        solids,
        partial(_shown, request.measurements[0]),
        other_robots,
        request.seed,
    )


def _planned(file: Path, chains: Chains, setup: Setup) -> tuple[Floats, list[str]]:
    """The configurations and targets of a plan."""
    from calib_pin.io.measurements import read_configurations
    from calib_pin.io.table import read_table

    q = read_configurations(file, chains, setup.joints, setup.columns)
    return q, [*read_table(file, columns=setup.columns).labels("target")]


def _shown(
    file: Path, chains: Chains, setup: Setup, q: Floats, target: str
) -> dict[str, str]:
    """A configuration in the names, units and signs of a measurement file."""
    from calib_pin.io.measurements import encode_configurations
    from calib_pin.io.table import read_table

    columns = read_table(file, columns=setup.columns).columns
    named = {*chains.joints, *setup.joints}
    degrees = any(c.unit == "deg" for name, c in columns.items() if name in named)
    table = encode_configurations(
        chains, q[None], [target], joints=setup.joints, degrees=degrees
    )
    header, cells = (line.split(",") for line in table.decode().splitlines()[-2:])
    digits = 3 if degrees else 4
    found = dict(zip(header, cells, strict=True))
    return {
        k: v if k == "target" else f"{float(v):.{digits}f}" for k, v in found.items()
    }


@dataclass(frozen=True, kw_only=True)
class Watched(options.QuietAnswer, Request):
    """Measurements that are to be followed.

    Attributes:
        output: Folder for the results, written at the end as by calibrate.
        plan: Configurations to measure, by plan.
        limit: Expected error of the tool point to be reached [m]; default 'limit' of
            the setup file.
        srdf: SRDF file of the pairs of links that need no collision check.
    """

    output: Annotated[Path | None, Told("DIR", "Output")] = None
    plan: Annotated[Path | None, Told("CSV", "Watch")] = None
    limit: Annotated[float | None, Told("S", "Watch", LIMIT)] = None
    srdf: Annotated[Path | None, Told("FILE", "Watch")] = None


@options.spread
def watch(asked: Watched, context: typer.Context) -> int:
    """Follow measurements while they are taken.

    Reads the files again whenever another program has written to them. Each new row is
    compared with what the rows before it predict; the verdict so far, the expected
    accuracy and the configuration to measure next follow. Ctrl-C ends with the result
    as calibrate would write it. The same command goes on with what is in the files.
    """
    job = watched(asked, asked.plan, asked.limit, srdf=asked.srdf)
    with display(json=asked.json, quiet=asked.quiet) as tell:
        follow(job, tell)
    context.obj = asked.words(asked.output or Path())[1:]
    if job.fit is None:
        return 1
    own = {"plan", "limit", "srdf"}
    given = {name: value for name, value in vars(asked).items() if name not in own}
    return calibrate(**given, context=context)


def follow(job: Watch, tell: Callable[[Event], None]) -> None:
    """Look at the files until somebody interrupts."""
    try:
        while True:
            for event in job.look():
                tell(event)
            time.sleep(PAUSE)
    except KeyboardInterrupt:
        return


@contextmanager
def display(*, json: bool, quiet: bool) -> Iterator[Callable[[Event], None]]:
    """Shows events: on a terminal the state below them, one line each elsewhere."""
    import sys

    if quiet:
        yield lambda event: None
    elif json:
        yield lambda event: say(f"{plain.dumps(event.document())}\n")
    elif not sys.stdout.isatty():
        yield lambda event: say(f"{event.text}\n")
    else:
        from rich.console import Console

        with live(Console(highlight=False, markup=False, emoji=False)) as tell:
            yield tell


STYLES = {"finding": "bold red", "problem": "bold red", "reached": "bold green"}
"""Styles of the lines of a terminal by the kind of their event."""


@contextmanager
def live(console: Any) -> Iterator[Callable[[Event], None]]:
    """The display of a terminal: rows go by, the state and the next stay below."""
    from rich.live import Live
    from rich.text import Text

    below: dict[str, Text] = {}
    with Live(console=console, auto_refresh=False) as shown:

        def tell(event: Event) -> None:
            wrong = bool(event.numbers.get("wrong"))
            style = "red" if wrong else STYLES.get(event.kind, "")
            if event.kind in ("state", "next", "waiting"):
                below.pop("waiting", None)
                below[event.kind] = Text(event.text, style="cyan")
                shown.update(Text("\n").join(below.values()), refresh=True)
            else:
                shown.console.print(Text(event.text, style=style))

        yield tell
