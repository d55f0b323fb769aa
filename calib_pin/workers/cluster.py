"""Workers on a cluster: those of a scheduler of dask.distributed.

Dask sends Python objects: whoever reaches its scheduler can run anything on its
workers. So only in a trusted network, or with TLS (docs/how-to/fleet.md).
"""

from __future__ import annotations

import asyncio
import json
import logging
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Future, ThreadPoolExecutor
from importlib import import_module
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from calib_pin.errors import CalibPinError, OptionError
from calib_pin.workers.base import WorkerLost
from calib_pin.workers.distributed import Share, distribute
from calib_pin.workers.local import cores
from calib_pin.workers.remote import Done, run

_Shared = TypeVar("_Shared")
_Item = TypeVar("_Item")
_Result = TypeVar("_Result")

PATIENCE = 5.0
"""Time to wait for an answer of the scheduler [s]."""

ALLOWED = "tcp://HOST:PORT, tls://HOST:PORT, a scheduler.json, local"


class Cluster:
    """The workers of a scheduler; a context that parts from it.

    Args:
        address: Address of the scheduler (`tcp://host:8786`, `tls://...`), its file
            (`scheduler.json`), or `local` for processes of our own, one for every core.

    Raises:
        OptionError: If dask.distributed is not there, nothing answers at the address,
            or the scheduler has no workers.
    """

    def __init__(self, address: str) -> None:
        """Meet the scheduler."""
        try:
            distributed = import_module("distributed")
        except ImportError as error:
            raise OptionError(
                "a cluster needs dask.distributed: pip install 'calib-pin[cluster]'"
            ) from error
        # What dask logs of lost connections is said in one line.
        for name in logging.root.manager.loggerDict:
            if name.partition(".")[0] == "distributed":
                logging.getLogger(name).setLevel(logging.CRITICAL)
        self._address = address
        self.count = 0
        if address == "local":
            self._client: Any = distributed.Client(
                n_workers=cores(),
                threads_per_worker=1,
                dashboard_address="127.0.0.1:0",
            )
        else:
            found = _scheduler(address)
            # A client that meets nobody takes long to give up.
            try:
                # In a notebook this thread has a loop already.
                with ThreadPoolExecutor(1) as pool:
                    pool.submit(asyncio.run, _greet(found)).result()
                self._client = distributed.Client(found, timeout=PATIENCE)
            except Exception as error:  # Anything may answer, in any language.
                reason = " ".join(str(error).split()) or type(error).__name__
                raise OptionError(
                    f"no scheduler answers at --cluster '{address}': {reason}",
                    allowed=ALLOWED,
                ) from error
        self.count = sum(self._client.nthreads().values())
        if not self.count:
            self._client.close()
            raise OptionError(f"the cluster at '{address}' has no workers")
        # For dask a batch is no pure function: two alike are two batches.
        self._executor = self._client.get_executor(pure=False)

    def __enter__(self) -> Self:
        """The workers."""
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        """Part from the scheduler; workers of our own end."""
        self._client.close()

    def map(
        self,
        work: Callable[[_Shared, _Item], _Result],
        shared: _Shared,
        items: Iterable[_Item],
        lost: Callable[[_Item], _Result] | None = None,
    ) -> Iterator[_Result]:
        """Results of items, in their order; see `Workers.map`."""
        seats = [_Thread(self._client, self._executor)] * self.count
        try:
            yield from distribute(seats, work, shared, items, lost)
        except Exception as error:
            # Dask may raise anything; what the work itself raised is not lost.
            if isinstance(error, CalibPinError) or self._client.status == "running":
                raise
            raise WorkerLost(
                f"the cluster at '{self._address}' no longer answers"
            ) from error


def _scheduler(address: str) -> str:
    """The address of a scheduler, read from its file where it is one.

    Raises:
        OptionError: If there is no such file, or it holds none.
    """
    if not address.endswith(".json"):
        return address
    try:
        return str(json.loads(Path(address).read_bytes())["address"])
    except OSError as error:
        raise OptionError(
            f"no file of a scheduler: {error.strerror}", file=address
        ) from error
    except (KeyError, TypeError, ValueError, RecursionError) as error:
        raise OptionError("is no file of a scheduler", file=address) from error


async def _greet(address: str) -> None:
    """Meet a scheduler once."""
    connect: Any = import_module("distributed.comm").connect
    # Its own limit does not cover whoever answers and then says nothing.
    meeting = connect(address, timeout=PATIENCE)
    comm = await asyncio.wait_for(meeting, PATIENCE + 1.0)
    await comm.close()


class _Thread:
    """A seat: a thread of some worker; dask chooses of which."""

    tries = 2

    def __init__(self, client: Any, executor: Any) -> None:
        self._client, self._executor = client, executor
        self._share = b""
        self._scattered: Any = None

    @property
    def died(self) -> tuple[type[BaseException], ...]:
        """Dask itself sends a batch again, and gives it up in the end."""
        return (import_module("distributed").KilledWorker,)

    def submit(self, share: Share, items: Sequence[Any]) -> Future[Done]:
        """Send a batch, and before the first one what all share."""
        if self._share != share.digest:
            self._scattered = self._client.scatter(
                share.payload, broadcast=True, hash=False
            )
            self._share = share.digest
        future: Future[Done] = self._executor.submit(
            run, share.digest, self._scattered, items
        )
        return future

    def renew(self) -> bool:
        """Dask has done so; the other batches go on."""
        return False
