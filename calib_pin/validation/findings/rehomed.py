"""Joints whose zero is another one from some measurement on.

A servo that was homed again, a motor that was changed, a belt that jumped a tooth: all
that follows stands a constant angle elsewhere. Every joint and every place in the files
is tried, to first order, all places together by sums from the end. The best one is
fitted with the robot, and must leave less than smooth errors of all joints do.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.problem import EXACT
from calib_pin.estimation.statistics.distributions import f_tail
from calib_pin.observations import Observations
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.hypotheses import FITTED
from calib_pin.validation.findings.joint_motions import refitted
from calib_pin.validation.findings.moves import OPTIONS, divisible, sums_behind
from calib_pin.validation.findings.quick_fit import QuickFit

STEPS = 6
"""Most steps in which the size of a change, and the robot, are found."""

CLEARER = 0.95
"""Part of what smooth errors of joints leave that it leaves at most."""

WAYS, FEW = 5, 1.0 / 3.0
"""Shapes of a smooth error, and the part of the redundant values up to which those of
all joints are tried together."""

SETTLED = 0.1
"""Change of the size, in its standard deviations, after which no more are taken."""


def rehomed(case: Case) -> Iterator[Finding]:
    """The joint whose zero has changed during the measurements, if there is one."""
    data = case.fit.problem.data
    if any(block.start.size for block in data.blocks) or case.fit.rms < EXACT:
        return
    seen = case.fit
    if (data.weight != 1.0).any():  # What was set aside may be all that follows.
        data = data.weighted(np.ones(len(data)))
        problem = replace(case.fit.problem, data=data, units=np.zeros(0))
        seen = QuickFit(problem, case.fit.theta, whole=True)
    found = _likeliest(seen, case)
    if found is None:
        return
    joint, rank = found
    behind = case.rank >= rank
    first = seen
    for _ in range(STEPS if case.fit.problem.data.weight.min() == 0.0 else 0):
        first = refitted(first, data)
    fit, size, row = first, 0.0, seen.problem.layout.row
    for _ in range(STEPS):
        score = fit.score((fit.by_joints[:, joint] * behind[row])[:, None])
        size += float(score.values[0])
        fit = refitted(fit, _shifted(data, joint, behind, size))
        if abs(score.values[0]) < SETTLED * score.deviations[0]:
            break
    if not fit.rms < min(CLEARER * _smoothed(first, case, joint), first.rms):
        return
    name = data.joints[joint]
    turns = dict(zip(case.chains.joints, case.chains.revolute, strict=True))[name]
    shown = f"{np.degrees(abs(size)):.2g} deg" if turns else f"{1e3 * abs(size):.2g} mm"
    place = _place(case, fit, joint, rank, size)
    at = case.data.in_order[place]
    file, line = case.data.files[at], int(case.data.lines[at])
    where = f"line {line} of {file}" if file else f"measurement {place + 1}"
    yield Finding(
        "joint-rehomed",
        "error" if fit.rms < FITTED * first.rms else "warning",
        f"the zero of joint '{name}' changed by {shown} at {where}",
        {
            "joint": name,
            "file": file,
            "line": line,
            "offset": size,
            "rms_before": first.errors,
            "rms_after": fit.errors,
        },
        "measure anew, or calibrate what was measured before and behind apart",
        figure="residuals-over-order",
    )


def _smoothed(fit: QuickFit, case: Case, joint: int) -> float:
    """Errors that smooth errors of joints in time and place leave, as `rms`.

    Of all joints, or of the one that is meant where there are few measurements.
    """
    row, data = fit.problem.layout.row, fit.problem.data
    few = WAYS * data.q.shape[1] > FEW * fit.left
    own = [joint] if few else slice(None)
    q, time = data.q[row][:, own], (case.rank / len(case.data))[row, None]
    shapes = (time, time**2, q, np.sin(q), np.cos(q))
    columns = np.hstack([fit.by_joints[:, own] * shape for shape in shapes])
    left = fit.left - columns.shape[1]
    if left < 1:
        return 0.0
    return fit.rms * float(np.sqrt(fit.score(columns).left * fit.left / left))


def _likeliest(fit: QuickFit, case: Case) -> tuple[int, int] | None:
    """The joint and the rank from which another zero explains most; None for chance."""
    Q, r = fit.unexplained
    row, total = fit.problem.layout.row, float(r @ r)
    order = np.argsort(case.rank[row], kind="stable")
    ranks = case.rank[row][order]
    starts = np.flatnonzero(np.diff(ranks, prepend=-1))
    within = divisible(fit.problem.data.groups()[np.argsort(case.rank)])
    Q, r, every = Q[: len(row)][order], r[: len(row)][order], fit.by_joints[order]
    best = (0.0, 0, 0)
    for joint, x in enumerate(every.T):
        squares = sums_behind(x**2)
        norms = squares - np.sum(sums_behind(x[:, None] * Q) ** 2, axis=1)
        # What the fit can do already leaves rounding.
        told = norms > OPTIONS.seen * squares.max(initial=1e-300)
        gains = sums_behind(x * r) ** 2 / np.where(told, norms, np.inf)
        gains = np.where(within, gains[starts], 0.0)
        k = int(np.argmax(gains))
        best = max(best, (float(gains[k]), joint, int(ranks[starts[k]])))
    left, dof = 1.0 - best[0] / max(total, 1e-300), fit.left - 2
    if dof < 1:
        return None
    F, tried = dof * (1.0 / max(left, 1e-12) - 1.0), every.shape[1] * len(starts)
    return best[1:] if f_tail(F, 1, dof) * tried < OPTIONS.chance else None


def _shifted(
    data: Observations, joint: int, behind: NDArray[np.bool_], size: float
) -> Observations:
    """Measurements whose joint stands elsewhere in some of them, shape (N,)."""
    q = data.q.copy()
    q[behind, joint] += size
    pairs = zip(data.blocks, data.slices, strict=True)
    return Observations(tuple(replace(block, q=q[rows]) for block, rows in pairs))


def _place(case: Case, fit: QuickFit, joint: int, rank: int, size: float) -> int:
    """The place of the first measurement with another zero, in the order of the files.

    It may be one that was not looked at.

    Args:
        case: The case.
        fit: The fit of those that were, with the change.
        joint: The joint.
        rank: The first of these.
        size: The change [rad, m].
    """
    order = case.data.in_order
    before = int(case.rank[case.rank < rank].max(initial=0))
    some = np.sort(order[before : rank + 1])
    data, squares = case.data.rows(some), []
    for behind in (np.zeros(len(some), bool), np.ones(len(some), bool)):
        there = replace(fit.problem, data=_shifted(data, joint, behind, size))
        r = there.residual(fit.theta)[: len(there.layout.row)]
        squares.append(np.bincount(there.layout.row, r**2, len(some)).astype(float))
    # In the order of the files: those before a place have the old zero.
    old, new = (s[np.argsort(np.argsort(order)[some])] for s in squares)
    total = np.cumsum(old) - old + sums_behind(new)
    return before + int(np.argmin(total))
