"""Faults of the data: each an alternative with a gain against chance, and a remedy.

A kind is one function, and one entry in the list at the end of its file. Explanations
say how measurements could be read otherwise; they are tried, alone and together, where
errors are left that no robot explains (`explanations.explain`). Faults that hide in a
fit that looks good are sought in every fit, by a few further columns of its Jacobian
(`QuickFit.score`) or in the measurements themselves.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass
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
from calib_pin.validation.findings.case import DOUBTFUL, FOREIGN, Case, Others
from calib_pin.validation.findings.explanations import Explanation, explain, finding

_Fault = TypeVar("_Fault")
_Given = TypeVar("_Given")

Kind = Callable[[Case], Iterable[Finding]]
"""Finds the faults of one kind."""

CONSEQUENCES: tuple[Kind, ...] = plausibility.KINDS + joint_motions.KINDS
"""Faults in every fit that may follow from another one, and then are not told."""

SHOWN: tuple[Kind, ...] = (*facts.KINDS, joint_motions.approach_order, *course.MODELED)
"""Faults in every fit that the measurements show whatever else is wrong."""

FOLLOW = (
    ("joint-offset", "large-correction"),  # The origin has taken it over.
    ("joint-columns", "backlash"),  # Commanded positions are off by the side.
    ("lag", "backlash"),  # So are those that were read too early.
    ("model-lacks", "gear-ripple"),  # Large errors of gears alias to ripples.
    ("computed-values", "coarse-steps"),
    # What no parameter describes leaves more than noise.
    *((code, "noise") for code in ("model-lacks", "backlash", "lag", "coarse-steps")),
    *((code, "noise") for code in ("instrument-drift", "robot-drift", "scale")),
    *((code, "noise") for code in ("known-distance", "computed-values")),
)
"""Errors and warnings, and findings that follow from them and then are not told."""

CLEARER = 0.8
"""Part of the errors that a motion of a joint leaves, below which another zero from a
row on is the cause."""


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
def find(case: Case, seek: bool = True) -> Found:
    """The faults of measurements and of what was fitted to them.

    Args:
        case: The case.
        seek: Whether to seek faults that change how measurements are read; they have
            been sought with another fit otherwise.
    """
    sought = _sought(case) if seek else ()
    causes = tuple(found for found in sought if found.severity == "error")
    kinds = SHOWN if causes else CONSEQUENCES + SHOWN
    if not causes and not case.errors_left <= FOREIGN:
        # Of what no robot has a fit tells nothing but where it stands.
        kinds = (plausibility.outliers, *SHOWN)
    others = [] if causes else [*sought]
    others += [found for kind in kinds for found in _told(kind, case)]
    told = {found.code for found in others if found.severity != "info"}
    follow = {code for first, code in FOLLOW if first in told}
    others = [found for found in others if found.code not in follow]
    wrong = {f.evidence["between"] for f in others if f.code == "known-distance"}
    distances = [d.between for d in case.setup.distances]
    ends = {end for both in distances if " - ".join(both) in wrong for end in both}
    # The measurements of its ends do not fit a wrong distance.
    others = [f for f in others if not _targets(f) or not _targets(f) <= ends]
    return Found(causes, tuple(others))


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
        InputError: If one is raised within, or the joints did not move.
    """
    facts.require_motion(data)
    try:
        yield
    except OptionError:
        raise
    except InputError as error:

        def look(given: Setup) -> Iterator[Finding]:
            case = Case.of_none(chains, data, given, others)
            found = _explanation(case)
            yield from finding(case, found) if found else ()

        for first in _told(look, setup)[:1] if len(data) else ():
            said = f"{first.message}; {first.remedy}; otherwise {error.reason}"
            file = error.file or next(iter(data.files.distinct), None) or None
            raise InputError(said, file=file) from error
        raise


def _sought(case: Case) -> tuple[Finding, ...]:
    """Faults that change how measurements are read, the likeliest explanation alone."""
    for kind in (facts.constant_orientation, facts.gauge_readings):
        if told := _told(kind, case):
            return told
    sets = _told(readings.joint_sets, case)
    if better := [found for found in sets if found.setup]:
        # What one column lags behind another is no lag of its joint.
        return (min(better, key=lambda found: _left([found])),)
    changes, motion = _told(course.changes, case), _motion(case)
    of_joints = [found for found in changes if "joint" in found.evidence]
    if motion is not None and not _left(of_joints) < CLEARER * motion.after:
        # A nominal robot that is read wrong makes plateaus of its own.
        return tuple(finding(case, motion))
    in_time = changes or _told(course.drift, case)
    causes = tuple(found for found in in_time if found.severity == "error")
    left = _left(causes)
    # As little may be left if these are corrected as a calibration leaves.
    enough = DOUBTFUL * expected_size(case.fit.quantity.unit)
    other = _tried(_explanation, case) if case.doubtful and not left < enough else None
    # Of the nominal robot more is left than of a fit: the parts are compared, too.
    if other is not None and (
        other.after < left or other.after < other.before * _left(causes, part=True)
    ):
        return tuple(finding(case, other))
    return causes or (*in_time, *sets)


def _motion(case: Case) -> Explanation | None:
    """The motion of joints that errors follow, unless parameters explain more."""
    motion = _tried(joint_motions.joint_motion, case)
    if motion is None or not motion.fitted:
        return motion
    # What bends follows joints as well, and the position of one most of all.
    _, squares = _tried(lambda case: case.lacking, case) or ((), 1.0)
    of_motion = np.exp(-motion.ratio / case.fit.left)
    return None if np.sqrt(squares) < CLEARER * of_motion else motion


def _explanation(case: Case) -> Explanation | None:
    """The likeliest one; boards apart cost few trials, and hide all others."""
    apart = explain(case, (readings.target_frames,))
    # A fit that leaves as little needs no further frames.
    if apart is not None and (case.fitted is None or apart.after < case.fit.errors):
        return apart
    return explain(case, readings.FAMILIES)


def _tried(look: Callable[[_Given], _Fault | None], given: _Given) -> _Fault | None:
    """A fault, if there is; None of measurements too absurd to compute with."""
    try:
        return look(given)
    except (CalibPinError, np.linalg.LinAlgError):
        return None


def _told(
    kind: Callable[[_Given], Iterable[Finding]], given: _Given
) -> tuple[Finding, ...]:
    """The findings of a kind, none of measurements too absurd to compute with."""
    return _tried(lambda given: tuple(kind(given)), given) or ()


def _targets(found: Finding) -> set[str]:
    """The targets of a finding; none where it has no such."""
    targets = str(found.evidence.get("target", ""))
    return {*targets.split(", ")} if targets else set()


def _left(causes: Iterable[Finding], part: bool = False) -> float:
    """Errors that are left if these are corrected [unit of the first quantity].

    Or the part of those that are there now.
    """
    pairs = [(f.evidence["rms_after"], f.evidence["rms_before"]) for f in causes]
    found = (float(a) / (float(b) if part else 1.0) for a, b in pairs)
    return min(found, default=float("inf"))
