"""Means that `join` has written with the standard deviation of one reading.

It did so until it wrote that of each mean, and says how many readings there were.
"""

from __future__ import annotations

import re
from dataclasses import replace
from pathlib import Path

from calib_pin.io.dialects.base import Columns, Dialect, Reading
from calib_pin.io.files import read_bytes

HEAD = re.compile(rb"# joined by time: (\d+) standstills, (\d+) readings\r?\n")


class Joined(Dialect):
    """Means by the count of all readings, as the head of the file states it."""

    def read(self, columns: Columns, file: Path) -> Reading | None:
        """The columns of a file as ours; None for a file of another layout."""
        head = HEAD.match(read_bytes(file, first=99) if file.is_file() else b"")
        rows = len(next(iter(columns.values())).numbers)
        if not head or not int(head[1]) == rows < int(head[2]):
            return None
        count, ours = int(head[2]) / rows, dict(columns)
        for name in (name for name in ours if name.startswith("sigma_")):
            ours[name] = replace(ours[name], numbers=ours[name].numbers / count**0.5)
        return Reading(ours, f"means of {count:.3g} readings, with the sigma of one")
