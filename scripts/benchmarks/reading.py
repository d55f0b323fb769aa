"""Reading files of a million measurements, against others' readers on the same files.

Each reader has a process of its own; memory is the most that it and its child ever
held, imports of numpy and Pinocchio included, time is without these.
"""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import calib_pin
from calib_pin.observations import Measurements

ROWS = 1_000_000
ROBOT = "space6"
ENDINGS = "csv parquet"
NUMBERS = 9 * 8 * ROWS
"""Bytes of the numbers of one file."""


OURS = "calib_pin.read_measurements"
READERS = {
    OURS: ("csv", "parquet", "csv parquet"),
    "numpy.loadtxt": ("csv",),
    "pyarrow.parquet": ("parquet",),
}
"""The files that each reads."""


def main() -> None:
    """Print time and memory of each reader, and their ratios."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "measurements"
        # In a process of its own too, for a process starts with its parent's peak.
        _run("write", file, "")
        sizes = [f"{each.stat().st_size / 1e6:.0f}" for each in _files(file, ENDINGS)]
        print(
            f"{ROWS} measurements of 6 joints and x, y, z: CSV of {sizes[0]} MB, "
            f"Parquet of {sizes[1]} MB; {NUMBERS / 1e6:.0f} MB of numbers"
        )
        print(f"{'':<42}{'seconds':>9}{'CPU':>9}{'MB':>6}{'of child':>9}")
        spent = {}
        for name, endings in READERS.items():
            for ending in endings:
                found = json.loads(_run(name, file, ending))
                seconds, spent[name, ending], memory, child = found
                print(
                    f"{name + ', ' + ending:<42}{seconds:>9.2f}"
                    f"{spent[name, ending]:>9.2f}{memory:>6.0f}{child:>9.0f}"
                )
        for other, ending in (("numpy.loadtxt", "csv"), (OURS, "csv")):
            mine = "parquet" if other == OURS else "csv"
            ratio = spent[other, ending] / spent[OURS, mine]
            print(f"CPU time of {other}, {ending}, over ours, {mine}: {ratio:.2f}")


def _files(file: Path, endings: str) -> list[Path]:
    return [file.with_suffix(f".{ending}") for ending in endings.split()]


def _run(job: str, file: Path, endings: str) -> bytes:
    command = [sys.executable, "-m", "benchmarks.reading", job, str(file), endings]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout


def _write(file: str) -> None:
    import pyarrow as pa
    from pyarrow import parquet

    rng = np.random.default_rng(0)
    chain = calib_pin.load_chain(ROBOT)
    q, values = chain.random_configurations(ROWS, rng), rng.normal(size=(ROWS, 3))
    rows = Measurements(chain.joints, q, "position", values)
    text, binary = _files(Path(file), ENDINGS)
    calib_pin.write_measurements(text, rows)
    names = [*chain.joints, "x", "y", "z"]
    columns = [*q.T, *values.T]
    parquet.write_table(pa.table(dict(zip(names, columns, strict=True))), binary)


def _read(name: str, file: str, endings: str) -> tuple[float, float, float, float]:
    """Seconds, seconds of the processors, and MB of one reader and of its child."""
    chain = calib_pin.load_chain(ROBOT)
    files = _files(Path(file), endings)
    start, busy = time.perf_counter(), time.process_time()
    if name == "numpy.loadtxt":
        count = len(np.loadtxt(files[0], delimiter=",", skiprows=1))
    elif name == "pyarrow.parquet":
        from pyarrow import parquet

        count = len(parquet.read_table(files[0], use_threads=False))
    else:
        count = len(calib_pin.read_measurements(files, chain))
    seconds, busy = time.perf_counter() - start, time.process_time() - busy
    assert count == ROWS * len(files)
    own, child = map(
        resource.getrusage, (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)
    )
    busy += child.ru_utime + child.ru_stime
    memory = [each.ru_maxrss * 1024 / 1e6 for each in (own, child)]
    return seconds, busy, memory[0], memory[1]


if __name__ == "__main__":
    if sys.argv[1] == "write":
        _write(sys.argv[2])
    else:
        print(json.dumps(_read(*sys.argv[1:])))
