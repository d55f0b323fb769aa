"""Ripples of joints: errors that come back many times per turn, as gears make them.

Residuals are projected on the motion of each joint j and searched for the frequency f
at which `a sin(f q_j) + b cos(f q_j)` explains most of them: a periodogram over
unevenly spaced positions (Lomb 1976, Scargle 1982). How often chance comes as high at
any of the frequencies is bounded by Baluev (2008): with the probability p at a single
one, W p sqrt(-ln p), W being the width of the band by the resolution.
"""

from __future__ import annotations

from collections.abc import Iterator
from typing import Any

import numpy as np

from calib_pin.estimation.evidence import Finding
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.transmission import MotorRipple, Transmission
from calib_pin.validation.findings.case import CHANCE, Case
from calib_pin.validation.findings.quick_fit import QuickFit, Score
from calib_pin.validation.findings.sentences import shown, told
from calib_pin.validation.findings.setup_lines import written

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


def ripples(case: Case) -> Iterator[Finding]:
    """Joints with a ripple that no parameter describes, and gears that make such."""
    if not case.informed:
        return
    joints = [name for name in case.data.joints if case.unit(name) == "rad"]
    fit, words, ratios, left = case.fit, list[str](), dict[str, float](), 1.0
    numbers: dict[str, Any] = {}
    # Eccentric and elliptic wheels are no ripple.
    low = [_waves(*_motion(fit, joint), k) for joint in joints for k in (1.0, 2.0)]
    if low and np.isfinite(low).all():
        fit = fit.explaining(np.hstack(low))
    while len(ratios) < len(joints):
        # One after the other: a large one leaks into the other joints.
        rest = [joint for joint in joints if joint not in ratios]
        found = {joint: one for joint in rest if (one := _ripple(fit, joint))}
        joint = min(found, key=lambda joint: found[joint][0], default="")
        if not joint or found[joint][0] * len(joints) > CHANCE:
            break
        chance, frequency, score = found[joint]
        q, motion = _motion(fit, joint)
        fit = fit.explaining(_waves(q, motion, frequency))
        # The wave generator of a strain-wave gear comes twice per turn of its motor,
        # which has an error of its own: half the frequency where that is seen as well.
        half = 0.5 * frequency
        seen = _chance(fit, fit.score(_waves(q, motion, half)).left) < CHANCE
        ratios[joint] = float(f"{half if seen else frequency:.4g}")
        size, left = float(np.linalg.norm(score.values)), left * score.left
        words += [f"'{joint}' {frequency:.4g} times per turn by {shown(size, 'rad')}"]
        first = {"frequency": frequency, "amplitude": size, "chance": chance}
        numbers = numbers or {"joint": joint, **first}
    if not words:
        return
    names = case.setup.parameters
    if not {Transmission.name, MotorRipple.name}.intersection(names):
        names = (*names, MotorRipple.name)
    every = {**case.setup.gear_ratios, **ratios}
    lines = {"parameters": [*names], "gear_ratios": every}
    remedy = "look up the gear ratios (a strain-wave gear ripples twice per turn of "
    remedy += f"its motor) and estimate the waves: {written(lines)}"
    said = f"joints ripple as gears do: {', '.join(words)}"
    yield told("gear-ripple", said, {**numbers, "left": left}, remedy, lines, info=True)


def _motion(fit: QuickFit, joint: str) -> tuple[Floats, Floats]:
    """Position of a joint at every residual, and how that changes it, shape (M,)."""
    column = fit.problem.data.joints.index(joint)
    row = fit.problem.layout.row
    return fit.problem.data.q[row, column], fit.by_joints[:, column]


def _waves(q: Floats, motion: Floats, frequency: float) -> Floats:
    """Sine and cosine of a frequency along the motion of a joint, shape (M, 2)."""
    angle = frequency * q
    return np.asarray(motion[:, None] * np.stack([np.sin(angle), np.cos(angle)], 1))


def _ripple(fit: QuickFit, joint: str) -> tuple[float, float, Score] | None:
    """The wave of a joint that explains most; None where it hardly moves.

    A bound of the probability that any frequency of the joint comes as high by chance,
    waves per turn, and the gain of sine and cosine.
    """
    q, motion = _motion(fit, joint)
    span = float(np.ptp(q)) if len(q) else 0.0
    lowest = max(LOWEST, 2.0 * np.pi * WAVES / max(span, 1e-300))
    usable = np.isfinite(motion).all() and motion.any() and fit.left > 2
    if lowest >= HIGHEST or not usable:
        return None
    step = 2.0 * np.pi / (FINER * span)
    frequencies = np.arange(lowest, HIGHEST, step)
    rest = fit.unexplained[1][: len(q)]
    peaks = np.argsort(-periodogram(q, motion, rest, frequencies), kind="stable")
    around = [frequencies[k] + step * AROUND for k in peaks[:PEAKS]]
    tried = [f[np.argmax(periodogram(q, motion, rest, f))].item() for f in around]
    scores = {f: fit.score(_waves(q, motion, f)) for f in tried}
    best = min(tried, key=lambda f: scores[f].left)
    score, whole = scores[best], float(round(best))
    even = fit.score(_waves(q, motion, whole))
    if _chance(fit, score.left / max(even.left, 1e-300)) > EVEN:
        best, score = whole, even
    # Effective length of the motion and width of the band, in waves.
    width = np.sqrt(4.0 * np.pi * np.var(q)) * (HIGHEST - lowest) / (2.0 * np.pi)
    alone = max(_chance(fit, score.left), 1e-300)
    chance = float(width * alone * np.sqrt(max(-np.log(alone), 1.0)))
    return min(1.0, chance), best, score


def _chance(fit: QuickFit, left: float) -> float:
    """Probability that one frequency leaves such a part of squares by chance (F test).

    A configuration counts as one value whatever is measured there: what a model lacks
    is no white noise, it moves all values of a configuration.
    """
    rows = len(fit.problem.layout.row)
    return float(left ** (0.5 * fit.left * len(fit.problem.data) / max(rows, 1)))


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
    # A frequency is a coarse and a fine part, whose exponentials meet in one product.
    fine = max(int(np.sqrt(len(frequencies))), 1)
    coarse, small = frequencies[::fine], frequencies[:fine] - frequencies[0]

    def sums(weight: Floats, times: float) -> tuple[Floats, Floats]:
        """Sums of `weight exp(i f q)` over positions, at some times the frequencies."""
        left = np.exp(1j * times * np.outer(coarse, q)) * weight
        of_each = (left @ np.exp(1j * times * np.outer(q, small))).ravel()
        return of_each.real[: len(frequencies)], of_each.imag[: len(frequencies)]

    c, s = sums(motion * residual, 1.0)
    double, cs = sums(0.5 * motion**2, 2.0)
    total = float(motion @ motion)
    cc, ss = 0.5 * total + double, 0.5 * total - double
    determinant = np.maximum(cc * ss - cs**2, 1e-12 * total**2)
    return np.asarray((ss * c**2 - 2.0 * cs * c * s + cc * s**2) / determinant)
