"""The errors of measurements row by row, for whoever wants to look at them."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np

from calib_pin.estimation.problem import side_by_side
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import Quantity
from calib_pin.observations import BlockKey, Measurements, Observations
from calib_pin.validation.calibrated_model import CalibratedModel

AXES = ("x", "y", "z")
"""Names of the components of a vector."""


def columns_of(
    model: CalibratedModel,
) -> tuple[tuple[Quantity, ...], Mapping[str, int]]:
    """Error columns of a robot's measurements, and the first of each model."""
    terms = model.terms.items()
    return side_by_side({key.model: term.measurement.quantities for key, term in terms})


@dataclass(frozen=True)
class MeasurementErrors:
    """Errors of N measurements, predicted minus measured.

    Attributes:
        rows: The measurements, in B blocks.
        quantities: Quantities of the D error columns, those of all models side by side.
        before: With base, tool and instrument fitted and the robot nominal, shape
            (N, D); NaN for what one does not have, infinite where nothing can be
            predicted.
        after: Those of the calibrated robot, shape (N, D).
        sigma: Standard deviations, shape (N, D); NaN for what one lacks, infinite for
            what is set aside.
        points: Where the calibrated robot has its tool, in the base link of the chain,
            shape (N, 3) [m].
        to_base: Rotation from the measurement frame of each block to the base link of
            its chain, shape (B, 3, 3).
        leverage: Leverage in the fit, 0 to d, shape (N,); NaN where it was not fitted.
    """

    rows: Observations
    quantities: tuple[Quantity, ...]
    before: Floats
    after: Floats
    sigma: Floats
    points: Floats
    to_base: Floats
    leverage: Floats

    @staticmethod
    def unknown(model: CalibratedModel, count: int) -> MeasurementErrors:
        """Errors of a number of measurements of which nothing else is known.

        Args:
            model: The calibrated robot.
            count: Number of measurements.
        """
        joints, (quantities, _) = (
            model.chains.joints,
            columns_of(model),
        )
        errors = np.full((count, quantities[-1].columns.stop), np.nan)
        q = np.zeros((count, len(joints)))
        values = np.zeros((count, model.only.measurement.width))
        rows = Measurements(joints, q, values=values, **model.only.key._asdict())
        points, to_base = np.full((count, 3), np.nan), np.full((1, 3, 3), np.nan)
        told = Observations.of(rows), quantities, errors, errors, errors
        return MeasurementErrors(*told, points, to_base, leverage=points[:, 0])

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

    def table(self, name: str, directions: bool = False) -> dict[str, Sequence[Any]]:
        """Cells of the columns of `measurements.csv`, SI units; NaN where none is.

        Args:
            name: The set, `train` or `validate`.
            directions: Whether directions of approach are told that no file states.
        """
        rows, held = self.rows, self.rows.conditions
        keys = [rows.keys[k] for k in rows.block_of.tolist()]
        found: dict[str, Sequence[Any]] = {
            "set": [name] * len(self),
            "file": rows.files,
            "line": rows.lines.tolist(),
            "target": rows.target,
            "payload": rows.payload,
            **{name: [getattr(key, name) for key in keys] for name in BlockKey._fields},
        }

        def add(form: str, names: Iterable[object], values: Floats) -> None:
            found.update(zip(map(form.format, names), values.T.tolist(), strict=True))

        width = max(block.values.shape[1] for block in rows.blocks)
        start, values, stated = (
            np.full((len(self), columns), np.nan)
            for columns in (len(rows.joints), width, self.sigma.shape[1])
        )
        for block, part in zip(rows.blocks, rows.slices, strict=True):
            values[part, : block.values.shape[1]] = block.values
            if block.start.size:
                start[part] = block.start
            if block.sigma is not None:
                own = ~np.isnan(self.sigma[part.start])
                stated[part, own] = block.sigma
        add("joint.{}", rows.joints, rows.q)
        if not np.isnan(start).all():
            add("start.{}", rows.joints, start)
        if held.direction.size and (directions or held.source == "columns"):
            add("direction.{}", rows.joints, held.direction.astype(float))
        for column in ("temperature", "time"):
            if len(getattr(held, column)):
                found[column] = getattr(held, column).tolist()
        add("measured.{}", range(1, width + 1), values)
        add("{}", ("weight", "leverage"), np.array([rows.weight, self.leverage]).T)
        add("tool.{}", AXES, self.points)
        stages = {"before": self.before, "after": self.after, "sigma": self.sigma}
        if not np.isnan(stated).all():
            stages["stated"] = stated
        for stage, values in stages.items():
            add(f"{{}}.{stage}", self.components, values)
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
        """Errors of position in the base links before and after, shape (N, 3) [m].

        NaN for rows that have none, or cannot be predicted; None where no row has,
        since it was measured otherwise.
        """
        lengths = [q.columns for q in self.quantities if q.unit == "m"]
        places = [of for of in lengths if of.stop - of.start == 3]
        if not places:
            return None
        R, found = self.to_base[self.rows.block_of], list[Floats]()
        for errors in (self.before, self.after):
            known = np.where(np.isfinite(errors), errors, np.nan)
            own = [np.einsum("nij,nj->ni", R, known[:, columns]) for columns in places]
            # Each measurement has one of the positions.
            none = np.isnan(own).all(axis=0)
            found.append(np.where(none, np.nan, np.nansum(own, axis=0)))
        return found[0], found[1]
