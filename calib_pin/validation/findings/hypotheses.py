"""Faults of the data, how to read these if they are there, and errors they explain."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np

from calib_pin.errors import InputError
from calib_pin.estimation.evidence import Finding
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.readings import read_otherwise
from calib_pin.observations import Measurements, Observations
from calib_pin.observations.blocks import of_joints
from calib_pin.setup import JointMap, ReadingSetup
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.sentences import (
    lines_of,
    merged,
    shown,
    told,
    written,
)

FITTED = 0.5
"""Part of the errors of a fit that one of them may leave."""


@dataclass(frozen=True)
class JointReading:
    """Joint positions as an affine function of those that were read.

    `q = factors @ q_read + offsets`

    Attributes:
        factors: Shape (n, n) [rad/rad, m/m].
        offsets: Shape (n,) [rad, m].
    """

    factors: Floats
    offsets: Floats

    @staticmethod
    def plain(count: int) -> JointReading:
        """Positions of so many joints as they are read."""
        return JointReading(np.eye(count), np.zeros(count))

    def positions(self, q: Floats) -> Floats:
        """The positions, shape (N, n); none of none."""
        return np.asarray(q @ self.factors.T + self.offsets) if q.size else q

    def after(self, first: JointReading) -> JointReading:
        """This one of positions that another one has read."""
        offsets = self.factors @ first.offsets + self.offsets
        return JointReading(self.factors @ first.factors, offsets)

    def maps(
        self, joints: Sequence[str], stated: Mapping[str, JointMap]
    ) -> dict[str, dict[str, Any]]:
        """The entries of `joints` in a setup file, of all that are not plain.

        Args:
            joints: Names of the joints.
            stated: Joint maps by which the positions have been read, by file column.
        """
        of_joint = {given.joint: name for name, given in stated.items()}
        columns = [of_joint.get(joint, joint) for joint in joints]
        pairs = zip(joints, columns, strict=True)
        given = [stated.get(column, JointMap(joint)) for joint, column in pairs]
        # Every position as it has been read is an affine function of file columns.
        names = [*dict.fromkeys([*columns, *(n for g in given for n in g.coupled)])]
        read = np.zeros((len(joints), len(names)))
        for row, column, own in zip(read, columns, given, strict=True):
            for name, part in [(column, 1.0), *own.coupled.items()]:
                row[names.index(name)] += own.sign * own.gear * part
        factors = self.factors @ read
        offsets = self.factors @ [own.offset for own in given] + self.offsets
        # Every joint has a column that no other one has, its own where it can.
        from scipy.optimize import linear_sum_assignment  # Slow to import.

        count = len(joints)
        has = factors[:, :count] != 0.0
        _, chosen = linear_sum_assignment(has * (count + np.eye(count)), maximize=True)
        result = {}
        rows = zip(joints, chosen.tolist(), factors, offsets.tolist(), strict=True)
        for joint, k, row, offset in rows:
            factor = float(row[k])
            others = [j for j in np.flatnonzero(row).tolist() if j != k]
            coupled = {names[j]: float(row[j]) / factor for j in others}
            sign = 1 if factor > 0.0 else -1
            entry = lines_of(JointMap(joint, sign, abs(factor), offset, coupled))
            if entry != {"joint": columns[k]} or columns[k] in stated:
                result[columns[k]] = entry
        return result


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
        figure: What the figure of residuals that shows it has them over.
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
    if (joints := joint_reading(faults)) is not None:
        if len(data.joints) != len(joints.offsets):
            raise InputError("these joints are those of another chain")
        at = joints.positions
        blocks = [replace(b, q=at(b.q), start=at(b.start)) for b in data.blocks]
        data = Observations(tuple(blocks))
    for fault in faults:
        if fault.chains is not None:
            data = _with_joints(data, fault.chains.joints)
    return read_otherwise(data, merged(fault.reading for fault in faults))


def _with_joints(data: Observations, joints: Sequence[str]) -> Observations:
    """Measurements with some of their joints, and further ones that they state."""
    new = [joint for joint in joints if joint not in data.joints]
    every = [*data.joints, *new]

    def with_new(b: Measurements) -> Measurements:
        if new and b.start.size:
            raise InputError("where these joints started is not known")
        return replace(
            b,
            joints=tuple(every),
            q=np.column_stack([b.q, *(b.conditions.spare[j, j] for j in new)]),
            conditions=b.conditions.among(range(len(b.joints)), len(every)),
        )

    return of_joints(Observations(tuple(map(with_new, data.blocks))), tuple(joints))


def joint_reading(faults: Iterable[Hypothesis]) -> JointReading | None:
    """How joint positions are to be read with all of some faults."""
    found = None
    for fault in faults:
        if fault.joints is not None:
            found = fault.joints if found is None else fault.joints.after(found)
    return found


def setup_lines(case: Case, faults: Sequence[Hypothesis]) -> dict[str, Any]:
    """Lines of a setup file with which measurements are read otherwise."""
    joints = joint_reading(faults) or JointReading.plain(len(case.data.joints))
    lines: dict[str, Any] = {
        "joints": joints.maps(case.data.joints, case.setup.joints),
        "reading": lines_of(merged(fault.reading for fault in faults)),
    }
    for fault in faults:
        lines |= fault.stated
    return {key: stated for key, stated in lines.items() if stated}


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
    lines, quantity = setup_lines(case, found.faults), case.fit.quantity
    scale = merged(fault.reading for fault in found.faults).scale
    remedy = f"state in the setup file: {written(lines)}"
    if [*lines.get("reading", ())] == ["scale"] and not any(case.data.files.distinct):
        remedy = f"multiply values by {scale:g}"
    if quantity.unit != "m" or found.fitted:
        scale = 1.0  # Errors of the nominal robot are in the unit of the file.
    before, after = scale * found.before, scale * found.after
    fall = f"fall from {shown(before, quantity.unit, 3)} to"
    robot = "of a fit" if found.fitted else "of the nominal robot"
    numbers = {"rms_before": before, "rms_after": after}
    numbers |= {"log_likelihood_ratio": found.ratio, "tried": found.tried}
    for fault in found.faults:
        said = f"{fault.words}: so read, the {quantity.name} errors {robot} "
        said += fall if np.isfinite(before) else "are"
        how = (fault.advice, {}) if fault.advice else (remedy, lines)
        said += f" {shown(after, quantity.unit, 3)}"
        clear = after < FITTED * before and not found.harmless
        yield told(fault.code, said, numbers, *how, fault.figure, error=clear)
