"""Measurements with one model, of one chain and one tool, from one station."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property, partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError
from calib_pin.observations.conditions import UNSTATED, Conditions
from calib_pin.observations.labels import Booleans, Floats, Indices, Labels, grouped
from calib_pin.setup.arguments import Brief, as_array, parse, settle

ARRAYS = ("q", "values", "validate", "lines", "weight")
WORDS = ("target", "files")
"""Attributes of `Measurements` with one entry for each measurement."""


class BlockKey(NamedTuple):
    """Model, chain, station and tool of a block; empty names are defaults.

    Attributes:
        model: Name of the measurement model.
        chain: Name of the chain that was measured.
        station: Where the instrument stood.
        tool: What was mounted.
    """

    model: str
    chain: str = ""
    station: str = ""
    tool: str = ""

    def __str__(self) -> str:
        """The model, and the names that are not defaults."""
        pairs = zip(self._fields[1:], self[1:], strict=True)
        return ", ".join([self.model, *(f"{k} {name}" for k, name in pairs if name)])


class SourcedRows:
    """Rows with joint positions, and with the place in a file where each stands."""

    if TYPE_CHECKING:

        @property
        def q(self) -> Floats:
            """Commanded joint positions, shape (N, n) [rad, m]."""

        @property
        def lines(self) -> Indices:
            """Line of each row in its file, shape (N,); 0 where there is no file."""

        @property
        def files(self) -> Labels:
            """File of each row."""

        @property
        def conditions(self) -> Conditions:
            """Conditions of each row beside the joint positions."""

    @property
    def payload(self) -> Labels:
        """Payload of each row; empty strings where the file names none."""
        return self.conditions.payload

    def groups(self) -> Indices:
        """Label rows that must stay together when data are split, see `grouped`."""
        return self._groups

    @cached_property
    def _groups(self) -> Indices:
        return grouped(self.q)

    @property
    def configurations(self) -> int:
        """Number of different configurations; repetitions show nothing new."""
        return int(self.groups().max(initial=-1)) + 1

    def source(self, row: int) -> str:
        """Where a row stands, as `file:line`, or `row k` where there is no file."""
        file = self.files[row]
        return f"{file}:{self.lines[row]}" if file else f"row {row}"

    def error(
        self,
        row: int,
        reason: str,
        *,
        column: str | None = None,
        allowed: str | None = None,
    ) -> InputError:
        """The error that refuses a row, with the place where the row stands."""
        details: dict[str, Any] = {"column": column, "allowed": allowed}
        if file := self.files[row]:
            return InputError(reason, file=file, line=int(self.lines[row]), **details)
        return InputError(f"{self.source(row)}: {reason}", **details)


@dataclass(frozen=True, repr=False)
class Measurements(Brief, SourcedRows):
    """N measurements with one model, of one chain and tool, from one station.

    A block of `Observations`. Names may be given as any sequence of strings.

    Attributes:
        joints: Names of the joints, the columns of `q`: those of the chain, or of all
            chains where several are measured.
        q: Commanded joint positions, shape (N, n) [rad, m].
        model: Name of the measurement model, such as `position`.
        values: Measured values in the layout of the model, shape (N, D), SI units:
            the columns that it declares and, where an orientation is measured, the
            quaternion qx qy qz qw; contacts none, or the deviations that gauges read.
        sigma: Standard deviations of the residual components, shape (N, d), or
            None where the file does not state them. Of an orientation they belong to
            the rotation vector in the tool frame [rad].
        target: Name of the plane, socket or reference point of each row, length N;
            empty strings where the file names none.
        conditions: What held at each row beside the joint positions; a payload for
            each, empty strings where the file names none.
        start: Joint positions at which the relative measurement of a row starts, shape
            (N, n) [rad, m]; of shape (0, 0) where measurements are absolute.
        validate: True for the rows that must not be fitted, shape (N,).
        lines: Line of each row in its file, shape (N,); 0 where there is no file.
        files: File of each row, length N; empty strings where there is none.
        weight: Factor of the precision of each row, shape (N,); default one. Zero sets
            a measurement aside: it keeps its place and has no say.
        chain: Name of the chain; empty for the only one.
        station: Name of the place where the instrument stood; empty for the only one.
        tool: Name of what was mounted; empty for the only one.
        orientation: How the file states orientations, such as `quaternion`; empty where
            there is no file, or files state them in several ways.

    Raises:
        InputError: If the shapes disagree or a number is not finite.
    """

    joints: tuple[str, ...]
    q: Floats
    model: str
    values: Floats
    sigma: Floats | None = None
    target: Labels = field(default_factory=Labels.none)
    conditions: Conditions = UNSTATED
    start: Floats = field(default_factory=lambda: np.zeros((0, 0)))
    validate: Booleans = field(default_factory=lambda: np.zeros(0, bool))
    lines: Indices = field(default_factory=lambda: np.zeros(0, np.int64))
    files: Labels = field(default_factory=Labels.none)
    weight: Floats = field(default_factory=lambda: np.zeros(0))
    chain: str = ""
    station: str = ""
    tool: str = ""
    orientation: str = ""

    def __post_init__(self) -> None:
        """Fill the optional columns and check types, shapes and values."""
        put = partial(object.__setattr__, self)
        for name in WORDS:
            names = getattr(self, name)
            if not isinstance(names, Labels):
                put(name, Labels.of(parse(name, names, Sequence[str])))
        settle(self)
        put("q", as_array("q", self.q, "N", len(self.joints)))
        count, values = len(self.q), self.values
        if values.shape == (count,):  # A single column.
            values = values[:, None]
        put("values", as_array("values", values, count, "D"))
        if self.sigma is not None:
            sigma, width = self.sigma, max(self.values.shape[1], 1)
            if sigma.ndim == 0:
                sigma = np.full((count, width), sigma)
            put("sigma", as_array("sigma", sigma, count, "d"))
        defaults = {
            **dict.fromkeys(WORDS, Labels.all("", count)),
            "validate": np.zeros(count, bool),
            "lines": np.zeros(count, np.int64),
            "weight": np.ones(count),
        }
        for name, default in defaults.items():
            given = getattr(self, name)
            if len(given) == 0:
                put(name, default)
            elif len(given) != count:
                raise InputError(f"'{name}' has not the {count} rows of q")
        put("conditions", self.conditions.of(count, len(self.joints)))
        if self.start.size and self.start.shape != self.q.shape:
            raise InputError(f"start has shape {self.start.shape}, not that of q")
        for name in ("q", "values"):
            known = np.isfinite(getattr(self, name)).all(axis=1)
            if not known.all():
                row = int(known.argmin())
                raise self.error(row, f"'{name}' must be finite numbers")
        if not (np.isfinite(self.weight).all() and (self.weight >= 0.0).all()):
            raise InputError("weights must be finite numbers, 0 or more")
        if self.sigma is not None and not (
            np.isfinite(self.sigma).all() and (self.sigma > 0.0).all()
        ):
            raise InputError("standard deviations must be positive finite numbers")

    def __len__(self) -> int:
        """Number of rows."""
        return len(self.q)

    @property
    def key(self) -> BlockKey:
        """Everything that the measurements have in common."""
        return BlockKey(self.model, self.chain, self.station, self.tool)

    def rows(self, index: NDArray[Any] | slice) -> Measurements:
        """The rows that a mask, a slice or an index array picks, in its order."""
        picked: dict[str, Any] = {
            name: getattr(self, name)[index] for name in (*ARRAYS, *WORDS)
        }
        return replace(
            self,
            **picked,
            conditions=self.conditions.rows(index),
            sigma=None if self.sigma is None else self.sigma[index],
            start=self.start[index] if self.start.size else self.start,
        )

    @staticmethod
    def concatenate(parts: Sequence[Measurements]) -> Measurements:
        """Join measurements of one block.

        Raises:
            InputError: If joints or what is measured differ, or only some of the
                measurements have standard deviations.
        """
        first = parts[0]
        for part in parts[1:]:
            if part.joints != first.joints:
                raise InputError("cannot join measurements of different joints")
            if part.key != first.key:
                raise InputError("cannot join measurements of different blocks")
        parts = [part for part in parts if len(part)] or parts[:1]
        first = parts[0]
        if len(parts) == 1:
            return first
        for part in parts:
            if (part.sigma is None) != (first.sigma is None):
                reason = "cannot join measurements with and without sigma"
                raise InputError(reason, file=part.files[0] or None)
        sigmas = [part.sigma for part in parts if part.sigma is not None]
        # Contacts without readings are exact beside those with some.
        width = max(part.values.shape[1] for part in parts)
        exact = [replace(p, values=np.zeros((len(p), width))) for p in parts]
        parts = [p if p.values.size else e for p, e in zip(parts, exact, strict=True)]
        joined: dict[str, Any] = {
            name: np.concatenate([getattr(part, name) for part in parts])
            for name in (*ARRAYS, "start")
        }
        for name in WORDS:
            joined[name] = Labels.concatenate([getattr(part, name) for part in parts])
        joined["conditions"] = Conditions.concatenate([p.conditions for p in parts])
        sigma = np.concatenate(sigmas) if sigmas else None
        ways = {part.orientation for part in parts}
        way = first.orientation if len(ways) == 1 else ""
        return replace(first, **joined, sigma=sigma, orientation=way)

    def sample(self, count: int) -> Measurements:
        """About `count` rows, spread evenly over the rows of every target.

        A target with few rows keeps up to twenty, unless there are too many of them.
        An image, whose targets follow one another, is kept whole.
        """
        if len(self) <= count:
            return self
        codes = self.target.codes
        begins = np.ones(len(self), bool)
        begins[1:] = (self.q[1:] != self.q[:-1]).any(axis=1) | (codes[1:] <= codes[:-1])
        firsts = np.flatnonzero(begins)
        count = max(1, count * len(firsts) // len(self))
        label = np.zeros(len(firsts), np.int64)
        if 1 < len(self.target.distinct) <= count // 20:
            label = np.unique(codes[firsts], return_inverse=True)[1]
        order, sizes = np.argsort(label, kind="stable"), np.bincount(label)
        kept = np.zeros(len(firsts), bool)
        for images in np.split(order, np.cumsum(sizes)[:-1]):
            few = min(len(images), 20, count)
            share = max(len(images) * count // len(firsts), few)
            kept[images[np.linspace(0, len(images) - 1, share).astype(np.int64)]] = True
        return self.rows(kept[np.cumsum(begins) - 1])


def trusted(data: Measurements) -> Measurements:
    """The measurements that have a weight; of a target that has none, all of them."""
    if data.weight.all():
        return data
    count = len(data.target.names)
    weighted = np.bincount(data.target.codes, data.weight > 0.0, count) > 0.0
    return data.rows((data.weight > 0.0) | ~weighted[data.target.codes])


def with_joints(data: Measurements, joints: tuple[str, ...]) -> Measurements:
    """The measurements with other joints; those that they do not state are zero."""
    if joints == data.joints:
        return data
    new = [joint for joint in joints if joint not in data.joints]
    columns = [[*data.joints, *new].index(joint) for joint in joints]

    def chosen(table: NDArray[Any]) -> NDArray[Any]:
        more = np.zeros((len(table), len(new)), table.dtype)
        return np.hstack([table, more])[:, columns]

    q, start, held = chosen(data.q), data.start, data.conditions
    start = chosen(start) if start.size else start
    if held.direction.size:
        held = replace(held, direction=chosen(held.direction))
    return replace(data, joints=joints, q=q, start=start, conditions=held)
