"""What the commands print: results on standard output, remarks on standard error."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import typer

if TYPE_CHECKING:
    from rich.console import RenderableType

__all__ = ["notice", "show"]


def show(content: RenderableType) -> None:
    """Print to standard output: colored on a terminal, plain 80 columns elsewhere."""
    from rich.console import Console

    from calib_pin.report.text import WIDTH, plain_text

    if sys.stdout.isatty():
        # Names are what they are: no markup and no emoji codes in them.
        console = Console(highlight=False, markup=False, emoji=False)
        # A narrower terminal wraps lines; rich would cut numbers off.
        console.width = max(console.width, WIDTH)
        console.print(content)
    else:
        typer.echo(plain_text(content), nl=False)


def notice(message: str) -> None:
    """A remark on standard error that does not stop the run."""
    print(f"calib-pin: note: {message}", file=sys.stderr)
