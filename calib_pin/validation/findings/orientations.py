"""Orientations stated in another way than their columns say.

Whatever the convention, with the right one `R = R_base R_tip R_tool` holds for all
measurements, where positions tell the base frame. So each convention is tried by how
well the rotations `R_tip^T R_base^T R` agree, which needs no fit. Angles beyond those
that a rotation has were lost in reading; of the rotations that they may have been, the
nearest to the others is taken.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np

from calib_pin.errors import CalibPinError
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.nominal import register
from calib_pin.estimation.terms import Term
from calib_pin.kinematics.spatial import Floats, from_quaternion, to_quaternion
from calib_pin.measurement_models import declared
from calib_pin.measurement_models.orientations import numbers_of, quaternions
from calib_pin.measurement_models.readings import with_values
from calib_pin.observations import BlockKey, Booleans, Measurements, Observations
from calib_pin.setup import HELD, STATED, OrientationSetup, ReadingSetup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.hypotheses import Hypothesis

ROWS = 60
"""Measurements of a block by which conventions are compared."""

SEEDS = 8
"""Measurements with whose rotation all others are compared."""

LIKELY = 0.3
"""Part of the disagreement as it is read that a convention may leave."""

MOST = 3
"""Conventions that are tried with the robot."""

DEGREE = np.pi / 180.0


def orientations(case: Case) -> Iterator[Hypothesis]:
    """The conventions with which orientations agree best, and inverted poses."""
    blocks = [b for b in case.data.blocks if declared(b.model).oriented]
    if not blocks:
        return
    yield Hypothesis(
        "pose-inverted",
        "the poses are those of the measurement frame in the tool",
        "pose of what",
        ReadingSetup(inverted=True),
        gross=True,
    )
    try:
        located = _located(case, blocks)
    except (CalibPinError, np.linalg.LinAlgError):
        return

    def tried(reading: OrientationSetup) -> tuple[float, dict[BlockKey, _Located]]:
        """The largest disagreement of a block, and all with their tools."""
        found = {b.key: located[b.key].agreed(reading, b) for b in blocks}
        with_tools = {k: replace(located[k], tool=found[k][1]) for k in found}
        return max(left for left, _ in found.values()), with_tools

    ways = {block.orientation or "quaternion" for block in blocks}
    now, _ = tried(OrientationSetup())
    trials = [(reading, *tried(reading)) for reading in _readings(ways)]
    for reading, left, found in sorted(trials, key=lambda trial: trial[1])[:MOST]:
        if left < LIKELY * now:
            yield Hypothesis(
                "orientation-convention",
                _words(reading),
                "convention of orientations",
                ReadingSetup(orientation=reading),
                change=partial(_read_so, reading=reading, located=found),
                gross=True,
            )


def _readings(ways: Iterable[str]) -> Iterator[OrientationSetup]:
    """All that the columns of an orientation may hold, by the ways of the files."""
    yield OrientationSetup(inverse=True)
    for columns in ways:
        for hold in (None, *HELD):
            angles = columns != "quaternion"
            if hold == columns or (hold is not None and (hold != "wxyz") != angles):
                continue
            if (columns, hold) == ("roll-pitch-yaw", "extrinsic-xyz"):
                continue
            if hold is not None:
                yield OrientationSetup(columns, hold)
                yield OrientationSetup(columns, hold, inverse=True)
            elif angles:
                yield OrientationSetup(columns, factor=DEGREE)
                yield OrientationSetup(columns, factor=1.0 / DEGREE)


def _words(reading: OrientationSetup) -> str:
    names = ", ".join(STATED[reading.columns]) if reading.columns else ""
    held = f"the columns {names} hold " if names else "the orientations are "
    if reading.hold is None:
        if reading.inverse:
            return f"{held}inverse rotations"
        return held + ("degrees" if reading.factor < 1.0 else "radians read as degrees")
    what = {
        "wxyz": "a quaternion in the order w, x, y, z",
        "rotation-vector": "a rotation vector",
    }.get(reading.hold, f"the angles '{reading.hold}'")
    return held + what + (" of the inverse rotation" if reading.inverse else "")


@dataclass(frozen=True)
class _Located:
    """Where a robot is in the frame of the measurements of a block.

    Attributes:
        term: The term of a problem that positions have located.
        tool: Orientation of the tool, a quaternion; None as long as it is unknown.
    """

    term: Term
    tool: Floats | None = None

    def tools(self, reading: OrientationSetup, block: Measurements) -> Floats:
        """The tool as each orientation may have it, quaternions (A, N, 4)."""
        error = self.term.error
        tip = error.chain.poses(block.q[:, self.term.columns])[:, :3, :3]
        to_tip = np.swapaxes(error.base.rotation @ tip, 1, 2)
        found = _possible(reading, block)
        return to_quaternion(to_tip @ from_quaternion(found))

    def agreed(
        self, reading: OrientationSetup, block: Measurements
    ) -> tuple[float, Floats]:
        """Typical disagreement about the tool [rad], and what most agree on."""
        tools = self.tools(reading, block.sample(ROWS))
        seeds = tools[:, :: max(1, tools.shape[1] // SEEDS)].reshape(-1, 4)
        nearest = np.abs(np.einsum("sk,ank->san", seeds, tools)).max(axis=1)
        typical = np.median(nearest, axis=1)
        best = int(np.argmax(typical))
        return 2.0 * float(np.arccos(min(typical[best], 1.0))), seeds[best]


def _located(case: Case, blocks: Sequence[Measurements]) -> dict[BlockKey, _Located]:
    """Where positions alone find the robot, by block."""
    positions = [
        replace(
            block.sample(ROWS),
            model="position",
            values=block.sample(ROWS).values[:, :3],
            sigma=None,
        )
        for block in blocks
    ]
    setup = replace(case.setup, parameters=(), learned=None, fixed=(), bounds={})
    data = Observations(tuple(positions))
    problem = make_problem(case.chains, data, replace(setup, prior={}))
    problem, found = register(problem, np.zeros(len(problem.parameters)))
    terms = problem.rebased(found.x)[0].terms
    return {
        block.key: _Located(terms[block.key._replace(model="position")])
        for block in blocks
    }


def _possible(reading: OrientationSetup, block: Measurements) -> Floats:
    """Quaternions that the orientations of a block may be, shape (A, N, 4)."""
    columns = block.orientation or "quaternion"
    stated = numbers_of(block.values[:, 3:], columns, turns=reading.factor != 1.0)
    return np.stack([quaternions(numbers, columns, reading) for numbers in stated])


def _read_so(
    data: Observations, reading: OrientationSetup, located: Mapping[BlockKey, _Located]
) -> Observations:
    """Measurements as the reader of files would have read them."""

    def change(block: Measurements, _: Booleans) -> Floats:
        own = located.get(block.key)
        if own is None or own.tool is None:
            return block.values
        near = np.abs(own.tools(reading, block) @ own.tool).argmax(axis=0)
        found = _possible(reading, block)[near, np.arange(len(block))]
        return np.hstack([block.values[:, :3], found])

    return with_values(data, change)
