"""Measurements of several files, Parquet and CSV, on the command line."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.cli.files import document, table

pytestmark = pytest.mark.needs("parquet")

CALIBRATE = "calibrate arm.urdf {} --setup setup.yaml -o {} --quiet"


def days() -> None:
    """The measurements as two Parquet files and the rest as CSV."""
    import pyarrow.parquet as parquet
    from pyarrow import csv

    header, lines, _ = table("rows.csv")
    third = len(lines) // 3
    parts = lines[:third], lines[third : 2 * third], lines[2 * third :]
    for number, part in enumerate(parts):
        file = Path(f"day{number}.csv")
        file.write_text("\n".join(map(",".join, [header, *part])) + "\n")
        if number < 2:
            parquet.write_table(csv.read_csv(file), f"day{number}.parquet")


def estimated(folder: str) -> list[object]:
    return [document(folder)[key] for key in ("parameters", "errors", "statistics")]


def test_files_of_either_kind_are_one_calibration(here, run):
    days()
    files = "day0.parquet day1.parquet day2.csv"
    assert run(CALIBRATE.format(files, "mixed")).status == 0
    assert run(CALIBRATE.format("rows.csv", "plain")).status == 0
    assert estimated("mixed") == estimated("plain")


def test_a_bad_file_costs_a_line(here, refuses):
    days()
    whole = Path("day0.parquet").read_bytes()
    Path("day0.parquet").write_bytes(whole[: len(whole) // 2])
    refuses(CALIBRATE.format("day0.parquet day2.csv", "bad"), file="day0.parquet")
