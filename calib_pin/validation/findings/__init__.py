"""Faults of the data: what may be wrong with them, which of it is, and what follows.

What makes errors that no robot explains are rows of one table (`alternatives`), which
compete by what they leave (`_cause`). Faults that hide in a fit that looks good are
sought in every fit, by a few further columns of its Jacobian (`QuickFit.score`) or in
the measurements themselves: a kind is one function, and one entry in the list at the
end of its file.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, replace
from typing import TypeVar

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import CalibPinError, InputError, OptionError
from calib_pin.estimation.evidence import Finding
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Observations
from calib_pin.parameterizations.base import expected_size
from calib_pin.setup import Setup
from calib_pin.validation.findings import (
    course,
    facts,
    joint_motions,
    plausibility,
    readings,
)
from calib_pin.validation.findings.alternatives import (
    Explanation,
    Family,
    explain,
    findings_of,
)
from calib_pin.validation.findings.case import CLEARER, DOUBTFUL, FOREIGN, Case, Others

_Fault = TypeVar("_Fault")
_Given = TypeVar("_Given")

Kind = Callable[[Case], Iterable[Finding]]
"""Finds the faults of one kind."""

CONSEQUENCES: tuple[Kind, ...] = (
    *plausibility.KINDS,
    *joint_motions.KINDS,
    facts.hidden_joints,
)
"""Faults in every fit that may follow from another one, and then are not told."""

SHOWN: tuple[Kind, ...] = (*facts.KINDS, joint_motions.approach_order, *course.MODELED)
"""Faults in every fit that the measurements show whatever else is wrong."""

LACKS = {"model-lacks", "held-number", "camera-intrinsics"}
"""Codes of what a fit may lack: families of parameters, numbers of instruments."""

FOLLOW = {
    "large-correction": {"joint-offset"},  # The origin has taken it over.
    # Commanded positions are off by the side, and those that were read too early.
    "backlash": {"joint-columns", "lag"},
    # Large errors of gears alias to ripples, and copies have no noise of their own.
    "gear-ripple": LACKS | {"copied-measurements"},
    "coarse-steps": {"computed-values"},
    "hidden-joints": {"computed-values"},  # Of the flange, which is on the last axis.
    # What no parameter describes leaves more than noise.
    "noise": {"backlash", "lag", "coarse-steps", "instrument-drift", "robot-drift"}
    | {"scale", "known-distance", "computed-values"}
    | LACKS,
    # A robot with more parameters comes closer to a wrong length, too.
    **{code: {"known-distance"} for code in LACKS},
}
"""Findings, and errors and warnings from which they follow and then are not told."""

POORER = LACKS | {"known-distance", "stuck-encoder"}
"""Codes of faults beside which good measurements may be outliers, for want of a better
fit."""


@dataclass(frozen=True)
class Findings:
    """The findings of a case.

    Attributes:
        causes: Faults from which errors follow that no robot explains.
        others: All others.
    """

    causes: tuple[Finding, ...]
    others: tuple[Finding, ...]


@serial_blas
def find(case: Case, seek: bool = True) -> Findings:
    """The faults of measurements and of what was fitted to them.

    Args:
        case: The case.
        seek: Whether to seek faults that change how measurements are read; they have
            been sought with another fit otherwise.
    """
    misreadings = _misreadings(case) if seek else ()
    causes = tuple(f for f in misreadings if f.severity == "error")
    kinds = SHOWN if causes else CONSEQUENCES + SHOWN
    if not causes and not case.remaining <= FOREIGN:
        # Of what no robot has a fit tells nothing but where it stands.
        kinds = (plausibility.outliers, *SHOWN)
    others = [] if causes else [*misreadings]
    others += [finding for kind in kinds for finding in _findings(kind, case)]
    codes = {finding.code for finding in others if finding.severity != "info"}
    others = [f for f in others if not codes & FOLLOW.get(f.code, set())]
    if codes & POORER:
        others = [_remark(f) if f.code == "outliers" else f for f in others]
    ends = {end for finding in others for end in _names(finding, "between", " - ")}
    # The measurements of its ends do not fit a wrong distance.
    targets = [_names(finding, "target", ", ") for finding in others]
    pairs = zip(others, targets, strict=True)
    others = [finding for finding, names in pairs if not names or not names <= ends]
    return Findings(causes, tuple(others))


@contextmanager
def explained(
    chains: Chains, data: Observations, setup: Setup, others: Others = tuple
) -> Iterator[None]:
    """Let an explanation of measurements precede why no robot can be fitted to them.

    Args:
        chains: The nominal chains.
        data: The measurements.
        setup: The setup.
        others: Other robots that may have been measured.

    Raises:
        InputError: If one is raised within, the joints did not move, or distances are
            negative.
    """
    facts.require_motion(data)
    facts.require_distances(data, setup)
    try:
        yield
    except OptionError:
        raise
    except InputError as error:

        def look(given: Setup) -> tuple[Finding, ...]:
            case = Case.of_none(chains, data, given, others)
            return findings_of(case, _explanation(case, readings.FAMILIES))

        for first in (_attempt(look, setup) or ())[:1] if len(data) else ():
            reason = f"{first.message}; {first.remedy}; otherwise {error.reason}"
            file = error.file or next(iter(data.files.distinct), None) or None
            raise InputError(reason, file=file) from error
        raise


def _misreadings(case: Case) -> tuple[Finding, ...]:
    """Faults that change how measurements are read, the likeliest explanation alone."""
    constant = _findings(facts.constant_orientation, case)
    constant += _findings(facts.constant_positions, case)
    return constant or findings_of(case, _cause(case))


def _cause(case: Case) -> Explanation | None:
    """The likeliest explanation of the errors that are left.

    Those that hide all others come first; the others compete by what they leave.
    """
    for kind in (facts.gauge_readings, readings.joint_sets, readings.lost_line):
        if explanation := _attempt(kind, case):
            return explanation
    changes = _attempt(course.changes, case)
    motion = _attempt(joint_motions.joint_motion, case)
    rehomed = changes if changes and any(f.joint for f in changes.faults) else None
    if motion and not (rehomed and rehomed.after < CLEARER * motion.after):
        return motion
    in_time = changes or _attempt(course.drift, case)
    clear = in_time if in_time and in_time.severity == "error" else None
    # As little may be left if it is corrected as a calibration leaves.
    enough = DOUBTFUL * expected_size(case.fit.quantity.unit)
    if case.doubtful and not (clear and clear.after < enough):
        families = (joint_motions.large_motions, *readings.FAMILIES)
        other = _attempt(lambda case: _explanation(case, families), case)
        # Of the nominal robot more is left than of a fit: the parts are compared, too.
        if other and not (
            clear and clear.after <= other.after and clear.part <= other.part
        ):
            return other
    return in_time


def _explanation(case: Case, families: Sequence[Family]) -> Explanation | None:
    """The likeliest one; boards apart cost few trials, and hide all others."""
    apart = explain(case, (readings.target_frames,))
    # A fit that leaves as little needs no further frames.
    if apart is not None and (case.fitted is None or apart.after < case.fit.errors):
        return apart
    return explain(case, families)


def _attempt(look: Callable[[_Given], _Fault | None], given: _Given) -> _Fault | None:
    """A fault, if there is; None of measurements too absurd to compute with."""
    try:
        return look(given)
    except (CalibPinError, np.linalg.LinAlgError):
        return None


def _findings(
    kind: Callable[[_Given], Iterable[Finding]], given: _Given
) -> tuple[Finding, ...]:
    """The findings of a kind, none of measurements too absurd to compute with."""
    return _attempt(lambda given: tuple(kind(given)), given) or ()


def _remark(finding: Finding) -> Finding:
    """A finding that accuses nobody, and asks for nothing."""
    return replace(finding, severity="info", remedy="", setup={})


def _names(finding: Finding, key: str, between: str) -> set[str]:
    """Names that stand in the evidence of a finding; none where it has no such."""
    return {*str(finding.evidence.get(key, "")).split(between)} - {""}
