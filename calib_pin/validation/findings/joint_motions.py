"""Joints that do not stand where their columns say: gears, couplings, lag.

Each changes the position of a joint by a small part of something known: of its own
position (a gear), of that of another joint (a coupling), of its last motion (a joint
that was read before it stood still). To first order it is one further column of the
Jacobian of the fit, and all of them are tried at once. The one that stands out is
fitted. Lost motion goes with the sign of the last motion; it is no matter of reading,
and is tried along only not to pass for a lag.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib_pin.estimation.statistics.distributions import f_tail
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.readings import last_motions
from calib_pin.observations import Indices, Observations
from calib_pin.setup import ReadingSetup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.hypotheses import Explanation, Hypothesis, read_so
from calib_pin.validation.findings.plausibility import OPTIONS
from calib_pin.validation.findings.quick_fit import QuickFit
from calib_pin.validation.findings.setup_lines import JointReading

LEFT = 0.42
"""Part of the sum of squares that a part of a motion leaves at most.

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
"""Largest part; more is another fault, such as a joint that is reversed."""

STEPS = 12
"""Most steps in which a part is fitted with the robot."""

SETTLED = 0.1
"""Change of the part, in its standard deviations, after which no more are taken."""

STILL = 0.99
"""Part of the errors that the last step leaves at least: the robot must settle, too."""


class Motion(NamedTuple):
    """Part of something by which joints stand elsewhere.

    Attributes:
        of: What it is a part of: `gear`, `lag`, `side` or `coupled`.
        joints: The joint, all joints, or the joint and the one it is coupled to.
    """

    of: str
    joints: tuple[int, ...]

    def hypothesis(self, case: Case, part: float) -> Hypothesis:
        """How measurements are to be read with so large a part."""
        names = case.data.joints
        name = names[self.joints[0]]
        if self.of == "lag":
            whose = f"joint '{name}'" if len(self.joints) == 1 else "all joints"
            return Hypothesis(
                "lag",
                f"errors follow the last motion of {whose}: {100 * part:.2g} % of it",
                "lag",
                reading=ReadingSetup(lag={names[j]: part for j in self.joints}),
                figure="residuals-over-order",
            )
        reading = JointReading.plain(len(names))
        reading.factors[self.joints[0], self.joints[-1]] += part
        if self.of == "gear":
            code = "joint-gear"
            words = f"joint '{name}' moves {1.0 + part:.5g} times as far as read"
        else:
            code, other = "joint-coupled", names[self.joints[1]]
            words = f"joint '{name}' is coupled to '{other}', by {100 * part:.2g} %"
        return Hypothesis(
            code,
            words,
            f"{self.of} of {name}",
            joints=reading,
            figure="residuals-by-joint",
        )


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
        joints = self.case.data.joints
        revolute = dict(
            zip(self.case.chains.joints, self.case.chains.revolute, strict=True)
        )
        every = range(len(joints))
        turning = [j for j in every if revolute.get(joints[j], True)]
        return (
            *(Motion("gear", (j,)) for j in every),
            *(Motion("lag", (j,)) for j in every),
            Motion("lag", tuple(every)),
            *(Motion("side", (j,)) for j in every),
            *(Motion("coupled", (j, k)) for j in turning for k in turning if j != k),
        )

    @cached_property
    def by_parts(self) -> Floats:
        """Whitened residual by the part of each motion, shape (M, K)."""
        fit = self.fit
        data, row = fit.problem.data, fit.problem.layout.row
        moved = last_motions(self.case.data)[self.index][row]
        sides = np.sign(moved)
        if data.conditions.direction.size:
            sides = data.conditions.direction[row]
        start = np.concatenate(
            [b.start if b.start.size else np.zeros(b.q.shape) for b in data.blocks]
        )[row]
        ends, starts, q = fit.by_joints, fit.by_starts, data.q[row]

        def column(motion: Motion) -> Floats:
            if motion.of in ("lag", "side"):
                own = list(motion.joints)
                by = moved[:, own] if motion.of == "lag" else sides[:, own]
                return np.asarray(-np.sum(ends[:, own] * by, axis=1))
            j, k = motion.joints[0], motion.joints[-1]
            return np.asarray(ends[:, j] * q[:, k] + starts[:, j] * start[:, k])

        return np.stack([column(motion) for motion in self.motions], axis=1)

    def likeliest(self) -> int | None:
        """The motion that explains most, where it does so alone and everywhere."""
        fit, rows = self.fit, len(self.by_parts)
        Q, r = fit.unexplained
        X = np.zeros((len(r), len(self.motions)))
        X[:rows] = self.by_parts
        X -= Q @ (Q.T @ X)
        norms, along = np.sum(X**2, axis=0), X.T @ r
        # What the fit can do already is not tried: what is left of it is rounding.
        before = np.sum(self.by_parts**2, axis=0)
        told = norms > 1e-6 * before
        gains = np.where(told, along**2 / np.where(told, norms, 1.0), 0.0)
        left = 1.0 - gains / max(float(r @ r), 1e-300)
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
        lost = self.motions[best].of == "side"
        return None if lost or contrary >= CONTRARY else int(best)


def joint_motion(case: Case) -> Explanation | None:
    """The small motion of a joint that errors follow; None where none stands out."""
    known = case.fit.whole or case.fit.redundant
    fit = case.fit if known else replace(case.fit, whole=True)
    if fit.left <= 1:
        return None
    columns = _Columns(case, fit)
    best = columns.likeliest()
    if best is None:
        return None
    # Noise that came out large for this very fault would hold back the robot's errors.
    fit = first = replace(fit, problem=replace(fit.problem, units=np.zeros(0)))
    columns = replace(columns, fit=fit)
    motion, X = columns.motions[best], columns.by_parts[:, [best]]
    part = 0.0
    for _ in range(STEPS):
        score = fit.score(X)
        part += float(score.values[0])
        if not abs(part) < LARGEST:
            return None
        data = read_so(case.data, [motion.hypothesis(case, part)]).rows(columns.index)
        before, fit = fit, refitted(fit, data)
        still = fit.rms > STILL * before.rms
        if still and abs(score.values[0]) < SETTLED * score.deviations[0]:
            break
    if (
        not fit.rms**2 < LEFT * first.rms**2
        or fit.largest_correction > OPTIONS.implausible
    ):
        # A robot of other lengths explains a prismatic joint that goes farther.
        return None
    return Explanation(
        (motion.hypothesis(case, part),),
        first.errors,
        fit.errors,
        fit.left * float(np.log(first.rms / fit.rms)),
        len(columns.motions),
        fitted=True,
    )


def refitted(fit: QuickFit, data: Observations) -> QuickFit:
    """A fit to the same measurements, read otherwise: one more step."""
    fit = replace(fit, problem=replace(fit.problem, data=data))
    parameters, (A, b) = fit.problem.parameters, fit.system
    theta, free = fit.theta.copy(), parameters.free
    theta[free] -= parameters.scales[free] * np.linalg.lstsq(A, b, rcond=1e-10)[0]
    return replace(fit, theta=theta)
