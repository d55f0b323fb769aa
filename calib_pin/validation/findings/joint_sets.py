"""Two columns of a file for the same joint: commanded and measured positions."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Mapping
from dataclasses import replace
from typing import Any

import numpy as np

from calib_pin.errors import CalibPinError
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.formulation import make_problem
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import JointMap
from calib_pin.units import DISPLAY
from calib_pin.validation.findings.case import STEPS, Case
from calib_pin.validation.findings.explanations import UNLIKELY
from calib_pin.validation.findings.hypotheses import FITTED
from calib_pin.validation.findings.quick_fit import QuickFit
from calib_pin.validation.findings.setup_lines import lines_of, written

MOST = 3
"""Sets that are tried."""


def joint_sets(case: Case) -> Iterator[Finding]:
    """Other columns of the joints that fit better, or worse, beyond chance."""
    setup = replace(case.setup, learned=None)
    some = case.fit.problem.data
    quantity = case.fit.problem.layout.quantities[0]
    unit, factor = DISPLAY[quantity.unit]
    for columns in _sets(some):
        try:
            here, there = (
                QuickFit.of(make_problem(case.chains, data, setup), STEPS)
                for data in (some, _moved(some, columns, setup.joints))
            )
        except CalibPinError:
            continue  # No robot is there.
        ratio = here.left * float(np.log(here.rms / there.rms))
        if not (here.redundant and abs(ratio) > UNLIKELY):
            continue
        better, clear = ratio > 0.0, there.rms < FITTED * here.rms
        stated = {"joints": _maps(columns, setup.joints)} if better else {}
        sizes = [f"{factor * fit.errors:.3g}" for fit in (here, there)]
        names = [*columns.values()]
        shown = " to ".join(
            f"'{name}'" for name in dict.fromkeys(names[:1] + names[-1:])
        )
        yield Finding(
            "joint-columns",
            ("error" if clear else "warning") if better else "info",
            f"with the joint positions in {shown} the {quantity.name} errors of a "
            f"fit are {sizes[1]} {unit} instead of {sizes[0]} {unit}"
            + ("" if better else ": those that were used are the better ones"),
            {
                "columns": ", ".join(names),
                "rms_before": here.errors,
                "rms_after": there.errors,
                "log_likelihood_ratio": ratio,
            },
            f"state in the setup file: {written(stated)}" if better else "",
            stated,
            "residuals-by-joint" if better else "",
        )


def _sets(data: Observations) -> list[dict[str, str]]:
    """Other columns by joint, one dictionary for each set."""
    near = defaultdict[str, list[str]](list)
    for joint, column in data.conditions.spare:
        if joint in data.joints:
            near[joint].append(column)
    count = max(map(len, near.values()), default=0)
    return [
        {j: near[j][k] for j in data.joints if k < len(near[j])}
        for k in range(min(count, MOST))
    ]


def _moved(
    data: Observations, columns: Mapping[str, str], joints: Mapping[str, JointMap]
) -> Observations:
    """Measurements with the joint positions that other columns have.

    Raises:
        CalibPinError: If those of the starts of relative measurements are not known.
    """

    def moved(block: Measurements) -> Measurements:
        if block.start.size:
            raise CalibPinError("where these columns started is not known")
        q = block.q.copy()
        for joint, column in columns.items():
            k = data.joints.index(joint)
            change = block.conditions.spare[joint, column] - block.q[:, k]
            q[:, k] += change
            own, given = _column_of(joint, joints)
            for other in joints.values():
                if part := other.coupled.get(own, 0.0):
                    part *= other.sign * other.gear / (given.sign * given.gear)
                    q[:, data.joints.index(other.joint)] += part * change
        return replace(block, q=q)

    return Observations(tuple(map(moved, data.blocks)))


def _maps(
    columns: Mapping[str, str], joints: Mapping[str, JointMap]
) -> dict[str, dict[str, Any]]:
    """Entries of `joints` in a setup file, of all that other columns change."""
    exchanged = {_column_of(joint, joints)[0]: c for joint, c in columns.items()}
    given = dict(_column_of(joint, joints) for joint in columns) | {**joints}
    return {
        exchanged.get(column, column): lines_of(
            replace(
                own, coupled={exchanged.get(c, c): f for c, f in own.coupled.items()}
            )
        )
        for column, own in given.items()
        if {column, *own.coupled} & exchanged.keys()
    }


def _column_of(joint: str, joints: Mapping[str, JointMap]) -> tuple[str, JointMap]:
    """The column of a joint, and how it becomes its position."""
    stated = ((c, given) for c, given in joints.items() if given.joint == joint)
    return next(stated, (joint, JointMap(joint)))
