"""Observations: blocks of measurements, each of one instrument looking at one tool.

A block is homogeneous: one measurement model, one chain, one station of the instrument,
one tool. Several instruments, a moved tracker, two arms and a touching hand are more
blocks. All blocks have the joints of all chains, so that configurations compare.
"""

from __future__ import annotations

from collections.abc import Sequence

from calib_pin.observations.blocks import (
    FRAMES,
    Frame,
    Observations,
    apart,
    fitted_and_held_out,
    states_sigmas,
    with_directions,
)
from calib_pin.observations.conditions import UNSTATED, Conditions, Signs, approached
from calib_pin.observations.labels import Booleans, Floats, Indices, Labels, grouped
from calib_pin.observations.measurements import BlockKey, Measurements, trusted

__all__ = [
    "AT",
    "FRAMES",
    "UNSTATED",
    "BlockKey",
    "Booleans",
    "Conditions",
    "Floats",
    "Frame",
    "Indices",
    "Labels",
    "Measurements",
    "Observations",
    "Signs",
    "Targets",
    "apart",
    "approached",
    "fitted_and_held_out",
    "grouped",
    "states_sigmas",
    "trusted",
    "with_directions",
]

Targets = Sequence[str]
"""The name of the target of each measurement; `Labels` where they are many."""

AT = "@"
"""Stands between a point of the tool and the place it is measured against."""
