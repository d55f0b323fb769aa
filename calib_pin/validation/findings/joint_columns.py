"""Joint columns that mean something else: reversed, offset, exchanged, in degrees."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from itertools import combinations

import numpy as np

from calib_pin.setup import ConvertedSetup, ReadingSetup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.hypotheses import Hypothesis
from calib_pin.validation.findings.robot import turned_by_base
from calib_pin.validation.findings.setup_lines import JointReading

TURNS = (90.0, -90.0, 180.0)
"""Offsets between the zeros of a controller and of a URDF [deg]."""

GEARS = (2.0, 0.5)
"""Gears of which the motion of a joint is often told before or behind."""


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
            joint=joint,
            joints=JointReading(factors, plain.offsets),
        )
    for j in turning:
        if joints[j] == turned_by_base(case):
            continue  # The frame of the base, which is another explanation, tells it.
        for turn in TURNS:
            yield offset_by(joints, j, np.radians(turn).item())
    for order in _orders(len(joints)):
        moved = [f"'{joints[k]}'" for k, other in enumerate(order) if k != other]
        named = f"{', '.join(moved[:-1])} and {moved[-1]}"
        yield Hypothesis(
            "joints-exchanged",
            f"the columns of joints {named} are exchanged",
            "order of the joint columns",
            joints=JointReading(plain.factors[list(order)], plain.offsets),
        )
    # Smaller angles would be next to none in degrees, and any wrong joint looks better
    # where it stands still.
    large = [j for j in turning if np.abs(case.data.q[:, j]).max() > 2.0 * np.pi]
    for some in dict.fromkeys([*((j,) for j in large), tuple(large)]):
        names = tuple(joints[j] for j in some)
        if names:
            yield Hypothesis(
                "joint-degrees",
                f"joint '{names[0]}' is in degrees"
                if len(names) == 1
                else f"joints '{names[0]}' to '{names[-1]}' are in degrees",
                "unit of the joints",
                reading=ReadingSetup(
                    converted=(ConvertedSetup(np.radians(1.0).item(), joints=names),)
                ),
            )
    for j in range(len(joints)):
        yield from (geared(joints, j, factor) for factor in GEARS)
    # Robots couple a joint to those before it.
    for other, j in combinations(turning, 2):
        for factor in (1.0, -1.0):
            factors = plain.factors.copy()
            factors[j, other] = factor
            yield Hypothesis(
                "joint-coupled",
                f"joint '{joints[j]}' is coupled to '{joints[other]}'",
                f"coupling of {joints[j]}",
                joint=joints[j],
                joints=JointReading(factors, plain.offsets),
            )


def offset_by(
    joints: Sequence[str], joint: int, offset: float, turns: bool = True
) -> Hypothesis:
    """A joint whose zero is elsewhere, by its position among all [rad, m]."""
    plain = JointReading.plain(len(joints))
    plain.offsets[joint] = offset
    shown = f"{np.degrees(offset):.4g} deg" if turns else f"{1e3 * offset:.4g} mm"
    return Hypothesis(
        "joint-offset",
        f"joint '{joints[joint]}' is offset by {shown}",
        f"zero of {joints[joint]}",
        joints=plain,
        joint=joints[joint],
    )


def geared(joints: Sequence[str], joint: int, factor: float) -> Hypothesis:
    """A joint that moves some times as far as its column says."""
    reading = JointReading.plain(len(joints))
    reading.factors[joint, joint] = factor
    return Hypothesis(
        "joint-gear",
        f"joint '{joints[joint]}' moves {factor:.5g} times as far as read",
        f"gear of {joints[joint]}",
        joints=reading,
        figure="residuals-by-joint",
    )


def _orders(count: int) -> Iterator[tuple[int, ...]]:
    """Other orders of so many columns: two exchanged, three shifted round."""
    plain = tuple(range(count))
    for first, second in combinations(plain, 2):
        order = list(plain)
        order[first], order[second] = second, first
        yield tuple(order)
    for k in plain[:-2]:
        a, b, c = plain[k : k + 3]
        yield (*plain[:k], b, c, a, *plain[k + 3 :])
        yield (*plain[:k], c, a, b, *plain[k + 3 :])
    if count > 3:
        yield plain[::-1]
