"""Findings in words: sizes, measurements, and the lines that correct them."""

from __future__ import annotations

import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import fields, is_dataclass
from typing import Any

import numpy as np

from calib_pin.estimation.evidence import Finding, Severity
from calib_pin.measurement_models.readings import places_of
from calib_pin.observations import Observations
from calib_pin.setup import ReadingSetup
from calib_pin.setup.values import Section
from calib_pin.units import DISPLAY

NAMED, LISTED = 3, 300
"""Things that a sentence names, and length of the lines that a remedy writes out; all
stand in the finding."""


def finding(
    code: str,
    message: str,
    numbers: Mapping[str, Any],
    remedy: str = "",
    lines: Mapping[str, Any] | None = None,
    residuals: str = "",
    *,
    error: bool = False,
    info: bool = False,
) -> Finding:
    """A finding, by default a warning, whose remedy ends with its lines.

    Args:
        code: Its code.
        message: One sentence with numbers.
        numbers: The numbers by name, SI units.
        remedy: Advice on how to correct it, or what else than its lines does.
        lines: Lines of a setup file that correct it.
        residuals: What the figure of residuals that shows it has them over, such as
            `by-joint`.
        error: Whether it takes the trust.
        info: Whether it is no more than a remark.
    """
    if lines:
        text = written(lines)
        state = f"state in the setup file: {text}"
        if len(text) > LISTED:
            state = "state the lines of this finding in the setup file"
        remedy = ", or ".join(filter(None, (remedy, state)))
    # Counts and lines of files stay whole numbers.
    known = numbers.items()
    evidence = {k: v if isinstance(v, str | int) else float(v) for k, v in known}
    severity: Severity = "error" if error else "info" if info else "warning"
    figure = f"residuals-{residuals}" if residuals else ""
    return Finding(code, severity, message, evidence, remedy, lines or {}, figure)


def shown(size: float, unit: str, digits: int = 2) -> str:
    """A size in the unit that people read.

    Examples:
        >>> shown(1.234, "m"), shown(1.234e-5, "m")
        ('1200 mm', '0.012 mm')
    """
    name, factor = DISPLAY[unit]
    text = f"{factor * size:.{digits}g}"
    return f"{float(text):.0f} {name}" if "e+" in text else f"{text} {name}"


def with_sigma(size: float, sigma: float, unit: str) -> str:
    """A size with its standard deviation.

    Examples:
        >>> with_sigma(1.234e-3, 2.1e-5, "m")
        '1.2 +- 0.02 mm'
    """
    return f"{shown(size, unit).split()[0]} +- {shown(sigma, unit, 1)}"


def listed(words: Sequence[str], more: int = 0) -> str:
    """The first of some words, and how many more there are."""
    more += max(len(words) - NAMED, 0)
    return ", ".join(words[:NAMED]) + (f" and {more} more" if more else "")


def named(data: Observations, rows: Sequence[int]) -> str:
    """Measurements in words, such as `lines 12, 31, 40 and 2 more`."""
    kind = "line" if data.files[rows[0]] else "measurement"
    kind += "s" * (len(rows) > 1)
    places = places_of(data, rows[:NAMED])
    return f"{kind} {listed(places, max(len(rows) - NAMED, 0))}"


def merged(readings: Iterable[ReadingSetup]) -> ReadingSetup:
    """Everything that several readings change."""
    result = dict[str, Any]()
    for new in map(_changed, readings):
        # Lines that differ add up.
        both = ((k, result[k]) for k in new.keys() & result.keys())
        more = {k: v + new[k] for k, v in both if isinstance(v, tuple) and v != new[k]}
        result |= new | more
    return ReadingSetup(**result)


def _changed(section: Section) -> dict[str, Any]:
    """The attributes of a section that are not at their defaults."""
    assert is_dataclass(section)
    values = [(f.name, getattr(section, f.name), f.default) for f in fields(section)]
    return {k: v for k, v, default in values if v != default and v not in ({}, ())}


def lines_of(section: Section) -> dict[str, Any]:
    """The keys of a section that are not at their defaults, as plain data."""
    return {name: _plain(value) for name, value in _changed(section).items()}


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, str) and value.isdigit():
        return int(value)
    return lines_of(value) if isinstance(value, Section) else value


def written(lines: Mapping[str, Any]) -> str:
    """Lines of a setup file as YAML on one line."""
    import yaml  # Slow to import.

    def short(number: str) -> float:
        value = float(f"{float(number):.9g}")
        return int(value) if value.is_integer() else value

    rounded = json.loads(json.dumps(lines), parse_float=short)
    style: dict[str, Any] = {"sort_keys": False, "width": np.inf}
    text = yaml.safe_dump(rounded, default_flow_style=True, allow_unicode=True, **style)
    return str(text).strip().removeprefix("{").removesuffix("}")
