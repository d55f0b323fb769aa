"""A job that is watched while it is measured."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import suppress
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from calib_pin.errors import CalibPinError, counted, one_line
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import fitting
from calib_pin.guidance.events import Event, State, sized
from calib_pin.guidance.fitted import Deviation, Fitted
from calib_pin.guidance.proposals import Proposal, Proposals
from calib_pin.io.urdf import other_robots
from calib_pin.kinematics.chains import Chains
from calib_pin.measurement_models import declared
from calib_pin.observations import Booleans, Observations, fitted_and_held_out
from calib_pin.setup import ReadingSetup, Setup

SETTLED = 0.5
"""Age of a file from which what another program writes to it is whole [s]."""

FEW = 8
"""New rows up to which each is judged by those before it, while more are judged
together."""

SOUGHT = 4
"""Rows from which a cause is sought why no robot explains them."""

SEVERAL = 3
"""Last rows that disagree with those before them from which all are fitted together."""

AGAIN = 1.25
"""Number of rows by that of the last robust fit, or the last search for a cause, from
which it is repeated."""

Key = tuple[str, bytes, int]
"""File, content and number of occurrence of a row."""


class Watch:
    """Follows files that others write.

    Args:
        read: Reads the job as it stands now: nominal chains, setup, measurements.
        files: The files to follow.
        proposals: Chooses the configuration to measure next.
        limit: Expected error of the tool point that is to be reached [m]; default the
            limit of the setup.
        seed: Seed of whatever is random.

    Attributes:
        proposals: Chooses the configuration to measure next.
        fit: The model so far; None before there is one.
        state: The last state; None before there is one.
        next: The configuration to measure next; None where nobody knows.
    """

    def __init__(
        self,
        read: Callable[[], tuple[Chains, Setup, Observations]],
        files: Sequence[Path],
        proposals: Proposals,
        limit: float | None = None,
        seed: int = 0,
    ) -> None:
        """Begin with nothing."""
        self._read, self._files, self._limit = read, tuple(files), limit
        self.proposals = proposals
        self._seed, self._searched, self._reviewed = seed, 0, 2 * FEW
        self._stamp: list[tuple[int, int]] | None = None
        self._problem, self._unplanned = "", ""
        self._reached, self._reported = False, set[str]()
        self._known, self._aside = dict[Key, str](), set[Key]()
        self._fitted: Fitted | None = None
        self.fit: Fit | None = None
        self.state: State | None = None
        self.next: Proposal | None = None

    @property
    def rows(self) -> int:
        """Number of measurements that have been read."""
        return len(self._known)

    def look(self, last: bool = False) -> Iterator[Event]:
        """The events since the last look; none where no file changed.

        Args:
            last: Whether no other look follows, so that nothing waits for it.
        """
        stamp = _stamp(self._files)
        if stamp == self._stamp:
            return
        if not last:
            age = time.time() - 1e-9 * max((changed for changed, _ in stamp), default=0)
            time.sleep(float(np.clip(SETTLED - age, 0.0, SETTLED)))
        self._stamp = _stamp(self._files)
        try:
            chains, setup, rows = self._read()
            setup = replace(setup, reading=ReadingSetup())
            chains, (rows,) = fitting(chains, setup, fitted_and_held_out(rows)[0])
            yield from self._update(Fitted(chains, rows, setup, self._seed))
            self._problem = ""
        except (CalibPinError, np.linalg.LinAlgError) as error:
            text = one_line(str(error))
            if text != self._problem:
                self._problem = text
                yield Event("problem" if self._known else "waiting", text)

    def _update(self, job: Fitted) -> Iterator[Event]:
        """Tell of rows that came and went, then of the job."""
        rows, keys = job.rows, _keys(job.rows)
        self._aside &= {*keys}
        used = np.array([key in self._known and key not in self._aside for key in keys])
        new = [k for k in rows.in_order.tolist() if keys[k] not in self._known]
        places = {key: rows.source(k) for k, key in enumerate(keys)}
        gone = [place for key, place in self._known.items() if key not in places]
        self._known = places
        if gone:
            what = gone[0] if len(gone) == 1 else f"{len(gone)} rows"
            text = f"{what}: removed or corrected, no longer used as before"
            yield Event("removed", text, {"places": gone})
        units = _units(rows, new)
        if gone or self._fitted is None or len(units) > FEW:
            used[new] = len(units) > FEW
            self._fitted = self._fit(job, used, robust=True)
        for unit in units if len(units) <= FEW else ():
            deviation = self._fitted.deviation(rows.rows(np.array(unit)))
            again = any(keys[k][2] for k in unit)
            if again or (deviation is not None and deviation.wrong):
                self._aside |= {keys[k] for k in unit}
            yield self._row(rows.source(unit[0]), deviation, again)
            used[unit] = keys[unit[0]] not in self._aside
            if used[unit[0]]:
                self._fitted = self._fit(job, used)
        # Which of several are wrong is for the fit of all to say.
        last = _units(rows, rows.in_order.tolist())[-SEVERAL:]
        if new and all(keys[unit[0]] in self._aside for unit in last):
            self._aside = {key for key in keys if key[2]}
            used = np.array([not key[2] for key in keys])
            self._fitted = self._fit(job, used, robust=True)
        yield from self._reconsider(rows, keys)
        yield from self._guide(rows)

    def _fit(self, job: Fitted, used: Booleans, *, robust: bool = False) -> Fitted:
        """Fit the rows that are used, now and then robustly."""
        known = self._fitted is not None and self._fitted.model is not None
        fitted = replace(job, rows=job.rows.rows(used))
        robust |= bool(used.sum() >= AGAIN * self._reviewed)
        if robust:
            self._reviewed = max(int(used.sum()), 2 * FEW)
        fitted = fitted.fit(known, robust) if used.any() else fitted
        self.fit, self._places = fitted.model, np.flatnonzero(used)
        return fitted

    def _row(self, place: str, deviation: Deviation | None, again: bool) -> Event:
        """Tell of a new row."""
        numbers: dict[str, Any] = {"place": place, "wrong": again}
        if again:
            text = "the same numbers as in a row before; was it measured?"
        elif deviation is None:
            text = "not known yet" if self._fitted is None else self._fitted.reason
        else:
            size, sigma = (sized(x, deviation.unit) for x in deviation[:2])
            text = f"{size} from where it is expected ({sigma})"
            if deviation.wrong:
                text += "; set aside: is the target seated? is the robot still?"
            numbers |= deviation._asdict() | {"wrong": deviation.wrong}
        return Event("row", f"{place}: {text}", numbers)

    def _reconsider(self, rows: Observations, keys: Sequence[Key]) -> Iterator[Event]:
        """Tell of rows that agree now, and of those that the fit has set aside."""
        fitted = self._fitted
        if fitted is None or fitted.lost:
            return
        aside = [k for k, key in enumerate(keys) if key in self._aside and not key[2]]
        for unit in _units(rows, aside):
            deviation = fitted.deviation(rows.rows(np.array(unit)))
            if deviation is not None and not deviation.wrong:
                self._aside -= {keys[k] for k in unit}
                place = rows.source(unit[0])
                text = f"{place}: agrees with the others now; used again"
                yield Event("row", text, {"place": place, "wrong": False})
        assert fitted.model is not None
        for outlier in () if fitted.early else fitted.model.robust.outliers:
            key = keys[self._places[outlier.row]]
            if outlier.weight == 0.0 and key not in self._aside:
                self._aside.add(key)
                text = f"{outlier.place}: does not fit the other rows; set aside"
                yield Event("row", text, {"place": outlier.place, "wrong": True})

    def _guide(self, rows: Observations) -> Iterator[Event]:
        """Tell the state, and where to go."""
        fitted, count = self._fitted, len(rows)
        assert fitted is not None
        doubtful = fitted.doubtful
        self._searched = self._searched if doubtful else 0
        least = AGAIN * self._searched if count > FEW else SOUGHT
        if doubtful and count >= least:
            self._searched = count
            others = partial(other_robots, fitted.chains, fitted.setup)
            yield from self._causes(fitted.causes(rows, others))
        try:
            self.next, ahead = self.proposals.ahead(fitted, rows)
        except CalibPinError as error:  # What is known of the rows stands.
            self.next, ahead = None, ()
            if (text := one_line(str(error))) != self._unplanned:
                self._unplanned = text
                yield Event("problem", text)
        if fitted.model is None:
            yield Event("waiting", f"{counted(count, 'row')}: {fitted.reason}")
        else:
            limit = self._limit or fitted.setup.limit.position
            known = State(count, len(self._aside), limit=limit)
            self.state, findings = fitted.assess(known, ahead, not doubtful)
            if not doubtful:
                yield from self._causes(findings)
            yield Event("state", self.state.text, self.state.document())
        if self.next is not None:
            yield Event("next", self.next.text, self.next.document())
        if self.state is not None and self.state.reached and not self._reached:
            self._reached = True
            yield Event("reached", self.state.conclusion)

    def _causes(self, findings: Iterable[Finding]) -> Iterator[Event]:
        """Tell of findings, each once as long as it stands."""
        by_code = {f.code: f for f in findings if f.severity == "error"}
        for code, finding in by_code.items():
            if code not in self._reported:
                text = "; ".join(filter(None, (finding.message, finding.remedy)))
                numbers = {"code": code, "setup": finding.setup}
                yield Event("finding", text, numbers)
        self._reported = {*by_code}


def _stamp(files: Sequence[Path]) -> list[tuple[int, int]]:
    """Times of change [ns] and sizes of the files that are there."""
    stamp = list[tuple[int, int]]()
    for file in files:
        with suppress(OSError):
            status = file.stat()
            stamp.append((status.st_mtime_ns, status.st_size))
    return stamp


def _keys(rows: Observations) -> list[Key]:
    """The content of every row, in the order of the rows; equal ones are counted."""
    keys, seen = list[Key](), Counter[tuple[str, bytes]]()
    for block, place in zip(rows.blocks, rows.slices, strict=True):
        parts = [block.q, block.values, block.sigma, block.conditions.time]
        numbers = [p.reshape(len(block), -1) for p in parts if p is not None and p.size]
        names = zip(np.hstack(numbers), block.target, rows.files[place], strict=True)
        for cells, target, file in names:
            same = file, cells.tobytes() + "/".join((*block.key, target)).encode()
            keys.append((*same, seen[same]))
            seen[same] += 1
    return keys


def _units(rows: Observations, new: Iterable[int]) -> list[list[int]]:
    """Rows that are judged together: those of an image, others one by one."""
    units: dict[tuple[int, int], list[int]] = {}
    groups = rows.groups()
    for k in new:
        block = int(rows.block_of[k])
        at_once = declared(rows.blocks[block].model).at_once
        unit = int(groups[k]) if at_once else -k - 1
        units.setdefault((block, unit), []).append(k)
    return [*units.values()]
