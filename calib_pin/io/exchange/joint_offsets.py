"""Joint offsets, to be typed into a controller."""

from __future__ import annotations

import csv
from pathlib import Path

from calib_pin.errors import OutputError
from calib_pin.io.exchange.base import Encoded, Exported, Format, JointErrors
from calib_pin.io.measurements import encode_table
from calib_pin.units import DISPLAY

ENOUGH = 1e-6
"""Error of the tip below which offsets alone are the whole correction [m]."""

USE = (
    "A joint is where its column reads plus the offset: add each offset to what the "
    "controller shows.",
    "A controller that asks what it shows where the joint is at zero gets the negative "
    "of it.",
)
"""Sentences that say how the table is used."""


def column_offsets(exported: Exported) -> dict[str, tuple[str, float]]:
    """The offset of each measured column, by joint: its name and offset [rad, m].

    Raises:
        OptionError: If the calibration has no corrected geometry.
    """
    found = {}
    for joint, offset in zip(
        exported.nominal.joints, exported.offsets.offsets, strict=True
    ):
        column, given = exported.columns[joint]
        found[joint] = column, float(offset) / (given.sign * given.gear)
    return found


def remarks(found: JointErrors, what: str = "offsets") -> tuple[str, ...]:
    """A sentence about errors that those of the joints leave, if there are any."""
    before, after = found.before, found.after
    if after < ENOUGH:
        return ()
    unit, factor = DISPLAY["m"]
    return (
        f"{what} alone leave {factor * after:.3g} of {factor * before:.3g} {unit} of "
        "what was found (tip, rms over random configurations)",
    )


def encode(exported: Exported, _: Path | None) -> Encoded:
    """A table, with the sentence that says how it is used."""
    offsets, left = column_offsets(exported), remarks(exported.offsets)
    rows = []
    revolute = exported.nominal.revolute
    for (joint, (column, offset)), turns in zip(offsets.items(), revolute, strict=True):
        si = "rad" if turns else "m"
        unit, factor = DISPLAY[si]
        rows.append((joint, column, f"{factor * offset:+.6f}", unit, offset, si))
    headers = ("joint", "column", "offset", "unit", "offset_si", "unit_si")
    table = dict(zip(headers, zip(*rows, strict=True), strict=True))
    data = encode_table(table, [*USE, *left])
    lines = [line for line in data.decode().splitlines() if line[:1] != "#"]
    for row in csv.DictReader(lines):
        if float(row["offset_si"]) != offsets[row["joint"]][1]:
            raise OutputError(f"the offset of '{row['joint']}' does not read back")
    return Encoded(data, left)


JOINT_OFFSETS = Format(
    "joint-offsets",
    ".csv",
    "offsets of the joints, to be typed into a controller",
    encode,
)
