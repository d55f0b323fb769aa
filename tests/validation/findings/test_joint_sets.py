"""Of two columns for the same joints the one that fits is named, with its lines."""

from __future__ import annotations

import csv
from dataclasses import replace

import numpy as np
import pytest

import calib_pin
from calib_pin.cli.files import open_chains, open_measurements
from calib_pin.setup import JointMap, Setup

SETUP = Setup(base="base_link", tip="tool0")


@pytest.fixture(scope="module")
def measured(ur10):
    return ur10(count=60).only


@pytest.fixture
def told(measured, tmp_path):
    """The findings of a file with one column of each joint, and others beside."""

    def of(q, columns, setup=SETUP):
        path = tmp_path / "rows.csv"
        calib_pin.write_measurements(path, replace(measured, q=q), force=True)
        with path.open() as file:
            lines = list(csv.reader(file))
        for name, values in columns.items():
            cells = [name, *map(str, values)]
            lines = [[*line, c] for line, c in zip(lines, cells, strict=True)]
        with path.open("w") as file:
            csv.writer(file).writerows(lines)
        chains = open_chains("example:ur10_robot", setup)
        chains, rows = open_measurements([path], chains, setup, quiet=True)
        result = calib_pin.calibrate(chains, rows, setup, validate=False)
        return {f.code: f for f in result.findings}

    return of


def commanded(measured, size):
    rng = np.random.default_rng(1)
    return measured.q + rng.normal(0.0, size, measured.q.shape)


def in_degrees(q):
    return {f"actual_{k} [deg]": np.degrees(column) for k, column in enumerate(q.T)}


def test_measured_positions_fit_better(told, measured) -> None:
    found = told(commanded(measured, 2e-3), in_degrees(measured.q))
    finding = found["joint-columns"]
    assert finding.severity == "error"
    assert finding.setup == {
        "joints": {f"actual_{k}": {"joint": j} for k, j in enumerate(measured.joints)}
    }
    assert finding.evidence["rms_after"] == pytest.approx(1.5e-4, rel=0.2)
    assert "lag" not in found


def test_worse_ones_are_a_remark(told, measured) -> None:
    found = told(measured.q, in_degrees(commanded(measured, 1e-3)))
    finding = found["joint-columns"]
    assert (finding.severity, finding.setup) == ("info", {})


def test_alike_ones_are_not_worth_a_word(told, measured) -> None:
    """And columns that overflow are no joints."""
    columns = in_degrees(commanded(measured, 1e-6))
    columns["count"] = np.full(len(measured.q), 1e300)
    assert told(measured.q, columns) == {}


def test_maps_of_joints_are_kept(told, measured) -> None:
    """The other column of a joint counts as the first one does."""
    first, second = measured.joints[:2]
    joints = {
        "shoulder": JointMap(first, sign=-1, gear=2.0, offset=0.1),
        second: JointMap(second, coupled={"shoulder": 0.5}),
    }
    there, q = commanded(measured, 1e-3), measured.q.copy()
    columns = {}
    for name, positions in (("shoulder", there), ("shoulder_measured", measured.q)):
        columns[name] = (0.1 - positions[:, 0]) / 2.0
    there[:, 1] -= 0.5 * columns["shoulder"]
    setup = replace(SETUP, joints=joints)
    finding = told(
        np.concatenate([q[:, :1], there[:, 1:2], q[:, 2:]], axis=1), columns, setup
    )["joint-columns"]
    assert finding.setup["joints"] == {
        "shoulder_measured": {"joint": first, "sign": -1, "gear": 2.0, "offset": 0.1},
        second: {"joint": second, "coupled": {"shoulder_measured": 0.5}},
    }
