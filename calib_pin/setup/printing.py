"""Statements of a user for printed reports; they change no number."""

from __future__ import annotations

import re
from calendar import monthrange
from dataclasses import dataclass
from typing import Annotated

from calib_pin.setup.conditions import Temperature
from calib_pin.setup.constraints import Checked, Section

LONGEST = 80
"""Letters of an entry, which have to fit beside its name on one page."""

DATE = re.compile(r"([12][0-9]{3})-([0-9]{2})-([0-9]{2})")


def _entry(value: object) -> str:
    printable = isinstance(value, str) and value.isprintable()
    if not isinstance(value, str) or not printable or len(value) > LONGEST:
        raise ValueError(
            f"text of at most {LONGEST} printable letters (in quotes if it looks like "
            "something else)"
        )
    return value.strip()


def _date(value: object) -> str:
    found = DATE.fullmatch(value) if isinstance(value, str) else None
    if found is not None:
        year, month, day = map(int, found.groups())
        if 1 <= month <= 12 and 1 <= day <= monthrange(year, month)[1]:
            return found[0]
    raise ValueError("a date, such as 2026-11-23")


Entry = Annotated[str, Checked(_entry, {"type": "string", "maxLength": LONGEST})]
Date = Annotated[str, Checked(_date, {"type": "string", "format": "date"})]


@dataclass(frozen=True)
class ReportSetup(Section):
    """Entries of a printed report; what is left out is filled in by hand.

    Attributes:
        serial_number: Serial number of the robot.
        customer: For whom it was measured.
        operator: Who measured.
        instrument: The measuring instrument.
        temperature: Temperature of the robot [degC].
        load: Load on the flange at an acceptance test.
        speed: Speed of an acceptance test.
        date: Day of the report, year-month-day; None for today.
    """

    serial_number: Entry = ""
    customer: Entry = ""
    operator: Entry = ""
    instrument: Entry = ""
    temperature: Temperature | None = None
    load: Entry = ""
    speed: Entry = ""
    date: Date | None = None
