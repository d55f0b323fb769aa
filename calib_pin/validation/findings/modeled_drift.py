"""The size of modeled changes in the course of time: no fault, but worth knowing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calib_pin.estimation.evidence import Finding
from calib_pin.parameterizations.base import COMPONENTS
from calib_pin.parameterizations.drift import INCREMENTS, InstrumentDrift
from calib_pin.parameterizations.thermal import WarmUp
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.sentences import shown, told

HOUR, MINUTE = 3600.0, 60.0


def modeled_drift(case: Case) -> Iterator[Finding]:
    """How far every instrument went, and from where to where in the end."""
    if InstrumentDrift.name not in case.setup.parameters or case.fitted is None:
        return
    values = dict(zip(case.fit.problem.parameters.names, case.fit.theta, strict=True))
    for station, (first, last) in case.setup.drift.spans.items():
        name = f"{station}.{InstrumentDrift.name}."
        steps = [
            [values.get(f"{name}{axis}{k + 1}", 0.0) for axis in COMPONENTS]
            for k in range(INCREMENTS)
        ]
        ways = np.cumsum(steps, axis=0)
        shift, turn = (np.linalg.norm(ways[:, k : k + 3], axis=1) for k in (0, 3))
        owner = "" if station == "base" else f" at station '{station}'"
        yield told(
            "modeled-drift",
            f"the instrument{owner} has drifted by {shown(shift[-1], 'm')} and "
            f"{shown(turn[-1], 'rad')} in {_duration(last - first)}",
            {
                "station": station,
                "seconds": last - first,
                "shift": shift[-1],
                "turn": turn[-1],
                "largest_shift": shift.max(),
                "largest_turn": turn.max(),
            },
            info=True,
        )


def modeled_warm_up(case: Case) -> Iterator[Finding]:
    """How far the tool moves as the robot warms up, rms where it was measured."""
    if WarmUp.name not in case.setup.parameters or case.fitted is None:
        return
    problem, thermal, moved = case.fit.problem, case.fit.problem.setup.thermal, []
    for block in problem.data.blocks:
        term = problem.terms[block.key]
        q, own = block.q[:, term.columns], case.fit.theta[term.of_error]
        cold, warm = (
            term.error.basis(q, replace(block.conditions, time=time))
            for time in (np.full(len(q), thermal.switched_on[0]), np.zeros(0))
        )
        both = term.error.poses(q, own, cold) - term.error.poses(q, own, warm)
        moved.append(both[:, :3, 3])
    size = float(np.sqrt(np.mean(np.sum(np.concatenate(moved) ** 2, axis=1))))
    constant = thermal.warm_up_time or 0.0
    yield told(
        "modeled-warm-up",
        f"the cold robot has its tool {shown(size, 'm')} (rms) from where the warm one "
        f"has it, and covers 63 % of that in {_duration(constant)}; the geometry is "
        "that of the warm robot",
        {"cold": size, "time_constant": constant},
        info=True,
    )


def _duration(seconds: float) -> str:
    """A time as people tell it.

    Examples:
        >>> _duration(10800.0), _duration(90.0)
        ('3 h', '1.5 min')
    """
    for unit, size in (("h", HOUR), ("min", MINUTE)):
        if seconds >= size:
            return f"{seconds / size:.2g} {unit}"
    return f"{seconds:.2g} s"
