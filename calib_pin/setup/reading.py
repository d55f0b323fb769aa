"""How measurement files are to be read where they are not as their columns say.

Each key undoes one mistake of a file: exchanged axes, a missing factor, joints that
stand one line below their measurement. Findings propose such keys; whoever agrees puts
them in the setup file, and the measurements stay as they are.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Annotated

from calib_pin.setup.constraints import Checked, Section, listed
from calib_pin.setup.values import (
    LARGEST_LENGTH,
    Flag,
    Number,
    OneOf,
    Text,
    Triple,
    Vector,
    number,
)

AXES = ("x", "y", "z")
"""Axes of a position, in the order of its values."""

STATED = {
    "quaternion": ("qx", "qy", "qz", "qw"),
    "rotation-vector": ("rx", "ry", "rz"),
    "roll-pitch-yaw": ("roll", "pitch", "yaw"),
}
"""The ways in which a file may state an orientation, and their columns."""

ORDERS = [a + b + c for a in "xyz" for b in "xyz" for c in "xyz" if a != b != c]

HELD = (
    "wxyz",
    "rotation-vector",
    *(f"{kind}-{order}" for kind in ("extrinsic", "intrinsic") for order in ORDERS),
    *(f"rpy-{order}" for order in ("xzy", "yxz", "yzx", "zxy")),
)
"""Orientations that such columns may hold instead."""


def _axes(value: object) -> tuple[str, ...]:
    names = value if isinstance(value, list) else []
    text = all(isinstance(name, str) for name in names)
    if not text or sorted(name.removeprefix("-") for name in names) != list(AXES):
        raise ValueError("x, y and z in any order, each with or without a -")
    return tuple(names)


def _place(value: object) -> str:
    file, _, line = value.rpartition(":") if isinstance(value, str) else ("", "", value)
    plain = number(line)
    if not (plain.is_integer() and 1 <= plain <= 2**53):
        raise ValueError
    return f"{file}:{int(plain)}" if file else str(int(plain))


def _places(value: object) -> tuple[str, ...]:
    try:
        return tuple(map(_place, value if isinstance(value, list) else [value]))
    except ValueError:
        raise ValueError("lines, such as [12, 31] or [day1.csv:12]") from None


def _pairs(value: object) -> tuple[tuple[str, ...], ...]:
    try:
        pairs = tuple(map(_places, value)) if isinstance(value, list) else ()
    except ValueError:
        pairs = ()
    if not pairs or any(len(pair) != 2 for pair in pairs):
        raise ValueError("pairs of lines, such as [[12, 13]]")
    return pairs


def _shift(value: object) -> int:
    plain = number(value)
    if not (plain.is_integer() and abs(plain) <= 1e6):
        raise ValueError("a whole number of lines")
    return int(plain)


LINE = {"anyOf": [{"type": "integer", "minimum": 1}, {"type": "string"}]}
"""JSON schema of a line, whose file and a colon precede it if there are several."""

Conversion = Annotated[
    float, Number(least=1e-6, most=1e6, words="a positive number from 1e-6 to 1e6")
]
Part = Annotated[float, Number(least=-1.0, most=1.0, words="a part from -1 to 1")]
Places = Annotated[tuple[str, ...], Checked(_places, {"type": "array", "items": LINE})]
Pairs = Annotated[
    tuple[tuple[str, ...], ...],
    Checked(_pairs, {"type": "array", "items": listed(LINE, 2)}),
]


@dataclass(frozen=True)
class ConvertedSetup(Section):
    """A part of the measurements that was written in another unit.

    Attributes:
        factor: Factor that brings their numbers to the unit of the column.
        lines: First and last line, or all lines one by one if `each` is true; left out
            for all measurements.
        each: Whether `lines` names every line.
        joints: Joints whose positions are converted; left out for the measured lengths.
    """

    factor: Conversion
    lines: Places = ()
    each: Flag = False
    joints: tuple[Text, ...] = ()

    def _check(self) -> None:
        if self.lines and not self.each and len(self.lines) != 2:
            raise ValueError("lines: [first, last], or each: true")


def _held(value: object) -> str:
    if not isinstance(value, str) or value not in HELD:
        raise ValueError(
            "wxyz, rotation-vector, extrinsic- or intrinsic- with axes such as xyz or "
            "zyz, rpy-xzy, rpy-yxz, rpy-yzx, rpy-zxy"
        )
    return value


@dataclass(frozen=True)
class OrientationSetup(Section):
    """How the columns of an orientation are to be read, where their names are wrong.

    Attributes:
        columns: The columns that it is about, by what their names say; files with
            others are read as they are. Left out for all.
        hold: Their numbers: `wxyz` a quaternion in this order,
            `rotation-vector`, `intrinsic-zyx` or `extrinsic-zyx` angles in the order
            of these rotations about turned or fixed axes, `rpy-yxz` angles about x, y
            and z that are applied about fixed axes in the order y, x, z.
        factor: Factor that brings their angles to the unit of the column.
        inverse: Whether they hold the inverse of the rotation.
    """

    columns: Annotated[str | None, OneOf(tuple(STATED))] = None
    hold: Annotated[str | None, Checked(_held, {"enum": list(HELD)})] = None
    factor: Conversion = 1.0
    inverse: Flag = False

    def _check(self) -> None:
        fits = (self.hold == "wxyz") == (self.columns == "quaternion")
        if self.hold is not None and (self.columns is None or not fits):
            raise ValueError(
                "with 'hold' also 'columns': quaternion for wxyz, rotation-vector or "
                "roll-pitch-yaw for angles"
            )


@dataclass(frozen=True)
class ReadingSetup(Section):
    """How measurement files are to be read where they are not as their columns say.

    All keys together are applied in the order in which they stand here.

    Attributes:
        orientation: How the columns of an orientation are to be read.
        inverted: Whether poses are those of the measurement frame in the tool.
        exchanged: Pairs of lines whose joint positions are exchanged.
        converted: Measurements in another unit.
        reversed: Whether the joint positions of every file stand in reversed order.
        shift: Lines by which the joint positions of a measurement stand below it.
        lag: Joint name to the part of its last motion that it had still before it when
            it was measured.
        axes: What stands in the columns x, y and z of a position: `[y, x, z]` says
            that the first two are exchanged, `-z` that an axis is negated.
        scale: Factor of all measured lengths.
        opposite: Whether deviations of contacts have the opposite sign.
        drift: Displacement of measured positions, or of distances, from the first to
            the last line of all files, which is taken out [m].
        moved: Lines from which on the instrument stood elsewhere.
        remounted: Lines from which on the tool was mounted elsewhere.
        without: Lines that are left out.
        sigmas: Whether the standard deviations of the files count.
    """

    orientation: OrientationSetup | None = None
    inverted: Flag = False
    exchanged: Pairs = ()
    converted: tuple[ConvertedSetup, ...] = ()
    reversed: Flag = False
    shift: Annotated[int, Checked(_shift, {"type": "integer"})] = 0
    lag: Mapping[str, Part] = field(default_factory=dict)
    axes: Annotated[
        tuple[str, ...],
        Checked(_axes, listed({"enum": [s + a for a in AXES for s in ("", "-")]}, 3)),
    ] = AXES
    scale: Conversion = 1.0
    opposite: Flag = False
    drift: Annotated[
        Triple,
        Vector(
            3,
            "three finite numbers in m, such as [0, 0, 0.001], or one of a distance",
            "m",
            limit=LARGEST_LENGTH,
            shorter=(1,),
        ),
    ] = (0.0, 0.0, 0.0)
    moved: Places = ()
    remounted: Places = ()
    without: Places = ()
    sigmas: Flag = True
