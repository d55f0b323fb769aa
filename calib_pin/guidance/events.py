"""The events of a watched job: one line for people, the numbers for programs."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from calib_pin.errors import counted, enumerated
from calib_pin.estimation.evidence import TRUSTED
from calib_pin.units import DISPLAY

Kind = Literal[
    "row", "removed", "waiting", "finding", "state", "next", "reached", "problem"
]

WORTH, AHEAD = 0.9, 5
"""Part of the expected error that so many further rows may leave to be worth it, where
no limit is stated."""


@dataclass(frozen=True)
class Event:
    """An event of a watched job.

    Attributes:
        kind: `row` for a new row, with `wrong` among its numbers; `removed` for rows
            that were taken back; `waiting` as long as rows cannot be judged; `finding`
            for the cause of wrong rows; `state` for all that is known so far; `next`
            for the configuration to measure; `reached` when more rows are not worth it,
            once; `problem` where the files cannot be read.
        text: One line.
        numbers: The same as plain data, in SI units.
    """

    kind: Kind
    text: str
    numbers: Mapping[str, Any] = field(default_factory=dict)

    def document(self) -> dict[str, Any]:
        """The event as plain data, without numbers that are not known."""
        # NaN is not equal to itself.
        known = {name: value for name, value in self.numbers.items() if value == value}
        return {"kind": self.kind, "text": self.text, **known}


@dataclass(frozen=True)
class State:
    """The state of a job.

    Attributes:
        rows: Number of rows.
        aside: Number of those that are set aside.
        verdict: The verdict so far; empty as long as there is none.
        reason: Its reason.
        near: Expected error of the tool point near the rows [m]; NaN where unknown.
        workspace: The same over the workspace.
        bound: Upper bound of that with 95 % confidence.
        unknown: Errors of the robot that more rows would tell.
        limit: The error that is to be reached [m]; None where none is stated.
        ahead: The error over the workspace after 0, 1, ... further rows [m].
    """

    rows: int
    aside: int
    verdict: str = ""
    reason: str = ""
    near: float = math.nan
    workspace: float = math.nan
    bound: float = math.nan
    unknown: tuple[str, ...] = ()
    limit: float | None = None
    ahead: tuple[float, ...] = ()

    @property
    def more(self) -> int | None:
        """Number of further rows that reach the limit; None where nobody knows."""
        if self.limit is None or math.isnan(self.bound):
            return None
        share = self.limit * self.workspace / self.bound
        return next((k for k, error in enumerate(self.ahead) if error <= share), None)

    @property
    def reached(self) -> bool:
        """Whether more rows are not needed."""
        if self.verdict not in TRUSTED:
            return False
        if self.limit is not None:
            return self.bound <= self.limit
        if self.verdict != "good" or len(self.ahead) <= AHEAD:
            return False
        return self.ahead[AHEAD] > WORTH * self.workspace

    @property
    def text(self) -> str:
        """One line."""
        words = [f"{counted(self.rows, 'row')}, {self.aside} set aside"]
        words.append(self.verdict.upper() or "no verdict yet")
        if self.verdict not in TRUSTED and self.reason:
            words[-1] += f" ({self.reason.partition(';')[0]})"
        if not math.isnan(self.workspace):
            near, over, bound = map(sized, (self.near, self.workspace, self.bound))
            over = f"{over} over the workspace (95 %: below {bound})"
            words.append(f"expected error {near} near the rows, {over}")
        if self.unknown:
            words.append(f"still unknown: {enumerated(self.unknown, 60)}")
        if self.more:
            words.append(f"about {self.more} more reach {sized(self.limit or 0.0)}")
        elif self.limit is None and len(self.ahead) > AHEAD:
            words.append(f"with {AHEAD} more rows {sized(self.ahead[AHEAD])}")
        return "; ".join(words)

    @property
    def conclusion(self) -> str:
        """Why more rows are not needed, one line."""
        if self.limit is not None:
            return f"reached: below {sized(self.limit)} over the workspace"
        now, then = sized(self.workspace), sized(self.ahead[AHEAD])
        return f"enough: {AHEAD} more rows would only lower {now} to {then}"

    def document(self) -> dict[str, Any]:
        """The state as plain data."""
        return {**vars(self), "more": self.more, "reached": self.reached}


def sized(size: float, unit: str = "m") -> str:
    """Two digits of a size [m, rad or px], in the unit that people read."""
    shown, factor = DISPLAY[unit]
    return f"{float(f'{factor * size:.2g}'):g} {shown}"
