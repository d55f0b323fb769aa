"""The objective of a search for configurations, its end, and who hears of it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices
from calib_pin.planning.criteria import Criterion
from calib_pin.planning.information import Information
from calib_pin.planning.rows import Rows
from calib_pin.solvers import Status

Progress = Callable[[str, float], bool | None]
"""Told the stage and the part that is done, 0 to 1; True stops the search."""


@dataclass(frozen=True)
class Found:
    """The set that a method has found.

    Attributes:
        q: Configurations, shape (K, n) [rad, m].
        aim: Position of what is measured at each among those of the workspace, (K,).
        cost: Their cost.
        method: The method.
        status: How it ended.
    """

    q: Floats
    aim: Indices
    cost: float
    method: str
    status: Status


@dataclass(frozen=True)
class Objective:
    """A criterion of sets of configurations.

    Attributes:
        rows: The rows of a configuration.
        criterion: Criterion to minimize.
        known: Information that is there already, shape (m, m).
    """

    rows: Rows
    criterion: Criterion
    known: Floats

    def information(self, rows: Floats) -> Information | None:
        """Information of rows (..., m) together with what is known."""
        U = rows.reshape(-1, rows.shape[-1])
        return Information.of(self.known + U.T @ U, self.rows.nuisances)

    def of_rows(self, rows: Floats) -> float:
        """Cost of rows (..., m); infinite where they do not determine everything."""
        found = self.information(rows)
        return np.inf if found is None else self.criterion.cost(found)

    def cost(self, q: Floats, aim: Indices) -> float:
        """Cost of a set of configurations."""
        return self.of_rows(self.rows.rows(q, aim))


class Listener:
    """Who is told the progress and may stop the search.

    One that was sent to another process hears nothing there.

    Args:
        progress: Told the progress; none if nobody listens.

    Attributes:
        stopped: Whether the search is to stop.
    """

    def __init__(self, progress: Progress | None = None) -> None:
        """Begin."""
        self.stopped = False
        self._progress = progress

    def __reduce__(self) -> tuple[type[Listener], tuple[()]]:
        """A deaf one."""
        return Listener, ()

    def told(self, stage: str, part: float) -> bool:
        """Tell the progress; whether the search is to stop."""
        if self._progress is not None and self._progress(stage, min(part, 1.0)):
            self.stopped = True
        return self.stopped
