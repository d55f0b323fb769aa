"""Foreign layouts that are recognized by their columns, a file for each."""

from __future__ import annotations

from collections.abc import Sequence

from calib_pin.io.dialects.base import Dialect, Reading
from calib_pin.io.dialects.ndi import Ndi
from calib_pin.io.dialects.rostopic import Rostopic

__all__ = ["DIALECTS", "Dialect", "Reading"]

DIALECTS: Sequence[Dialect] = (Rostopic(), Ndi())
"""Tried in this order."""
