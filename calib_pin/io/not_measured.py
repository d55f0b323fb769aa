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

YES = re.compile(
    r"1|true|y|yes|ok|good|valid|tracked|visible|pass|passed|i\.?o\.?", re.IGNORECASE
)
NO = re.compile(
    r"0|false|n|no|nok|ng|bad|lost|invalid|occluded|fail|failed|error|n\.?i\.?o\.?",
    re.IGNORECASE,
)
"""Their cells; numbers of a status may mean anything."""


def first_statistic(
    columns: Mapping[str, Column], lines: NDArray[np.int64]
) -> int | None:
    """The row with which statistics begin that end a file of some lines; None if none.

    Payloads may be called `max` and tools `std`, so that one of them has to be a mean
    or the like, and none stands above.
    """
    begin = max(1, len(lines) - TAIL)
    statistics = dict[int, re.Match[str]]()
    for column in (column for column in columns.values() if column.words):
        above = {*column.codes[:begin].tolist()}
        for row in range(begin, len(lines)):
            name = SUMMARY.fullmatch(column.text(row).strip(" :"))
            if name and int(column.codes[row]) not in above:
                statistics[row] = name
    return min(statistics) if any(name[1] for name in statistics.values()) else None


def out_of_sight(name: str, column: Column) -> Booleans | None:
    """Which rows were not measured as a flag says, shape (N,); None if it is none."""
    if (flag := FLAG.fullmatch(name)) is None:
        return None
    texts = column.texts().map(str.strip)
    good, bad = ({t for t in texts.names if way.fullmatch(t)} for way in (YES, NO))
    if not {*texts.distinct} <= (good | bad) - {*("01" if flag[2] else "")}:
        return None
    gone = bad if flag[1] or flag[2] else good
    lost = np.isin(texts.codes, [k for k, t in enumerate(texts.names) if t in gone])
    return lost if lost.any() and not lost.all() else None
