"""Means that `join` has written with the standard deviation of one reading.

It did so until it wrote that of each mean, and says how many readings there were.
"""

from __future__ import annotations

import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import calib_pin.io.dialects.base as base
from calib_pin.io.columns import Column
from calib_pin.io.files import read_blocks

HEAD = re.compile(rb"# joined by time: (\d+) standstills, (\d+) readings\r?\n")


class Joined(base.Dialect):
    """Means by the count of all readings, as the head of the file states it."""

    def read(self, columns: Mapping[str, Column], file: Path) -> base.Reading | None:
        """The columns of a file as ours; None for a file of another layout."""
        found = HEAD.match(next(read_blocks(file, 99), b"") if file.is_file() else b"")
        rows = len(next(iter(columns.values())).numbers)
        if not found or not int(found[1]) == rows < int(found[2]):
            return None
        count, ours = int(found[2]) / rows, dict(columns)
        for name, one in columns.items():
            if name.startswith("sigma_"):
                ours[name] = replace(one, numbers=one.numbers / count**0.5)
        told = f"means of {count:.3g} readings, whose sigma is that of one"
        return base.Reading(ours, told)
