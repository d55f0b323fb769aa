"""Options of commands whose work may be spread over processes or a cluster."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import TYPE_CHECKING, Annotated

from calib_pin.cli.options import number, option
from calib_pin.errors import OptionError

if TYPE_CHECKING:
    from calib_pin.workers import Workers

MOST = 1000
"""Most processes that can be meant."""

WorkerCount = Annotated[
    int | None,
    option(
        "Workers",
        "--workers N",
        "Processes on this machine that share the work; by default one for every core. "
        "The results are the same for any number.",
        number(int, "--workers", f"a number of processes, 1 to {MOST}", 1, MOST),
    ),
]
ClusterAddress = Annotated[
    str | None,
    option(
        "Workers",
        "--cluster ADDRESS",
        "Workers of a dask scheduler instead: its address, its scheduler.json, or "
        "local. Only in a trusted network.",
    ),
]


@contextmanager
def asked_workers(
    count: int | None, cluster: str | None, patience: float | None = None
) -> Iterator[Workers]:
    """The workers that `--workers` and `--cluster` ask for.

    Args:
        count: Number of processes; None for one for every core.
        cluster: Address of a scheduler; None for processes of this machine.
        patience: Time that items are done in this process before others are started
            [s]; None for the default, zero where an item may end its process.

    Raises:
        OptionError: If both are asked for, or the cluster cannot be used.
    """
    if cluster is not None:
        if count is not None:
            raise OptionError("--workers and --cluster exclude each other")
        from calib_pin.workers.cluster import Cluster

        with Cluster(cluster) as workers:
            yield workers
        return
    from calib_pin.workers.local import PATIENCE, LocalProcesses

    with LocalProcesses(count, PATIENCE if patience is None else patience) as local:
        yield local
