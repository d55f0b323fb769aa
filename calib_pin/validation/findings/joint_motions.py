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

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib_pin.estimation.statistics.distributions import f_tail
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.readings import last_motions, with_positions
from calib_pin.observations import Indices, Observations
from calib_pin.parameterizations.base import expected_size
from calib_pin.setup import ReadingSetup
from calib_pin.validation.findings.case import DOUBTFUL, Case
from calib_pin.validation.findings.explanations import DECISIVE, UNLIKELY
from calib_pin.validation.findings.hypotheses import Explanation, Hypothesis, read_so
from calib_pin.validation.findings.plausibility import IMPLAUSIBLE
from calib_pin.validation.findings.quick_fit import QuickFit
from calib_pin.validation.findings.readings import (
    geared,
    offset_by,
    turned_by_base,
)
from calib_pin.validation.findings.setup_lines import JointReading

LEFT = 0.42
"""Part of the sum of squares that a small motion leaves at most.

Gears that err by what no parameter describes have left 0.43 of it, on a path.
"""

CHANCE = 1e-4
"""Probability that one of them explains as much by chance, from which it is told."""

CONTRARY = 0.04
"""Part of what it explains that some stretches of the files may contradict.

Of true gears and lags it is below 0.013, also where these cost less than noise.
"""

STRETCHES = 20
"""Number of these stretches."""

CLEAR = 5.0
"""Logarithm of the likelihood ratio to the next best."""

LARGEST = 0.3
"""Largest part that is small; more is another fault, such as a joint that is
reversed."""

STEPS = 12
"""Most steps in which a motion is fitted: an offset of 60 deg takes seven."""

SETTLED = 0.1
"""Change of the number, in its standard deviations, after which no more are taken."""

STILL = 0.99
"""Part of the errors that the last step leaves at least: the robot must settle, too."""

LARGE = 10.0
"""Errors of the nominal robot, in expected sizes, from which large ones are sought."""

TRIED = 4
"""Large ones that are fitted: what explains most to first order may not in the end."""

LEAST = np.radians(3.0)
"""Least large offset that is told [rad]; robots have up to half of it."""

ROUND = (45.0, 15.0, 10.0, 5.0, 1.0)
"""Round angles [deg]."""

NEARBY = 0.6
"""Largest distance from one of them [deg], three times a usual error of a robot."""

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
            return offset_by(names, j, size, _turns(case, j))
        if self.of == "gear":
            return geared(names, j, 1.0 + size)
        if self.of == "coupled":
            reading = JointReading.plain(len(names))
            reading.factors[j, self.joints[1]] += size
            other = names[self.joints[1]]
            return Hypothesis(
                "joint-coupled",
                f"joint '{names[j]}' is coupled to '{other}', by {100 * size:.2g} %",
                f"coupled of {names[j]}",
                joints=reading,
                figure="residuals-by-joint",
            )
        whose = f"joint '{names[j]}'" if len(self.joints) == 1 else "all joints"
        lag = Hypothesis(
            "lag",
            f"errors follow the last motion of {whose}: {100 * size:.2g} % of it",
            "lag",
            figure="residuals-over-order",
        )
        if self.of == "lag":
            parts = ReadingSetup(lag={names[j]: size for j in self.joints})
            return replace(lag, reading=parts)
        whose = "every joint has" if self.of == "early-each" else "the farthest has"
        return replace(
            lag,
            words="the joints were read as arrived while they still moved: "
            f"{whose} {np.degrees(size):.2g} deg to go",
            change=lambda data: _early(data, self, size),
            advice=REST,
        )


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
class _Columns:
    """Motions that are tried in a case, with the fit that they explain."""

    case: Case
    fit: QuickFit

    @cached_property
    def index(self) -> Indices:
        """Positions of the measurements that were fitted among all."""
        return self.case.data.in_order[self.case.rank]

    @cached_property
    def motions(self) -> tuple[Motion, ...]:
        """Motions that are tried, of every joint."""
        every = range(len(self.case.data.joints))
        turning = [j for j in every if _turns(self.case, j)]
        return (
            *(
                Motion(of, (j,))
                for of in ("zero", "gear", "lag", "side")
                for j in every
            ),
            Motion("lag", tuple(every)),
            *(Motion(of, tuple(turning)) for of in ("early", "early-each") if turning),
            *(Motion("coupled", (j, k)) for j in turning for k in turning if j != k),
        )

    @cached_property
    def read(self) -> Observations:
        """Measurements that were fitted, read without a motion."""
        return self.case.data.rows(self.index)

    @cached_property
    def along(self) -> dict[str, Floats]:
        """Ways of joints in motions that go with their last one, by kind, (N, n)."""
        moved = last_motions(self.case.data)[self.index]
        known = self.read.conditions.direction
        farthest = np.abs(moved).max(axis=1, keepdims=True)
        return {
            "lag": moved,
            "side": known.astype(float) if known.size else np.sign(moved),
            "early": moved / np.where(farthest > 0.0, farthest, 1.0),
            "early-each": np.sign(moved),
        }

    @cached_property
    def by_sizes(self) -> Floats:
        """Whitened residual by the size of each motion, shape (M, K)."""
        return np.stack([self.column(motion) for motion in self.motions], axis=1)

    def column(self, motion: Motion) -> Floats:
        """The same of one, shape (M,)."""
        fit, row = self.fit, self.fit.problem.layout.row
        ends, starts = fit.by_joints, fit.by_starts
        own, j, k = list(motion.joints), motion.joints[0], motion.joints[-1]
        if motion.of in self.along:
            moved = self.along[motion.of][row]
            return np.asarray(-np.sum(ends[:, own] * moved[:, own], axis=1))
        if motion.of == "zero":
            return np.asarray(ends[:, j] + starts[:, j])
        q, blocks = self.read.q, self.read.blocks
        start = [b.start if b.start.size else np.zeros(b.q.shape) for b in blocks]
        by_start = starts[:, j] * np.concatenate(start)[row, k]
        return np.asarray(ends[:, j] * q[row, k] + by_start)

    def gains(self) -> tuple[Floats, Floats, Floats]:
        """Part of the squares that each motion leaves, shape (K,).

        With what of it the fit cannot do, (M', K), and that along the residual, (K,).
        """
        _, r = self.fit.unexplained
        X = self.fit.beyond(self.by_sizes)
        norms, along = np.sum(X**2, axis=0), X.T @ r
        # What the fit can do already is not tried: what is left of it is rounding.
        told = norms > 1e-6 * np.sum(self.by_sizes**2, axis=0)
        gains = np.where(told, along**2 / np.where(told, norms, 1.0), 0.0)
        return 1.0 - gains / max(float(r @ r), 1e-300), X, along

    def likeliest(self) -> Motion | None:
        """The small motion that explains most, if it does so alone and everywhere."""
        fit, rows, (left, X, along) = self.fit, len(self.by_sizes), self.gains()
        _, r = fit.unexplained
        best, second = np.argsort(left)[:2]
        F = (fit.left - 1) * (1.0 / max(left[best], 1e-12) - 1.0)
        if (
            left[best] > LEFT
            or 0.5 * fit.left * np.log(left[second] / left[best]) < CLEAR
            or f_tail(F, 1, fit.left - 1) * len(left) > CHANCE
        ):
            return None
        stretch = self.case.rank[fit.problem.layout.row] * STRETCHES
        stretch = stretch // (int(self.case.rank.max()) + 1)
        shares = np.bincount(stretch, X[:rows, best] * r[:rows]) / along[best]
        contrary = -float(shares[shares < 0.0].sum())
        motion = self.motions[best]
        # What moves a zero moves an origin as well.
        lost = motion.of in ("side", "zero")
        return None if lost or contrary >= CONTRARY else motion

    def fitted(self, motion: Motion) -> Iterator[tuple[QuickFit, float]]:
        """The fit with a motion, and its size, in every step; it ends settled."""
        size, here = 0.0, self
        for _ in range(STEPS):
            score = here.fit.score(here.column(motion)[:, None])
            size += float(score.values[0])
            read = read_so(self.case.data, [motion.hypothesis(self.case, size)])
            before, fit = here.fit, refitted(here.fit, read.rows(self.index))
            here = replace(here, fit=fit)
            yield fit, size
            still = fit.rms > STILL * before.rms
            if still and abs(score.values[0]) < SETTLED * score.deviations[0]:
                return


def joint_motion(case: Case) -> Explanation | None:
    """The motion of joints that errors follow; None where none stands out."""
    return _small(case) or _large(case)


def _small(case: Case) -> Explanation | None:
    """The one that a fit leaves."""
    known = case.fit.whole or case.fit.redundant
    fit = case.fit if known else replace(case.fit, whole=True)
    if fit.left <= 1:
        return None
    motion = _Columns(case, fit).likeliest()
    if motion is None:
        return None
    # Noise that came out large for this very fault would hold back the robot's errors.
    first = replace(fit, problem=replace(fit.problem, units=np.zeros(0)))
    columns = _Columns(case, first)
    for step in columns.fitted(motion):
        fit, size = step
        if not (abs(size) < LARGEST or motion.of.startswith("early")):
            return None
    if not fit.rms**2 < LEFT * first.rms**2 or fit.largest_correction > IMPLAUSIBLE:
        # A robot of other lengths explains a prismatic joint that goes farther.
        return None
    return Explanation(
        (motion.hypothesis(case, size),),
        first.errors,
        fit.errors,
        fit.left * float(np.log(first.rms / fit.rms)),
        len(columns.motions),
        fitted=True,
    )


def _large(case: Case) -> Explanation | None:
    """The one that the nominal robot lacks."""
    problem = replace(case.fit.problem, units=np.zeros(0))
    first = QuickFit(problem, case.nominal, robot=False)
    columns, before = _Columns(case, first), first.errors
    if not before > LARGE * expected_size(problem.layout.quantities[0].unit):
        return None
    tried = [columns.motions[k] for k in np.argsort(columns.gains()[0])[:TRIED]]
    # The frame of a base that is stated is another explanation of its first joint.
    joint = turned_by_base(case)
    none = [Motion("zero", (case.data.joints.index(joint),))] if joint else []
    tried = [m for m in tried if m.of != "side" and m not in none]
    found = [(*[*columns.fitted(m)][-1], m) for m in tried]
    if not found:
        return None
    fit, size, motion = min(found, key=lambda one: one[0].errors)
    ratio = first.left * float(np.log(before / fit.errors))
    chance = UNLIKELY + float(np.log(len(columns.motions)))
    if not fit.errors < DECISIVE * before or ratio < chance:
        return None
    hypothesis = motion.hypothesis(case, size)
    if motion.of == "zero":
        turns = _turns(case, motion.joints[0])
        if turns and abs(size) < LEAST:
            return None
        size = _rounded(size) if turns else size
        hypothesis = motion.hypothesis(case, size)
        fit = refitted(fit, read_so(case.data, [hypothesis]).rows(columns.index))
        # A fit of this very offset has said it already, and more exactly.
        name = f"{case.data.joints[motion.joints[0]]}.joint-offset.q"
        estimated = any(p.free and p.name == name for p in problem.parameters)
        if case.fitted is not None and estimated and case.fit.errors <= fit.errors:
            return None
    if motion.of == "gear" and not 1.0 + size > 0.0:
        return None  # It is reversed, if anything.
    known = case.fitted is not None and case.errors_left <= DOUBTFUL
    return Explanation(
        (hypothesis,),
        before,
        fit.errors,
        ratio,
        len(columns.motions),
        fitted=False,
        harmless=known and motion.of == "zero",
    )


def refitted(fit: QuickFit, data: Observations) -> QuickFit:
    """A fit to the same measurements, read otherwise: one more step."""
    fit = replace(fit, problem=replace(fit.problem, data=data))
    parameters, (A, b) = fit.problem.parameters, fit.system
    if not (np.isfinite(A).all() and np.isfinite(b).all()):
        raise np.linalg.LinAlgError  # A point lies behind the camera, say.
    theta, free = fit.theta.copy(), parameters.free
    theta[free] -= parameters.scales[free] * np.linalg.lstsq(A, b, rcond=1e-10)[0]
    return replace(fit, theta=theta)


def _turns(case: Case, joint: int) -> bool:
    """Whether a joint turns, by its position among those of the measurements."""
    return case.unit(case.data.joints[joint]) == "rad"


def _rounded(angle: float) -> float:
    """The roundest angle nearby, for zeros are set on purpose [rad].

    The rest is an error of the robot, which nothing else tells from it.
    """
    degrees = float(np.degrees(angle))
    for step in ROUND:
        if abs(degrees - step * round(degrees / step)) < NEARBY:
            return float(np.radians(step * round(degrees / step)))
    return angle
