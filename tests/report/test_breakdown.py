"""The tables of stations, tools and chains."""

from __future__ import annotations

import math
from typing import Any

from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.report.blocks import Block, Line, Table
from calib_pin.report.breakdown import parts, still_joints
from calib_pin.report.terminal import plain_text
from calib_pin.validation.result import (
    Accuracy,
    Breakdown,
    ChainSummary,
    FrameSummary,
    QuantityErrors,
)


def errors(name: str, unit: str, before: float, after: float) -> QuantityErrors:
    sizes = (Accuracy(rms, rms, rms, rms) for rms in (before, after))
    return QuantityErrors(name, unit, *sizes, None, None)


def noise(quantity: str, estimate: float) -> VarianceComponent:
    interval = (0.9 * estimate, 1.1 * estimate)
    return VarianceComponent(
        quantity, "m", 1e-4, True, 1.0, estimate, interval, 0.9, 90.0, False
    )


def frame(name: str, *heard: VarianceComponent, **changes: Any) -> FrameSummary:
    given: dict[str, Any] = {
        "link": "base_link",
        "measurements": 30,
        "errors": (errors("position", "m", 2e-3, 1e-4),),
        "xyz": (1.2345678, -0.5, 0.0),
        "rpy": (0.0, 0.1, math.pi),
        "sigma": (1.2e-5, 2e-5, 3e-5, 1e-5, 0.0, 1e-4),
        "estimated": True,
    }
    return FrameSummary(name=name, noise=heard, **{**given, **changes})


STATIONS = (
    frame("day1", noise("position (day1)", 5e-5)),
    frame("day2", noise("position (day2)", 8e-5), sigma=()),
)
HEARD = [frame.noise[0] for frame in STATIONS]
TOOLS = (
    frame("ball", *HEARD, link="flange"),
    frame("probe", link="flange", sigma=(0.0,) * 6, estimated=False),
)


def table(blocks: list[Block], title: str) -> Table:
    """The table whose title begins so."""
    (found,) = (b for b in blocks if isinstance(b, Table) and b.title.startswith(title))
    return found


def test_one_of_each_is_not_told():
    found = Breakdown(
        stations=STATIONS[:1],
        tools=TOOLS[:1],
        chains=(ChainSummary("", "base_link", "flange", ("a",), 30, ()),),
    )
    assert list(parts(found)) == list(still_joints(found)) == []


def test_stations_and_tools():
    blocks = list(parts(Breakdown(stations=STATIONS, tools=TOOLS)))
    found = table(blocks, "Stations, tools")
    rows = [[cell.text for cell in row] for row in found.rows]
    assert [row[0].split()[1] for row in rows] == ["day1", "day2", "ball", "probe"]
    assert rows[0][1:] == ["30", "position", "2.000", "0.1000", "0.0500", "mm"]
    # Two stations look at the ball, each with its own noise.
    assert [row[5] for row in rows] == ["0.0500", "0.0800", "-", "-"]
    assert max(map(len, plain_text(blocks).splitlines())) <= 80
    chains = tuple(
        ChainSummary(name, "torso", tip, ("a", "b"), 40, (), still=still)
        for name, tip, still in (("left", "hand", ()), ("", "head", ("c", "d")))
    )
    (line,) = still_joints(Breakdown(chains=chains))
    assert isinstance(line, Line) and "c, d" in line.text
