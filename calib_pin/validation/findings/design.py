"""Configurations that are too much alike to tell the errors of a whole workspace."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib_pin.estimation.evidence import Finding
from calib_pin.kinematics.spatial import Floats
from calib_pin.units import DISPLAY
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.unmoved_joints import MORE

NARROW, SMALL, WIDE = 0.1, 0.25, 0.4
"""Parts of the range of a joint below which there is a warning, and a remark, and a
warning where far more errors are expected elsewhere."""

ELSEWHERE = 3.0
"""Expected errors over the workspace, by those where it was measured, from which the
configurations are too much alike.

Random ones have 1.0 to 1.6, those of narrow ranges and paths that cost more than twice
the noise 3.5 and more.
"""

SMOOTH = 0.05
"""Squared steps between neighbors of a path, by those between any two configurations.

Random ones have 1.
"""

FEWEST = 10
"""Fewest configurations that can be too much alike."""

CHANCE = 0.01
"""Probability, for one of the joints, below which a small range is not that of a few
configurations anywhere."""

RANGE = 2.0 * np.pi
"""Range of a revolute joint that counts; turns beyond it show the same again [rad]."""

ALONE = 0.03
"""Motion along a direction, by that along the largest, that counts as independent.

Each joint counts by its own spread.
"""

FEW = 2
"""Independent directions that do not tell the errors of a robot.

Three of six joints that repeat the others have told them to 0.06 mm.
"""

NAMED = 3
"""Joints that a finding names."""


def design(case: Case) -> Iterator[Finding]:
    """Joints that are hardly moved, and joints that only move together."""
    if case.fitted is None or not len(case.data):
        return
    chains, q = case.chains, case.data.q
    span = np.ptp(q, axis=0)
    room = chains.upper - chains.lower
    room = np.where(chains.revolute, np.minimum(room, RANGE), room)
    free = np.array([joint not in chains.mimics for joint in chains.joints])
    moved = free & (span > 0.0)
    part = np.divide(span, room, out=np.ones(len(span)), where=room > 0.0)
    count = case.data.configurations
    # Of fewer configurations more is wrong than where they are.
    elsewhere = _elsewhere(case) if count >= FEWEST else ""
    if elsewhere and _smooth(q[case.data.in_order][:, moved]):
        yield Finding(
            "one-path",
            "warning",
            f"all configurations lie on one path, and {elsewhere}",
            {},
            MORE,
            figure="residuals-by-joint",
        )
        elsewhere = ""
    limit = WIDE if elsewhere else SMALL
    within = np.minimum(part, 1.0)
    by_chance = moved.sum() * (count - (count - 1) * within) * within ** (count - 1)
    few = np.flatnonzero(moved & (part < limit) & (by_chance < CHANCE))
    if len(few):
        worst = few[np.argsort(part[few])]
        told = []
        for j in worst[:NAMED].tolist():
            unit, factor = DISPLAY["rad" if chains.revolute[j] else "m"]
            low, high = (factor * end for end in (q[:, j].min(), q[:, j].max()))
            told.append(f"{chains.joints[j]} from {low:.3g} to {high:.3g} {unit}")
        more = f" and {len(few) - NAMED} more" if len(few) > NAMED else ""
        narrow = elsewhere or part[worst[0]] < NARROW
        yield Finding(
            "small-range",
            "warning" if narrow else "info",
            f"the measurements move {', '.join(told)}{more}, less than "
            f"{100 * limit:.0f} % of the range; "
            f"{elsewhere or 'elsewhere the accuracy is uncertain'}",
            {chains.joints[j]: float(part[j]) for j in worst.tolist()},
            MORE,
            figure="residuals-by-joint",
        )
    if moved.sum() < 2 or len(q) <= moved.sum():
        return
    scaled = (q - q.mean(axis=0))[:, moved] / q[:, moved].std(axis=0)
    s = np.linalg.svd(scaled, compute_uv=False)
    directions = int((s > ALONE * s[0]).sum())
    # So many configurations move in one direction less at most.
    if directions < min(moved.sum(), count - 1):
        yield Finding(
            "joints-move-together",
            "warning" if directions <= FEW else "info",
            f"the {moved.sum()} joints that move do so in only {directions} "
            f"independent direction{'s' if directions > 1 else ''}; errors that cancel "
            "along them show elsewhere",
            {"directions": float(directions), "joints": float(moved.sum())},
            MORE,
            figure="residuals-by-joint",
        )


def _elsewhere(case: Case) -> str:
    """Expected errors elsewhere in words, if they are far above those of the design."""
    worst, said = ELSEWHERE, ""
    for accuracy in case.accuracies.values():
        if accuracy.measured is None or accuracy.workspace is None:
            continue
        there = accuracy.workspace.calibrated.position
        times = there / max(accuracy.measured.calibrated.position, 1e-300)
        if times > worst:
            worst, (unit, factor) = times, DISPLAY["m"]
            said = (
                f"over the workspace errors of {factor * there:.2g} {unit} are "
                f"expected, {times:.2g} times those where it was measured"
            )
    return said


def _smooth(q: Floats) -> bool:
    """Whether configurations, repeated or not, follow one another closely."""
    changed = np.any(np.diff(q, axis=0) != 0.0, axis=1)
    q = q[np.append(True, changed)]
    steps = np.mean(np.diff(q, axis=0) ** 2, axis=0)
    return float(np.mean(steps / (2.0 * q.var(axis=0)))) < SMOOTH
