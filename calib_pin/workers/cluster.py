"""Workers on a cluster: those of a scheduler of dask.distributed.

Dask sends Python objects: whoever reaches its scheduler can run anything on its
workers. So only in a trusted network, or with TLS (docs/how-to/fleet.md).
"""

from __future__ import annotations

import json
import logging
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager
from functools import partial
from importlib import import_module
from pathlib import Path
from typing import Any

from calib_pin.errors import CalibPinError, OptionError, require_package, words_of
from calib_pin.workers.base import Submit, WorkerLost, Workers, run

PATIENCE = 5.0
"""Time to wait for an answer of the scheduler [s]."""


class Cluster(Workers, AbstractContextManager["Cluster"]):
    """The workers of a scheduler; a context that parts from it.

    Args:
        address: Address of the scheduler (`tcp://host:8786`, `tls://...`), or its file
            (`scheduler.json`).

    Raises:
        OptionError: If dask.distributed is not there, nothing answers at the address,
            or the scheduler has no workers.
    """

    patience = 0.0

    def __init__(self, address: str) -> None:
        """Meet the scheduler."""
        require_package("distributed", "a cluster needs dask.distributed", "cluster")
        distributed = import_module("distributed")
        # What dask logs of lost connections is said in one line.
        for name in logging.root.manager.loggerDict:
            if name.partition(".")[0] == "distributed":
                logging.getLogger(name).setLevel(logging.CRITICAL)
        there = address
        if address.endswith(".json"):
            try:
                there = str(json.loads(Path(address).read_bytes())["address"])
            except (OSError, LookupError, TypeError, ValueError, RecursionError) as e:
                raise OptionError("is no file of a scheduler", file=address) from e
        try:
            self._client: Any = distributed.Client(there, timeout=PATIENCE)
        except Exception as error:  # Anything may answer, in any language.
            reason = f"no scheduler answers at --cluster '{address}': {words_of(error)}"
            allowed = "tcp://HOST:PORT, tls://HOST:PORT, a scheduler.json"
            raise OptionError(reason, allowed=allowed) from error
        self.count = sum(self._client.nthreads().values())
        if not self.count:
            self._client.close()
            raise OptionError(f"the cluster at '{address}' has no workers")
        # For dask an item is no pure function's: two alike are done twice.
        self._executor = self._client.get_executor(pure=False)
        self.died = distributed.KilledWorker

    def __exit__(self, *_: object) -> None:
        """Part from the scheduler."""
        self._client.close()

    @contextmanager
    def sharing(self, payload: bytes) -> Iterator[Submit]:
        """The way to workers, all of which are sent what they share."""
        try:
            scattered = self._client.scatter(payload, broadcast=True, hash=False)
            yield partial(self._executor.submit, run, scattered)
        except Exception as error:
            # Dask may raise anything; what the work itself raised is not lost.
            if not isinstance(error, CalibPinError):
                self.require_there()
            raise

    def require_there(self) -> None:
        """Look whether the scheduler answers: what is sent to none never ends.

        Raises:
            WorkerLost: If it does not.
        """
        if self._client.status != "running":
            raise WorkerLost("the cluster no longer answers")
