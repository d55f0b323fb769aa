"""Temperature and time on the way from simulated errors to a calibration and back."""

from __future__ import annotations

import csv
import json
from pathlib import Path

import numpy as np
import pytest

import calib_pin

SETUP = """
model: position
parameters: [placement, cross-compliance, thermal, instrument-drift]
payloads: {load: {mass: 20, com: [0.1, 0, 0.1]}}
thermal: {reference: 20, materials: {aluminium: [joint_2, joint_3]}}
frames: {base: {estimate: true}, tool: {xyz: [0, 0, 0.1], estimate: true}}
noise: {position: 2e-5}
"""
DRIFT = "drift: {spans: {base: [0, 3600]}, shift: 1e-4, turn: 0}\n"
ERRORS = """
base.instrument-drift.x2: 1e-4
aluminium.thermal.growth: 2.3e-5
joint_3.cross-compliance.kx: 3e-6
"""


@pytest.fixture
def measured(run, tmp_path, monkeypatch):  # type: ignore[no-untyped-def]
    """A folder with measurements of a true robot at stated conditions."""
    monkeypatch.chdir(tmp_path)
    chain, count = calib_pin.load_chain("space6"), 100
    q = chain.random_configurations(count, np.random.default_rng(0))
    with Path("at.csv").open("w", newline="") as file:
        table = csv.writer(file)
        table.writerow([*chain.joints, "temperature", "time"])
        for k, row in enumerate(q.tolist()):
            table.writerow([*row, 20.0 + 0.1 * k, 36.0 * k])
    Path("true.yaml").write_text(SETUP + DRIFT)
    Path("setup.yaml").write_text(SETUP)
    Path("errors.yaml").write_text(ERRORS)
    words = "--setup true.yaml --errors errors.yaml --configurations at.csv"
    assert run(f"simulate space6 {words} -o rows.csv").status == 0
    return run


def test_errors_of_conditions_come_back(measured) -> None:  # type: ignore[no-untyped-def]
    words = "calibrate space6 rows.csv --setup setup.yaml -o out"
    done = measured(words)
    assert done.status == 0
    assert "the instrument has drifted by" in " ".join(done.out.split())
    document = json.loads(Path("out/calibration.json").read_text())
    found = {p["name"]: p for p in document["parameters"]}
    for name, size in (
        ("aluminium.thermal.growth", 2.3e-5),
        ("joint_3.cross-compliance.kx", 3e-6),
    ):
        assert abs(found[name]["value"] - size) < 5.0 * found[name]["sigma"] < size
    drift = document["setup"]["drift"]
    assert drift["spans"] == {"base": [0.0, 3564.0]} and drift["turn"] == 0.0
    # The file alone tells as much as the calibration did.
    said = measured("evaluate out/calibration.json rows.csv --json")
    errors = json.loads(said.out)["errors"]["position"]
    after = document["errors"]["position"]["training"]["after"]
    assert errors["rms"] == pytest.approx(after["rms"], rel=1e-9)


def test_rows_without_what_is_needed(measured, refuses) -> None:  # type: ignore[no-untyped-def]
    for column in ("temperature", "time"):
        lines = Path("rows.csv").read_text().splitlines()
        kept = [line for line in lines if not line.startswith("#")]
        names = kept[0].split(",")
        place = names.index(column)
        rows = [line.split(",") for line in kept]
        text = [",".join(row[:place] + row[place + 1 :]) for row in rows]
        Path("less.csv").write_text("\n".join(text) + "\n")
        refuses(
            "calibrate space6 less.csv --setup setup.yaml -o out",
            file="less.csv",
            line=2,
            column=column,
        )
