"""Files that commands read and write, as tests look at them."""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from calib_pin.report.figures import NAMES


def document(path: str | Path) -> dict[str, Any]:
    """A document of JSON, or that of the calibration in a folder."""
    path = Path(path)
    file = path / "calibration.json" if path.is_dir() else path
    return json.loads(file.read_text())  # type: ignore[no-any-return]


def table(path: str) -> tuple[list[str], list[list[str]], list[str]]:
    """Header, cells and comments of a CSV file."""
    lines = Path(path).read_text().splitlines()
    comments = [line for line in lines if line.startswith("#")]
    header, *rows = csv.reader(line for line in lines if not line.startswith("#"))
    return header, rows, comments


def column(path: str, name: str) -> list[str]:
    """Cells of a column of a CSV file."""
    header, rows, _ = table(path)
    return [row[header.index(name)] for row in rows]


def numbers(path: str) -> np.ndarray:
    """A CSV file that holds nothing but numbers."""
    return np.array(table(path)[1], float)


def write(path: str, header: str, rows: Any) -> None:
    """Write a CSV file under a comment."""
    lines = [",".join(str(cell) for cell in row) for row in rows]
    Path(path).write_text("\n".join(["# mine", header, *lines]) + "\n")


def marked(path: str, every: int) -> None:
    """Mark every so many rows of a file for validation."""
    header, rows, _ = table(path)
    marks = ("train", "validate")
    write(
        path,
        ",".join([*header, "set"]),
        [[*row, marks[k % every == 0]] for k, row in enumerate(rows)],
    )


DRAW = [f"calib_pin.cli.{name}.draw_calibration" for name in ("calibrate", "report")]
"""What commands draw the figures of a calibration with."""


@contextmanager
def undrawn() -> Iterator[None]:
    """Pages of calibrations have no figures, which take the longest."""
    with pytest.MonkeyPatch.context() as patch:
        for place in DRAW:
            patch.setattr(place, lambda *about: [])
        yield


@dataclass(frozen=True)
class Figure:
    """What stands for a figure, and takes no time to draw."""

    name: str
    content: str
    title: str = "title"
    reading: str = ""

    def svg(self) -> str:
        return f"<svg>{self.content}</svg>"

    def picture(self, kind: str) -> bytes:
        return f"{self.name} {self.content} {kind}".encode() * 10_000


def figures(result: Any, *_: object) -> list[Figure]:
    """Instead of those of a calibration; they tell results apart."""
    names = NAMES["calibration"]
    return [Figure(name, repr(result.statistics.chi2)) for name in names]


def planned_uncertainty(report: str) -> float:
    """The tool-point uncertainty that the report of a plan predicts [mm]."""
    (found,) = re.findall(r"predicted tool-point uncertainty +([\d.e-]+) mm", report)
    return float(found)
