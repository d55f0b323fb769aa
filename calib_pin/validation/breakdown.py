"""A calibration by its stations, tools, chains and blocks of measurements."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import NamedTuple

from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.estimation.system import FRAME, Part
from calib_pin.observations import Indices
from calib_pin.validation.accuracy import QuantityErrors
from calib_pin.validation.summaries import ToolAccuracy

REMEDY = (
    "measure it otherwise and hold it in the setup file: 'estimate: false', or "
    "'fixed: [tool.frame.z]' for one value of a stated frame"
)
"""Advice on values that measurements leave open."""


@dataclass(frozen=True)
class FrameSummary:
    """A station or a tool, and where the calibration puts it.

    Attributes:
        name: Its name among the parameters; `base` or `tool` for the only one.
        link: The link that a station stands before, or that a tool is mounted on.
        measurements: Number of fitted measurements.
        errors: Accuracy of these by quantity.
        noise: Their variance components.
        xyz: Of a station where the link is in its measurement frame, of a tool where it
            is in the link [m].
        rpy: The orientation that belongs to it [rad].
        sigma: Standard deviations of the position along, and of the orientation about,
            the axes of the frame that `xyz` is in, shape (6,) [m, rad]: zero for what
            is known, NaN for what measurements leave open. Empty without redundancy.
        estimated: Whether anything of it was estimated.
    """

    name: str
    link: str
    measurements: int
    errors: tuple[QuantityErrors, ...]
    noise: tuple[VarianceComponent, ...]
    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float]
    sigma: tuple[float, ...]
    estimated: bool

    @property
    def unknown(self) -> tuple[str, ...]:
        """Names of what measurements leave open: x, y, z, and rx, ry, rz about them."""
        names = ("x", "y", "z", "rx", "ry", "rz")
        return tuple(names[k] for k, s in enumerate(self.sigma) if math.isnan(s))


@dataclass(frozen=True)
class ChainSummary:
    """A chain, and the errors of its measurements.

    Attributes:
        name: Its name in the measurements; empty for the only one.
        base: The link that it starts at.
        tip: The link that it ends at.
        joints: Names of its moving joints.
        measurements: Number of fitted measurements.
        errors: Accuracy of these by quantity.
        still: Those of its joints that no measurement moves; they stay at nominal.
    """

    name: str
    base: str
    tip: str
    joints: tuple[str, ...]
    measurements: int
    errors: tuple[QuantityErrors, ...]
    still: tuple[str, ...] = ()


@dataclass(frozen=True)
class BlockSummary:
    """A block of measurements, and the errors of the robot that it tells.

    Attributes:
        model: Name of the measurement model.
        chain: Name of the chain; empty for the only one.
        station: Name of the station among the parameters, see `FrameSummary.name`.
        tool: Name of the tool.
        measurements: Number of fitted measurements.
        targets: Names of what was measured.
        errors: Accuracy by quantity.
        noise: Variance components.
        rank: Errors of the robot that these measurements alone tell.
        added: Errors of the robot that the others do not tell without these.
        ties: Frames that hang together through these measurements alone: without
            them the frames fall apart into these groups. Empty where they do not.
    """

    model: str
    chain: str
    station: str
    tool: str
    measurements: int
    targets: tuple[str, ...]
    errors: tuple[QuantityErrors, ...]
    noise: tuple[VarianceComponent, ...]
    rank: int
    added: int
    ties: tuple[tuple[str, ...], ...] = ()


@dataclass(frozen=True)
class CoupledFrames:
    """Frames that measurements cannot tell apart, even if the robot were known.

    Attributes:
        frames: Their names, see `FrameSummary.name`.
        expression: The linear combination of their parameters that is known.
        sentence: The same in words.
    """

    frames: tuple[str, ...]
    expression: str
    sentence: str


@dataclass(frozen=True, kw_only=True)
class Breakdown:
    """The findings of a calibration, part by part.

    Attributes:
        accuracies: The expected errors of the tool by the name of the chain; the first
            chain that moves is the first.
        stations: The stations.
        tools: The tools.
        chains: The chains that were measured.
        blocks: The blocks of measurements.
        coupled_frames: Frames that cannot be told apart.
        unknown: Names of parameters of frames and instruments whose values the
            measurements leave open; of a frame along its own axes.
    """

    accuracies: Mapping[str, ToolAccuracy] = field(default_factory=dict)
    stations: tuple[FrameSummary, ...] = ()
    tools: tuple[FrameSummary, ...] = ()
    chains: tuple[ChainSummary, ...] = ()
    blocks: tuple[BlockSummary, ...] = ()
    coupled_frames: tuple[CoupledFrames, ...] = ()
    unknown: tuple[str, ...] = ()

    def unknown_of(self, kind: str, name: str) -> tuple[str, ...]:
        """Unknown parts of a `station` or a `tool`, see `FrameSummary.unknown`."""
        frames = self.tools if kind == "tool" else self.stations
        return next((f.unknown for f in frames if f.name == name), ())

    @property
    def accuracy(self) -> ToolAccuracy:
        """The expected errors of the tool of the first chain that moves."""
        return next(iter(self.accuracies.values()), ToolAccuracy())


class Frame(NamedTuple):
    """A frame of a part, or something else that several parts may have.

    Attributes:
        kind: `station`, `tool`, or the section of a reference object.
        name: Name among the parameters; `base` or `tool` for the only one.
    """

    kind: str
    name: str

    @property
    def label(self) -> str:
        """Name in a sentence."""
        alone = self.name in ("base", "tool")
        return f"the {self.name}" if alone else f"the {self.kind} '{self.name}'"


def frames_of(part: Part) -> tuple[tuple[Frame, Indices], tuple[Frame, Indices]]:
    """Station and tool of a part, with the positions of their parameters, (6,)."""
    scope, count = part.scope, len(part.error.screws)
    tool = scope.tool.rpartition(".")[0]
    if not scope.offset.isIdentity():
        tool = part.key.tool
    return (
        (Frame("station", scope.station.rpartition(".")[0]), part.index[:FRAME]),
        (Frame("tool", tool), part.index[count - FRAME : count]),
    )
