"""Processes of this machine: the same results, and what becomes of dead ones."""

from __future__ import annotations

import os
import signal
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from calib_pin.errors import OptionError
from calib_pin.workers.base import SERIAL
from calib_pin.workers.cluster import Cluster
from calib_pin.workers.local import LocalProcesses


def threads(shared: None, item: int) -> tuple[int, str | None, int]:
    """The process, and how many threads it may use."""
    from numba import config
    from threadpoolctl import threadpool_info

    product = np.ones((2, 2)) @ np.ones((2, 2))
    assert product.any()
    most = max((pool["num_threads"] for pool in threadpool_info()), default=1)
    return most, os.environ.get("OMP_NUM_THREADS"), int(config.NUMBA_NUM_THREADS)


def drawn(seed: int, item: int) -> bytes:
    return np.random.default_rng([seed, item]).normal(size=100).tobytes()


def slow(shared: None, item: int) -> int:
    time.sleep(0.05)
    return os.getpid()


def deadly(flag: str | None, item: int) -> int:
    """Item 7 ends its process: always, or once where a file is to tell of it."""
    if item == 7 and not (flag and Path(flag).exists()):
        if flag:
            Path(flag).touch()
        os.kill(os.getpid(), signal.SIGKILL)
    return item


def inner(shared: int, item: int) -> int:
    with LocalProcesses(2, patience=0.0) as workers:
        return sum(workers.map(added, shared, range(item)))


def added(shared: int, item: int) -> int:
    return shared + item


def test_any_number_of_processes_has_the_same_bytes():
    expected = list(SERIAL.map(drawn, 3, range(200)))
    for count in (1, 2):
        with LocalProcesses(count, patience=0.0) as workers:
            assert list(workers.map(drawn, 3, range(200))) == expected
            assert list(workers.map(drawn, 4, iter(range(5)))) != expected[:5]


def test_a_worker_has_one_thread():
    with LocalProcesses(1, patience=0.0) as workers:
        assert list(workers.map(threads, None, [0])) == [(1, "1", 1)]


def test_what_is_done_soon_starts_no_process():
    with LocalProcesses(2, patience=30.0) as workers:
        assert set(workers.map(slow, None, range(4))) == {os.getpid()}
    with LocalProcesses(1) as workers:
        assert set(workers.map(slow, None, range(3))) == {os.getpid()}


@pytest.mark.slow
def test_what_takes_longer_is_shared():
    with LocalProcesses(2, patience=0.1) as workers:
        found = list(workers.map(slow, None, range(60)))
    assert found[0] == os.getpid() and len(set(found)) == 3


@pytest.mark.slow
def test_an_item_that_kills_its_process_stops_nothing(tmp_path: Path):
    with LocalProcesses(2, patience=0.0) as workers:
        found = workers.map(deadly, None, range(40), lambda item: -item)
        assert list(found) == [-7 if k == 7 else k for k in range(40)]
        flag = str(tmp_path / "flag")
        assert list(workers.map(deadly, flag, range(40))) == list(range(40))
        assert list(workers.map(inner, 1, range(4))) == [0, 1, 3, 6]


SCRIPT = """
import os, sys, tempfile, time
from calib_pin.workers.local import LocalProcesses

def work(shared, item):
    os.write(1, b"%d\\n" % os.getpid())  # At once: two processes write.
    time.sleep(60)

if __name__ == "__main__":
    tempfile.tempdir = sys.argv[1]
    with LocalProcesses(2, patience=0.0) as workers:
        list(workers.map(work, None, range(8)))
"""


@pytest.mark.parametrize("number", [signal.SIGKILL, signal.SIGINT, signal.SIGTERM])
def test_no_worker_outlives_its_parent(tmp_path: Path, number: signal.Signals):
    script = tmp_path / "script.py"
    script.write_text(SCRIPT)
    process = subprocess.Popen(
        [sys.executable, script, tmp_path],
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
    )
    assert process.stdout is not None
    children = [int(process.stdout.readline()) for _ in range(2)]
    process.send_signal(number)
    process.wait(20)
    deadline = time.monotonic() + 20
    while time.monotonic() < deadline and any(map(alive, children)):
        time.sleep(0.05)
    assert not any(map(alive, children))
    assert not list(tmp_path.glob("calib-pin-*"))
    process.stdout.close()


def alive(process: int) -> bool:
    """Whether a process runs; one that nobody has buried does not."""
    try:
        state = Path(f"/proc/{process}/stat").read_text().rpartition(")")[2].split()[0]
    except OSError:
        return False
    return state != "Z"


def test_without_dask_one_line_says_how_to_get_it(monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(OptionError, match=r"calib-pin\[cluster\]"):
        Cluster("tcp://127.0.0.1:9")
