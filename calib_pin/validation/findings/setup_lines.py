"""How measurements could be read otherwise, as lines of a setup file."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, fields, replace
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
        return JointReading(
            self.factors @ first.factors, self.factors @ first.offsets + self.offsets
        )

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
        # Every position as it has been read is an affine function of file columns.
        read: list[tuple[dict[str, float], float]] = []
        for joint, column in zip(joints, columns, strict=True):
            given = stated.get(column, JointMap(joint))
            factor = given.sign * given.gear
            parts = {column: factor}
            for name, added in given.coupled.items():
                parts[name] = parts.get(name, 0.0) + factor * added
            read.append((parts, given.offset))
        found: list[tuple[dict[str, float], float]] = []
        for factors, offset in zip(self.factors, self.offsets.tolist(), strict=True):
            parts = {}
            for k in np.flatnonzero(factors).tolist():
                factor = float(factors[k])
                offset += factor * read[k][1]
                for name, part in read[k][0].items():
                    parts[name] = parts.get(name, 0.0) + factor * part
            found.append(({n: p for n, p in parts.items() if p}, offset))
        # Every joint has a column that no other one has, its own where it can.
        from scipy.optimize import linear_sum_assignment  # Slow to import.

        has = np.array([[c in parts for c in columns] for parts, _ in found])
        chosen = linear_sum_assignment(
            has * (len(has) + np.eye(len(has))), maximize=True
        )[1]
        result = {}
        for joint, k, (terms, offset) in zip(
            joints, chosen.tolist(), found, strict=True
        ):
            column = columns[k]
            entry: dict[str, Any] = {"joint": joint}
            factor = terms.pop(column)
            if factor < 0.0:
                entry["sign"] = -1
            if abs(factor) != 1.0:
                entry["gear"] = abs(factor)
            if offset:
                entry["offset"] = offset
            if terms:
                entry["coupled"] = {n: part / factor for n, part in terms.items()}
            if entry != {"joint": column} or column in stated:
                result[column] = entry
        return result


def merged(readings: Iterable[ReadingSetup]) -> ReadingSetup:
    """Everything that several readings change."""
    result, plain = ReadingSetup(), ReadingSetup()
    for reading in readings:
        changed = {
            f.name: getattr(reading, f.name)
            for f in fields(ReadingSetup)
            if getattr(reading, f.name) != getattr(plain, f.name)
        }
        result = replace(result, **changed)
    return result


def lines_of(section: Section) -> dict[str, Any]:
    """The keys of a section that are not at their defaults, as plain data."""

    def plain(value: Any) -> Any:
        if isinstance(value, tuple):
            return [plain(entry) for entry in value]
        if isinstance(value, Mapping):
            return {key: plain(entry) for key, entry in value.items()}
        if isinstance(value, str) and value.isdigit():
            return int(value)
        return changed(value) if hasattr(value, "__dataclass_fields__") else value

    def changed(value: Any) -> dict[str, Any]:
        default = {f.name: f.default for f in fields(value)}
        return {
            f.name: plain(getattr(value, f.name))
            for f in fields(value)
            if getattr(value, f.name) != default[f.name]
            and getattr(value, f.name) not in ({}, ())
        }

    return changed(section)


def written(lines: Any) -> str:
    """Lines of a setup file as YAML on one line."""
    if isinstance(lines, Mapping):
        inner = ", ".join(f"{written(k)}: {_nested(v)}" for k, v in lines.items())
        return inner
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
