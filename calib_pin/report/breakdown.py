"""A calibration by its stations, tools, chains and blocks of measurements.

All of it is shown only where there are several of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from itertools import chain as joined
from itertools import combinations
from typing import Any

from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.report.blocks import Block, Names, note, table
from calib_pin.report.tables import UNIT, counted, measures
from calib_pin.validation.result import Breakdown

QUANTITY = "quantity|word"


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


def parts(found: Breakdown) -> Iterator[Block]:
    """Accuracy and noise by station, tool and chain."""
    members: list[tuple[str, Any, Sequence[VarianceComponent]]] = [
        (f"{kind} {frame.name}", frame, frame.noise)
        for kind, frames in (("station", found.stations), ("tool", found.tools))
        for frame in (frames if len(frames) > 1 else ())
    ]
    members += [
        (f"chain {c.name}" if c.name else f"chain to {c.tip}", c, ())
        for c in (found.chains if len(found.chains) > 1 else ())
    ]
    rows: list[tuple[object, ...]] = []
    for label, of, noise in members:
        first: tuple[str | int, ...] = (label, of.measurements)
        for error in of.errors:
            own = [n for n in noise if _plain(n.quantity) == _plain(error.name)]
            # Of a tool that several stations look at there is no single noise.
            size = own[0].estimate if len(own) == 1 else math.nan
            numbers = error.before.rms, error.after.rms, size
            rows.append((*first, error.name, *measures(error.unit, *numbers)))
            first = "", ""
    if rows:
        titles = ("", "measurements", QUANTITY, "nominal", "calibrated", "noise", UNIT)
        title = "Stations, tools and chains (rms of fitted measurements)"
        yield table(title, titles, rows)


def _plain(name: str) -> str:
    """Name of a quantity without the model and the station it is told apart by."""
    return name.partition(" (")[0]


def told(found: Breakdown, *, details: bool = True) -> Iterator[Block]:
    """Joints that never moved, and frames that cannot be told apart.

    Args:
        found: The breakdown.
        details: Also the ranks of several blocks, and the combinations of the frames.
    """
    for chain in found.chains:
        if chain.still:
            of_chain = f" of chain {chain.name}" if chain.name else ""
            joints = f"joint{'s' if len(chain.still) > 1 else ''} "
            joints += f"{', '.join(chain.still)}{of_chain}"
            yield note(f"No measurement moves {joints}: held at nominal.")
    if details and len(found.blocks) > 1:
        yield from _blocks(found)
    coupled = [coupled.sentence for coupled in found.coupled_frames]
    if details and coupled:
        yield Names("Frames that cannot be told apart", coupled)
    elif coupled:
        said = counted(len(coupled), "combination")
        yield note(f"Frames that cannot be told apart: {said}, see --details.")


def _blocks(found: Breakdown) -> Iterator[Block]:
    """Rank that each block adds, and the frames that hang together through it."""
    keys = [(b.model, b.chain, b.station, b.tool) for b in found.blocks]
    names = block_names(keys)
    rows = []
    for name, block in zip(names, found.blocks, strict=True):
        first: tuple[str | int, ...] = (name, block.measurements)
        ranks: tuple[str | int, ...] = (block.rank, block.added)
        for error in block.errors:
            numbers = measures(error.unit, error.after.rms)
            rows.append((*first, error.name, *numbers, *ranks))
            first = ranks = "", ""
    titles = ("", "measurements", QUANTITY, "rms", UNIT, "rank", "added")
    yield table("Blocks of measurements", titles, rows)
    yield note(
        "Rank: errors of the robot that the measurements of a block identify by "
        "themselves. Added: those that the others do not identify without them."
    )
    for name, block in zip(names, found.blocks, strict=True):
        if block.ties:
            groups = " | ".join(", ".join(group) for group in block.ties)
            yield note(
                f"Without the measurements of {name} the frames fall apart: {groups}."
            )
