"""The report as tables for a terminal, at most 80 columns wide."""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Iterator, Sequence

from rich.console import Console, Group, RenderableType
from rich.padding import Padding
from rich.table import Table
from rich.text import Text

from calib_pin.result import (
    Accuracy,
    CalibrationResult,
    CoupledGroup,
    Evaluation,
    Identifiability,
    Identification,
    ParameterEstimate,
    QuantityErrors,
)

__all__ = [
    "evaluation_report",
    "format_report",
    "identification_report",
    "plain_text",
    "report",
]

WIDTH = 80
"""Columns of the report where it is not printed to a terminal."""

DISPLAY = {"m": ("mm", 1e3), "rad": ("deg", 180.0 / math.pi)}
"""Unit and factor that people read, by SI unit."""

LISTED_ROWS = 5
"""Outliers and correlated pairs that are listed before the rest is only counted."""


def format_report(result: CalibrationResult) -> str:
    """The report of a calibration as plain text of at most 80 columns.

    Example:
        >>> import calib_pin
        >>> chain = calib_pin.load_chain("space7")
        >>> setup = calib_pin.read_setup(calib_pin.robot_file("space7", "setup.yaml"))
        >>> rows = calib_pin.read_measurements(
        ...     calib_pin.robot_file("space7", "measurements.csv"), chain
        ... )
        >>> result = calib_pin.calibrate(chain, rows, setup)
        >>> print(calib_pin.format_report(result).splitlines()[0])
        GOOD: the fit converged and is better on rows it has not seen.
    """
    return plain_text(report(result))


def plain_text(content: RenderableType) -> str:
    """Render without colors, at most 80 columns wide."""
    stream = io.StringIO()
    Console(file=stream, width=WIDTH, color_system=None, highlight=False).print(content)
    return "\n".join(line.rstrip() for line in stream.getvalue().splitlines()) + "\n"


def report(result: CalibrationResult) -> RenderableType:
    """Verdict, accuracy, identifiability and what does not fit."""
    return Group(
        _verdict(result),
        "",
        *_accuracy(result.errors, result.validation),
        "",
        identification_report(result, fitted=True),
        *_statistics(result),
        *_outliers(result),
    )


def identification_report(found: Identification, *, fitted: bool) -> RenderableType:
    """Ranks, parameters by status, and coupled groups as formulae.

    Args:
        found: What can be known.
        fitted: Whether there are estimates to show.
    """
    parts: list[RenderableType] = [*_ranks(found.identifiability, fitted)]
    identifiable = [p for p in found.parameters if p.status == "identifiable"]
    if identifiable:
        parts += ["", _identifiable(identifiable, fitted)]
    if found.groups:
        parts += ["", _groups(found, fitted)]
    remarks = {
        "weak": "weak (these measurements cannot tell; left near nominal)",
        "unidentifiable": "unidentifiable (no effect on what is measured)",
        "fixed": "fixed",
    }
    for status, meaning in remarks.items():
        names = [p.name for p in found.parameters if p.status == status]
        if names:
            parts += ["", Text(f"{meaning}:", style="bold")]
            parts += [Padding(line, (0, 0, 0, 2)) for line in _compressed(names)]
    return Group(*parts)


def evaluation_report(evaluation: Evaluation) -> RenderableType:
    """Accuracy on rows that were not fitted."""
    table = _table("Accuracy", ("rows", "mean", "rms", "max", "unit"))
    for name, unit, accuracy in evaluation.errors:
        table.add_row(
            name, str(evaluation.rows), *_sizes(accuracy, unit), DISPLAY[unit][0]
        )
    how = (
        "Base, tool and instrument were registered on these rows."
        if evaluation.registered
        else "Nothing was fitted to these rows."
    )
    return Group(table, Text(how, style="dim"))


def _verdict(result: CalibrationResult) -> Text:
    if result.verdict != "good":
        return Text(f"UNTRUSTED: {result.reason}.", style="bold red")
    if result.validation == "none":
        text = "GOOD: the fit converged; too few rows to check it on unseen ones."
    else:
        text = "GOOD: the fit converged and is better on rows it has not seen."
    return Text(text, style="bold green")


def _accuracy(
    errors: Sequence[QuantityErrors], method: str
) -> Iterator[RenderableType]:
    table = _table("Accuracy", ("rows", "robot", "mean", "rms", "max", "unit"))
    for error in errors:
        pairs = [("fitted", error.before, error.after)]
        if error.validation_before and error.validation_after:
            unseen = f"unseen ({method})"
            pairs.append((unseen, error.validation_before, error.validation_after))
        name = error.name
        for rows, before, after in pairs:
            for robot, accuracy in (("nominal", before), ("calibrated", after)):
                cells = (*_sizes(accuracy, error.unit), DISPLAY[error.unit][0])
                table.add_row(name, rows, robot, *cells)
                name = rows = ""
    yield table
    yield Text("Base, tool and instrument are fitted in either case.", style="dim")


def _ranks(ranks: Identifiability, fitted: bool) -> Iterator[RenderableType]:
    yield Text("Identifiability", style="bold")
    lines = [
        ("free parameters", f"{ranks.parameters}"),
        (
            "structural rank",
            f"{ranks.structural_rank}   (gap {_number(ranks.gap)}; Everett's count "
            f"4R + 2P + 6 = {ranks.everett} for full poses)",
        ),
    ]
    if fitted:
        lines.append(
            (
                "practical rank",
                f"{ranks.rank}   ({ranks.weak} directions left at nominal)"
                if ranks.weak
                else f"{ranks.rank}",
            )
        )
    if ranks.singular_values:
        first, last = ranks.singular_values[0], ranks.singular_values[-1]
        lines.append(("singular values", f"{_number(first)} ... {_number(last)}"))
        lines.append(("condition number", _number(ranks.condition)))
    if ranks.observability:
        indices = "  ".join(f"{k} {_number(v)}" for k, v in ranks.observability.items())
        lines.append(("observability", indices))
    grid = Table.grid(padding=(0, 2))
    for name, value in lines:
        grid.add_row(f"  {name}", value)
    yield grid


def _identifiable(
    parameters: Sequence[ParameterEstimate], fitted: bool
) -> RenderableType:
    if not fitted:
        names = [parameter.name for parameter in parameters]
        lines = [Padding(line, (0, 0, 0, 2)) for line in _compressed(names)]
        return Group(Text("identifiable:", style="bold"), *lines)
    table = _table("Identifiable parameters", ("value", "std. dev.", "unit"))
    for parameter in parameters:
        table.add_row(parameter.name, *_estimate(parameter))
    return table


def _groups(found: Identification, fitted: bool) -> RenderableType:
    table = Table(
        title="Coupled groups: only the sums are known (coefficients in SI units)",
        title_justify="left",
        title_style="bold",
        box=None,
        pad_edge=False,
        show_header=fitted,
    )
    table.add_column("", justify="right")
    table.add_column("sum", overflow="fold")
    if fitted:
        table.add_column("value", justify="right", no_wrap=True)
        table.add_column("std. dev.", justify="right", no_wrap=True)
        table.add_column("unit", no_wrap=True)
    for group in found.groups:
        cells = _estimate(group) if fitted else ()
        table.add_row(str(group.number), group.expression, *cells)
    return table


def _statistics(result: CalibrationResult) -> Iterator[RenderableType]:
    yield ""
    yield Text("Statistics", style="bold")
    grid = Table.grid(padding=(0, 2))
    sigmas = "stated" if result.stated_sigma else "assumed"
    grid.add_row("  chi-square", f"{_number(result.chi2)} with {result.dof} dof")
    grid.add_row("  sigma0", f"{_number(result.sigma0)} times the {sigmas} sigma")
    if result.stated_sigma and result.dof > 0:
        low, high = _chi2_interval(result.dof)
        inside = low <= result.chi2 <= high
        verdict = "inside" if inside else "outside"
        grid.add_row("", f"{verdict} the 95 % interval {low:.4g} ... {high:.4g}")
    yield grid
    pairs = result.identifiability.correlated
    if pairs:
        yield ""
        yield Text("Correlated above 0.95", style="bold")
        for first, second, value in pairs[:LISTED_ROWS]:
            yield Padding(f"{value:+.3f}  {first}  |  {second}", (0, 0, 0, 2))
        yield from _rest(len(pairs), "pairs")


def _outliers(result: CalibrationResult) -> Iterator[RenderableType]:
    if not result.outliers:
        return
    yield ""
    yield Text("Rows that do not fit", style="bold")
    for outlier in result.outliers[:LISTED_ROWS]:
        yield Padding(f"{outlier.place}  {outlier.size:.1f} sigma", (0, 0, 0, 2))
    yield from _rest(len(result.outliers), "rows")


def _rest(count: int, what: str) -> Iterator[RenderableType]:
    if count > LISTED_ROWS:
        more = f"and {count - LISTED_ROWS} more {what} in calibration.json"
        yield Padding(more, (0, 0, 0, 2))


def _table(title: str, columns: Iterable[str]) -> Table:
    table = Table(
        title=title, title_justify="left", title_style="bold", box=None, pad_edge=False
    )
    table.add_column("")
    for column in columns:
        left = column in ("unit", "rows", "robot")
        table.add_column(column, justify="left" if left else "right", no_wrap=True)
    return table


def _sizes(accuracy: Accuracy, unit: str) -> tuple[str, str, str]:
    factor = DISPLAY[unit][1]
    mean, rms, largest = (
        _number(factor * value) for value in (accuracy.mean, accuracy.rms, accuracy.max)
    )
    return mean, rms, largest


def _estimate(item: ParameterEstimate | CoupledGroup) -> tuple[str, str, str]:
    """Value, standard deviation and unit of a parameter or a group."""
    unit, factor = DISPLAY.get(item.unit, (item.unit, 1.0))
    sigma = "-" if item.sigma is None else f"{factor * item.sigma:.4f}"
    return f"{factor * item.value:+.4f}", sigma, unit


def _number(value: float) -> str:
    """Four significant digits, plain where that is short."""
    if not math.isfinite(value):
        return "inf" if value > 0 else "unknown"
    if value == 0.0 or 1e-3 <= abs(value) < 1e5:
        return f"{value:.4g}" if abs(value) >= 1.0 else f"{value:.4f}"
    return f"{value:.1e}"


def _compressed(names: Sequence[str]) -> Iterator[str]:
    """Names with the components of one owner and kind on one line."""
    together: dict[str, list[str]] = {}
    for name in names:
        stem, component = name.rsplit(".", 1)
        together.setdefault(stem, []).append(component)
    for stem, components in together.items():
        yield f"{stem}.{'|'.join(components)}"


def _chi2_interval(dof: int) -> tuple[float, float]:
    from scipy.special import chdtri

    return float(chdtri(dof, 0.975)), float(chdtri(dof, 0.025))
