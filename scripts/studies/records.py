"""The records of a study: our numbers beside the published ones, and what must hold.

A study yields tables of records. They are printed, checked and written to JSON here.
"""

from __future__ import annotations

import operator
import textwrap
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from studies import shared

Values = Mapping[str, float]
"""Numbers by column, in SI units."""

UNITS: Mapping[str, tuple[str, float]] = {
    "": ("1", 1.0),
    "%": ("1", 1e2),
    "s": ("s", 1.0),
    "mm": ("m", 1e3),
    "um": ("m", 1e6),
    "mm^2": ("m^2", 1e6),
    "deg": ("rad", float(np.degrees(1.0))),
    "urad": ("rad", 1e6),
    "urad/Nm": ("rad/Nm", 1e6),
}
"""SI unit, and factor from it, of every unit of the terminal."""

RELATIONS: Mapping[str, Callable[[float, float], bool]] = {
    "above": operator.gt,
    "at least": operator.ge,
    "at most": operator.le,
    "below": operator.lt,
    "equal to": operator.eq,
}

WIDTH = 80
"""Columns of the terminal."""


@dataclass(frozen=True)
class Condition:
    """A claim about the values of a record.

    Attributes:
        claim: The claim in words.
        relation: One of `RELATIONS`, or `within` for a tolerance.
        limit: What the values are compared with: one number for all columns, or one
            for each column that the claim is about, in SI units.
        tolerance: Largest distance of a value from its limit, for `within`.
    """

    claim: str
    relation: str
    limit: float | Values
    tolerance: float = 0.0

    def limits(self, values: Values) -> Values:
        """The limit of every column that the claim is about."""
        if isinstance(self.limit, Mapping):
            return self.limit
        return dict.fromkeys(values, self.limit)

    def met(self, values: Values) -> bool:
        """Whether all values satisfy it; NaN does not."""
        if self.relation == "within":
            pairs = ((values[c], x) for c, x in self.limits(values).items())
            return all(abs(value - limit) < self.tolerance for value, limit in pairs)
        holds = RELATIONS[self.relation]
        return all(holds(values[c], x) for c, x in self.limits(values).items())


@dataclass(frozen=True)
class Record:
    """A quantity of a study.

    Attributes:
        name: The quantity, as the line of a table.
        ours: Our values.
        unit: Unit of the terminal, one of `UNITS`.
        published: Published values of some columns.
        bound: `<` or `>` where the published values are only bounds.
        conditions: What must hold.
    """

    name: str
    ours: Values
    unit: str = ""
    published: Values = field(default_factory=dict)
    bound: str = ""
    conditions: Sequence[Condition] = ()

    @property
    def label(self) -> str:
        """Name with unit."""
        name = self.name.rstrip()
        return f"{name} [{self.unit}]" if self.unit else name

    def shown(self, value: float | None, digits: int = 3) -> str:
        """A value in the unit of the terminal; nothing for None."""
        return "" if value is None else number(UNITS[self.unit][1] * value, digits)

    def verdicts(self) -> Iterator[str]:
        """A line for every condition: whether it is met, and by which numbers."""
        unit = f" {self.unit}" if self.unit else ""
        for condition in self.conditions:
            words = []
            for column, limit in condition.limits(self.ours).items():
                target = f"{self.shown(limit, 4)}{unit}"
                if condition.relation == "within":
                    target = f"{self.shown(condition.tolerance)}{unit} of {target}"
                value = f"{column} {self.shown(self.ours[column], 4)}{unit}".lstrip()
                words.append(f"{value} ({condition.relation} {target})")
            met = "met" if condition.met(self.ours) else "NOT MET"
            text = f"{condition.claim}: {self.name.strip()}, {', '.join(words)}"
            yield wrapped(f"{met:<8} {text}", 9)

    def document(self) -> dict[str, object]:
        """The record for JSON, in SI units."""
        return {
            "name": self.name,
            "unit": UNITS[self.unit][0],
            "ours": self.ours,
            **({"published": self.published} if self.published else {}),
            **({"published_bound": self.bound} if self.bound else {}),
            "conditions": [
                {
                    "claim": condition.claim,
                    "relation": condition.relation,
                    "limit": condition.limit,
                    "tolerance": condition.tolerance,
                    "met": condition.met(self.ours),
                }
                for condition in self.conditions
            ],
        }


@dataclass
class Table:
    """Records that share columns.

    Attributes:
        title: The title.
        note: A remark for the reader of the numbers.
        digits: Significant digits on the terminal.
        records: One for every line.
    """

    title: str
    note: str = ""
    digits: int = 3
    records: list[Record] = field(default_factory=list)

    def add(
        self,
        name: str,
        ours: Values | float,
        unit: str = "",
        *conditions: Condition,
        published: Values | None = None,
        bound: str = "",
    ) -> None:
        """Add a record, see `Record`; a single number has a column without a name."""
        values = ours if isinstance(ours, Mapping) else {"": float(ours)}
        self.records.append(
            Record(name, values, unit, published or {}, bound, conditions)
        )

    def lines(self) -> Iterator[str]:
        """Lines for the terminal."""
        yield self.title
        columns = list(dict.fromkeys(c for r in self.records for c in r.ours))
        first = max(len(record.label) for record in self.records) + 2
        widths = [max(10, len(column) + 2) for column in columns]

        def line(label: str, cells: Sequence[str]) -> str:
            pairs = zip(cells, widths, strict=True)
            return f"{label:<{first}}{''.join(f'{c:>{w}}' for c, w in pairs)}".rstrip()

        if columns != [""]:
            yield line("", columns)
        for record in self.records:
            ours = [record.shown(record.ours.get(c), self.digits) for c in columns]
            yield line(f"  {record.label}", ours)
            if record.published:
                known = [record.shown(record.published.get(c), 4) for c in columns]
                signs = [f"{record.bound} {x}".lstrip() if x else "" for x in known]
                yield line("    published", signs)
        if self.note:
            yield wrapped(self.note)

    def document(self) -> dict[str, object]:
        """The table for JSON."""
        records = [record.document() for record in self.records]
        return {"title": self.title, "note": self.note, "records": records}


@dataclass(frozen=True)
class Report:
    """A study as it is printed and written.

    Attributes:
        name: Name of the study, and of its JSON file.
        source: The publication.
        description: What was simulated; paragraphs.
        settings: The settings, a dataclass or a mapping.
        tables: The records.
        results: Whatever else is written, by name.
    """

    name: str
    source: str
    description: Sequence[str]
    settings: Mapping[str, object]
    tables: Sequence[Table]
    results: Mapping[str, object]

    def met(self) -> dict[str, bool]:
        """Whether the conditions of every claim are met."""
        result: dict[str, bool] = {}
        for record in (record for table in self.tables for record in table.records):
            for condition in record.conditions:
                before = result.get(condition.claim, True)
                result[condition.claim] = before and condition.met(record.ours)
        return result

    def text(self) -> str:
        """What the terminal shows: tables, then conditions."""
        parts = ["\n".join([self.source, *map(wrapped, self.description)])]
        parts += ["\n".join(table.lines()) for table in self.tables]
        records = (record for table in self.tables for record in table.records)
        parts.append("\n".join(v for record in records for v in record.verdicts()))
        return "\n\n".join(parts)

    def document(self) -> dict[str, object]:
        """What JSON holds, in SI units (m, rad, s, kg)."""
        return {
            "study": self.name,
            "source": self.source,
            "versions": shared.versions(),
            "settings": self.settings,
            "conditions": self.met(),
            "tables": [table.document() for table in self.tables],
            **self.results,
        }

    def publish(
        self,
        folder: Path,
        figures: shared.Figures,
        about: Sequence[object],
        *files: str,
    ) -> bool:
        """Print, write the JSON file and the figures, and name all files.

        Returns whether all conditions are met.

        Args:
            folder: The folder of the files.
            figures: The figures by the names of their files.
            about: The other arguments of the figures.
            files: Names of the files that are there already.
        """
        print(self.text())
        shared.write_json(folder / f"{self.name}.json", self.document())
        for name, draw in figures.items():
            draw(folder / name, *about)
        print()
        for file in (f"{self.name}.json", *files, *figures):
            print(f"wrote {folder / file}")
        return all(self.met().values())


def number(value: float, digits: int = 3) -> str:
    """A number to some significant digits; a dash where there is none.

    Numbers below 1e-4 have an exponent and one digit, large ones all of theirs before
    the point.
    """
    if not np.isfinite(value):
        return "-"
    if 0.0 < abs(value) < 1e-4:
        return f"{value:.0e}"
    return f"{value:.{digits}g}" if abs(value) < 10.0**digits else f"{value:.0f}"


def wrapped(text: str, indent: int = 0) -> str:
    """Text in lines that fit the terminal, the later ones indented."""
    return textwrap.fill(text, WIDTH, subsequent_indent=" " * indent)
