"""Wrong conventions of joint readings, where no robot explains the measurements.

A controller counts a joint the other way, from another zero, or relative to the joint
before it. Each of these leaves hundreds of millimeters that no calibration removes, and
each can be tried: the nominal robot is registered on readings that are taken so.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.nominal import register
from calib_pin.estimation.registration import registered
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.progress import Progress
from calib_pin.setup import JointMap, Setup

ROWS = 60
"""Measurements that readings are tried on."""

MOST = 3
"""Things that may be wrong at once."""

WIDTH = 3
"""Readings that are kept to be combined with others."""

CLEAR = 0.95
"""Part of the errors that another reading may leave to be worth combining."""

DECISIVE = 0.2
"""Part of the errors that all of them together may leave to be suggested."""

EXPLAINED = 0.02
"""Part of the errors with which nothing more is sought."""

TURNS = (90.0, -90.0, 180.0)
"""Offsets between the zeros of a controller and of a URDF [deg]."""


@dataclass(frozen=True)
class Reading:
    """How one joint is read: `sign (q_j + factor q_k) + offset`, as in `JointMap`.

    Attributes:
        joint: Position j of the joint in the chain.
        sign: 1, or -1 where it counts the other way.
        offset: Added offset [rad].
        coupled: Position k of a joint whose reading is added; None for none.
        factor: 1 or -1 times that.
    """

    joint: int
    sign: int = 1
    offset: float = 0.0
    coupled: int | None = None
    factor: int = 1

    def position(self, q: Floats) -> Floats:
        """The joint's position at readings q, shape (N, n) -> (N,)."""
        read = q[:, self.joint]
        if self.coupled is not None:
            read = read + self.factor * q[:, self.coupled]
        return np.asarray(self.sign * read + self.offset)

    def words(self, joints: Sequence[str]) -> str:
        """The mistake in words."""
        what = []
        if self.coupled is not None:
            what.append(f"coupled to '{joints[self.coupled]}'")
        if self.sign < 0:
            what.append("reversed")
        if self.offset:
            what.append(f"offset by {np.degrees(self.offset):g} deg")
        return f"joint '{joints[self.joint]}' is {' and '.join(what)}"

    def entry(self, joints: Sequence[str], columns: Sequence[str]) -> str:
        """Its entry under `joints` in a setup file, of plain file columns."""
        keys = [f"joint: {joints[self.joint]}"]
        if self.coupled is not None:
            keys.append(f"coupled: {{{columns[self.coupled]}: {self.factor}}}")
        if self.sign < 0:
            keys.append("sign: -1")
        if self.offset:
            keys.append(f"offset: {self.offset:.9g}")
        return f"{columns[self.joint]}: {{{', '.join(keys)}}}"


@dataclass(frozen=True)
class Suggestion:
    """Readings with which the measurements make sense.

    Attributes:
        readings: The suggested changes.
        before: Error of the registered nominal robot as it is read now, root mean
            square in standard deviations.
        after: The same read so.
    """

    readings: tuple[Reading, ...]
    before: float
    after: float

    def text(self, joints: Sequence[str], maps: Mapping[str, JointMap]) -> str:
        """Advice for a message.

        Args:
            joints: Names of the chain's joints.
            maps: Joint map by file column, as it is.
        """
        part = 100.0 * self.after / self.before
        words = " and ".join(reading.words(joints) for reading in self.readings)
        advice = f"they fall to {part:.2g} % before any fit if {words}"
        column = {stated.joint: name for name, stated in maps.items()}
        columns = [column.get(joint, joint) for joint in joints]
        if any(replace(m, joint="") != JointMap("") for m in maps.values()):
            # What is mapped already changes what the entries would have to be.
            return f"{advice}; state it under 'joints' in the setup file"
        entries = ", ".join(r.entry(joints, columns) for r in self.readings)
        return f"{advice}; state it in the setup file, joints: {{{entries}}}"


@serial_blas
def suggest_conventions(
    chains: Chains,
    rows: Observations,
    setup: Setup,
    progress: Progress | None = None,
) -> Suggestion | None:
    """Find readings of few joints with which the nominal robot fits far better.

    They are tried one change at a time; the best few are kept and changed again, as
    long as that removes a part of what is left.

    Args:
        chains: The nominal chains.
        rows: The rows as they are read.
        setup: Known quantities of frames and instrument.
        progress: Told how much is done, 0 to 1.

    Returns:
        The suggestion, None where nothing helps decisively.
    """
    plain = replace(setup, parameters=(), learned=None, fixed=(), bounds={}, prior={})
    rows = rows.sample(ROWS)
    first = _misfit(chains, rows, plain)
    beam: list[tuple[float, dict[int, Reading]]] = [(first, {})]
    best = beam[0]
    for k in range(MOST):
        if progress is not None:
            progress(k / MOST)
        found: dict[tuple[Reading, ...], tuple[float, dict[int, Reading]]] = {}
        for left, kept in beam:
            for reading in _readings(chains, kept):
                trial = {**kept, reading.joint: reading}
                key = tuple(trial[j] for j in sorted(trial))
                if key not in found:
                    misfit = _misfit(chains, _read(rows, trial), plain)
                    if misfit < CLEAR * left:
                        found[key] = misfit, trial
        beam = sorted(found.values(), key=lambda pair: pair[0])[:WIDTH]
        if not beam:
            break
        best = min(best, beam[0], key=lambda pair: pair[0])
        if best[0] < EXPLAINED * first:
            break
    left, kept = best
    if not left < DECISIVE * first:
        return None
    return Suggestion(tuple(kept[j] for j in sorted(kept)), first, left)


def _readings(chains: Chains, kept: Mapping[int, Reading]) -> Iterator[Reading]:
    """Readings of one joint that differ in one thing from the kept ones.

    The likeliest kinds come first.
    """
    now = [kept.get(j, Reading(j)) for j in range(len(chains.joints))]
    turning = [reading for reading in now if chains.revolute[reading.joint]]
    yield from (replace(reading, sign=-reading.sign) for reading in now)
    for reading in turning:
        for turn in TURNS:
            yield replace(reading, offset=reading.offset + float(np.radians(turn)))
    # Robots couple a joint to those before it.
    for reading in turning:
        for other in turning:
            if other.joint < reading.joint:
                yield replace(reading, coupled=other.joint, factor=1)
                yield replace(reading, coupled=other.joint, factor=-1)


def _read(rows: Observations, readings: Mapping[int, Reading]) -> Observations:
    """Measurements whose joints are read in another way."""

    def read(positions: Floats) -> Floats:
        result = positions.copy()
        for j, reading in readings.items():
            result[:, j] = reading.position(positions)
        return result

    return Observations(
        tuple(
            replace(b, q=read(b.q), start=read(b.start) if b.start.size else b.start)
            for b in rows.blocks
        )
    )


def _misfit(chains: Chains, rows: Observations, setup: Setup) -> float:
    """Error of the registered nominal robot, rms in standard deviations.

    The closed form is enough to tell a robot from none; without a measurement frame
    there may be nothing in closed form, and it is fitted.
    """
    problem = make_problem(chains, rows, setup)
    zero = np.zeros(len(problem.parameters))
    try:
        parts = problem.parts.values()
        if any(part.measurement.declaration.external for part in parts):
            cost = registered(problem, zero).cost(zero)
        else:
            cost = register(problem, zero)[1].cost
    except (InputError, np.linalg.LinAlgError):
        return np.inf  # No beam meets its plane, say.
    size = float(np.sqrt(2.0 * cost / max(problem.count, 1)))
    return size if np.isfinite(size) else np.inf
