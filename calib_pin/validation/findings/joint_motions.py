"""Joints that do not stand where their columns say, or that err as gears do.

Motions move joints by something known times one number: by one (a zero), by its own
position (a gear) or that of another joint (a coupling), along its last motion (a joint
that was read before it stood still). To first order that is one further column of the
Jacobian, and all are tried at once. Small ones are fitted with the errors of the robot;
those that cost more than robots err, with the nominal one, which tells where a fit has
spread them over all origins.

Lost motion goes with the sign of the last motion. A fit without hysteresis is asked how
far each joint stands behind it. Where a joint came from depends on where it is: high
positions are reached from below. So the side to be expected at a position is fitted
along, as are smooth errors of the joints where they show. Measurements between two
reversals may share what the model lacks; each such run counts once, and the sides of
measurements before and behind must not explain nearly as much.

Ripples come back many times per turn. Residuals are projected on the motion of each
joint j and searched for the frequency f at which `a sin(f q_j) + b cos(f q_j)` explains
most of them: a periodogram over unevenly spaced positions (Lomb 1976, Scargle 1982).
How often chance comes as high at any of the frequencies is bounded by Baluev (2008):
with the probability p at a single one, W p sqrt(-ln p), W being the width of the band
by the resolution.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import CalibPinError, enumerated
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.problem import EXACT
from calib_pin.estimation.statistics.distributions import f_tail, student_tail
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.readings import last_motions, with_positions
from calib_pin.observations import Indices, Observations, Signs
from calib_pin.parameterizations import needed_conditions
from calib_pin.parameterizations.transmission import MotorRipple, Transmission
from calib_pin.setup import ReadingSetup
from calib_pin.validation.findings.alternatives import (
    Alternative,
    Explanation,
    read_with,
)
from calib_pin.validation.findings.case import (
    CHANCE,
    IMPLAUSIBLE,
    Case,
    QuickFit,
    Score,
    fit_factors,
    squares,
    surpasses,
    unlikely,
)
from calib_pin.validation.findings.readings import (
    coupled,
    geared,
    offset_by,
    turned_by_base,
)
from calib_pin.validation.findings.sentences import finding, shown

LEFT, BENDS = 0.42, 0.8
"""Part of the sum of squares that a small motion leaves at most, and part of the errors
that it leaves below which families of parameters that the fit lacks are the cause.

Gears that err by what no parameter describes have left 0.43 of it, on a path.
"""

CONTRARY, STRETCHES = 0.04, 20
"""Part of what it explains that some stretches of the files may contradict, and their
number. Of true gears and lags it is below 0.013, also where these cost less than noise.
"""

LARGEST = 0.3
"""Largest part that is small; more is another fault, such as a joint that is
reversed."""

SMALLEST, TRIED = np.radians(3.0), 4
"""Least large offset that is told [rad]; robots have up to half of it. And how many
large motions are fitted: what explains most to first order may not in the end."""

ROUND, NEARBY = (45.0, 15.0, 10.0, 5.0, 1.0), 0.6
"""Round angles [deg], and the largest distance from one of them [deg], three times a
usual error of a robot."""

BACKLASH = 3e-3
"""Most lost motion that joints of arms have [rad]. Joints that were read as little
before they arrived err by the side from which they come, as those that lose motion."""

SHORTEST = {"early": 0.0, "early-each": BACKLASH}
"""Ways that joints must have to go, by kind [rad]: nothing has less than nothing."""

REST = "measure again at rest: the joints must stand still when they are read"


DEGREE = 3
"""Degree of the polynomial by which the side to be expected depends on a position."""

RUNS, LAGS = 10, 40
"""Least number of reversals of a joint of which something can be said, and lags by
which sides of other measurements are tried."""

LEAST = 0.02
"""Least part of a joint's side that nothing else explains, of its sum of squares, and
of the errors left that its lost motion explains.

Of very many measurements less can be told, but makes no difference: 0.013 on the UR5.
"""

LOWEST, HIGHEST = 4.0, 400.0
"""Frequencies that are sought, in waves per turn: below are eccentric wheels and what
no parameter describes; a strain-wave gear of 200 has its wave generator above."""

WAVES, FINER = 3.0, 4
"""Least number of waves over the motion of a joint, and frequencies within its
resolution."""

AROUND, PEAKS = np.linspace(-1.0, 1.0, 65), 3
"""Where better frequencies are sought around one, in steps, and around how many."""

EVEN = 0.1
"""Likelihood of a whole number, by that of the best frequency, that is enough."""

BY_ORDER = "the sides are taken from the order of the measurements in their files"


class Motion(NamedTuple):
    """How joints stand elsewhere, but for one number.

    Attributes:
        kind: `zero`, `gear`, `coupled`, `lag` (by a part of their last motion), `early`
            and `early-each` (by an angle before its end, of the joint that went
            farthest, or of each) or `side`.
        joints: The joint, all joints, or the joint and the one it is coupled to.
    """

    kind: str
    joints: tuple[int, ...]

    def alternative(self, case: Case, size: float) -> Alternative:
        """How measurements are to be read with a motion of a size [rad, m, or none]."""
        names, j = case.data.joints, self.joints[0]
        if self.kind == "zero":
            return offset_by(names, j, size, case.unit(names[j]) == "rad")
        if self.kind == "gear":
            return geared(names, j, 1.0 + size)
        if self.kind == "coupled":
            return coupled(names, j, self.joints[1], size, f", by {100 * size:.3g} %")
        if self.kind == "lag":
            whose = f"joint '{names[j]}'" if len(self.joints) == 1 else "all joints"
            text = f"errors follow the last motion of {whose}: {100 * size:.2g} % of it"
            parts = ReadingSetup(lag={names[j]: size for j in self.joints})
            return Alternative("lag", text, "lag", parts, figure="over-order")
        text = "the joints were read as arrived while they still moved: "
        text += "every joint has" if self.kind == "early-each" else "the farthest has"
        text += f" {np.degrees(size):.2g} deg to go"
        lag = Alternative("lag", text, "lag", advice=REST, figure="over-order")
        return replace(lag, change=lambda data: _unsettled(data, self, size))


def _unsettled(data: Observations, motion: Motion, angle: float) -> Observations:
    """Measurements whose joints have still an angle to go, or all of a shorter way."""
    moved, joints = last_motions(data), list(motion.joints)
    travel = np.abs(moved[:, joints])
    if motion.kind == "early":
        travel = travel.max(axis=1, keepdims=True)
    share = np.where(travel > 0.0, angle / np.where(travel > 0.0, travel, 1.0), 0.0)
    q = data.q.copy()
    q[:, joints] -= np.minimum(share, 1.0) * moved[:, joints]
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
    def motions(self) -> tuple[Motion, ...]:
        """Motions that are tried, of every joint."""
        joints, kinds = self.case.data.joints, ("zero", "gear", "lag", "side")
        each = range(len(joints))
        turning = tuple(j for j in each if self.case.unit(joints[j]) == "rad")
        return (
            *(Motion(kind, (j,)) for kind in kinds for j in each),
            Motion("lag", tuple(each)),
            *(Motion(kind, turning) for kind in ("early", "early-each") if turning),
            *(Motion("coupled", (j, k)) for j in turning for k in turning if j != k),
        )

    @cached_property
    def phi(self) -> dict[str, Floats]:
        """Motions of all joints by size one, by kind, (N, n), or (2, N, n) of starts.

        Positions are those without a motion.
        """
        moved = last_motions(self.case.data, self.index)
        data = self.fit.problem.data
        direction = data.conditions.direction
        farthest = np.abs(moved).max(axis=1, keepdims=True)
        starts = [b.start if b.start.size else 0.0 * b.q for b in data.blocks]
        positions = np.stack([data.q, np.concatenate(starts)])
        return {
            "zero": np.ones_like(positions),
            "gear": positions,
            "coupled": positions,
            "lag": -moved,
            "side": -(direction.astype(float) if direction.size else np.sign(moved)),
            "early": -moved / np.where(farthest > 0.0, farthest, 1.0),
            "early-each": -np.sign(moved),
        }

    def column(self, fit: QuickFit, motion: Motion) -> Floats:
        """Whitened residual of a fit by the size of a motion, shape (M, 1)."""
        row, phi, joints = fit.problem.layout.row, self.phi[motion.kind], motion.joints
        if phi.ndim == 2:
            by_size = fit.by_joints * phi[row]
            return np.asarray(by_size[:, joints].sum(axis=1, keepdims=True))
        j, k = joints[:1], joints[-1:]
        ends, starts = phi[0][row][:, k], phi[1][row][:, k]
        return np.asarray(fit.by_joints[:, j] * ends + fit.by_starts[:, j] * starts)

    def likeliest(self) -> Motion | None:
        """The small motion that explains most, if it does so alone and everywhere."""
        fit, columns = self.fit, [self.column(self.fit, m) for m in self.motions]
        scores = [fit.score(column) for column in columns]
        best, second = np.argsort([score.remaining for score in scores])[:2]
        remaining, motion = scores[best].remaining, self.motions[best]
        clear = 0.5 * fit.dof * np.log(scores[second].remaining / max(remaining, 1e-12))
        sure = scores[best].chance * len(scores) <= CHANCE and clear >= unlikely()
        # What moves a zero moves an origin as well.
        if remaining > LEFT or not sure or motion.kind in ("side", "zero"):
            return None
        if self.loose(motion):
            return None
        row = fit.problem.layout.row
        gains = (fit.beyond(columns[best])[:, 0] * fit.unexplained[1])[: len(row)]
        stretch = self.case.rank[row] * STRETCHES // (int(self.case.rank.max()) + 1)
        shares = np.bincount(stretch, gains) / float(gains.sum())
        return motion if -shares[shares < 0.0].sum() < CONTRARY else None

    def loose(self, motion: Motion) -> bool:
        """Whether a motion is no more than the mean of what the joints lose."""
        if not motion.kind.startswith("early"):
            return False
        fit, sides = self.fit, [Motion("side", (j,)) for j in motion.joints]
        columns = np.hstack([self.column(fit, side) for side in sides])
        after = squares(fit) * fit.score(columns).remaining
        return surpasses(fit, after, len(sides), self.column(fit, motion))

    def fitted(self, motion: Motion) -> tuple[QuickFit, float]:
        """The fit with a motion, and its size."""

        def read(sizes: Floats) -> Observations:
            fault = motion.alternative(self.case, float(sizes[0]))
            return read_with(self.case.data, [fault]).rows(self.index)

        def column(fit: QuickFit) -> Floats:
            return self.column(fit, motion)

        fit, (size,) = fit_factors(self.fit, np.zeros(1), column, read)
        return fit, float(size)


def joint_motion(case: Case) -> Explanation | None:
    """The small motion that the errors of a fit follow; None where none stands out."""
    fit = case.fit
    motion = _Motions(case, fit).likeliest() if fit.dof > 1 else None
    if motion is None:
        return None
    # Noise that came out large for this very fault would hold back the robot's errors.
    first = replace(fit, problem=replace(fit.problem, units=np.zeros(0)))
    fit, size = _Motions(case, first).fitted(motion)
    small = abs(size) < LARGEST or motion.kind.startswith("early")
    # A robot of other lengths explains a prismatic joint that goes farther.
    possible = small and fit.largest_correction <= IMPLAUSIBLE
    if not (possible and fit.rms**2 < LEFT * first.rms**2):
        return None
    if size <= SHORTEST.get(motion.kind, -np.inf):
        return None
    # What bends follows joints as well, and the position of one most of all.
    if np.sqrt(case.lacking[1]) < BENDS * fit.rms / first.rms:
        return None
    return Explanation((motion.alternative(case, size),), first.errors, fit.errors)


def large_motions(case: Case) -> Iterator[Alternative]:
    """Motions that the nominal robot lacks, those first that explain most."""
    problem = replace(case.fit.problem, units=np.zeros(0))
    first = QuickFit(problem, case.nominal, robot=False)
    if not np.isfinite(first.linear[0]).all():
        return
    search, of_fit = _Motions(case, first), _Motions(case, case.fit)
    joints = case.data.joints
    parts = [first.score(search.column(first, m)).remaining for m in search.motions]
    for motion in [search.motions[k] for k in np.argsort(parts)[:TRIED]]:
        name = joints[motion.joints[0]]
        # The frame of a base that is stated is another explanation of its first joint.
        if motion.kind == "side" or (
            motion.kind == "zero" and name == turned_by_base(case)
        ):
            continue
        try:
            _, size = search.fitted(motion)
        except (CalibPinError, np.linalg.LinAlgError):
            continue  # It has led away.
        if motion.kind == "zero" and case.unit(name) == "rad":
            size = _rounded(size) if abs(size) >= SMALLEST else 0.0
        # What goes backwards is reversed, and a lag of a whole motion is a shift.
        backwards = motion.kind == "gear" and not size > -1.0
        whole = motion.kind == "lag" and not abs(size) < LARGEST
        beyond = size <= SHORTEST.get(motion.kind, -np.inf) or of_fit.loose(motion)
        if size and not (backwards or whole or beyond):
            yield motion.alternative(case, size)


def _rounded(angle: float) -> float:
    """The roundest angle nearby, for zeros are set on purpose [rad].

    The rest is an error of the robot, which nothing else tells from it.
    """
    degrees = float(np.degrees(angle))
    for step in ROUND:
        if abs(degrees - step * round(degrees / step)) < NEARBY:
            return float(np.radians(step * round(degrees / step)))
    return angle


def approach_order(case: Case) -> Iterator[Finding]:
    """That lost motion was estimated by an order that nobody has stated."""
    by_order = case.data.conditions.source == "order"
    if by_order and "direction" in needed_conditions(case.setup.parameters):
        text = f"{BY_ORDER}: they must be those of measuring"
        remedy = "or state them in columns '<joint>.direction', or when each "
        remedy += "measurement was taken in a column 'time'"
        numbers = {"joints": ", ".join(case.data.joints)}
        yield finding("approach-by-order", text, numbers, remedy, info=True)


def approach(case: Case) -> Iterator[Finding]:
    """Joints whose errors depend on the side from which they came."""
    fit, conditions = case.fit, case.fit.problem.data.conditions
    known = conditions.direction.size and "hysteresis" not in case.setup.parameters
    if not (known and case.informed and fit.rms > EXACT):
        return
    lost = lost_motions(case)
    if not lost:
        return
    numbers: dict[str, Any] = {joint: size for joint, (size, _) in lost.items()}
    sizes = []
    for joint, (size, sigma) in lost.items():
        unit = "mrad" if case.unit(joint) == "rad" else "mm"
        sizes.append(f"'{joint}' {1e3 * size:.2g} +- {1e3 * sigma:.1g} {unit}")
    words = "errors depend on the approach direction (backlash): "
    words += enumerated(sizes) + f" ({BY_ORDER})" * (conditions.source == "order")
    names, numbers["joints"] = [*case.setup.parameters, "hysteresis"], ", ".join(lost)
    remedy = f"estimate it: --parameters {','.join(names)}", {"parameters": names}
    yield finding("backlash", words, numbers, *remedy, "by-joint")


def lost_motions(case: Case) -> dict[str, tuple[float, float]]:
    """Lost motion of joints as a fit without it leaves it, the surest first.

    Its value and standard deviation [rad, m], of joints of which chance does not make
    as much, and where it makes a difference.
    """
    fit, data, lost = case.fit, case.fit.problem.data, {}
    row, by_joints = fit.problem.layout.row, fit.by_joints
    sides, order = data.conditions.direction, np.argsort(case.rank)
    place = np.argsort(order)[row]  # Of each residual, in the order of the files.
    usual = by_joints * _usual_sides(data.q, sides)[row]
    smooth = np.hstack([usual, _smooth(case, by_joints, data.q[row])])
    columns = -0.5 * by_joints * sides[row]
    # Smooth errors are fitted along where they show at all.
    base = fit.explaining(smooth if fit.score(smooth).chance < CHANCE else usual)
    X = base.beyond(columns)
    seen = np.flatnonzero(np.sum(X**2, axis=0) > LEAST * np.sum(columns**2, axis=0))
    dof = base.dof - len(seen)
    if not len(seen) or dof < 1:
        return {}
    full = base.explaining(columns[:, seen])
    # Each lost motion is a weighted sum of residuals.
    weights, rest = np.linalg.pinv(X[:, seen]).T, full.unexplained[1]
    values = -(weights.T @ base.unexplained[1])
    squares = np.sum(weights**2, axis=0)
    deviations = np.sqrt(float(rest @ rest) / dof * squares)
    for k, j in enumerate(seen.tolist()):
        side, value = sides[order, j], float(values[k])
        run = np.cumsum(np.diff(side, prepend=0) != 0)[place]
        runs, t = len(np.unique(run)), float(values[k] / deviations[k])
        if runs < RUNS or t <= 0.0 or t**2 < LEAST * (t**2 + dof):
            continue
        # Residuals of a run may err together.
        sums = np.bincount(run, (weights[:, k] * rest)[: len(row)])
        of_runs = max(float(np.sqrt(runs / (runs - 1.0) * (sums @ sums))), 1e-300)
        # Along a path what the model lacks changes as slowly as sides do: those of
        # other measurements must explain far less.
        count = min(LAGS, len(side) - 1)
        lags = np.arange(1, count + 1) * len(side) // (count + 1)
        lagged = np.column_stack([np.roll(side, lag) for lag in lags])[place]
        rivals = full.beyond(by_joints[:, [j]] * lagged)
        norms = np.maximum(np.sum(rivals**2, axis=0), 1e-300)
        theirs = max(float(np.mean((rivals.T @ rest) ** 2 / norms)), 1e-300)
        ratio = float(value**2 / squares[k]) / theirs
        by_runs = student_tail(value / of_runs, runs - 1)
        # Sides that hardly change are alike at neighboring lags.
        by_others = f_tail(ratio, 1, min(count, runs - 1))
        chance = max(student_tail(t, dof), by_runs, by_others)
        if chance * len(data.joints) < CHANCE:
            lost[data.joints[j]] = value, max(float(deviations[k]), of_runs)
    return dict(sorted(lost.items(), key=lambda item: -item[1][0] / item[1][1]))


def _usual_sides(q: Floats, sides: Signs) -> Floats:
    """The mean side at the position of each joint, a polynomial of it, (N, n)."""
    means = np.zeros(q.shape)
    for x, side, usual in zip(q.T, sides.T, means.T, strict=True):
        center, width = 0.5 * (x.max() + x.min()), 0.5 * float(np.ptp(x))
        V = np.polynomial.chebyshev.chebvander((x - center) / (width or 1.0), DEGREE)
        usual[:] = V @ np.linalg.lstsq(V, side.astype(float), rcond=None)[0]
    return means


def _smooth(case: Case, by_joints: Floats, q: Floats) -> Floats:
    """Whitened residual by smooth errors of the joints at their positions, (M, K)."""
    columns = []
    for j, joint in enumerate(case.data.joints):
        x = q[:, j]
        waves = [np.sin(x), np.cos(x), np.sin(2.0 * x), np.cos(2.0 * x)]
        shapes = [x, *waves] if case.unit(joint) == "rad" else [x, x**2]
        columns += [by_joints[:, j] * shape for shape in shapes]
    return np.column_stack(columns)


def ripples(case: Case) -> Iterator[Finding]:
    """Joints with a ripple that no parameter describes, and gears that make such."""
    if not case.informed:
        return
    joints = [name for name in case.data.joints if case.unit(name) == "rad"]
    fit, words, ratios, part = case.fit, list[str](), dict[str, float](), 1.0
    numbers: dict[str, Any] = {}
    # Eccentric and elliptic wheels are no ripple.
    low = [_waves(fit, joint, k) for joint in joints for k in (1.0, 2.0)]
    if low and np.isfinite(low).all():
        fit = fit.explaining(np.hstack(low))
    while len(ratios) < len(joints):
        # One after the other: a large one leaks into the other joints.
        remaining = [joint for joint in joints if joint not in ratios]
        waves = {joint: wave for joint in remaining if (wave := _ripple(fit, joint))}
        joint = min(waves, key=lambda joint: waves[joint][0], default="")
        if not joint or waves[joint][0] * len(joints) > CHANCE:
            break
        chance, frequency, score = waves[joint]
        fit = fit.explaining(_waves(fit, joint, frequency))
        # The wave generator of a strain-wave gear comes twice per turn of its motor,
        # which has an error of its own: half the frequency where that is seen as well.
        half = 0.5 * frequency
        seen = chance_of(fit, fit.score(_waves(fit, joint, half)).remaining) < CHANCE
        ratios[joint] = float(f"{half if seen else frequency:.4g}")
        size, part = float(np.linalg.norm(score.values)), part * score.remaining
        words += [f"'{joint}' {frequency:.4g} times per turn by {shown(size, 'rad')}"]
        first = {"frequency": frequency, "amplitude": size, "chance": chance}
        numbers = numbers or {"joint": joint, **first}
    if not words:
        return
    names = case.setup.parameters
    if not {Transmission.name, MotorRipple.name}.intersection(names):
        names = (*names, MotorRipple.name)
    gear_ratios = {**case.setup.gear_ratios, **ratios}
    lines = {"parameters": [*names], "gear_ratios": gear_ratios}
    remedy = "look up the gear ratios (a strain-wave gear ripples twice per turn of "
    remedy += "its motor)"
    text = f"joints ripple as gears do: {', '.join(words)}"
    yield finding(
        "gear-ripple", text, {**numbers, "left": part}, remedy, lines, info=True
    )


def _motion(fit: QuickFit, joint: str) -> tuple[Floats, Floats]:
    """Position of a joint at every residual, and how that changes it, shape (M,)."""
    column = fit.problem.data.joints.index(joint)
    row = fit.problem.layout.row
    return fit.problem.data.q[row, column], fit.by_joints[:, column]


def _waves(fit: QuickFit, joint: str, frequency: float) -> Floats:
    """Sine and cosine of a frequency along the motion of a joint, shape (M, 2)."""
    q, motion = _motion(fit, joint)
    waves = np.stack([np.sin(frequency * q), np.cos(frequency * q)], axis=1)
    return np.asarray(motion[:, None] * waves)


def _ripple(fit: QuickFit, joint: str) -> tuple[float, float, Score] | None:
    """The wave of a joint that explains most; None where it hardly moves.

    A bound of the probability that any frequency of the joint comes as high by chance,
    waves per turn, and the gain of sine and cosine.
    """
    q, motion = _motion(fit, joint)
    span = float(np.ptp(q)) if len(q) else 0.0
    lowest = max(LOWEST, 2.0 * np.pi * WAVES / max(span, 1e-300))
    usable = np.isfinite(motion).all() and motion.any() and fit.dof > 2
    if lowest >= HIGHEST or not usable:
        return None
    step = 2.0 * np.pi / (FINER * span)
    frequencies = np.arange(lowest, HIGHEST, step)
    r = fit.unexplained[1][: len(q)]
    peaks = np.argsort(-periodogram(q, motion, r, frequencies), kind="stable")
    around = [frequencies[k] + step * AROUND for k in peaks[:PEAKS]]
    candidates = [f[np.argmax(periodogram(q, motion, r, f))].item() for f in around]
    scores = {f: fit.score(_waves(fit, joint, f)) for f in candidates}
    best = min(candidates, key=lambda f: scores[f].remaining)
    score, whole = scores[best], float(round(best))
    even = fit.score(_waves(fit, joint, whole))
    if chance_of(fit, score.remaining / max(even.remaining, 1e-300)) > EVEN:
        best, score = whole, even
    # Effective length of the motion and width of the band, in waves.
    width = np.sqrt(4.0 * np.pi * np.var(q)) * (HIGHEST - lowest) / (2.0 * np.pi)
    alone = max(chance_of(fit, score.remaining), 1e-300)
    chance = float(width * alone * np.sqrt(max(-np.log(alone), 1.0)))
    return min(1.0, chance), best, score


def chance_of(fit: QuickFit, part: float) -> float:
    """Probability that one frequency leaves such a part of squares by chance (F test).

    A configuration counts as one value whatever is measured there: what a model lacks
    is no white noise, it moves all values of a configuration.
    """
    rows = len(fit.problem.layout.row)
    values = fit.dof * len(fit.problem.data) / max(rows, 1)
    return float(min(part, 1.0) ** (0.5 * values))


Waves: TypeAlias = NDArray[np.complex128]
"""Waves at positions, `exp(i f q)`."""


def periodogram(
    q: Floats, motion: Floats, residual: Floats, frequencies: Floats
) -> Floats:
    """Squares of a residual that waves explain, where nothing else is fitted.

    Args:
        q: Positions, shape (M,) [rad].
        motion: Change of the residual by a position, shape (M,).
        residual: The residual, shape (M,).
        frequencies: Evenly spaced frequencies, shape (F,) [rad/rad].

    Returns:
        Squares, shape (F,).
    """
    # All values of a configuration share its waves.
    q, configuration = np.unique(q, return_inverse=True)
    # A frequency is a coarse and a fine part, whose exponentials meet in one product.
    fine = max(int(np.sqrt(len(frequencies))), 1)
    coarse, small = frequencies[::fine], frequencies[:fine] - frequencies[0]
    waves = np.exp(1j * np.outer(coarse, q)), np.exp(1j * np.outer(q, small))

    def sums(weight: Floats, left: Waves, right: Waves) -> tuple[Floats, Floats]:
        """Sums of `weight exp(i f q)` over positions, by the parts of its waves."""
        weighted = left * np.bincount(configuration, weight)
        of_each = (weighted @ right).ravel()[: len(frequencies)]
        return of_each.real, of_each.imag

    c, s = sums(motion * residual, *waves)
    # The square of a wave has twice the frequency.
    double, cs = sums(0.5 * motion**2, *(wave**2 for wave in waves))
    total = float(motion @ motion)
    cc, ss = 0.5 * total + double, 0.5 * total - double
    determinant = np.maximum(cc * ss - cs**2, 1e-12 * total**2)
    return np.asarray((ss * c**2 - 2.0 * cs * c * s + cc * s**2) / determinant)


KINDS = (approach, ripples)
"""Faults that are sought in every fit."""
