"""Joints that do not stand where their columns say: zeros, gears, couplings, lag.

Each moves joints by something known times one number: by one (a zero), by its own
position (a gear) or that of another joint (a coupling), along its last motion (a joint
that was read before it stood still). To first order that is one further column of the
Jacobian, and all are tried at once. Small ones are fitted with the errors of the robot;
those that cost more than robots err, with the nominal one, which tells where a fit has
spread them over all origins. Lost motion goes with the sign of the last motion; it is
no matter of reading, and is tried along only not to pass for a lag.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.readings import last_motions, with_positions
from calib_pin.observations import Indices, Observations
from calib_pin.parameterizations.base import expected_size
from calib_pin.setup import ReadingSetup
from calib_pin.validation.findings.case import DOUBTFUL, Case
from calib_pin.validation.findings.explanations import DECISIVE
from calib_pin.validation.findings.hypotheses import Explanation, Hypothesis, read_so
from calib_pin.validation.findings.plausibility import IMPLAUSIBLE
from calib_pin.validation.findings.quick_fit import CHANCE, QuickFit, unlikely
from calib_pin.validation.findings.readings import (
    coupled,
    geared,
    offset_by,
    turned_by_base,
)

LEFT = 0.42
"""Part of the sum of squares that a small motion leaves at most.

Gears that err by what no parameter describes have left 0.43 of it, on a path.
"""

CONTRARY, STRETCHES = 0.04, 20
"""Part of what it explains that some stretches of the files may contradict, and their
number. Of true gears and lags it is below 0.013, also where these cost less than noise.
"""

CLEAR = 5.0
"""Logarithm of the likelihood ratio to the next best."""

LARGEST = 0.3
"""Largest part that is small; more is another fault, such as a joint that is
reversed."""

LARGE, TRIED = 10.0, 4
"""Errors of the nominal robot, in expected sizes, from which large ones are sought, and
how many are fitted: what explains most to first order may not in the end."""

LEAST = np.radians(3.0)
"""Least large offset that is told [rad]; robots have up to half of it."""

ROUND, NEARBY = (45.0, 15.0, 10.0, 5.0, 1.0), 0.6
"""Round angles [deg], and the largest distance from one of them [deg], three times a
usual error of a robot."""

REST = "measure again at rest: the joints must stand still when they are read"


class Motion(NamedTuple):
    """How joints stand elsewhere, but for one number.

    Attributes:
        of: `zero`, `gear`, `coupled`, `lag` (by a part of their last motion), `early`
            and `early-each` (by an angle before its end, of the joint that went
            farthest, or of each) or `side`.
        joints: The joint, all joints, or the joint and the one it is coupled to.
    """

    of: str
    joints: tuple[int, ...]

    def hypothesis(self, case: Case, size: float) -> Hypothesis:
        """How measurements are to be read with a motion of a size [rad, m, or none]."""
        names, j = case.data.joints, self.joints[0]
        if self.of == "zero":
            return offset_by(names, j, size, case.turns(names[j]))
        if self.of == "gear":
            return geared(names, j, 1.0 + size)
        if self.of == "coupled":
            return coupled(names, j, self.joints[1], size, f", by {100 * size:.2g} %")
        if self.of == "lag":
            whose = f"joint '{names[j]}'" if len(self.joints) == 1 else "all joints"
            said = f"errors follow the last motion of {whose}: {100 * size:.2g} % of it"
            parts = ReadingSetup(lag={names[j]: size for j in self.joints})
            return Hypothesis("lag", said, "lag", parts, figure="over-order")
        said = "the joints were read as arrived while they still moved: "
        said += "every joint has" if self.of == "early-each" else "the farthest has"
        said += f" {np.degrees(size):.2g} deg to go"
        lag = Hypothesis("lag", said, "lag", advice=REST, figure="over-order")
        return replace(lag, change=lambda data: _early(data, self, size))


def _early(data: Observations, motion: Motion, angle: float) -> Observations:
    """Measurements whose joints have still an angle to go, or all of a shorter way."""
    moved, own = last_motions(data), list(motion.joints)
    way = np.abs(moved[:, own])
    if motion.of == "early":
        way = way.max(axis=1, keepdims=True)
    share = np.where(way > 0.0, angle / np.where(way > 0.0, way, 1.0), 0.0)
    q = data.q.copy()
    q[:, own] -= np.minimum(share, 1.0) * moved[:, own]
    return with_positions(data, q)


@dataclass(frozen=True)
class _Motions:
    """Motions that are tried in a case, with the fit that they explain."""

    case: Case
    fit: QuickFit

    @cached_property
    def index(self) -> Indices:
        """Positions of the measurements that were fitted among all."""
        return self.case.data.in_order[self.case.rank]

    @cached_property
    def every(self) -> tuple[Motion, ...]:
        """Motions that are tried, of every joint."""
        joints = self.case.data.joints
        each = range(len(joints))
        turning = [j for j in each if self.case.turns(joints[j])]
        return (
            *(Motion(of, (j,)) for of in ("zero", "gear", "lag", "side") for j in each),
            Motion("lag", tuple(each)),
            *(Motion(of, tuple(turning)) for of in ("early", "early-each") if turning),
            *(Motion("coupled", (j, k)) for j in turning for k in turning if j != k),
        )

    @cached_property
    def along(self) -> dict[str, Floats]:
        """Ways of joints by a number of one, by kind, (N, n), or (2, N, n) of starts.

        Positions are those without a motion.
        """
        moved, read = last_motions(self.case.data)[self.index], self.fit.problem.data
        known = read.conditions.direction
        farthest = np.abs(moved).max(axis=1, keepdims=True)
        starts = [b.start if b.start.size else 0.0 * b.q for b in read.blocks]
        positions = np.stack([read.q, np.concatenate(starts)])
        return {
            "zero": np.ones_like(positions),
            "gear": positions,
            "coupled": positions,
            "lag": -moved,
            "side": -(known.astype(float) if known.size else np.sign(moved)),
            "early": -moved / np.where(farthest > 0.0, farthest, 1.0),
            "early-each": -np.sign(moved),
        }

    def column(self, fit: QuickFit, motion: Motion) -> Floats:
        """Whitened residual of a fit by the size of a motion, shape (M, 1)."""
        row, way, own = fit.problem.layout.row, self.along[motion.of], motion.joints
        if way.ndim == 2:
            by_size = fit.by_joints * way[row]
            return np.asarray(by_size[:, own].sum(axis=1, keepdims=True))
        j, k = own[:1], own[-1:]
        ends, starts = way[0][row][:, k], way[1][row][:, k]
        return np.asarray(fit.by_joints[:, j] * ends + fit.by_starts[:, j] * starts)

    def likeliest(self) -> Motion | None:
        """The small motion that explains most, if it does so alone and everywhere."""
        fit, columns = self.fit, [self.column(self.fit, m) for m in self.every]
        scores = [fit.score(column) for column in columns]
        best, second = np.argsort([score.left for score in scores])[:2]
        left, motion = scores[best].left, self.every[best]
        clear = 0.5 * fit.left * np.log(scores[second].left / max(left, 1e-12))
        sure = scores[best].chance * len(scores) <= CHANCE and clear >= CLEAR
        # What moves a zero moves an origin as well.
        if left > LEFT or not sure or motion.of in ("side", "zero"):
            return None
        row = fit.problem.layout.row
        gains = (fit.beyond(columns[best])[:, 0] * fit.unexplained[1])[: len(row)]
        stretch = self.case.rank[row] * STRETCHES // (int(self.case.rank.max()) + 1)
        shares = np.bincount(stretch, gains) / float(gains.sum())
        return motion if -shares[shares < 0.0].sum() < CONTRARY else None

    def fitted(self, motion: Motion) -> tuple[QuickFit, float]:
        """The fit with a motion, and its size."""

        def read(sizes: Floats) -> Observations:
            hypothesis = motion.hypothesis(self.case, float(sizes[0]))
            return read_so(self.case.data, [hypothesis]).rows(self.index)

        def column(fit: QuickFit) -> Floats:
            return self.column(fit, motion)

        fit, (size,) = self.fit.sized(np.zeros(1), column, read)
        return fit, float(size)


def joint_motion(case: Case) -> Explanation | None:
    """The motion of joints that errors follow; None where none stands out."""
    return _small(case) or _large(case)


def _small(case: Case) -> Explanation | None:
    """The one that a fit leaves."""
    known = case.fit.whole or case.fit.redundant
    fit = case.fit if known else replace(case.fit, whole=True)
    motion = _Motions(case, fit).likeliest() if fit.left > 1 else None
    if motion is None:
        return None
    # Noise that came out large for this very fault would hold back the robot's errors.
    first = replace(fit, problem=replace(fit.problem, units=np.zeros(0)))
    motions = _Motions(case, first)
    fit, size = motions.fitted(motion)
    small = abs(size) < LARGEST or motion.of.startswith("early")
    # A robot of other lengths explains a prismatic joint that goes farther.
    possible = small and fit.largest_correction <= IMPLAUSIBLE
    if not (possible and fit.rms**2 < LEFT * first.rms**2):
        return None
    ratio, tried = fit.left * float(np.log(first.rms / fit.rms)), len(motions.every)
    faults, sizes = (motion.hypothesis(case, size),), (first.errors, fit.errors)
    return Explanation(faults, *sizes, ratio, tried, fitted=True)


def _large(case: Case) -> Explanation | None:
    """The one that the nominal robot lacks."""
    problem = replace(case.fit.problem, units=np.zeros(0))
    first = QuickFit(problem, case.nominal, robot=False)
    motions, before, joints = _Motions(case, first), first.errors, case.data.joints
    if not before > LARGE * expected_size(first.quantity.unit):
        return None
    left = [first.score(motions.column(first, m)).left for m in motions.every]
    tried = [motions.every[k] for k in np.argsort(left)[:TRIED]]
    # The frame of a base that is stated is another explanation of its first joint.
    joint = turned_by_base(case)
    none = [Motion("zero", (joints.index(joint),))] if joint else []
    tried = [m for m in tried if m.of != "side" and m not in none]
    found = [(*motions.fitted(m), m) for m in tried]
    if not found:
        return None
    fit, size, motion = min(found, key=lambda one: one[0].errors)
    ratio = first.left * float(np.log(before / fit.errors))
    decisive = fit.errors < DECISIVE * before
    # One that goes backwards is reversed, if anything.
    reversed_gear = motion.of == "gear" and not 1.0 + size > 0.0
    if not decisive or ratio < unlikely(len(motions.every)) or reversed_gear:
        return None
    if motion.of == "zero":
        name = joints[motion.joints[0]]
        if case.turns(name) and abs(size) < LEAST:
            return None
        size = _rounded(size) if case.turns(name) else size
        read = read_so(case.data, [motion.hypothesis(case, size)])
        fit = fit.stepped(read.rows(motions.index))
        # A fit of this very offset has said it already, and more exactly.
        name = f"{name}.joint-offset.q"
        estimated = any(p.free and p.name == name for p in problem.parameters)
        if case.fitted is not None and estimated and case.fit.errors <= fit.errors:
            return None
    known = case.fitted is not None and case.errors_left <= DOUBTFUL
    faults, of_trial = (motion.hypothesis(case, size),), (ratio, len(motions.every))
    harmless = known and motion.of == "zero"
    return Explanation(faults, before, fit.errors, *of_trial, False, harmless)


def _rounded(angle: float) -> float:
    """The roundest angle nearby, for zeros are set on purpose [rad].

    The rest is an error of the robot, which nothing else tells from it.
    """
    degrees = float(np.degrees(angle))
    for step in ROUND:
        if abs(degrees - step * round(degrees / step)) < NEARBY:
            return float(np.radians(step * round(degrees / step)))
    return angle
