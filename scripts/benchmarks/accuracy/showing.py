"""The table of accuracies, and the same as JSON."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from importlib.metadata import version
from typing import Any

from rich import box
from rich.table import Table

from benchmarks.accuracy.measuring import METHODS, Errors, Measured
from benchmarks.accuracy.published import published
from calib_pin.validation.result import Accuracy, QuantityError

MM = 1e3
HEADERS = {
    "nominal": "nominal",
    "placement": "placement",
    "compliance": "placement, compliance",
    "chosen": "chosen by itself",
}
"""What the methods are called in the table and the figure."""


def table(found: Iterable[Measured]) -> Table:
    """Errors of every data set, mean and rms in mm."""
    result = Table(box=box.SIMPLE_HEAD, title="mean / rms in mm, not fitted")
    result.add_column("data set")
    for name in ("measurements", *(HEADERS[method] for method in METHODS)):
        result.add_column(name)
    result.add_column("predicted away")
    result.add_column("others")
    for measured in found:
        name = f"{measured.data_set.name}\n{measured.model}"
        for k, line in enumerate(measured.lines):
            result.add_row(
                name if k == 0 else "",
                f"{line.where}: {line.what}, {line.count}",
                *(_pair(line.errors[method]) for method in METHODS),
                _pair(measured.predicted_beside(line)),
                _others(measured, line),
                end_section=k + 1 == len(measured.lines),
            )
    return result


def _pair(errors: Accuracy | QuantityError | None) -> str:
    if errors is None:
        return ""
    return f"{MM * errors.mean:.3f} / {MM * errors.rms:.3f}"


def _others(measured: Measured, line: Errors) -> str:
    known = published(measured.data_set.key, line.where)
    return "\n".join(f"{p.error:g} ({p.statistic}), {p.method}" for p in known)


def document(found: Sequence[Measured], seed: int) -> dict[str, Any]:
    """All numbers, in SI units but for those of others."""
    return {
        "format": "calib-pin/accuracy",
        "version": 1,
        "calib_pin": version("calib-pin"),
        "seed": seed,
        "data_sets": [_numbers(measured) for measured in found],
    }


def _numbers(measured: Measured) -> dict[str, Any]:
    data_set = measured.data_set
    return {
        "key": data_set.key,
        "name": data_set.name,
        "instrument": data_set.instrument,
        "measurement_model": data_set.model,
        "fitted": measured.fitted,
        "model": measured.model,
        "verdict": measured.verdict,
        "predicted_away": None
        if measured.predicted is None
        else {"mean": measured.predicted.mean, "rms": measured.predicted.rms},
        "errors": [
            {
                "where": line.where,
                "measurements": line.what,
                "count": line.count,
                **{method: vars(line.errors[method]) for method in METHODS},
            }
            for line in measured.lines
        ],
        "published": [
            vars(each)
            for where in ("near", "away")
            for each in published(data_set.key, where)
        ],
    }
