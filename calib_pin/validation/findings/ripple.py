"""Ripples of joints: errors that come back many times per turn, as gears make them.

Residuals are projected on the motion of each joint j and searched for the frequency f
at which `a sin(f q_j) + b cos(f q_j)` explains most of them: a periodogram over
unevenly spaced positions (Lomb 1976, Scargle 1982). How often chance comes as high at
any of the frequencies is bounded by Baluev (2008): with the probability p at a single
one, W p sqrt(-ln p), W being the width of the band by the resolution.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from calib_pin.estimation.evidence import Finding
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.transmission import MotorRipple, Transmission
from calib_pin.units import DISPLAY
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.quick_fit import QuickFit, Score
from calib_pin.validation.findings.setup_lines import written

CHANCE = 1e-3
"""Probability by chance, over all frequencies and joints, below which it is told."""

LOWEST, HIGHEST = 4.0, 400.0
"""Frequencies that are sought, in waves per turn: below are eccentric wheels and what
no parameter describes; a strain-wave gear of 200 has its wave generator above."""

WAVES = 3.0
"""Least number of waves over the motion of a joint."""

FINER = 4
"""Frequencies within the resolution of the motion."""

AROUND = np.linspace(-1.0, 1.0, 65)
"""Where better frequencies are sought around one, in steps."""

PEAKS = 3
"""Peaks of the rough periodogram of a joint that are looked at closely."""

EVEN = 2.0
"""Loss of log-likelihood for which a whole number is taken for a frequency."""


@dataclass(frozen=True)
class Ripple:
    """A wave of a joint.

    Attributes:
        joint: Name of the joint.
        frequency: Waves per turn of the joint.
        amplitude: Its amplitude [rad].
        left: Part of the sum of squares that it leaves.
        chance: Bound of the probability that any frequency of the joint comes as high
            by chance.
        columns: Change of the whitened residual by its sine and cosine, shape (M, 2).
    """

    joint: str
    frequency: float
    amplitude: float
    left: float
    chance: float
    columns: Floats


def ripples(case: Case) -> Iterator[Finding]:
    """Joints with a ripple that no parameter describes, and gears that make such."""
    if not case.informed:
        return
    turning = dict(zip(case.chains.joints, case.chains.revolute, strict=True))
    joints = [name for name in case.data.joints if turning.get(name, False)]
    fit = _without_low_waves(case.fit, joints)
    found, ratios = list[Ripple](), dict[str, float]()
    while len(found) < len(joints):
        # One after the other: a large one leaks into the other joints.
        left = [joint for joint in joints if joint not in ratios]
        tried = [one for joint in left if (one := ripple_of(fit, joint)) is not None]
        best = min(tried, key=lambda one: one.chance, default=None)
        if best is None or best.chance * len(joints) > CHANCE:
            break
        fit = fit.explaining(best.columns)
        ratios[best.joint] = _ratio(fit, best)
        found.append(best)
    if not found:
        return
    unit, factor = DISPLAY["rad"]
    waves = [
        f"'{one.joint}' {one.frequency:.4g} times per turn by "
        f"{factor * one.amplitude:.2g} {unit}"
        for one in found
    ]
    names = case.setup.parameters
    if not {Transmission.name, MotorRipple.name}.intersection(names):
        names = (*names, MotorRipple.name)
    lines = {
        "parameters": list(names),
        "gear_ratios": {**case.setup.gear_ratios, **ratios},
    }
    yield Finding(
        "gear-ripple",
        "info",
        f"joints ripple as gears do: {', '.join(waves)}",
        {
            "joint": found[0].joint,
            "frequency": found[0].frequency,
            "amplitude": found[0].amplitude,
            "chance": found[0].chance,
            "left": float(np.prod([one.left for one in found])),
        },
        "look up the gear ratios (a strain-wave gear ripples twice per turn of its "
        f"motor) and estimate the waves: {written(lines)}",
        lines,
    )


def ripple_of(fit: QuickFit, joint: str) -> Ripple | None:
    """The ripple of a joint that explains most; None where it hardly moves.

    Args:
        fit: The fit.
        joint: Name of the joint.
    """
    data, layout = fit.problem.data, fit.problem.layout
    column = data.joints.index(joint)
    q, motion = data.q[layout.row, column], fit.by_joints[:, column]
    span = float(np.ptp(q)) if len(q) else 0.0
    lowest = max(LOWEST, 2.0 * np.pi * WAVES / max(span, 1e-300))
    usable = np.isfinite(motion).all() and motion.any() and fit.left > 2
    if lowest >= HIGHEST or not usable:
        return None
    step = 2.0 * np.pi / (FINER * span)
    frequencies = np.arange(lowest, HIGHEST, step)
    rest = fit.unexplained[1][: len(q)]
    gains = periodogram(q, motion, rest, frequencies)
    scores: dict[float, Score] = {}

    def left(frequency: float) -> float:
        if frequency not in scores:
            scores[frequency] = fit.score(_waves(q, motion, frequency))
        return scores[frequency].left

    peaks = []
    for k in np.argsort(-gains, kind="stable")[:PEAKS]:
        near = frequencies[k] + step * AROUND
        peaks.append(float(near[np.argmax(periodogram(q, motion, rest, near))]))
    best = min(peaks, key=left)
    whole = float(round(best))
    gained = np.log(left(whole) / max(left(best), 1e-300))
    best = whole if 0.5 * _dof(fit) * gained < EVEN else best
    score = scores[best]
    # Effective length of the motion and width of the band, in waves.
    width = np.sqrt(4.0 * np.pi * np.var(q)) * (HIGHEST - lowest) / (2.0 * np.pi)
    alone = max(_chance(fit, score), 1e-300)
    chance = min(1.0, width * alone * np.sqrt(max(-np.log(alone), 1.0)))
    return Ripple(
        joint=joint,
        frequency=best,
        amplitude=float(np.linalg.norm(score.values)),
        left=score.left,
        chance=float(chance),
        columns=_waves(q, motion, best),
    )


def _without_low_waves(fit: QuickFit, joints: Sequence[str]) -> QuickFit:
    """The fit as if eccentric and elliptic wheels of joints were in it."""
    data, layout = fit.problem.data, fit.problem.layout
    columns = [np.zeros((len(layout.row), 0))]
    for joint in joints:
        column = data.joints.index(joint)
        q, motion = data.q[layout.row, column], fit.by_joints[:, column]
        columns += [_waves(q, motion, k) for k in (1.0, 2.0)]
    low = np.hstack(columns)
    return fit.explaining(low) if np.isfinite(low).all() else fit


def _ratio(fit: QuickFit, found: Ripple) -> float:
    """Gear ratio that suggests itself, half the frequency where that is seen as well.

    The wave generator of a strain-wave gear comes twice per turn of its motor, which
    has an error of its own.

    Args:
        fit: The fit with the ripple taken out.
        found: The ripple.
    """
    data, layout = fit.problem.data, fit.problem.layout
    column, half = data.joints.index(found.joint), 0.5 * found.frequency
    q, motion = data.q[layout.row, column], fit.by_joints[:, column]
    seen = _chance(fit, fit.score(_waves(q, motion, half))) < CHANCE
    return float(f"{half if seen else found.frequency:.4g}")


def _dof(fit: QuickFit) -> float:
    """Values that are left, a configuration counted as one whatever is measured there.

    What a model lacks is no white noise: it moves all values of a configuration.
    """
    rows = len(fit.problem.layout.row)
    return fit.left * len(fit.problem.data) / max(rows, 1)


def _chance(fit: QuickFit, score: Score) -> float:
    """Probability that one frequency explains so much by chance (F test)."""
    return float(score.left ** (0.5 * _dof(fit)))


def _waves(q: Floats, motion: Floats, frequency: float) -> Floats:
    """Sine and cosine of a frequency along the motion of a joint, shape (M, 2)."""
    angle = frequency * q
    return np.asarray(motion[:, None] * np.stack([np.sin(angle), np.cos(angle)], 1))


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
    projected = _sums(motion * residual, q, frequencies)
    double = _sums(motion**2, q, 2.0 * frequencies)
    total = float(motion @ motion)
    cc, ss = 0.5 * (total + double.real), 0.5 * (total - double.real)
    cs, c, s = 0.5 * double.imag, projected.real, projected.imag
    determinant = np.maximum(cc * ss - cs**2, 1e-12 * total**2)
    return np.asarray((ss * c**2 - 2.0 * cs * c * s + cc * s**2) / determinant)


def _sums(
    weight: Floats, q: Floats, frequencies: Floats
) -> np.ndarray[tuple[int], np.dtype[np.complex128]]:
    """Sums of `weight exp(i f q)`, shape (F,), of evenly spaced f.

    A frequency is a coarse and a fine part, whose exponentials meet in one product of
    matrices.
    """
    fine = max(int(np.sqrt(len(frequencies))), 1)
    coarse = frequencies[::fine]
    small = frequencies[:fine] - frequencies[0]
    left = np.exp(1j * np.outer(coarse, q)) * weight
    sums = left @ np.exp(1j * np.outer(q, small))
    return np.asarray(sums.reshape(-1)[: len(frequencies)])
