"""Measurements of several files, Parquet and CSV, on the command line."""

from __future__ import annotations

import json
from pathlib import Path

import pyarrow as pa
import pyarrow.parquet as parquet
from pyarrow import csv

CALIBRATE = "calibrate arm.urdf {} --setup setup.yaml -o {} --quiet"


def days() -> None:
    """The measurements as two Parquet files and the rest as CSV."""
    text = Path("rows.csv").read_text().splitlines()
    header, *lines = (line for line in text if not line.startswith("#"))
    third = len(lines) // 3
    parts = lines[:third], lines[third : 2 * third], lines[2 * third :]
    for number, part in enumerate(parts):
        file = Path(f"day{number}.csv")
        file.write_text("\n".join([header, *part]) + "\n")
        if number < 2:
            parquet.write_table(csv.read_csv(file), f"day{number}.parquet")


def estimated(folder: str) -> list[object]:
    document = json.loads(Path(folder, "calibration.json").read_text())
    return [document[key] for key in ("parameters", "errors", "statistics")]


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
    refuses(
        CALIBRATE.format("day0.parquet day2.csv", "bad"),
        reason="cannot be read as Parquet",
        file="day0.parquet",
    )
    table = parquet.read_table("day1.parquet")
    columns = {name: table[name].to_pylist() for name in table.column_names}
    columns["x"][4] = None
    parquet.write_table(pa.table(columns), "hole.parquet")
    refuses(
        CALIBRATE.format("hole.parquet", "bad"),
        reason="the cell is empty",
        file="hole.parquet",
        line=5,
        column="x",
        value="",
        allowed="a finite number",
    )
