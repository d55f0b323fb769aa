"""A cluster of dask on the loopback: the same results, whoever dies."""

from __future__ import annotations

import asyncio
import os
import signal
import time
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from calib_pin.errors import OptionError
from calib_pin.workers.base import SERIAL, WorkerLost
from calib_pin.workers.cluster import Cluster

pytestmark = [pytest.mark.filterwarnings("default"), pytest.mark.needs("cluster")]


def square(shared: int, item: int) -> int:
    time.sleep(0.001)
    return item * item + shared


def who(shared: None, item: int) -> int:
    time.sleep(0.05)
    return os.getpid()


@pytest.mark.slow
def test_workers_of_dask_have_the_same_results(dask):
    with Cluster(str(dask.file)) as cluster:
        items = range(300)
        assert list(cluster.map(square, 3, items)) == list(SERIAL.map(square, 3, items))
        assert os.getpid() not in set(cluster.map(who, None, range(4)))


@pytest.mark.slow
def test_a_worker_that_is_killed_is_done_without(dask):
    items = range(600)
    with Cluster(str(dask.file)) as cluster:
        assert cluster.count == 2
        found = cluster.map(square, 1, items)
        first = [next(found) for _ in range(40)]
        dask.workers[0].send_signal(signal.SIGKILL)
        assert [*first, *found] == list(SERIAL.map(square, 1, items))


@pytest.mark.slow
def test_a_scheduler_that_is_killed_is_one_line(dask):
    with Cluster(str(dask.file)) as cluster:
        found = cluster.map(square, 1, range(100_000))
        next(found)
        dask.scheduler.send_signal(signal.SIGKILL)
        with pytest.raises(WorkerLost):
            list(found)


@pytest.mark.slow
def test_a_thread_with_a_loop_of_its_own_meets_a_scheduler(dask):
    """As in a notebook."""

    async def meet() -> int:
        with Cluster(str(dask.file)) as cluster:
            return cluster.count

    # This thread may have a loop already: the browser of another test leaves one.
    with ThreadPoolExecutor(1) as thread:
        assert thread.submit(asyncio.run, meet()).result() == 2


@pytest.mark.slow
@pytest.mark.parametrize("address", ["tcp://127.0.0.1:9", "nonsense"])
def test_where_no_scheduler_is_there_is_one_line_within_ten_seconds(address: str):
    begin = time.monotonic()
    with pytest.raises(OptionError):
        Cluster(address)
    assert time.monotonic() - begin < 10.0


@pytest.mark.parametrize("text", ["", "[]", '{"address": 1', '{"id": 3}'])
def test_files_that_are_no_scheduler(tmp_path: Path, text: str):
    file = tmp_path / "scheduler.json"
    with pytest.raises(OptionError, match="scheduler"):
        Cluster(str(file))
    file.write_text(text)
    with pytest.raises(OptionError, match="scheduler"):
        Cluster(str(file))
