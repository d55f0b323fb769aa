"""Arrays whose rows and columns have names."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np


class NamedArray(np.ndarray):
    """A numpy array with names of its rows and columns; what is made of it has none.

    Attributes:
        rows: Names of the rows.
        columns: Names of the columns.

    Example:
        >>> found = NamedArray.of(np.eye(2), ("a", "b"), ("x", "y"))
        >>> found.columns, found[1].columns, float(found[found.rows.index("b"), 1])
        (('x', 'y'), (), 1.0)
    """

    rows: tuple[str, ...]
    columns: tuple[str, ...]

    @staticmethod
    def of(values: Any, rows: Sequence[str], columns: Sequence[str]) -> NamedArray:
        """A view of an array of shape (len(rows), len(columns)) with names."""
        result = np.asarray(values, float).view(NamedArray)
        result.rows, result.columns = tuple(rows), tuple(columns)
        return result

    def __array_finalize__(self, array: object) -> None:
        """Leave the names behind: a part or a product has others."""
        self.rows, self.columns = (), ()
