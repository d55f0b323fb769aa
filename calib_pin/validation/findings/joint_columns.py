"""Joint columns that mean something else: reversed, offset, coupled, exchanged."""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.hypotheses import Hypothesis
from calib_pin.validation.findings.setup_lines import JointReading

TURNS = (90.0, -90.0, 180.0)
"""Offsets between the zeros of a controller and of a URDF [deg]."""


def joint_columns(case: Case) -> Iterator[Hypothesis]:
    """Explanations by joint columns, the likeliest kinds first."""
    joints = case.data.joints
    revolute = dict(zip(case.chains.joints, case.chains.revolute, strict=True))
    turning = [j for j, joint in enumerate(joints) if revolute.get(joint, True)]
    plain = JointReading.plain(len(joints))
    for j, joint in enumerate(joints):
        factors = plain.factors.copy()
        factors[j, j] = -1.0
        yield Hypothesis(
            "joint-reversed",
            f"joint '{joint}' is reversed",
            f"sign of {joint}",
            joints=JointReading(factors, plain.offsets),
        )
    for j in turning:
        for turn in TURNS:
            offsets = plain.offsets.copy()
            offsets[j] = np.radians(turn)
            yield Hypothesis(
                "joint-offset",
                f"joint '{joints[j]}' is offset by {turn:g} deg",
                f"zero of {joints[j]}",
                joints=JointReading(plain.factors, offsets),
            )
    for first, second in combinations(range(len(joints)), 2):
        order = np.arange(len(joints))
        order[[first, second]] = second, first
        yield Hypothesis(
            "joints-exchanged",
            f"the columns of joints '{joints[first]}' and '{joints[second]}' are "
            "exchanged",
            "order of the joint columns",
            joints=JointReading(plain.factors[order], plain.offsets),
        )
    # Robots couple a joint to those before it.
    for other, j in combinations(turning, 2):
        for factor in (1.0, -1.0):
            factors = plain.factors.copy()
            factors[j, other] = factor
            yield Hypothesis(
                "joint-coupled",
                f"joint '{joints[j]}' is coupled to '{joints[other]}'",
                f"coupling of {joints[j]}",
                joints=JointReading(factors, plain.offsets),
            )
