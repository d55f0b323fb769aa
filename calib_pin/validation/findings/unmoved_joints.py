"""Joints of which measurements can say nothing."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib_pin.errors import enumerated
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.problem import Problem
from calib_pin.validation.findings.case import Case

MORE = (
    "measure configurations that differ more: calib-pin plan ROBOT --add 10 --to FILE"
)
"""The advice about configurations that are too much alike."""


def still_joints(problem: Problem) -> tuple[str, ...]:
    """Names of the joints of the chains that no measurement moves."""
    moved = {
        joint
        for term, data, _, _ in problem.blocks
        for joint, span in zip(data.joints, np.ptp(data.q, axis=0), strict=True)
        if span > 0.0
    }
    mimics = problem.chains.mimics
    # One that others follow moves with them, be it in a chain or not.
    moved |= {mimics[joint].leader for joint in moved & mimics.keys()}
    return tuple(joint for joint in problem.chains.joints if joint not in moved)


def unmoved_joints(case: Case) -> Iterator[Finding]:
    """The joints of which nothing can be said; of a single chain this is a fault."""
    if case.fitted is None:
        return  # Nobody asks measurements for errors that are not fitted.
    problem = case.fit.problem
    chains, names = problem.chains, [*still_joints(problem)]
    single = len(chains.names) == 1
    if not single:
        there = chains.robot.model.names[1:]
        names += [name for name in there if name not in chains.joints]
    names = [name for name in names if name not in chains.robot.mimics]
    if not names:
        return
    joints = "joint is" if len(names) == 1 else "joints are"
    yield Finding(
        "unmoved-joints",
        "warning" if single else "info",
        f"{len(names)} {joints} moved or seen by no measurement, and errors that only "
        f"their motion shows stay at nominal: {enumerated(names)}",
        {"joints": ", ".join(names)},
        MORE if single else "",
        figure="residuals-by-joint" if single else "",
    )
