"""The command `calib-pin`: one file per command, errors printed in one place."""

from __future__ import annotations

import os
import sys
from collections.abc import Sequence

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: The words after the program's name; default those of the process.

    Returns:
        Exit status: 0 good, 1 the input or an option is wrong, 2 it ran but the
        result must not be trusted.
    """
    # Matrices here are small: threads cost more than they bring, and their number
    # would change the last bits of a result.
    for name in ("OPENBLAS_NUM_THREADS", "OMP_NUM_THREADS", "MKL_NUM_THREADS"):
        os.environ.setdefault(name, "1")

    from typer.exceptions import TyperException

    from calib_pin.cli.app import app
    from calib_pin.errors import CalibPinError

    words = list(sys.argv[1:] if arguments is None else arguments)
    debug = "--debug" in words
    words = [word for word in words if word != "--debug"]
    try:
        status = app(words, standalone_mode=False, prog_name="calib-pin")
    except (CalibPinError, TyperException) as error:
        if debug:
            raise
        message = getattr(error, "format_message", error.__str__)()
        _complain(" ".join(message.split()))
        return 1
    except KeyboardInterrupt:
        _complain("interrupted")
        return 130
    except BrokenPipeError:
        # The reader of our output went away; that is its right.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 1
    return status if isinstance(status, int) else 0


def _complain(message: str) -> None:
    print(f"calib-pin: {message}", file=sys.stderr)
