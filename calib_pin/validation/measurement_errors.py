"""The errors of measurements row by row, for whoever wants to look at them."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import Quantity
from calib_pin.observations import Measurements

AXES = ("x", "y", "z")
"""Names of the components of a vector."""


@dataclass(frozen=True)
class MeasurementErrors:
    """Errors of N measurements, predicted minus measured.

    Attributes:
        rows: The measurements.
        quantities: Quantities of the error columns.
        before: With base, tool and instrument fitted and the robot nominal, shape
            (N, d); NaN for what one does not have, infinite where nothing can be
            predicted.
        after: Those of the calibrated robot, shape (N, d).
        sigma: Standard deviations, shape (N, d); infinite for what one lacks.
        points: Where the calibrated robot has its tool, in the base link, shape (N, 3)
            [m].
        to_base: Rotation from the measurement frame to the base link, shape (3, 3).
        leverage: Leverage in the fit, 0 to d, shape (N,); NaN where it was not fitted.
    """

    rows: Measurements
    quantities: tuple[Quantity, ...]
    before: Floats
    after: Floats
    sigma: Floats
    points: Floats
    to_base: Floats
    leverage: Floats

    def __len__(self) -> int:
        """Number of measurements."""
        return len(self.rows)

    @property
    def components(self) -> tuple[str, ...]:
        """Names of the residual components, such as `position.x`."""
        return tuple(
            f"{quantity.name}.{axis}" if len(axes) > 1 else quantity.name
            for quantity in self.quantities
            for axes in [AXES[: quantity.columns.stop - quantity.columns.start]]
            for axis in axes
        )

    def table(self, name: str) -> dict[str, Sequence[Any]]:
        """Cells of the columns of `measurements.csv`, SI units; NaN where none is.

        Args:
            name: The set, `train` or `validate`.
        """
        rows = self.rows
        found: dict[str, Sequence[Any]] = {
            "set": [name] * len(self),
            "file": rows.files,
            "line": rows.lines.tolist(),
            "target": rows.target,
            "payload": rows.payload,
        }

        def add(names: Iterable[str], values: Floats) -> None:
            found.update(zip(names, values.T.tolist(), strict=True))

        add((f"joint.{joint}" for joint in rows.joints), rows.q)
        if rows.start.size:
            add((f"start.{joint}" for joint in rows.joints), rows.start)
        width = rows.values.shape[1]
        add((f"measured.{k + 1}" for k in range(width)), rows.values)
        add(("weight", "leverage"), np.column_stack([rows.weight, self.leverage]))
        add((f"tool.{axis}" for axis in AXES), self.points)
        stages = {"before": self.before, "after": self.after, "sigma": self.sigma}
        if rows.sigma is not None:
            stages["stated"] = rows.sigma
        for stage, values in stages.items():
            add((f"{component}.{stage}" for component in self.components), values)
        return found

    def sizes(self, quantity: Quantity) -> tuple[Floats, Floats]:
        """Sizes of the errors of a quantity before and after, shape (N,) each.

        NaN for rows that do not have it.
        """
        before, after = (
            np.linalg.norm(errors[:, quantity.columns], axis=1)
            for errors in (self.before, self.after)
        )
        return before, after

    @property
    def displacements(self) -> tuple[Floats, Floats] | None:
        """Errors of position in the base link before and after, shape (N, 3) [m].

        NaN for rows that have none, or cannot be predicted; None where no row has,
        since it was measured otherwise.
        """
        found: tuple[Floats, Floats] | None = None
        for quantity in self.quantities:
            columns = quantity.columns
            if quantity.unit != "m" or columns.stop - columns.start != 3:
                continue
            parts = [
                np.where(np.isfinite(errors), errors, np.nan) @ self.to_base.T
                for errors in (self.before[:, columns], self.after[:, columns])
            ]
            if found is not None:  # Of mixed measurements, each row has one of them.
                parts = [
                    np.where(np.isnan(first), second, first)
                    for first, second in zip(found, parts, strict=True)
                ]
            found = parts[0], parts[1]
        return found
