"""CSV files of pandas: an index without a name, and names of two parts.

Source: https://pandas.pydata.org/docs/user_guide/io.html: `DataFrame.to_csv` writes the
index first, under a blank name; columns of a `MultiIndex` have a line of names for each
part.
"""

from __future__ import annotations

from pathlib import Path

import numpy as np

from calib_pin.io.dialects.base import Columns, Dialect, Heading, Lines, Reading, cut

INDEX = "column 1"
"""An unnamed first column, as it is called then."""


class Pandas(Dialect):
    """A data frame."""

    remark = "a data frame of pandas"

    def heading(self, lines: Lines) -> Heading | None:
        """Two lines of names below a blank index, of which the upper ones repeat."""
        lines = [one for one in lines if not one[1].startswith("#")]
        (upper, *rows), mark = cut(lines[:3] or [(1, "")])
        if len(rows) < 2 or upper[0] or not all(upper[1:]):
            return None
        if len({*map(len, (upper, *rows))}) > 1:
            return None
        pairs = zip(upper[1:], rows[0][1:], strict=True)
        names = ["", *("_".join(filter(None, pair)) for pair in pairs)]
        numbered = rows[0][0][:1].isdigit()  # It is a row, with its index.
        if len({*upper}) == len(upper) or len({*names}) < len(names) or numbered:
            return None
        # A name of the index stands alone in a line.
        last = lines[1 if any(rows[1][1:]) else 2][0]
        return Heading(mark, names, last, self.remark)

    def read(self, columns: Columns, file: Path) -> Reading | None:
        """The columns without an index that counts the rows."""
        steps = np.diff(columns[INDEX].numbers) if INDEX in columns else np.zeros(0)
        if not len(steps) or (steps != 1.0).any():
            return None
        return Reading({n: c for n, c in columns.items() if n != INDEX}, self.remark)
