"""A joint whose zero is elsewhere than in the URDF, by any angle.

A fit of placements finds it as well, spread over the origins around. That one offset of
the nominal robot explains nearly all shows where it is: a mastering mark that was
missed, a zero that was set anew.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from calib_pin.estimation.directions import column_space
from calib_pin.parameterizations.base import expected_size
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.explanations import DECISIVE, Explanation
from calib_pin.validation.findings.hypotheses import read_so
from calib_pin.validation.findings.joint_columns import offset_by
from calib_pin.validation.findings.quick_fit import QuickFit

LARGE = 10.0
"""Errors of the nominal robot, in expected sizes, from which an offset is sought."""

LEAST = np.radians(3.0)
"""Least offset that is told [rad]; robots have up to half of it."""

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
    parameters = problem.parameters
    frames = parameters.free & parameters.nuisance
    joint, angle, fault = -1, 0.0, None
    for _ in range(STEPS):
        r, J = fit.linear
        Q, X = column_space(J[:, frames]), fit.by_joints + fit.by_starts
        seen = X - Q @ (Q.T @ X)
        norms = np.sum(seen**2, axis=0)
        if fault is None:
            told = norms > 1e-6 * np.sum(X**2, axis=0)
            gains = (seen.T @ r) ** 2 / np.where(told, norms, np.inf)
            joint = int(np.argmax(gains))
        angle -= float(seen[:, joint] @ r / max(norms[joint], 1e-300))
        A = np.column_stack([J[:, frames], X[:, joint]])
        theta = fit.theta.copy()
        step = np.linalg.lstsq(A, r, rcond=1e-10)[0][:-1]
        theta[frames] -= parameters.scales[frames] * step
        fault = offset_by(data.joints, joint, float(np.degrees(angle)))
        fit = QuickFit(replace(problem, data=read_so(data, (fault,))), theta)
    after = fit.errors
    if fault is None or not after < DECISIVE * before or abs(angle) < LEAST:
        return None
    ratio = len(first.linear[0]) * float(np.log(before / after))
    return Explanation(
        (fault,),
        before,
        after,
        ratio,
        len(data.joints),
        fitted=False,
        harmless=not case.doubtful,
    )
