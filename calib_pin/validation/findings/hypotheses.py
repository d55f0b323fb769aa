"""Faults of the data, how to read these if they are there, and errors they explain."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calib_pin.errors import InputError
from calib_pin.estimation.evidence import Finding
from calib_pin.kinematics.chains import Chains
from calib_pin.measurement_models.readings import read_otherwise
from calib_pin.observations import Measurements, Observations
from calib_pin.observations.measurements import with_joints
from calib_pin.setup import ReadingSetup
from calib_pin.units import DISPLAY
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.setup_lines import (
    JointReading,
    lines_of,
    merged,
    written,
)

FITTED = 0.5
"""Part of the errors of a fit that one of them may leave."""


@dataclass(frozen=True)
class Hypothesis:
    """One fault of the data, and how they are to be read if it is there.

    Attributes:
        code: Code of its finding.
        words: The fault in words, the beginning of a sentence.
        of: Its subject; two explanations of one subject do not combine.
        reading: How the measurements are to be read.
        joints: How the joint positions are to be read; None for as they are.
        change: What the reader of files would do first, of which they alone know the
            numbers; None for nothing.
        chains: The chains that were measured, where they are others.
        setup: What the setup states otherwise, by the names of its attributes.
        stated: Further lines of the setup file.
        gross: Whether the errors are as large as the robot, which the nominal one
            tells; a fit to them says nothing.
        advice: What to do instead of stating something; empty where the setup helps.
        figure: Name of a figure that shows it.
        joint: The joint that it concerns alone: what is wrong with one joint may only
            show once all of it is read otherwise.
    """

    code: str
    words: str
    of: str
    reading: ReadingSetup = field(default_factory=ReadingSetup)
    joints: JointReading | None = None
    change: Callable[[Observations], Observations] | None = None
    chains: Chains | None = None
    setup: Mapping[str, Any] = field(default_factory=dict)
    stated: Mapping[str, Any] = field(default_factory=dict)
    gross: bool = False
    advice: str = ""
    figure: str = ""
    joint: str = ""
    absorbs: float = 1.0


def read_so(data: Observations, faults: Iterable[Hypothesis]) -> Observations:
    """Measurements as they are to be read if they have some faults.

    Raises:
        InputError: If faults of joint columns are those of other chains.
    """
    faults = tuple(faults)
    for fault in faults:
        data = data if fault.change is None else fault.change(data)
    joints = joint_reading(faults)
    if joints is not None:
        if len(data.joints) != len(joints.offsets):
            raise InputError("these joints are those of another chain")
        data = Observations(
            tuple(
                replace(
                    b,
                    q=joints.positions(b.q),
                    start=joints.positions(b.start) if b.start.size else b.start,
                )
                for b in data.blocks
            )
        )
    for fault in faults:
        if fault.chains is not None:
            data = _with_joints(data, fault.chains.joints)
    return read_otherwise(data, merged(fault.reading for fault in faults))


def _with_joints(data: Observations, joints: Sequence[str]) -> Observations:
    """Measurements with some of their joints, and further ones that they state."""
    new = [joint for joint in joints if joint not in data.joints]

    def with_new(b: Measurements) -> Measurements:
        if new and b.start.size:
            raise InputError("where these joints started is not known")
        part = with_joints(b, tuple(joints))
        for joint in new:
            part.q[:, part.joints.index(joint)] = b.conditions.spare[joint, joint]
        return part

    return Observations(tuple(map(with_new, data.blocks)))


def joint_reading(faults: Iterable[Hypothesis]) -> JointReading | None:
    """How joint positions are to be read with all of some faults."""
    found = None
    for fault in faults:
        if fault.joints is not None:
            found = fault.joints if found is None else fault.joints.after(found)
    return found


def setup_lines(case: Case, faults: Sequence[Hypothesis]) -> dict[str, Any]:
    """Lines of a setup file with which measurements are read otherwise."""
    lines: dict[str, Any] = {}
    joints = joint_reading(faults)
    if joints is not None:
        maps = joints.maps(case.data.joints, case.setup.joints)
        if maps:
            lines["joints"] = maps
    reading = lines_of(merged(fault.reading for fault in faults))
    if reading:
        lines["reading"] = reading
    for fault in faults:
        lines |= fault.stated
    return lines


@dataclass(frozen=True)
class Explanation:
    """Faults that explain the measurements together.

    Attributes:
        faults: The faults.
        before: Errors as the measurements are read now, rms [unit of the quantity];
            infinite where the robot cannot be located.
        after: Errors if they are read so.
        ratio: Logarithm of the likelihood ratio.
        tried: Number of explanations that were tried.
        fitted: Whether both are errors of a fit, or of the nominal robot.
        harmless: Whether a fit finds the same errors of the robot without it.
    """

    faults: tuple[Hypothesis, ...]
    before: float
    after: float
    ratio: float
    tried: int
    fitted: bool
    harmless: bool = False


def finding(case: Case, found: Explanation) -> Iterator[Finding]:
    """The findings of an explanation, one of each fault.

    Each has the lines of all, which belong together.
    """
    lines = setup_lines(case, found.faults)
    quantity = case.fit.problem.layout.quantities[0]
    unit, factor = DISPLAY[quantity.unit]
    scale = merged(fault.reading for fault in found.faults).scale
    if quantity.unit == "m" and not found.fitted:  # Errors are in the unit of the file.
        found = replace(found, before=scale * found.before, after=scale * found.after)
    sizes = [f"{factor * size:.3g} {unit}" for size in (found.before, found.after)]
    robot = "of a fit" if found.fitted else "of the nominal robot"
    fall = f"fall from {sizes[0]} to" if np.isfinite(found.before) else "are"
    clear = found.after < FITTED * found.before and not found.harmless
    remedy = f"state in the setup file: {written(lines)}"
    if [*lines.get("reading", ())] == ["scale"] and not any(case.data.files.distinct):
        remedy = f"multiply values by {scale:g}"
    for fault in found.faults:
        yield Finding(
            fault.code,
            "error" if clear else "warning",
            f"{fault.words}: so read, the {quantity.name} errors {robot} {fall} "
            f"{sizes[1]}",
            {
                "rms_before": found.before,
                "rms_after": found.after,
                "log_likelihood_ratio": found.ratio,
                "tried": float(found.tried),
            },
            fault.advice or remedy,
            {} if fault.advice else lines,
            fault.figure,
        )
