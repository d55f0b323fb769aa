"""Rows of which a file itself says that they are no measurements.

Statistics below the last one, as a sheet has them, and those whose flag says that the
target was lost: their coordinates are often those of the last time it was.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np
from numpy.typing import NDArray

from calib_pin.io.columns import Column
from calib_pin.observations import Booleans

TAIL = 12
"""Last rows of a file among which statistics of the others may stand."""

SUMMARY = re.compile(
    r"(mean|average|avg\.?|median|std\.?(?:\W?dev\.?)?|stdev|mittelwert|stabw\w*|"
    r"standardabweichung|moyenne|[ée]cart.type)|min\.?|max\.?|minimum|maximum|sum|"
    r"range|rms",
    re.IGNORECASE,
)
"""Names of statistics; those in the group mean nothing else."""

FLAG = re.compile(
    r"(?:.*[\W_])?(?:(valid|tracked|visible)|(status)|occluded|lost)", re.IGNORECASE
)
"""Columns that say whether each row was measured; the last two, that it was not."""

YES = frozenset(["1", "true", "yes", "ok", "good", "valid", "tracked"])
NO = frozenset(["0", "false", "no", "bad", "lost", "invalid", "occluded"])
"""Their cells; numbers of a status may mean anything."""


def first_statistic(
    columns: Mapping[str, Column], lines: NDArray[np.int64]
) -> int | None:
    """The row with which statistics begin that end a file of some lines; None if none.

    Payloads may be called `max`, so that one of them has to be a mean or the like.
    """
    tail = range(max(1, len(lines) - TAIL), len(lines))
    cells = ((row, column.text(row)) for row in tail for column in columns.values())
    found = [(row, SUMMARY.fullmatch(text.strip(" :"))) for row, text in cells]
    rows = [row for row, name in found if name]
    return rows[0] if any(name and name[1] for _, name in found) else None


def out_of_sight(name: str, column: Column) -> Booleans | None:
    """Which rows were not measured as a flag says, shape (N,); None if it is none."""
    if (flag := FLAG.fullmatch(name)) is None:
        return None
    texts = column.texts().map(lambda text: text.strip().lower())
    known = YES | NO - {"0"} - {"1"} if flag[2] else YES | NO
    if not {*texts.distinct} <= known:
        return None
    bad = NO if flag[1] or flag[2] else YES
    lost = np.isin(
        texts.codes, [k for k, text in enumerate(texts.names) if text in bad]
    )
    return lost if lost.any() and not lost.all() else None
