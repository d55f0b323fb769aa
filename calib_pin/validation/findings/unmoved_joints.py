"""Joints of which measurements can say nothing."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib_pin.errors import enumerated
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.problem import Problem
from calib_pin.validation.findings.case import Case


def still_joints(problem: Problem) -> tuple[str, ...]:
    """Names of the joints of the chains that no measurement moves."""
    moved = {
        joint
        for part, data, _, _ in problem.blocks
        for joint, span in zip(data.joints, np.ptp(data.q, axis=0), strict=True)
        if span > 0.0
    }
    return tuple(joint for joint in problem.chains.joints if joint not in moved)


def unmoved_joints(case: Case) -> Iterator[Finding]:
    """The joints of a robot with several chains of which nothing can be said."""
    problem = case.fit.problem
    if len(problem.chains.names) == 1:
        return
    chains = problem.chains
    names = [name for name in chains.robot.model.names[1:] if name not in chains.joints]
    names = [*still_joints(problem), *names]
    if names:
        yield Finding(
            "unmoved-joints",
            "info",
            f"{len(names)} joints are moved or seen by no measurement and stay at "
            f"nominal: {enumerated(names)}",
            {"joints": ", ".join(names)},
        )
