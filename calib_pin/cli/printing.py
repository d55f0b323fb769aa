"""Printing: results go to standard output, remarks to standard error."""

from __future__ import annotations

import os
import shlex
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from time import monotonic
from typing import IO, TYPE_CHECKING

import click

from calib_pin.errors import CalibPinError, one_line
from calib_pin.progress import Progress, named

if TYPE_CHECKING:
    from rich.console import Console

    from calib_pin.report.blocks import Block

PATIENCE = 10.0
"""Time after which work tells its stage where no bar can be shown, and time between two
such lines [s]."""

_notices: list[str] = []

Bar = Callable[[str, float | None], None]
"""Told the stage and the part that is done, 0 to 1; None where that is not known."""


def console(file: IO[str] | None = None) -> Console:
    """A terminal on which names are what they are: no markup, no emoji codes."""
    from rich.console import Console

    return Console(file=file, highlight=False, markup=False, emoji=False)


def show(blocks: Iterable[Block]) -> None:
    """Print to standard output: colored on a terminal, plain 80 columns elsewhere."""
    from calib_pin.report.terminal import WIDTH, laid_out, plain_text

    if sys.stdout.isatty():
        terminal = console()
        # A narrower terminal wraps lines; rich would cut numbers off.
        terminal.width = max(terminal.width, WIDTH)
        terminal.print(laid_out(blocks))
    else:
        say(plain_text(blocks))


def command_line(words: Sequence[str]) -> str:
    """The command line, but for `--force`, which changes nothing of what follows."""
    return shlex.join(["calib-pin", *(word for word in words if word != "--force")])


def say(text: str) -> None:
    """Print to standard output, at once; that nobody listens any more is no error.

    Raises:
        OSError: If it cannot be written, as to a full disk.
    """
    try:
        click.echo(text, nl=False)
    except BrokenPipeError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def say_written(lines: Iterable[str]) -> None:
    """Tell of files that are in place, which nothing that fails now can change."""
    try:
        say("".join(f"{line}\n" for line in lines))
    except OSError as error:
        notice(f"standard output: {error.strerror}")


def notice(message: str) -> None:
    """A remark on standard error that does not stop the run, told at its end.

    Of a run that an error ends, the error alone is told.
    """
    _notices.append(message)


def tell_notices() -> None:
    """Print the remarks so far."""
    for message in pop_notices():
        print(f"calib-pin: {one_line(f'note: {message}')}", file=sys.stderr)


def pop_notices() -> list[str]:
    """The remarks so far, which are told then."""
    remarks = [*_notices]
    _notices.clear()
    return remarks


def complaint(error: Exception) -> str:
    """An error as a user is told of it."""
    if isinstance(error, CalibPinError):
        return str(error)
    if isinstance(error, OSError):
        return f"{error.filename or 'output'}: {error.strerror or error}"
    if isinstance(error, ImportError) and not (error.path or ".py").endswith(".py"):
        # A compiled package, as Pinocchio in a container without OpenMP.
        with_apt = " (Debian, Ubuntu: apt install libgomp1)" * ("libgomp" in str(error))
        return f"{error.name} needs a library of the system{with_apt}: {error}"
    reason = f"{type(error).__name__}: {error}"
    return f"internal error, please report it with --debug: {reason}"


def stage(bar: Bar | None, name: str) -> Progress | None:
    """The listener to the progress of one stage, 0 to 1; None without a bar."""
    if bar is None:
        return None
    bar(name, None)
    return named(bar, name)


@contextmanager
def progress_bar(*, quiet: bool = False) -> Iterator[Bar | None]:
    """A bar with the time that is left on standard error; None where nobody looks.

    Where it is no terminal, long work tells each of its stages in a line.
    """
    if quiet:
        yield None
        return
    if not sys.stderr.isatty():
        yield _lines()
        return
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    stages = TextColumn("{task.description}", markup=False)
    columns = (stages, BarColumn(), TimeRemainingColumn())
    terminal = console(sys.stderr)
    with Progress(*columns, console=terminal, transient=True) as progress:
        task = progress.add_task("", total=None)
        done = 0.0

        def update(stage: str, part: float | None) -> None:
            nonlocal done
            if part is None or part < done:
                # The time that is left is that of the stage which begins.
                progress.reset(task)
            done = part or 0.0
            # Without a total it only moves to and fro.
            total = None if part is None else 1.0
            progress.update(task, description=stage, completed=done, total=total)

        yield update


def _lines() -> Bar:
    """Tells a stage once, in a line on standard error, of work that takes long."""
    before, last = monotonic(), ""

    def update(stage: str, _: float | None) -> None:
        nonlocal before, last
        if stage != last and monotonic() - before > PATIENCE:
            before, last = monotonic(), stage
            print(f"calib-pin: {stage} ...", file=sys.stderr, flush=True)

    return update
