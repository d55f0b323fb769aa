"""Joints that were read full turns away from where their limits allow them.

A turn changes no placement, and a fit is as good with it. It shows where the position
itself counts: in the limits, in commands that are computed from the calibrated robot.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib_pin.estimation.evidence import Finding
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.hypotheses import setup_lines
from calib_pin.validation.findings.joint_columns import offset_by
from calib_pin.validation.findings.setup_lines import written

ROUNDED = 1e-3
"""By how much limits may be exceeded, which are rounded [rad]."""


def joint_turns(case: Case) -> Iterator[Finding]:
    """Joints all of whose positions are within the limits some turns on."""
    chains, data = case.chains, case.data
    limits = zip(
        chains.joints, chains.lower, chains.upper, chains.revolute, strict=True
    )
    for joint, lower, upper, revolute in limits:
        if not revolute or joint not in data.joints:
            continue
        j = data.joints.index(joint)
        least, most = data.q[:, j].min(), data.q[:, j].max()
        first = np.ceil((lower - ROUNDED - least) / (2.0 * np.pi))
        last = np.floor((upper + ROUNDED - most) / (2.0 * np.pi))
        # The fewest turns that bring all of them between the limits, if any do.
        turns = int(max(first, min(0, last)))
        if not first <= turns <= last or turns == 0:
            continue
        lines = setup_lines(case, (offset_by(data.joints, j, 2.0 * np.pi * turns),))
        way = "on" if turns > 0 else "back"
        way = f"a turn {way}" if abs(turns) == 1 else f"{abs(turns)} turns {way}"
        yield Finding(
            "joint-turns",
            "info",
            f"joint '{joint}' was read at up to {np.degrees(max(most, -least)):.0f} "
            f"deg, beyond its limits; {way} all of its positions are within them",
            {"joint": joint, "turns": float(turns)},
            f"state in the setup file: {written(lines)}",
            lines,
        )
