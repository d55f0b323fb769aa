"""Rows of which a file itself says that they are no measurements.

Statistics below the last one, as a sheet has them, and those whose flag says that the
target was lost: their coordinates are often those of the last time it was.
"""

from __future__ import annotations

import re
from collections.abc import Mapping

import numpy as np

from calib_pin.io.columns import Column
from calib_pin.observations import Indices

TAIL = 12
"""Last rows of a file among which statistics of the others may stand."""

SUMMARY = re.compile(
    r"(mean|average|avg\.?|median|std\.?(?:\W?dev\.?)?|stdev|mittelwert|stabw\w*|"
    r"standardabweichung|moyenne|[ée]cart.type)|min\.?|max\.?|minimum|maximum|sum|"
    r"range|rms",
    re.IGNORECASE,
)
"""Names of statistics; those in the group mean nothing else."""

FLAG = re.compile(r"(?i)(?:.*[\W_])?(?:(valid|tracked|visible)|(status)|occluded|lost)")
"""Columns that say whether each row was measured; the last two, that it was not."""

YES = re.compile(r"(?i)1|true|y|yes|ok|good|valid|tracked|visible|pass|passed|i\.?o\.?")
NO = re.compile(
    r"0|false|n|no|nok|ng|bad|lost|invalid|occluded|fail|failed|error|n\.?i\.?o\.?",
    re.IGNORECASE,
)
"""Their cells; numbers of a status may mean anything."""


def first_statistic(columns: Mapping[str, Column], lines: Indices) -> int | None:
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


def out_of_sight(columns: Mapping[str, Column]) -> tuple[str, Indices] | None:
    """A flag that says of some rows that they were not measured, and the others.

    None where there is none. Of several the first counts.
    """
    for name, column in columns.items():
        if (flag := FLAG.fullmatch(name)) is None:
            continue
        texts = column.texts().map(str.strip)
        good, bad = ({t for t in texts.names if way.fullmatch(t)} for way in (YES, NO))
        if {*texts.distinct} <= (good | bad) - {*("01" if flag[2] else "")}:
            gone = bad if flag[1] or flag[2] else good
            known = [k for k, text in enumerate(texts.names) if text not in gone]
            seen = np.flatnonzero(np.isin(texts.codes, known))
            if 0 < len(seen) < len(texts):
                return name, seen
    return None
