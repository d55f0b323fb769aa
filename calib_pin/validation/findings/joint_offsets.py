"""A joint whose zero is elsewhere than in the URDF, by any angle.

A fit of placements finds it as well, spread over the origins around. That one offset of
the nominal robot explains nearly all shows where it is: a mastering mark that was
missed, a zero that was set anew.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.directions import column_space
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.base import expected_size
from calib_pin.validation.findings.case import DOUBTFUL, Case
from calib_pin.validation.findings.explanations import DECISIVE
from calib_pin.validation.findings.hypotheses import Explanation, read_so
from calib_pin.validation.findings.joint_columns import offset_by
from calib_pin.validation.findings.quick_fit import QuickFit

LARGE = 10.0
"""Errors of the nominal robot, in expected sizes, from which an offset is sought."""

LEAST = 3.0
"""Least offset that is told [deg]; robots have up to half of it."""

ROUND = (45.0, 15.0, 10.0, 5.0, 1.0)
"""Round angles [deg]."""

NEARBY = 0.6
"""Largest distance from one of them [deg], three times a usual error of a robot."""

ROWS = 200
"""Measurements that are looked at."""

STEPS = 8
"""Steps in which an offset is found: from 60 deg off it takes seven."""


def joint_offset(case: Case) -> Explanation | None:
    """The joint whose offset the nominal robot lacks; None where none is decisive."""
    data = case.fit.problem.data.sample(ROWS)
    problem = replace(case.fit.problem, data=data, expected=None)
    first = fit = QuickFit(problem, case.nominal)
    quantity = problem.layout.quantities[0]
    before = fit.errors
    if not before > LARGE * expected_size(quantity.unit):
        return None
    joint, degrees = _likeliest(fit), 0.0
    for _ in range(STEPS):
        theta, change = _step(fit, [joint])
        degrees += float(np.degrees(change[0]))
        fit = _read(problem, theta, joint, degrees)
    degrees = _rounded(degrees)
    fit = _read(problem, fit.theta, joint, degrees)
    fit = replace(fit, theta=_step(fit, [])[0])
    after = fit.errors
    if not after < DECISIVE * before or abs(degrees) < LEAST:
        return None
    # A fit of this very offset has said it already, and more exactly.
    name = f"{data.joints[joint]}.joint-offset.q"
    estimated = any(p.free and p.name == name for p in problem.parameters)
    if case.fitted is not None and estimated and case.fit.errors <= after:
        return None
    return Explanation(
        (offset_by(data.joints, joint, degrees),),
        before,
        after,
        len(first.linear[0]) * float(np.log(before / after)),
        len(data.joints),
        fitted=False,
        harmless=case.fitted is not None and case.errors_left <= DOUBTFUL,
    )


def offset_within(
    case: Case, x: Floats, size: Callable[[Floats], float]
) -> tuple[float, int, float]:
    """The joint offset without which some errors of the robot are the smallest.

    What an offset turns, origins around it share, so that each looks smaller.

    Args:
        case: The case.
        x: Errors of the fit in their scales, shape (P,).
        size: The size of such errors.

    Returns:
        The size without it, the joint, and the offset [rad, m].
    """
    fit, parameters = case.fit, case.fit.problem.parameters
    free, robot = parameters.free, parameters.free & ~parameters.nuisance
    moves = fit.by_joints + fit.by_starts
    found = []
    spread = np.linalg.lstsq(fit.linear[1][:, free], moves, rcond=1e-9)[0]
    for joint, column in enumerate(spread.T):
        along = np.zeros(len(parameters))
        along[free] = column
        along[~robot] = 0.0
        offset = float(along @ x) / max(float(along @ along), 1e-300)
        found.append((size(x - offset * along), joint, offset))
    return min(found)


def _read(problem: Problem, theta: Floats, joint: int, degrees: float) -> QuickFit:
    """Measurements read with an offset of a joint."""
    fault = offset_by(problem.data.joints, joint, degrees)
    return QuickFit(replace(problem, data=read_so(problem.data, (fault,))), theta)


def _frames(fit: QuickFit) -> NDArray[np.bool_]:
    """Parameters that place the nominal robot, shape (P,)."""
    parameters = fit.problem.parameters
    return np.asarray(parameters.free & parameters.nuisance)


def _likeliest(fit: QuickFit) -> int:
    """The joint whose offset explains most, to first order."""
    r, J = fit.linear
    Q, X = column_space(J[:, _frames(fit)]), fit.by_joints + fit.by_starts
    seen = X - Q @ (Q.T @ X)
    norms, squares = np.sum(seen**2, axis=0), np.sum(X**2, axis=0)
    norms[norms <= 1e-6 * squares] = np.inf
    return int(np.argmax((seen.T @ r) ** 2 / norms))


def _step(fit: QuickFit, joints: list[int]) -> tuple[Floats, Floats]:
    """Parameter values with better frames, and the step of some joints [rad]."""
    frames, (r, J) = _frames(fit), fit.linear
    X = (fit.by_joints + fit.by_starts)[:, joints] if joints else np.zeros((len(r), 0))
    A = np.column_stack([J[:, frames], X])
    if not (np.isfinite(A).all() and np.isfinite(r).all()):
        raise np.linalg.LinAlgError  # A point lies behind the camera, say.
    step, theta = -np.linalg.lstsq(A, r, rcond=1e-10)[0], fit.theta.copy()
    count = int(frames.sum())
    theta[frames] += fit.problem.parameters.scales[frames] * step[:count]
    return theta, np.asarray(step[count:], float)


def _rounded(degrees: float) -> float:
    """The roundest angle nearby, for zeros are set on purpose [deg].

    The rest is an error of the robot, which nothing else tells from it.
    """
    for step in ROUND:
        if abs(degrees - step * round(degrees / step)) < NEARBY:
            return float(step * round(degrees / step))
    return degrees
