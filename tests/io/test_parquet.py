"""Parquet files: the same measurements as from CSV, and one line for a damaged one."""

from __future__ import annotations

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
from calib_pin.io.table import read_table
from calib_pin.units import as_number

pytestmark = pytest.mark.needs("parquet")

Write = Callable[..., Path]


@pytest.fixture
def write(tmp_path: Path) -> Write:
    """Write columns as a Parquet file, a few rows in each of its groups."""

    import pyarrow as pa
    import pyarrow.parquet as parquet

    def write(columns: Any, name: str = "a.parquet", **options: Any) -> Path:
        table = columns if isinstance(columns, pa.Table) else pa.table(columns)
        about = {"row_group_size": 2, **options}
        parquet.write_table(table, tmp_path / name, **about)
        return tmp_path / name

    return write


def columns_of(count: int) -> dict[str, Any]:
    chain, rng = calib_pin.load_chain("space6"), np.random.default_rng(0)
    q = np.rad2deg(chain.random_configurations(count, rng))
    columns = {f"{joint} [deg]": q[:, k] for k, joint in enumerate(chain.joints)}
    columns |= {f"{axis} [mm]": rng.normal(size=count) for axis in "xyz"}
    columns["target"] = [f"ball{k % 3}" for k in range(count)]
    columns["payload"] = [k % 2 for k in range(count)]
    return columns | {"set": ["train"] * (count - 2) + ["validate"] * 2}


def test_the_same_measurements_as_from_csv(write: Write, tmp_path: Path) -> None:
    chain, columns = calib_pin.load_chain("space6"), columns_of(25)
    text = tmp_path / "a.csv"
    text.write_bytes(encode_table(columns, []))
    ours = read_measurements(write(columns, row_group_size=7), chain)
    theirs = read_measurements(text, chain)
    for name in ("q", "values", "validate", "target", "payload"):
        found, expected = (list(getattr(data.only, name)) for data in (ours, theirs))
        np.testing.assert_array_equal(found, expected)
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
    every = found.texts([*types])
    assert found.columns["float"].text(3) == "2"
    for name, (_, texts) in types.items():
        assert list(every[name]) == texts
        column = found.columns[name]
        assert column.missing().tolist() == [not text for text in texts]
        numbers = [as_number(text) for text in texts]
        expected = [np.nan if number is None else number for number in numbers]
        np.testing.assert_array_equal(column.numbers, expected)


def test_a_file_is_known_by_its_content(write: Write, tmp_path: Path) -> None:
    found = read_table(write({"n": [1.0, 2.0, None, 4.0]}, "measured.dat"))
    with pytest.raises(InputError) as caught:
        found.numbers("n", PURE)
    assert (caught.value.line, caught.value.column) == (3, "n")
    text = tmp_path / "a.csv"
    text.write_text("PAR,n\n1,2\n")
    assert "PAR" in read_table(text)


def read_or_refused(file: Path) -> bool:
    """Whether a file is read; if not it costs one line, which names it."""
    try:
        found = read_table(file)
        return bool(found.texts([*found.columns]))
    except InputError as error:
        assert "\n" not in str(error) and str(error.file) == str(file)
        return False


def test_files_that_are_none(write: Write, tmp_path: Path) -> None:
    import pyarrow as pa

    (tmp_path / "a.parquet").write_bytes(b"PAR1" + bytes(40))
    twice = pa.table([pa.array([1.0]), pa.array([2.0])], names=["x", "x [mm]"])
    files = [tmp_path / "a.parquet", tmp_path / "b.parquet"]
    files += [write({"x": pa.array([], pa.float64())}, "c"), write(twice, "d")]
    assert not any(map(read_or_refused, files))


def test_damaged_files_cost_a_line(write: Write) -> None:
    file = write(columns_of(40), row_group_size=20)
    whole, rng = file.read_bytes(), random.Random(0)
    for cut in (len(whole) // 2, len(whole) - 1):
        file.write_bytes(whole[:cut])
        assert not read_or_refused(file)
    for count in (1, 20, 20):
        data = bytearray(whole)
        for _ in range(count):
            data[rng.randrange(4, len(data))] = rng.randrange(256)
        file.write_bytes(data)
        read_or_refused(file)


def test_names_keep_their_digits(write: Write) -> None:
    names = [f"{k:03d}" for k in range(300)]
    table = read_table(write({"target": names, "x": np.arange(300.0)}))
    assert [*table.labels("target")] == names


def test_without_the_extra(write: Write, monkeypatch: pytest.MonkeyPatch) -> None:
    file = write({"x": [1.0]})
    monkeypatch.setitem(sys.modules, "pyarrow", None)
    with pytest.raises(OptionError, match=r"calib-pin\[parquet\]"):
        read_table(file)


MEASURE = """
import resource, sys
import calib_pin

chain, peaks = calib_pin.load_chain("space6"), []
# What a few of them take is what the program takes.
for files in (sys.argv[1:2], sys.argv[2:]):
    data = calib_pin.read_measurements(files, chain).only
    peaks.append(resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024)
print((peaks[1] - peaks[0]) / (data.q.nbytes + data.values.nbytes))
"""


@pytest.mark.slow
def test_memory_of_very_many_measurements(write: Write, tmp_path: Path) -> None:
    """In a file of either kind."""
    chain, rng = calib_pin.load_chain("space6"), np.random.default_rng(0)
    q = chain.random_configurations(300_000, rng)
    values = rng.normal(size=(3, len(q)))
    many = dict(zip([*chain.joints, *"xyz"], [*q.T, *values], strict=True))
    few = write({name: column[:10] for name, column in many.items()}, "few.parquet")
    files = [write(many, "many.parquet", row_group_size=1 << 20), tmp_path / "many.csv"]
    files[1].write_bytes(encode_table(many, []))
    command = [sys.executable, "-c", MEASURE, *map(str, [few, *files])]
    done = subprocess.run(command, check=True, capture_output=True)
    assert float(done.stdout) < 4.0
