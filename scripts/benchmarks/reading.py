"""Reading a file of a million measurements, against numpy's reader on the same file.

Each reader has a process of its own; memory is the most that it ever held, imports of
numpy and Pinocchio included, time is without these.
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


def main() -> None:
    """Print time and memory of either reader, and their ratio."""
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "measurements.csv"
        # In a process of its own too, for a process starts with its parent's peak.
        _run("write", file)
        size = file.stat().st_size / 1e6
        print(f"{ROWS} measurements of 6 joints and x, y, z, {size:.0f} MB")
        print(f"{'':<30}{'seconds':>9}{'CPU':>9}{'MB':>6}")
        spent = {}
        for name in ("calib_pin.read_measurements", "numpy.loadtxt"):
            seconds, spent[name], memory = json.loads(_run(name, file))
            print(f"{name:<30}{seconds:>9.2f}{spent[name]:>9.2f}{memory:>6.0f}")
        ours, numpys = spent.values()
        print(f"CPU time of numpy's over ours: {numpys / ours:.2f}")


def _run(job: str, file: Path) -> bytes:
    command = [sys.executable, "-m", "benchmarks.reading", job, str(file)]
    return subprocess.run(command, check=True, stdout=subprocess.PIPE).stdout


def _write(file: str) -> None:
    rng = np.random.default_rng(0)
    chain = calib_pin.load_chain(ROBOT)
    q, values = chain.random_configurations(ROWS, rng), rng.normal(size=(ROWS, 3))
    rows = Measurements(chain.joints, q, "position", values)
    calib_pin.write_measurements(file, rows)


def _read(name: str, file: str) -> tuple[float, float, float]:
    """Seconds, seconds of the processor, and MB of one reader."""
    chain = calib_pin.load_chain(ROBOT)
    start, busy = time.perf_counter(), time.process_time()
    if name == "numpy.loadtxt":
        count = len(np.loadtxt(file, delimiter=",", skiprows=1))
    else:
        count = len(calib_pin.read_measurements(file, chain))
    seconds, busy = time.perf_counter() - start, time.process_time() - busy
    assert count == ROWS
    memory = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024 / 1e6
    return seconds, busy, memory


if __name__ == "__main__":
    if sys.argv[1] == "write":
        _write(sys.argv[2])
    else:
        print(json.dumps(_read(*sys.argv[1:])))
