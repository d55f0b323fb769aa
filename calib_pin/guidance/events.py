"""What a watched job tells: one line for people, the numbers for programs."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

Kind = Literal[
    "row", "removed", "waiting", "finding", "state", "next", "reached", "problem"
]


@dataclass(frozen=True)
class Event:
    """Something that a watched job tells.

    Attributes:
        kind: `row` for a new row, with `wrong` among its numbers; `removed` for rows
            that were taken back; `waiting` for what is missing before rows can be
            judged; `finding` for the cause of wrong rows; `state` for what is known so
            far; `next` for the configuration to measure; `reached` when more rows are
            not worth it, once; `problem` where the files cannot be read.
        text: One line.
        numbers: The same as plain data, in SI units.
    """

    kind: Kind
    text: str
    numbers: Mapping[str, Any] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """The event as plain data."""
        return {"kind": self.kind, "text": self.text, **self.numbers}
