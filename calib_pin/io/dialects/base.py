"""A foreign layout: its columns with our names, units and meaning."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Protocol

from calib_pin.io.columns import Column


@dataclass(frozen=True)
class Reading:
    """The columns of a foreign layout as ours.

    Attributes:
        columns: All columns of the file by name.
        remark: A sentence about what was recognized.
    """

    columns: Mapping[str, Column]
    remark: str


class Dialect(Protocol):
    """A foreign layout."""

    def read(self, columns: Mapping[str, Column]) -> Reading | None:
        """The columns of a file as ours; None for a file of another layout.

        Args:
            columns: Columns by name, those first renamed that the setup file names.
        """
