"""Joint offsets, to be typed into a controller."""

from __future__ import annotations

import csv
from pathlib import Path

import numpy as np

from calib_pin.errors import OutputError, enumerated
from calib_pin.io.exchange.base import Encoded, Exported, Format, JointErrors
from calib_pin.io.measurements import encode_table
from calib_pin.units import DISPLAY
from calib_pin.validation.joint_offsets import encoder_steps
from calib_pin.validation.result import ParameterEstimate

ENOUGH = 1e-6
"""Error of the tip below which offsets alone are the whole correction [m]."""

ESTIMATED = ".joint-offset.q"
"""End of the names of offsets that were estimated as such."""

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


def estimates(exported: Exported) -> dict[str, ParameterEstimate]:
    """The estimated offsets by joint, where the calibration has them as parameters."""
    owners = ((p.name.removesuffix(ESTIMATED), p) for p in exported.result.parameters)
    return {joint: p for joint, p in owners if joint != p.name}


def doubts(exported: Exported) -> tuple[str, ...]:
    """A sentence about offsets that the measurements do not tell, if there are any."""
    unknown = [
        f"{joint} ({p.status})"
        for joint, p in estimates(exported).items()
        if p.status not in ("identifiable", "fixed")
    ]
    if not unknown:
        return ()
    return (
        f"not known by themselves, only with the other values of the calibration: "
        f"{enumerated(unknown)}",
    )


def encode(exported: Exported, _: Path | None) -> Encoded:
    """A table, with the sentence that says how it is used."""
    offsets, known = column_offsets(exported), estimates(exported)
    left = *remarks(exported.offsets), *doubts(exported)
    rows = []
    stepped = encoder_steps(exported.result.model.setup, exported.nominal.joints)
    revolute = exported.nominal.revolute
    for (joint, (column, offset)), turns in zip(offsets.items(), revolute, strict=True):
        si = "rad" if turns else "m"
        unit, factor = DISPLAY[si]
        given, estimate = exported.columns[joint][1], known.get(joint)
        status, sigma = "", ""
        if estimate is not None:
            status = estimate.status
        if estimate is not None and estimate.sigma is not None:
            sigma = f"{factor * estimate.sigma / abs(given.gear):.6f}"
        shown, steps, exact = f"{factor * offset:+z.6f}", "", repr(offset)
        if turns and joint in stepped:
            steps = f"{offset * stepped[joint] / (2.0 * np.pi):+z.1f}"
        if status not in ("", "identifiable", "fixed"):
            # A zero would pass for a result.
            shown = steps = exact = ""
        rows.append((joint, column, shown, sigma, unit, steps, status, exact, si))
    headers = (
        *("joint", "column", "offset", "sigma", "unit", "steps", "status"),
        *("offset_si", "unit_si"),
    )
    table = dict(zip(headers, zip(*rows, strict=True), strict=True))
    data = encode_table(table, [*USE, *left])
    lines = [line for line in data.decode().splitlines() if line[:1] != "#"]
    for row in csv.DictReader(lines):
        exact = row["offset_si"]
        if exact and float(exact) != offsets[row["joint"]][1]:
            raise OutputError(f"the offset of '{row['joint']}' does not read back")
    return Encoded(data, left)


JOINT_OFFSETS = Format(
    "joint-offsets",
    ".csv",
    "offsets of the joints, to be typed into a controller",
    encode,
)
