"""Joint offsets, to be typed into a controller."""

from __future__ import annotations

import csv
from pathlib import Path
from typing import NamedTuple

import numpy as np

from calib_pin.errors import enumerated
from calib_pin.io.exchange.base import (
    Encoded,
    Exported,
    Format,
    JointErrors,
    require_read,
)
from calib_pin.io.measurements import encode_table
from calib_pin.units import DISPLAY
from calib_pin.validation.joint_offsets import encoder_steps, joint_columns
from calib_pin.validation.result import ParameterEstimate

ENOUGH = 1e-6
"""Error of the tip below which offsets alone are the whole correction [m]."""

ESTIMATED = ".joint-offset.q"
"""End of the names of offsets that were estimated as such."""

KNOWN = ("identifiable", "fixed")
"""Statuses of offsets that are known by themselves."""

HEADERS = "joint column offset sigma unit steps status offset_si unit_si"

USE = (
    "A joint is where its column reads plus the offset: add each offset to what the "
    "controller shows.",
    "A controller that asks what it shows where the joint is at zero gets the negative "
    "of it.",
)
"""Sentences that say how the table is used."""


class ColumnOffset(NamedTuple):
    """The offset of a measured column.

    Attributes:
        joint: The joint.
        column: Name of the column.
        gear: Size of its gear.
        offset: What is added to what the column reads [rad, m].
    """

    joint: str
    column: str
    gear: float
    offset: float


def column_offsets(exported: Exported) -> list[ColumnOffset]:
    """The offset of each measured column."""
    joints, setup = exported.nominal.joints, exported.result.model.setup
    columns, offsets = joint_columns(setup, joints), list[ColumnOffset]()
    for joint, offset in zip(joints, exported.offsets.offsets.tolist(), strict=True):
        column, given = columns[joint]
        offset /= given.sign * given.gear
        offsets.append(ColumnOffset(joint, column, abs(given.gear), offset))
    return offsets


def remarks(found: JointErrors, what: str = "offsets") -> tuple[str, ...]:
    """A sentence about errors that those of the joints leave, if there are any."""
    if found.after < ENOUGH:
        return ()
    unit, factor = DISPLAY["m"]
    return (
        f"{what} alone leave {factor * found.after:.3g} of {factor * found.before:.3g} "
        f"{unit} of what was found (tip, rms over random configurations)",
    )


def estimates(exported: Exported) -> dict[str, ParameterEstimate]:
    """The estimated offsets by joint, where the calibration has them as parameters."""
    owners = ((p.name.removesuffix(ESTIMATED), p) for p in exported.result.parameters)
    return {joint: p for joint, p in owners if joint != p.name}


def doubts(exported: Exported) -> tuple[str, ...]:
    """A sentence about offsets that the measurements do not tell, if there are any."""
    estimated = estimates(exported).items()
    unknown = [f"{j} ({p.status})" for j, p in estimated if p.status not in KNOWN]
    about = "not known by themselves, only with the other values of the calibration: "
    return (about + enumerated(unknown),) if unknown else ()


def encode(exported: Exported, _: Path | None) -> Encoded:
    """A table, with the sentence that says how it is used."""
    known, rows = estimates(exported), []
    left = (*remarks(exported.offsets), *doubts(exported))
    stepped = encoder_steps(exported.result.model.setup, exported.nominal.joints)
    revolute, offsets = exported.nominal.revolute, column_offsets(exported)
    for (joint, column, gear, offset), turns in zip(offsets, revolute, strict=True):
        si = "rad" if turns else "m"
        (unit, factor), estimate = DISPLAY[si], known.get(joint)
        shown, steps, exact = f"{factor * offset:+z.6f}", "", repr(offset)
        status, sigma = "", ""
        if turns and joint in stepped:
            steps = f"{offset * stepped[joint] / (2.0 * np.pi):+z.1f}"
        if estimate is not None:
            status = estimate.status
            if estimate.sigma is not None:
                sigma = f"{factor * estimate.sigma / gear:.6f}"
            if status not in KNOWN:  # A zero would pass for a result.
                shown = steps = exact = ""
        rows.append([joint, column, shown, sigma, unit, steps, status, exact, si])
    table = dict(zip(HEADERS.split(), zip(*rows, strict=True), strict=True))
    data = encode_table(table, [*USE, *left])
    lines = [line for line in data.decode().splitlines() if line[:1] != "#"]
    require_read([*csv.reader(lines)], [HEADERS.split(), *rows], "the offsets")
    return Encoded(data, left)


JOINT_OFFSETS = Format(
    "joint-offsets",
    ".csv",
    "offsets of the joints, to be typed into a controller",
    encode,
)
