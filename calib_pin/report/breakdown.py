"""A calibration by its stations, tools, chains and blocks of measurements.

All of it is shown only where there are several of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from itertools import chain as joined
from itertools import combinations

from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.report.blocks import (
    Block,
    Cell,
    Kind,
    Line,
    Names,
    Table,
    columns,
)
from calib_pin.report.tables import known, quantity
from calib_pin.units import DISPLAY
from calib_pin.validation.accuracy import QuantityErrors
from calib_pin.validation.result import Breakdown

KINDS: Mapping[str, Kind] = {"quantity": "word", "measurements": "number"}
"""Columns that are not what they are elsewhere."""


def block_names(keys: Sequence[Sequence[str]]) -> list[str]:
    """Names of blocks: as few parts of their keys as tell them apart.

    Examples:
        >>> block_names([("pose", "", "day1", "ball"), ("pose", "", "day2", "ball")])
        ['day1', 'day2']
    """
    width = len(keys[0])
    for told in joined(*(combinations(range(width), k) for k in range(width + 1))):
        names = [tuple(key[k] for k in told) for key in keys]
        if len(set(names)) == len(keys):
            break
    return [", ".join(part or "-" for part in name) for name in names]


def keys_of(found: Breakdown) -> list[tuple[str, str, str, str]]:
    """Model, chain, station and tool of each block."""
    return [(b.model, b.chain, b.station, b.tool) for b in found.blocks]


def parts(found: Breakdown) -> Iterator[Block]:
    """Accuracy and noise by station, tool and chain."""
    rows: list[Sequence[Cell]] = []
    for kind, frames in (("station", found.stations), ("tool", found.tools)):
        for frame in frames if len(frames) > 1 else ():
            label = f"{kind} {frame.name}"
            rows += _sizes(label, frame.measurements, frame.errors, frame.noise)
    for chain in found.chains if len(found.chains) > 1 else ():
        label = f"chain {chain.name}" if chain.name else f"chain to {chain.tip}"
        rows += _sizes(label, chain.measurements, chain.errors, None)
    if rows:
        titles = ("measurements", "quantity", "nominal", "calibrated", "noise", "unit")
        title = "Stations, tools and chains (rms of fitted measurements)"
        yield Table(title, columns("", titles, KINDS), rows)


def _sizes(
    label: str,
    count: int,
    errors: Sequence[QuantityErrors],
    noise: Sequence[VarianceComponent] | None,
) -> Iterator[Sequence[Cell]]:
    """The rows of a part, one for each quantity."""
    first = Cell(label), Cell(str(count), count)
    for error in errors:
        own = [n for n in noise or () if _plain(n.quantity) == _plain(error.name)]
        # Of a tool that several stations look at there is no single noise.
        size = own[0].estimate if len(own) == 1 else math.nan
        yield (
            *first,
            Cell(error.name),
            quantity(error.before.rms, error.unit),
            quantity(error.after.rms, error.unit),
            known(size, error.unit),
            Cell(DISPLAY[error.unit][0]),
        )
        first = Cell(""), Cell("")


def _plain(name: str) -> str:
    """Name of a quantity without the model and the station it is told apart by."""
    return name.partition(" (")[0]


def told(found: Breakdown) -> Iterator[Block]:
    """Rank that each block adds, and the frames that hang together through it."""
    yield from stills(found)
    if len(found.blocks) < 2:
        return
    names = block_names(keys_of(found))
    rows: list[Sequence[Cell]] = []
    for name, block in zip(names, found.blocks, strict=True):
        first = [Cell(name), Cell(str(block.measurements), block.measurements)]
        ranks = [Cell(str(rank), rank) for rank in (block.rank, block.added)]
        for error in block.errors:
            size, unit = quantity(error.after.rms, error.unit), DISPLAY[error.unit][0]
            rows.append((*first, Cell(error.name), size, Cell(unit), *ranks))
            first = ranks = [Cell("")] * 2
    titles = ("measurements", "quantity", "rms", "unit", "rank", "added")
    yield Table("Blocks of measurements", columns("", titles, KINDS), rows)
    yield Line(
        "Rank: errors of the robot that the measurements of a block identify by "
        "themselves. Added: those that the others do not identify without them.",
        "note",
    )
    for name, block in zip(names, found.blocks, strict=True):
        if block.ties:
            groups = " | ".join(", ".join(group) for group in block.ties)
            yield Line(
                f"Without the measurements of {name} the frames fall apart: {groups}.",
                "note",
            )
    yield from _coupled(found)


def frames_told(found: Breakdown, *, details: bool = False) -> Iterator[Block]:
    """Joints that never moved, and frames that cannot be told apart.

    Args:
        found: The breakdown.
        details: Also the ranks of several blocks.
    """
    if details and len(found.blocks) > 1:
        yield from told(found)
        return
    yield from stills(found)
    yield from _coupled(found)


def _coupled(found: Breakdown) -> Iterator[Names]:
    if found.coupled_frames:
        sentences = [coupled.sentence for coupled in found.coupled_frames]
        yield Names("Frames that cannot be told apart", sentences)


def stills(found: Breakdown) -> Iterator[Line]:
    """Joints that no measurement moves."""
    for chain in found.chains:
        if chain.still:
            of_chain = f" of chain {chain.name}" if chain.name else ""
            joints = f"joint{'s' if len(chain.still) > 1 else ''} "
            joints += f"{', '.join(chain.still)}{of_chain}"
            yield Line(f"No measurement moves {joints}: held at nominal.", "note")
