"""The rows of measurement files, and what changed between two looks at them."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Sequence
from pathlib import Path

from calib_pin.observations import Observations

SETTLED = 1.0
"""Age of a file from which what looks unfinished is what it is [s]."""

Key = tuple[str, bytes, int]
"""File, content and number of occurrence of a row."""


def stamps(files: Sequence[Path]) -> tuple[tuple[int, int] | None, ...]:
    """Time of change and size of files; None for one that is not there."""
    return tuple(map(_stamp, files))


def _stamp(file: Path) -> tuple[int, int] | None:
    try:
        found = file.stat()
    except OSError:
        return None
    return found.st_mtime_ns, found.st_size


def fresh(files: Sequence[Path]) -> bool:
    """Whether one of the files has just been written to."""
    times = [stamp[0] for stamp in stamps(files) if stamp is not None]
    return bool(times) and time.time() - max(times) * 1e-9 < SETTLED


def unfinished(file: Path) -> bool:
    """Whether the last line of a file has no end."""
    try:
        with file.open("rb") as stream:
            stream.seek(-1, 2)
            return stream.read() not in b"\r\n"
    except OSError:
        return False  # It is empty, or not there.


def keys_of(rows: Observations) -> list[Key]:
    """The content of every row, in the order of the rows; equal ones are counted."""
    found, seen = list[Key](), Counter[tuple[str, bytes]]()
    conditions = rows.conditions
    for block in rows.blocks:
        for k in range(len(block)):
            sigma = b"" if block.sigma is None else block.sigma[k].tobytes()
            names = "/".join((*block.key, block.target[k])).encode()
            own = block.q[k].tobytes() + block.values[k].tobytes() + sigma + names
            row = len(found)
            if len(conditions.time):
                own += conditions.time[row].tobytes()
            same = rows.files[row], own
            found.append((*same, seen[same]))
            seen[same] += 1
    return found
