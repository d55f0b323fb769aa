"""Units that people read; inside, everything is SI."""

from __future__ import annotations

import math

DISPLAY = {
    "m": ("mm", 1e3),
    "rad": ("deg", 180.0 / math.pi),
    "m/m": ("%", 100.0),
    "rad/rad": ("%", 100.0),
    "px": ("px", 1.0),
    "m/N": ("um/N", 1e6),
    "rad/Nm": ("urad/Nm", 1e6),
}
"""Unit and factor that people read, by SI unit."""
