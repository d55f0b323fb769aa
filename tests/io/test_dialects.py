"""Foreign layouts: recognized by their columns, and read with our names and units."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from pathlib import Path

import numpy as np
import pytest

from calib_pin.io.columns import LENGTH
from calib_pin.io.dialects import DIALECTS
from calib_pin.io.logs import TIME
from calib_pin.io.measured_columns import read_quaternions
from calib_pin.io.table import Table, read_table
from calib_pin.kinematics.spatial import so3_exp, to_quaternion
from calib_pin.plugins import extensions


@pytest.fixture
def table(tmp_path: Path):
    def table(text: str, columns: Mapping[str, str] = {}) -> Table:
        file = tmp_path / "a.csv"
        file.write_text(text)
        return read_table(file, columns=columns)

    return table


def test_a_topic_of_ros_1(table):
    found = table(
        "%time,field.header.seq,field.header.stamp,field.name0,field.name1,"
        "field.position0,field.position1,field.velocity0,field.velocity1\n"
        "1700000000100000000,4,1700000000000000000,elbow,shoulder,0.5,-1.5,0,0\n"
        "1700000000200000000,5,1700000000100000000,elbow,shoulder,0.6,-1.6,0,0\n"
    )
    assert found.columns["elbow"].numbers.tolist() == [0.5, 0.6]
    assert found.columns["shoulder"].numbers.tolist() == [-1.5, -1.6]
    # When it was measured, not when it came.
    assert np.allclose(found.numbers("time", TIME), [1.7e9, 1.7e9 + 0.1])
    assert "ROS 1" in found.remarks[0]


def test_a_log_of_ndi(table):
    R = so3_exp(np.random.default_rng(0).normal(size=(3, 3)))
    matrix = [f"R{row}{column}" for row in range(3) for column in range(3)]
    lines = [",".join(["Tool ID", "Timestamp", "Frame #", "Tx", "Ty", "Tz", *matrix])]
    for k, turned in enumerate(R):
        cells = [f"{value:.4f}" for value in turned.ravel()]
        lines.append(",".join([str(k % 2), f"{k}.5", "9", "100", "-20", "3", *cells]))
    lines.append(",".join(["1", "7.5", "9", *["MISSING"] * 12]))
    found = table("\n".join(lines))
    assert found.columns["x"].missing().tolist() == [False] * 3 + [True]
    assert found.columns["qx"].missing().tolist() == [False] * 3 + [True]
    seen = found.rows(np.arange(3), found.columns)
    assert seen.numbers("x", LENGTH).tolist() == [0.1] * 3
    assert list(seen.texts(["tool"])["tool"]) == ["0", "1", "0"]
    turned = read_quaternions(seen, "quaternion")
    assert np.allclose(turned, to_quaternion(R), rtol=0, atol=1e-4)


def test_columns_that_the_setup_names_are_as_it_says(table):
    text = "Tx,Ty,Tz,Q0,Qx,Qy,Qz\n1,2,3,1,0,0,0\n"
    assert table(text).numbers("x", LENGTH).tolist() == [1e-3]
    found = table(text, {"x": "Tx [m]"})
    assert found.numbers("x", LENGTH).tolist() == [1.0] and not found.remarks


@pytest.fixture
def outside(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[None]:
    """The dialect of another package, as pip leaves it."""
    info = tmp_path / "site" / "shouting-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text("Name: shouting\nVersion: 1.0\n")
    entry = "[calib_pin.dialects]\nshouting = shouting:Shouting\n"
    (info / "entry_points.txt").write_text(entry)
    (tmp_path / "site" / "shouting.py").write_text(
        "from calib_pin.io.dialects import Dialect, Reading\n\n\n"
        "class Shouting(Dialect):\n"
        "    def read(self, columns, file):\n"
        "        if not all(name.isupper() for name in columns):\n"
        "            return None\n"
        "        return Reading({k.lower(): c for k, c in columns.items()}, 'loud')\n"
    )
    monkeypatch.syspath_prepend(tmp_path / "site")
    extensions.cache_clear()
    yield
    extensions.cache_clear()


def test_a_dialect_of_another_package(table, outside):
    found = table("X,Y\n1,2\n")
    assert list(found.columns) == ["x", "y"] and found.remarks == ("read as loud",)
    assert list(table("X,y\n1,2\n").columns) == ["X", "y"]
    assert list(DIALECTS)[-1] == "shouting"
