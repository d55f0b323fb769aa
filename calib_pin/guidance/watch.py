"""A job that is watched while it is measured."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, Protocol

import numpy as np

from calib_pin.errors import CalibPinError, one_line
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.fit import FittedModel
from calib_pin.estimation.formulation import fitting
from calib_pin.guidance.events import Event
from calib_pin.guidance.expectation import Deviation, Expectation
from calib_pin.guidance.proposals import Left, Proposal, Proposals, Shown
from calib_pin.guidance.rows import Key, fresh, keys_of, stamps, unfinished
from calib_pin.guidance.state import State, assess, causes, doubtful
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.collision import Collisions
from calib_pin.measurement_models import declared
from calib_pin.observations import Observations, fitted_and_held_out
from calib_pin.setup import ReadingSetup, Setup
from calib_pin.units import DISPLAY

FEW = 8
"""New rows up to which each is judged by those before it; more are judged together."""

SEVERAL = 3
"""Last rows that disagree with those before them from which all are fitted together."""

AGAIN = 1.25
"""Number of rows, by that of the last search for a cause, from which it is sought again.
"""


class Job(Protocol):
    """A calibration as it stands in its files, read and checked."""

    @property
    def chains(self) -> Chains:
        """The nominal chains."""

    @property
    def setup(self) -> Setup:
        """The setup."""

    @property
    def measurements(self) -> Observations:
        """The rows so far."""


class Watch:
    """Follows files that others write.

    Args:
        read: Reads the job as it stands now.
        files: The files to follow; the first ones hold the rows.
        plan: Reads the plan; None where there is none.
        limit: Expected error of the tool point that is to be reached [m]; default the
            limit of the setup.
        collisions: Loads the collisions to avoid.
        shown: Columns of the measurement file for a configuration and a target.
        others: Other robots with the same joints that may have been measured.
        seed: Seed of whatever is random.

    Attributes:
        fit: The model so far; None before there is one.
        state: The last state; None before there is one.
        next: The configuration to measure next; None where nobody knows.
    """

    def __init__(
        self,
        read: Callable[[], Job],
        files: Sequence[Path],
        plan: Left | None = None,
        limit: float | None = None,
        collisions: Callable[[Chains, Setup], Collisions | None] | None = None,
        shown: Shown | None = None,
        others: Callable[[Chains, Setup], Iterable[Chains]] = lambda *_: (),
        seed: int = 0,
    ) -> None:
        """Begin with nothing."""
        self._read, self._files, self._seed = read, tuple(files), seed
        self._stamp: object = None
        self._told, self._reached = "", False
        self._aside: dict[Key, Deviation | None] = {}
        self._known: dict[Key, str] = {}
        self._expected = Expectation(None)
        self._proposals = Proposals(plan, collisions, shown, seed)
        self._limit, self._others = limit, others
        self._found, self._searched = set[str](), 0
        self.fit: FittedModel | None = None
        self.state: State | None = None
        self.next: Proposal | None = None

    def look(self) -> Iterator[Event]:
        """What changed since the last look; nothing where nothing did."""
        stamp = stamps(self._files)
        if stamp == self._stamp:
            return
        new = fresh(self._files)
        if new and any(map(unfinished, self._files)):
            return  # A half-written line waits.
        try:
            job = self._read()
            setup = replace(job.setup, reading=ReadingSetup())
            rows = fitted_and_held_out(job.measurements)[0]
            chains, (rows,) = fitting(job.chains, setup, rows)
        except CalibPinError as error:
            if new:
                return
            self._stamp = stamp
            said = one_line(str(error))
            if said != self._told:
                self._told = said
                yield Event("problem" if self._known else "waiting", said)
            return
        found = dict(
            zip(keys_of(rows), map(rows.source, range(len(rows))), strict=True)
        )
        gone = [place for key, place in self._known.items() if key not in found]
        if gone and new:
            return  # A file that is written anew begins with nothing.
        self._stamp, self._told = stamp, ""
        yield from self._changed(chains, rows, setup, found, gone)

    def _changed(
        self,
        chains: Chains,
        rows: Observations,
        setup: Setup,
        found: dict[Key, str],
        gone: Sequence[str],
    ) -> Iterator[Event]:
        """Tell of rows that came and went, then of the job."""
        keys = [*found]
        new = [k for k in rows.in_order.tolist() if keys[k] not in self._known]
        self._aside = {key: d for key, d in self._aside.items() if key in found}
        if gone:
            what = gone[0] if len(gone) == 1 else f"{len(gone)} rows"
            text = f"{what}: removed or corrected; no longer used as it was"
            yield Event("removed", text, {"places": [*gone]})
        units = self._units(rows, new)
        one_by_one = len(units) <= FEW
        used = np.array(
            [
                k not in set(new) and keys[k] not in self._aside
                for k in range(len(rows))
            ],
            bool,
        )
        if gone or self._expected.model is None:
            self._fit(chains, rows, used, setup)
        for unit in units if one_by_one else ():
            deviation = self._expected.deviation(rows.rows(np.array(unit)))
            repeated = [k for k in unit if keys[k][2]]
            wrong = repeated or (deviation is not None and deviation.wrong)
            if wrong:
                self._aside |= {keys[k]: deviation for k in unit}
            yield self._row(found[keys[unit[0]]], deviation, bool(repeated))
            if not wrong:
                used[unit] = True
                self._fit(chains, rows, used, setup)
        if not one_by_one:
            used[new] = True
            self._fit(chains, rows, used, setup)
        self._known = found
        yield from self._reconsidered(chains, rows, setup, keys, used)
        yield from self._guided(chains, rows, setup)

    def _units(self, rows: Observations, new: Sequence[int]) -> list[list[int]]:
        """Rows that are judged together: those of an image, others one by one."""
        found: dict[tuple[int, int], list[int]] = {}
        groups = rows.groups()
        for k in new:
            block = int(rows.block_of[k])
            together = declared(rows.blocks[block].model).at_once
            found.setdefault(
                (block, int(groups[k]) if together else -k - 1), []
            ).append(k)
        return [*found.values()]

    def _fit(self, chains: Chains, rows: Observations, used: Any, setup: Setup) -> None:
        """Fit the rows that are used."""
        if not used.any():
            self._expected = Expectation(None)
            return
        self._fitted, self._places = rows.rows(used), np.flatnonzero(used)
        given = chains, self._fitted, setup, self._seed
        self._expected = Expectation.of(*given, self._expected.model is not None)
        self.fit = self._expected.model

    def _row(self, place: str, deviation: Deviation | None, repeated: bool) -> Event:
        """Tell of a new row."""
        numbers: dict[str, Any] = {"place": place, "wrong": repeated}
        if repeated:
            text = f"{place}: the same numbers as in a row before; was it measured?"
            return Event("row", text, numbers)
        if deviation is None:
            reason = self._expected.reason or "nothing to compare it with yet"
            return Event("row", f"{place}: {reason}", {**numbers, "expected": None})
        unit, factor = DISPLAY[deviation.unit]
        size, sigma = factor * deviation.size, factor * deviation.sigma
        numbers |= {"size": deviation.size, "sigma": deviation.sigma}
        numbers |= {"chance": deviation.chance, "wrong": deviation.wrong}
        text = (
            f"{place}: {size:.2g} {unit} from where it is expected ({sigma:.2g} {unit})"
        )
        if deviation.wrong:
            text += "; set aside: is the target seated? is the robot still?"
        return Event("row", text, numbers)

    def _reconsidered(
        self,
        chains: Chains,
        rows: Observations,
        setup: Setup,
        keys: Sequence[Key],
        used: Any,
    ) -> Iterator[Event]:
        """Rows that were set aside, after what came since; and those set aside now."""
        order = rows.in_order
        aside = np.array([key in self._aside for key in keys], bool)
        if aside[order[-SEVERAL:]].sum() == SEVERAL:
            # Which of them are wrong is for the fit of all to say.
            used[:] = [key[2] == 0 for key in keys]
            self._fit(chains, rows, used, setup)
            self._aside = {key: None for key in keys if key[2]}
        else:
            for k in np.flatnonzero(aside).tolist():
                again = self._expected.deviation(rows.rows(np.array([k])))
                if keys[k][2] == 0 and again is not None and not again.wrong:
                    del self._aside[keys[k]]
                    used[k] = True
                    text = f"{rows.source(k)}: agrees with the others now; used again"
                    yield Event("row", text, {"place": rows.source(k), "wrong": False})
        if self.fit is None or self._expected.early or doubtful(chains, self._expected):
            return
        for outlier in self.fit.fit.robust.outliers:
            key = keys[self._places[outlier.row]]
            if outlier.weight > 0.0 or key in self._aside:
                continue
            self._aside[key] = None
            text = f"{outlier.place}: does not fit the other rows; set aside"
            yield Event("row", text, {"place": outlier.place, "wrong": True})

    def _guided(
        self, chains: Chains, rows: Observations, setup: Setup
    ) -> Iterator[Event]:
        """The state, and where to go."""
        far = self._expected.model is None or doubtful(chains, self._expected)
        self._searched = self._searched if far else 0
        if far and len(rows) >= AGAIN * max(self._searched, FEW // AGAIN):
            self._searched = len(rows)
            given = chains, rows, setup, partial(self._others, chains, setup)
            yield from self._causes(causes(*given))
        if self._expected.model is None:
            yield Event("waiting", f"{len(rows)} rows: {self._expected.reason}")
            return
        outlook = self._proposals.outlook(chains, rows, setup, self._expected)
        limit = setup.limit.position if self._limit is None else self._limit
        aside = len(self._aside)
        seen = self._expected, outlook, limit, len(rows), aside, self._seed, not far
        self.state, found = assess(chains, self._fitted, *seen)
        if not far:
            yield from self._causes(found)
        yield Event("state", self.state.text, self.state.document())
        self.next = outlook.next
        if self.next is not None:
            yield Event("next", self.next.text, self.next.document())
        if self.state.reached and not self._reached:
            self._reached = True
            yield Event("reached", self.state.conclusion)

    def _causes(self, found: Iterable[Finding]) -> Iterator[Event]:
        """Tell of findings, each once as long as it stands."""
        found = [*found]
        for one in found:
            if one.code not in self._found:
                told = "; ".join(filter(None, (one.message, one.remedy)))
                numbers = {"code": one.code, "severity": one.severity}
                yield Event("finding", told, {**numbers, "setup": dict(one.setup)})
        self._found = {one.code for one in found}
