"""Parquet files: the same measurements as from CSV, and one line for a damaged one."""

from __future__ import annotations

import json
import random
import subprocess
import sys
from collections.abc import Callable
from decimal import Decimal
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError, OptionError
from calib_pin.io.columns import PURE
from calib_pin.io.measurements import encode_table, read_measurements
from calib_pin.io.table import Table, read_table
from calib_pin.units import as_number

pytestmark = pytest.mark.needs("parquet")

Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write columns as a Parquet file, a few rows in each of its groups."""

    import pyarrow as pa
    import pyarrow.parquet as parquet

    def write(columns: Any, name: str = "a.parquet", **options: Any) -> Path:
        file = tmp_path / name
        parquet.write_table(
            columns if isinstance(columns, pa.Table) else pa.table(columns),
            file,
            **{"row_group_size": 2, **options},
        )
        return file

    return write


def columns_of(count: int, seed: int = 0) -> dict[str, Any]:
    rng = np.random.default_rng(seed)
    chain = calib_pin.load_chain("space6")
    q = np.rad2deg(chain.random_configurations(count, rng))
    joints = {f"{joint} [deg]": q[:, k] for k, joint in enumerate(chain.joints)}
    values = {f"{axis} [mm]": rng.normal(size=count) for axis in "xyz"}
    return {
        **joints,
        **values,
        "target": [f"ball{k % 3}" for k in range(count)],
        "payload": [k % 2 for k in range(count)],
        "set": ["train"] * (count - 2) + ["validate"] * 2,
    }


def test_the_same_measurements_as_from_csv(write: Write, tmp_path: Path) -> None:
    chain, columns = calib_pin.load_chain("space6"), columns_of(25)
    text = tmp_path / "a.csv"
    text.write_bytes(encode_table(columns, []))
    ours = read_measurements(write(columns, row_group_size=7), chain)
    theirs = read_measurements(text, chain)
    for name in ("q", "values", "validate"):
        found, expected = (getattr(data.only, name) for data in (ours, theirs))
        np.testing.assert_array_equal(found, expected)
    for name in ("target", "payload"):
        found, expected = (getattr(data.only, name) for data in (ours, theirs))
        assert list(found) == list(expected)
    assert ours.only.lines.tolist() == list(range(1, 26))


def cells_of_types() -> dict[str, tuple[Any, list[str]]]:
    """Cells of columns, and their trimmed texts."""
    import pyarrow as pa

    floats = pa.array([0.5, 1, 2, -0.0], pa.float32())
    coded = pa.array(["a", "a", "b", "a"]).dictionary_encode()
    return {
        "float": (pa.array([1.5, None, np.nan, 2.0]), ["1.5", "", "", "2"]),
        "int": (pa.array([1, 2, None, 2**40]), ["1", "2", "", str(2**40)]),
        "uint8": (pa.array([7, 8, 9, 10], pa.uint8()), ["7", "8", "9", "10"]),
        "float32": (floats, ["0.5", "1", "2", "-0"]),
        "text": (pa.array(["1.5", "b", None, " 2"]), ["1.5", "b", "", "2"]),
        "coded": (coded, ["a", "a", "b", "a"]),
        "bool": (pa.array([True, False, None, True]), ["True", "False", "", "True"]),
        "decimal": (pa.array([Decimal("1.25")] * 4), ["1.25"] * 4),
        "list": (pa.array([[1.0], [], None, [2.0]]), ["[1.0]", "[]", "", "[2.0]"]),
        "null": (pa.nulls(4), [""] * 4),
    }


def test_cells_of_every_type(write: Write) -> None:
    types = cells_of_types()
    found = read_table(write({name: cells for name, (cells, _) in types.items()}))
    some = found.rows(np.array([3, 1]), [*types])
    every, few = found.texts([*types]), some.texts([*types])
    assert found.columns["float"].text(3) == "2"
    for name, (_, texts) in types.items():
        assert list(every[name]) == texts
        assert list(few[name]) == [texts[3], texts[1]]
        column = found.columns[name]
        assert column.missing().tolist() == [not text for text in texts]
        numbers = [as_number(text) for text in texts]
        expected = [np.nan if number is None else number for number in numbers]
        np.testing.assert_array_equal(column.numbers, expected)


def test_a_bad_cell_is_blamed_on_its_row(write: Write) -> None:
    found = read_table(write({"n": [1.0, 2.0, None, 4.0]}))
    with pytest.raises(InputError) as caught:
        found.numbers("n", PURE)
    assert (caught.value.line, caught.value.column) == (3, "n")


def test_by_content(write: Write, tmp_path: Path) -> None:
    assert len(read_table(write({"n": [1.0]}, "measured.dat")).lines) == 1
    text = tmp_path / "a.csv"
    text.write_text("PAR,n\n1,2\n")
    assert "PAR" in read_table(text)


def unreadable(file: Path) -> None:
    """A file costs one line, which names it."""
    with pytest.raises(InputError) as caught:
        found = read_table(file)
        assert isinstance(found, Table)
        for name in found.columns:
            found.texts([name])
    assert "\n" not in str(caught.value)
    assert str(caught.value.file) == str(file)


def test_files_that_are_none(write: Write, tmp_path: Path) -> None:
    import pyarrow as pa

    file = tmp_path / "a.parquet"
    file.write_bytes(b"PAR1" + bytes(40))
    unreadable(file)
    unreadable(tmp_path / "b.parquet")
    unreadable(write({"x": pa.array([], pa.float64())}))
    twice = pa.table([pa.array([1.0]), pa.array([2.0])], names=["x", "x [mm]"])
    unreadable(write(twice))


def test_damaged_files_cost_a_line(write: Write) -> None:
    file = write(columns_of(40), row_group_size=20)
    whole, rng = file.read_bytes(), random.Random(0)
    for cut in (len(whole) // 2, len(whole) - 1):
        file.write_bytes(whole[:cut])
        unreadable(file)
    for _ in range(3):
        data = bytearray(whole)
        for _ in range(rng.choice((1, 20))):
            data[rng.randrange(4, len(data))] = rng.randrange(256)
        file.write_bytes(data)
        try:
            read_table(file)
        except InputError as error:
            assert "\n" not in str(error)


def test_without_the_extra(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write({"x": [1.0]})
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(OptionError, match=r"calib-pin\[parquet\]"):
        read_table(file)


MEASURE = """
import json, resource, sys
import calib_pin

def peak(who):
    return resource.getrusage(who).ru_maxrss * 1024

chain = calib_pin.load_chain("space6")
# What a few of them take is what the program takes.
calib_pin.read_measurements(sys.argv[1:2], chain)
before = peak(resource.RUSAGE_SELF)
data = calib_pin.read_measurements(sys.argv[2:], chain).only
print(json.dumps({
    "numbers": data.q.nbytes + data.values.nbytes,
    "taken": peak(resource.RUSAGE_SELF) - before,
}))
"""


@pytest.mark.slow
def test_memory_of_a_million_measurements(write: Write, tmp_path: Path) -> None:
    """In a file of either kind."""
    chain, rng = calib_pin.load_chain("space6"), np.random.default_rng(0)

    def columns(count: int) -> dict[str, Any]:
        q = chain.random_configurations(count, rng)
        values = rng.normal(size=(count, 3))
        return {**dict(zip(chain.joints, q.T, strict=True)), "x": values[:, 0]} | {
            axis: values[:, k + 1] for k, axis in enumerate("yz")
        }

    few = write(columns(10), "few.parquet")
    many = columns(1_000_000)
    files = [write(many, "many.parquet", row_group_size=1 << 20), tmp_path / "many.csv"]
    files[1].write_bytes(encode_table(many, []))
    command = [sys.executable, "-c", MEASURE, *map(str, [few, *files])]
    found = json.loads(subprocess.run(command, check=True, capture_output=True).stdout)
    assert found["taken"] < 4.0 * found["numbers"]
