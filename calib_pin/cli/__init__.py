"""The command `calib-pin`: one file per command, errors printed in one place."""

from __future__ import annotations

import atexit
import gc
import os
import signal
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager, suppress

from calib_pin.workers.threads import limit_blas

__all__ = ["main"]


def main(arguments: Sequence[str] | None = None) -> int:
    """Run the command line.

    Args:
        arguments: The words after the program's name; default those of the process.

    Returns:
        Exit status: 0 good, 1 the input or an option is wrong, 2 it ran but the
        result must not be trusted, 130 after Ctrl-C, 143 after SIGTERM.
    """
    # Whatever multiplies matrices is `serial_blas`, here as in any script. In a process
    # of our own BLAS need not even start threads that nobody uses.
    limit_blas()
    if arguments is None:
        # A process of our own is short: looking for garbage takes a tenth of its time.
        gc.set_threshold(300_000)
        atexit.register(gc.freeze)
        atexit.register(_flush_output)
    _prepare_streams()

    import click

    from calib_pin.cli.application import INTERRUPTED, application
    from calib_pin.cli.printing import complaint, pop_notices, tell_notices

    pop_notices()
    given = list(sys.argv[1:] if arguments is None else arguments)
    words = [word for word in given if word != "--debug"]
    try:
        with _stopped_by_sigterm():
            status = application(words)(
                words, standalone_mode=False, prog_name="calib-pin", obj=given
            )
    except _Terminated:
        _complain("terminated")
        return 143
    except (KeyboardInterrupt, click.Abort):
        status = INTERRUPTED
    except BrokenPipeError:
        # The reader of our output went away; that is its right.
        return 1
    except Exception as error:
        if "--debug" in given:
            raise
        usage = isinstance(error, click.ClickException)
        _complain(_usage(error) if usage else complaint(error))
        return 1
    tell_notices()
    if status == INTERRUPTED:
        _complain("interrupted")
    return status if isinstance(status, int) else 0


class _Terminated(BaseException):
    """The process was asked to end, and does what a `finally` asks for first."""


@contextmanager
def _stopped_by_sigterm() -> Iterator[None]:
    """Let SIGTERM end the command as Ctrl-C does; a second one ends it at once."""

    def stop(number: int, _: object) -> None:
        signal.signal(number, signal.SIG_DFL)
        raise _Terminated

    # Only the main thread may set handlers, and what is ignored stays ignored.
    in_main = threading.current_thread() is threading.main_thread()
    if not in_main or signal.getsignal(signal.SIGTERM) != signal.SIG_DFL:
        yield
        return
    signal.signal(signal.SIGTERM, stop)
    try:
        yield
    finally:
        signal.signal(signal.SIGTERM, signal.SIG_DFL)


def _prepare_streams() -> None:
    """Make standard output and error take whatever is written to them."""
    for number, name in ((1, "stdout"), (2, "stderr")):
        if getattr(sys, name) is None:  # Closed by the caller.
            os.dup2(os.open(os.devnull, os.O_WRONLY), number)
            setattr(sys, name, os.fdopen(number, "w", closefd=False))
        # A file name may hold what the encoding does not.
        with suppress(AttributeError):
            getattr(sys, name).reconfigure(errors="backslashreplace")


def _flush_output() -> None:
    """Write what standard output still holds, or drop it where nothing takes it.

    The interpreter would try once more, complain, and exit with status 120.
    """
    try:
        sys.stdout.flush()
    except OSError:
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def _usage(error: Exception) -> str:
    """The error of a command line, and where its help is."""
    message = getattr(error, "format_message", error.__str__)().strip().rstrip(".")
    context = getattr(error, "ctx", None)
    command = getattr(context, "command_path", "calib-pin")
    return f"{message}; see {command} --help"


def _complain(message: str) -> None:
    from calib_pin.errors import one_line

    print(f"calib-pin: {one_line(message)}", file=sys.stderr)
