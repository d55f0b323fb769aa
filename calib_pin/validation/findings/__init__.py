"""Faults of the data: each kind a hypothesis, its gain against chance, its remedy.

A kind is one file and one line here. There are two sorts. Explanations say how
measurements could be read otherwise; they are tried, alone and together, where errors
are left that no robot explains (`explanations.explain`). Faults that hide in a fit that
looks good are sought in every fit, by a few further columns of its Jacobian
(`QuickFit.score`) or in the measurements themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.evidence import Finding
from calib_pin.validation.findings.axes import axes
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.coarse_values import coarse_values
from calib_pin.validation.findings.design import design
from calib_pin.validation.findings.explanations import Family, explain, finding
from calib_pin.validation.findings.joint_columns import joint_columns
from calib_pin.validation.findings.joint_motions import joint_motion
from calib_pin.validation.findings.line_order import line_order
from calib_pin.validation.findings.moved_frames import move_findings
from calib_pin.validation.findings.noise import noise
from calib_pin.validation.findings.orientations import orientations
from calib_pin.validation.findings.outliers import outliers
from calib_pin.validation.findings.plausibility import plausibility
from calib_pin.validation.findings.repetitions import repetitions
from calib_pin.validation.findings.robot import robots
from calib_pin.validation.findings.units import units, units_of_some
from calib_pin.validation.findings.unmoved_joints import unmoved_joints

Kind = Callable[[Case], Iterable[Finding]]
"""Finds the faults of one kind."""

EXPLANATIONS: tuple[Family, ...] = (
    joint_columns,
    line_order,
    axes,
    units,
    orientations,
    robots,
)
"""Explanations of errors that no robot explains."""

CONSEQUENCES: tuple[Kind, ...] = (
    units_of_some,
    plausibility,
    outliers,
    noise,
)
"""Faults in every fit that may follow from another one, and then are not told."""

FACTS: tuple[Kind, ...] = (repetitions, unmoved_joints, design, coarse_values)
"""Faults in every fit that the measurements show whatever else is wrong."""


@dataclass(frozen=True)
class Found:
    """The findings of a case.

    Attributes:
        causes: Faults from which errors follow that no robot explains.
        others: All others.
    """

    causes: tuple[Finding, ...]
    others: tuple[Finding, ...]


@serial_blas
def find(case: Case) -> Found:
    """The faults of measurements and of what was fitted to them."""
    explanation = joint_motion(case)
    causes = () if explanation else tuple(move_findings(case))
    if explanation is None and case.doubtful:
        explanation = explain(case, EXPLANATIONS)
    if explanation is not None and explanation.after < _left(causes):
        causes = tuple(finding(case, explanation))
    kinds = FACTS if causes else CONSEQUENCES + FACTS
    return Found(causes, tuple(found for kind in kinds for found in kind(case)))


def _left(causes: Iterable[Finding]) -> float:
    """Errors that are left if these are corrected [unit of the first quantity]."""
    found = (float(finding.evidence["rms_after"]) for finding in causes)
    return min(found, default=float("inf"))
