"""How measurements could be read otherwise, as lines of a setup file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from typing import Any

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.setup import JointMap, ReadingSetup
from calib_pin.setup.values import Section


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
        """The positions, shape (N, n)."""
        return np.asarray(q @ self.factors.T + self.offsets)

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


def merged(readings: Iterable[ReadingSetup]) -> ReadingSetup:
    """Everything that several readings change."""
    result = ReadingSetup()
    for reading in readings:
        result = replace(result, **_changed(reading))
    return result


def _changed(section: Section) -> dict[str, Any]:
    """The attributes of a section that are not at their defaults."""
    assert is_dataclass(section)
    values = [(f.name, getattr(section, f.name), f.default) for f in fields(section)]
    return {k: v for k, v, default in values if v != default and v not in ({}, ())}


def lines_of(section: Section) -> dict[str, Any]:
    """The keys of a section that are not at their defaults, as plain data."""
    return {name: _plain(value) for name, value in _changed(section).items()}


def _plain(value: Any) -> Any:
    if isinstance(value, tuple):
        return [_plain(entry) for entry in value]
    if isinstance(value, Mapping):
        return {key: _plain(entry) for key, entry in value.items()}
    if isinstance(value, str) and value.isdigit():
        return int(value)
    return lines_of(value) if isinstance(value, Section) else value


def written(lines: Any) -> str:
    """Lines of a setup file as YAML on one line."""
    if isinstance(lines, Mapping):
        return ", ".join(f"{written(k)}: {_nested(v)}" for k, v in lines.items())
    return _nested(lines)


def _nested(value: Any) -> str:
    if isinstance(value, Mapping):
        return f"{{{written(value)}}}"
    if isinstance(value, list | tuple):
        return f"[{', '.join(map(_nested, value))}]"
    if isinstance(value, bool):
        return str(value).lower()
    if isinstance(value, float):
        return f"{value:.9g}"
    text = str(value)
    plain = text.replace("_", "").replace("-", "").replace(".", "").isalnum()
    return text if plain and text.strip() == text else f"'{text}'"
