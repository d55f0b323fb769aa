"""Limits of the processes that read what others wrote, see `io.children`."""

from __future__ import annotations

from contextlib import suppress

MEMORY = 3 << 29
"""Address space of the process [bytes], of which its libraries take a tenth."""

SECONDS = 600
"""Time of a processor that it takes in all, should nobody be left to stop it [s]."""


def limit() -> None:
    """Give up what this process does not need, where the system can hold it to that."""
    try:
        import resource
    except ImportError:  # On Windows.
        return
    for kind, most in (
        (resource.RLIMIT_AS, MEMORY),
        (resource.RLIMIT_CPU, SECONDS),
        (resource.RLIMIT_CORE, 0),
    ):
        with suppress(OSError, ValueError):  # It has less, or the system refuses.
            resource.setrlimit(kind, (most, resource.getrlimit(kind)[1]))
