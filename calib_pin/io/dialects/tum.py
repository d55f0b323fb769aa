"""Trajectories in the format of the TUM RGB-D benchmark, as evo reads and writes them.

Source: "File Formats" of the benchmark (cvg.cit.tum.de): `timestamp tx ty tz qx qy qz
qw` in each line, separated by spaces, and no header but in a comment.
"""

from __future__ import annotations

import numpy as np

import calib_pin.io.dialects.base as base
from calib_pin.measurement_models.declaration import QUATERNION
from calib_pin.units import as_number

UNIT = 1e-2
"""Largest error of the norm of a quaternion that rounding explains."""


class Tum(base.Dialect):
    """Poses with their times."""

    def heading(self, lines: base.Lines) -> base.Heading | None:
        """No header: every line is a time, a position and a unit quaternion."""
        rows = [base.cells_of(t, " ") for _, t in lines if not t.startswith("#")]
        cells = [[as_number(cell) for cell in row] for row in rows]
        if any(len(row) != 8 or None in row for row in cells) or not cells:
            return None
        numbers = np.array(cells, float)
        norms = np.linalg.norm(numbers[:, 4:], axis=1)
        if np.abs(norms - 1.0).max() > UNIT or (np.diff(numbers[:, 0]) <= 0.0).any():
            return None
        names = ["time [s]", *(f"{axis} [m]" for axis in "xyz"), *QUATERNION]
        return base.Heading(" ", names, 0, "a trajectory of TUM (times and poses)")
