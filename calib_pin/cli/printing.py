"""What the commands print: results on standard output, remarks on standard error."""

from __future__ import annotations

import sys
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from calib_pin.report.blocks import Block

__all__ = ["notice", "progress_bar", "show"]


def show(blocks: Iterable[Block]) -> None:
    """Print to standard output: colored on a terminal, plain 80 columns elsewhere."""
    from rich.console import Console

    from calib_pin.report.terminal import WIDTH, laid_out, plain_text

    if sys.stdout.isatty():
        # Names are what they are: no markup and no emoji codes in them.
        console = Console(highlight=False, markup=False, emoji=False)
        # A narrower terminal wraps lines; rich would cut numbers off.
        console.width = max(console.width, WIDTH)
        console.print(laid_out(blocks))
    else:
        typer.echo(plain_text(blocks), nl=False)


def notice(message: str) -> None:
    """A remark on standard error that does not stop the run."""
    print(f"calib-pin: note: {message}", file=sys.stderr)


@contextmanager
def progress_bar(*, quiet: bool) -> Iterator[Callable[[str, float], None] | None]:
    """A bar on standard error while something runs; None where nobody looks at it.

    What it gives takes the name of the stage and the part that is done, 0 to 1.
    """
    if quiet or not sys.stderr.isatty():
        yield None
        return
    from rich.console import Console
    from rich.progress import BarColumn, Progress, TextColumn, TimeRemainingColumn

    columns = (
        TextColumn("{task.description}", markup=False),
        BarColumn(),
        TimeRemainingColumn(),
    )
    console = Console(file=sys.stderr, highlight=False, markup=False, emoji=False)
    with Progress(*columns, console=console, transient=True) as progress:
        task = progress.add_task("", total=1.0)

        def update(stage: str, part: float) -> None:
            progress.update(task, description=stage, completed=part)

        yield update
