"""Temperature and time on the way from simulated errors to a calibration and back."""

from __future__ import annotations

import json
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from tests.cli.files import document, table, write

SETUP = """
model: position
parameters: [joint-offset, cross-compliance, thermal, instrument-drift]
payloads: {load: {mass: 20, com: [0.1, 0, 0.1]}}
thermal: {reference: 20}
frames: {base: {estimate: true}, tool: {xyz: [0, 0, 0.1], estimate: true}}
noise: {position: 2e-5}
"""
DRIFT = "drift: {spans: {base: [0, 3600]}, shift: 1e-4, turn: 0}\n"
ERRORS = """
base.instrument-drift.x2: 1e-4
joint_2.thermal.growth: 2.3e-5
joint_3.cross-compliance.kx: 3e-6
"""


@pytest.fixture
def measured(run, alone):  # type: ignore[no-untyped-def]
    """A folder with measurements of a true robot at stated conditions."""
    chain, count = calib_pin.load_chain("space6"), 100
    q = chain.random_configurations(count, np.random.default_rng(0))
    rows = [[*row, 20.0 + 0.1 * k, 36.0 * k] for k, row in enumerate(q.tolist())]
    write("at.csv", ",".join([*chain.joints, "temperature", "time"]), rows)
    Path("true.yaml").write_text(SETUP + DRIFT)
    Path("setup.yaml").write_text(SETUP)
    Path("errors.yaml").write_text(ERRORS)
    words = "--setup true.yaml --errors errors.yaml --configurations at.csv"
    assert run(f"simulate space6 {words} -o rows.csv").status == 0
    return run


@pytest.mark.slow
def test_errors_of_conditions_come_back(measured) -> None:  # type: ignore[no-untyped-def]
    words = "calibrate space6 rows.csv --setup setup.yaml -o out"
    done = measured(words)
    assert done.status == 0
    stated = document("out")
    found = {p["name"]: p for p in stated["parameters"]}
    for name, size in (
        ("joint_2.thermal.growth", 2.3e-5),
        ("joint_3.cross-compliance.kx", 3e-6),
    ):
        assert abs(found[name]["value"] - size) < 5.0 * found[name]["sigma"] < size
    drift = stated["setup"]["drift"]
    assert drift["spans"] == {"base": [0.0, 3564.0]} and drift["turn"] == 0.0
    # The file alone tells as much as the calibration did.
    said = measured("evaluate out/calibration.json rows.csv --json")
    errors = json.loads(said.out)["errors"]["position"]
    after = stated["errors"]["position"]["training"]["after"]
    assert errors["rms"] == pytest.approx(after["rms"], rel=1e-9)
    # No target says how warm the robot is: it is told what the commands are for.
    write("targets.csv", "x,y,z", [[0.5, 0.1, 0.6]])
    told = measured("compensate out targets.csv -o commands.csv --payload load").err
    assert "links at 20 degC" in told and "before it drifted" in told


def test_rows_without_what_is_needed(measured, refuses) -> None:  # type: ignore[no-untyped-def]
    header, rows, _ = table("rows.csv")
    for column in ("temperature", "time"):
        at = header.index(column)
        less = [row[:at] + row[at + 1 :] for row in rows]
        write("less.csv", ",".join(header[:at] + header[at + 1 :]), less)
        refuses(
            "calibrate space6 less.csv --setup setup.yaml -o out",
            file="less.csv",
            line=3,
            column=column,
        )
