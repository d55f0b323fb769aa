"""`calib-pin watch`: a job that is guided while it is measured."""

from __future__ import annotations

import csv
import io
import sys
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from dataclasses import replace
from functools import partial
from json import dumps
from pathlib import Path
from typing import Any

from rich.console import Group
from rich.live import Live
from rich.text import Text

import calib_pin.cli.options as options
import calib_pin.guidance as guidance
from calib_pin.cli.asked import Calibrate, Watch
from calib_pin.cli.calibrate import Inputs, calibrate, open_inputs
from calib_pin.cli.files import open_chains, setup_for
from calib_pin.cli.init import reading
from calib_pin.cli.options import Request
from calib_pin.cli.printing import console, notice, pop_notices, say
from calib_pin.errors import InputError, OptionError, RobotError, enumerated
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.guidance import Event
from calib_pin.guidance.proposals import Proposals, remaining
from calib_pin.io.files import write_atomically
from calib_pin.io.measured_columns import asked_models, infer_model, needed
from calib_pin.io.table import read_table
from calib_pin.observations import fitted_and_held_out
from calib_pin.setup import Setup
from calib_pin.validation.robot_state import expected_setup, resume

PAUSE = 0.2
"""Time between two looks at the files [s]."""

Tell = Callable[[Event], None]


def watched(asked: Watch) -> guidance.Watch:
    """The watch of a calibration as `calibrate` takes it."""

    def read() -> Any:
        try:
            inputs = open_inputs(asked, None)
            return inputs.chains, _setup_so_far(inputs), inputs.measurements
        finally:
            pop_notices()

    files, folders = asked.measurements, asked.package_dir or ()
    proposals = Proposals(files[0], asked.plan, asked.srdf, folders)
    followed = [*files, *filter(None, [asked.setup])]
    return guidance.Watch(read, followed, proposals, asked.limit, asked.seed)


def _setup_so_far(inputs: Inputs) -> Setup:
    """The setup, with what an older calibration tells of the rows so far."""
    older, noise = inputs.start, inputs.request.process_noise
    if older is None:
        return inputs.setup
    rows = fitted_and_held_out(inputs.measurements)[0]
    try:
        return resume(inputs.chains, rows, inputs.setup, older, noise)[0]
    except OptionError:
        raise
    except InputError:  # Frames use up the rows.
        return expected_setup(inputs.chains, inputs.setup, older, noise)


def watch(asked: Watch) -> int:
    """Do what `Watch` asks for."""
    before: Callable[[], object] = partial(time.sleep, PAUSE)
    if asked.board is not None:
        from calib_pin.cli.detect import images_of

        folder = asked.measurements[0]
        file, before = images_of(folder, asked.board, asked.joints, PAUSE)
        asked = replace(asked, measurements=[file])
    job = watched(asked)
    try:
        inputs = open_inputs(asked, asked.output, force=asked.force)
    except (OptionError, RobotError):
        raise
    except InputError:
        pass  # There may be no rows yet.
    else:
        job.proposals.check(inputs.chains, inputs.setup)
    pop_notices()
    if asked.type and asked.plan is not None:
        if len(asked.measurements) != 1:
            raise OptionError("--type needs one file of measurements")
        before = typed(asked, asked.plan)
    lines = asked.type or asked.json or asked.quiet or not sys.stdout.isatty()
    live = None if lines else console()
    if live is not None and not asked.once:
        end = f"writes {asked.output}" if asked.output else "prints the result"
        live.print(
            f"following {enumerated(map(str, asked.measurements))}; Ctrl-C {end}"
        )
    with (
        display(json=asked.json, quiet=asked.quiet, live=live) as tell,
        suppress(KeyboardInterrupt, EOFError),
    ):
        while True:
            for event in job.look(last=asked.once):
                # Where rows are typed, the question says where to go.
                if not (asked.type and event.kind == "next"):
                    tell(event)
            if asked.once:
                break
            before()
    if job.fit is None:
        notice("no result: nothing could be fitted yet")
        return 2 if job.rows else 1
    if asked.once:
        trusted = job.state is not None and job.state.verdict in TRUSTED
        return 0 if trusted else 2
    whole = Calibrate(**options.same(asked, Calibrate))
    return calibrate(whole, asked.words(asked.output or Path())[1:])


STYLES = {
    **dict.fromkeys(("state", "next", "waiting"), "cyan"),
    **dict.fromkeys(("finding", "problem"), "bold red"),
    "reached": "bold green",
}
"""Styles of the lines of a terminal by the kind of their event."""


def styled(event: Event) -> Text:
    """The line of an event on a terminal."""
    wrong = event.numbers.get("wrong")
    return Text(event.text, style="red" if wrong else STYLES.get(event.kind, ""))


@contextmanager
def display(
    *, json: bool = False, quiet: bool = False, live: Any = None
) -> Iterator[Tell]:
    """Shows events, one line each.

    Args:
        json: Whether they are shown as JSON.
        quiet: Whether they are not shown.
        live: A rich console where the state and the next configuration stay below the
            other events.
    """
    if live is None:

        def line(event: Event) -> None:
            if json or not quiet:
                text = dumps(event.document(), default=dict) if json else event.text
                say(f"{text}\n")

        yield line
        return
    below: dict[str, Text] = {}
    with Live(console=live, auto_refresh=False) as shown:

        def tell(event: Event) -> None:
            if event.kind not in ("state", "next", "waiting"):
                shown.console.print(styled(event))
                return
            below.pop("waiting", None)
            below[event.kind] = styled(event)
            shown.update(Group(*below.values()), refresh=True)

        yield tell


# --- readings that are typed --------------------------------------------------------


def typed(request: Request, plan: Path) -> Callable[[], None]:
    """Asks for the reading of the next configuration of a plan, and writes its row.

    What is in the file already is not asked for again; `skip` leaves a configuration
    out, `back` takes the last row of the file back.

    Raises:
        InputError: If the plan or the file cannot be used.
        OptionError: If nothing says what is measured.
    """
    (file,), setup = request.measurements, setup_for(request)
    chains = open_chains(request, setup, "")
    table = read_table(plan, columns=setup.columns)
    models = asked_models(setup.model)
    if not models and not file.exists():
        raise OptionError("say what is measured with --model", allowed="--model NAME")
    model = models[0] if models else infer_model(read_table(file), ())
    kinds = needed(model)
    if len({kind.si for kind in kinds.values()}) != 1:
        raise OptionError("readings of this model cannot be typed", value=model)
    header = [*(c.header for c in table.columns.values()), *kinds]
    if not file.exists() or not file.stat().st_size:
        _rewrite(file, header)
    skipped, unit = set[int](), ""

    def ask() -> None:
        nonlocal unit
        first, _, rest = file.read_text().partition("\n")
        if next(csv.reader([first])) != header:
            allowed = ", ".join(header)
            raise InputError("has other columns", file=file, allowed=allowed)
        empty = table.rows(slice(0))
        rows = read_table(file, columns=setup.columns) if rest else empty
        due = remaining(table, rows, chains, setup)
        row = next((k for k in due if k not in skipped), None)
        if row is None:
            say("all configurations of the plan are measured or skipped\n")
            raise EOFError
        cells = [column.text(row) for column in table.columns.values()]
        where = ", ".join(f"{n} {c}" for n, c in zip(header, cells, strict=False))
        say(f"{len(due)} left; go to {where}\n")
        while True:
            text = input(f"{' '.join(kinds)}{f' [{unit}]' * bool(unit)}, skip, back: ")
            if text.strip() == "skip":
                skipped.add(row)
                return
            if text.strip() == "back":
                _rewrite(file)
                return
            try:
                numbers, unit = reading(text, kinds, unit)
            except InputError as error:
                say(f"{error}\n")
                continue
            _rewrite(file, [*cells, *(f"{number:.9g}" for number in numbers)])
            return

    return ask


def _rewrite(file: Path, cells: Sequence[str] = ()) -> None:
    """Put a row at the end of a file, or take the last one back; the header stays.

    It is on the disk when this returns. The other rows stay byte by byte: a person may
    have written them with another program.
    """
    lines = file.read_bytes().splitlines(keepends=True) if file.exists() else []
    if cells:
        row = io.StringIO()
        csv.writer(row, lineterminator="\n").writerow(cells)
        if lines and not lines[-1].endswith((b"\n", b"\r")):
            lines[-1] += b"\n"
        lines.append(row.getvalue().encode())
    elif len(lines) > 1:
        lines.pop()
    write_atomically(file.resolve(), b"".join(lines), force=True)
