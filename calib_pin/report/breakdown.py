"""A calibration by its stations, tools and chains.

Where base, tools, stations and cameras are, the numbers that others need; what each of
several is worth is shown only where there are several of them.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

import numpy as np

from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.measurement_models.pinhole import INTRINSICS
from calib_pin.report.blocks import Block, Cell, Table, note, table
from calib_pin.report.tables import UNIT, decimals, measures, significant
from calib_pin.setup import CameraSetup
from calib_pin.units import DISPLAY
from calib_pin.validation.result import (
    REMEDY,
    Breakdown,
    CalibrationResult,
    FrameSummary,
)

QUANTITY = "quantity|word"


def parts(breakdown: Breakdown) -> Iterator[Block]:
    """Accuracy and noise by station, tool and chain."""
    members: list[tuple[str, Any, Sequence[VarianceComponent]]] = [
        (f"{kind} {frame.name}", frame, frame.noise)
        for kind, frames in (("station", breakdown.stations), ("tool", breakdown.tools))
        for frame in (frames if len(frames) > 1 else ())
    ]
    members += [
        (f"chain {c.name}" if c.name else f"chain to {c.tip}", c, ())
        for c in (breakdown.chains if len(breakdown.chains) > 1 else ())
    ]
    rows: list[tuple[object, ...]] = []
    for label, of, noise in members:
        for error in of.errors:
            components = [n for n in noise if _plain(n.quantity) == _plain(error.name)]
            # Of a tool that several stations look at there is no single noise.
            size = components[0].estimate if len(components) == 1 else math.nan
            numbers = error.before.rms, error.after.rms, size
            cells = measures(error.unit, *numbers)
            rows.append((label, of.measurements, error.name, *cells))
    if rows:
        titles = ("", "measurements", QUANTITY, "nominal", "calibrated", "noise", UNIT)
        title = "Stations, tools and chains (rms of fitted measurements)"
        yield table(title, titles, rows, grouped=2)


def _plain(name: str) -> str:
    """Name of a quantity without the model and the station it is told apart by."""
    return name.partition(" (")[0]


def still_joints(breakdown: Breakdown) -> Iterator[Block]:
    """Joints that never moved."""
    for chain in breakdown.chains:
        if chain.still:
            joints = f"joint{'s' * (len(chain.still) > 1)} {', '.join(chain.still)}"
            joints += f" of chain {chain.name}" * bool(chain.name)
            yield note(f"No measurement moves {joints}: held at nominal.")


# --- where frames and cameras are ---------------------------------------------------


def frame_blocks(result: CalibrationResult) -> Iterator[Block]:
    """Frames and cameras of which something was estimated."""
    stations = [frame for frame in result.stations if frame.estimated]
    tools = [frame for frame in result.tools if frame.estimated]
    seen = {name: of for name, of in result.model.cameras.items() if of.estimate}
    if stations or tools:
        yield _frames(stations, tools)
        of = [f"of {_link(stations)} in the measurement frame of a station"]
        of = of * bool(stations) + [f"of a tool on {_link(tools)}"] * bool(tools)
        yield note(
            f"Pose {', and '.join(of)}, with standard deviations; rotations are roll, "
            "pitch and yaw, their deviations those about x, y and z."
        )
    open_ones = {name.partition(".intrinsics.")[0] for name in result.unknown}
    if any({*"xyz"} & {*f.unknown} for f in stations + tools) or open_ones & {*seen}:
        yield note(f"-: unknown, the measurements leave it open; {REMEDY}.")
    variances = np.nan_to_num(np.diag(result.covariance))
    sigmas = dict(zip(result.covariance.rows, np.sqrt(variances), strict=True))
    sigmas |= dict.fromkeys(result.unknown, math.nan)
    for name, camera in seen.items():
        yield _camera(name, camera, sigmas)


def _camera(name: str, camera: CameraSetup, sigmas: Mapping[str, float]) -> Table:
    """The intrinsics of a camera."""
    values = (*camera.focal, *camera.center, *camera.distortion)
    rows = []
    for (key, unit, _), value in zip(INTRINSICS, values, strict=True):
        sigma = sigmas[f"{name}.intrinsics.{key}"]
        rows.append((key, _estimate_text(value, sigma, 1.0), unit))
    return table(f"Intrinsics of {name}", ("", "value", UNIT), rows)


def _link(frames: Sequence[FrameSummary]) -> str:
    """The link of all frames, where there is only one."""
    links = {frame.link for frame in frames}
    return links.pop() if len(links) == 1 else "a link"


def _frames(stations: Sequence[FrameSummary], tools: Sequence[FrameSummary]) -> Table:
    rows = []
    for frame, others in [(f, fs) for fs in (stations, tools) for f in fs]:
        label = frame.name
        sigma = frame.sigma or (0.0,) * 6
        halves = [
            ("position", "m", frame.xyz, sigma[:3]),
            ("rotation", "rad", frame.rpy, sigma[3:]),
        ]
        for name, unit, values, deviations in halves:
            pairs = zip(values, deviations, strict=True)
            cells = [_estimate_text(*pair, DISPLAY[unit][1]) for pair in pairs]
            rows.append((label, name, *cells, DISPLAY[unit][0]))
            label = "" if _link(others) == frame.link else f"  {frame.link}"
    return table("Frames of stations and tools", ("", "|word", *"xyz", UNIT), rows)


def _estimate_text(value: float, sigma: float, factor: float) -> Cell:
    """A value with its standard deviation, such as `12.345 +- 0.012`.

    A dash for what the measurements leave open.
    """
    if math.isnan(sigma):
        return Cell("-")
    if not sigma > 0.0:
        return Cell(f"{factor * value:z.3f}", value)
    places = max(decimals(factor * sigma), 0)
    text = f"{factor * value:z.{places}f} +- {significant(factor * sigma)}"
    return Cell(text, value)
