"""Several ways of measuring in one fit, each weighted by its own sigma.

A measurement belongs to one of the models, its part; its target is qualified by the
name of that, as in `fixed-point:front/0`. The residual has the components of all parts;
those of the others are zero, and their standard deviation is infinite.

All parts share the measurement frame and the tool, and references of the same kind and
name are the same: the ball that a tracker sees is the one that rests in a socket. Only
a camera, which is a frame of its own, has its own stand and its own place on the tool.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.base import (
    Batch,
    BatchedModel,
    Linearization,
    MeasurementModel,
)
from calib_pin.measurement_models.declaration import Declaration, Quantity
from calib_pin.measurement_models.mount import Mounted
from calib_pin.measurement_models.references import ReferenceObject, slices
from calib_pin.measurement_models.side_by_side import by_part
from calib_pin.observations import (
    PART,
    PLUS,
    Booleans,
    Measurements,
    Targets,
    rows_by_part,
)


@dataclass(frozen=True)
class Mixed(MeasurementModel):
    """Values and residuals of several models side by side, told apart by targets.

    Attributes:
        parts: The models by name.
    """

    parts: Mapping[str, MeasurementModel]

    @staticmethod
    def create(parts: Mapping[str, MeasurementModel]) -> Mixed:
        """Mix models; one that follows nothing (a camera) gets frames of its own.

        A name shared by several of them has the parameters of all: a point that is
        known to a camera and estimated by a tracker is estimated.
        """
        mixed = Mixed(
            {
                name: Mounted.of(model)
                if model.declaration.external and not model.declaration.tracks
                else model
                for name, model in parts.items()
            }
        )
        return mixed.with_references(mixed.references)

    @cached_property
    def declaration(self) -> Declaration:
        """That of all parts together.

        Quantities that two of them have are named with the part. A base frame is
        external, and measurements have a start, where those of some part do.
        """
        stated = [part.declaration for part in self.parts.values()]
        names = [q.name for one in stated for q in one.quantities]
        quantities: list[Quantity] = []
        for one in stated:
            first = quantities[-1].columns.stop if quantities else 0
            quantities += [
                replace(
                    q,
                    name=f"{q.name} ({one.name})"
                    if names.count(q.name) > 1
                    else q.name,
                    noise=q.name,
                    columns=slice(first + q.columns.start, first + q.columns.stop),
                )
                for q in one.quantities
            ]
        return Declaration(
            name=PLUS.join(self.parts),
            help="",
            components=tuple(name for one in stated for name in one.components),
            quantities=tuple(quantities),
            contact=all(one.contact for one in stated),
            relative=any(one.relative for one in stated),
            external=any(one.external for one in stated),
        )

    @property
    def width(self) -> int:
        """Columns of all parts."""
        return sum(part.width for part in self.parts.values())

    @property
    def sees_tool(self) -> bool:
        """Whether some part does."""
        return any(part.sees_tool for part in self.parts.values())

    @property
    def missing(self) -> str:
        """Things that the first part lacks that lacks any."""
        return next(filter(None, (p.missing for p in self.parts.values())), "")

    @property
    def targets(self) -> Sequence[str]:
        """Those of all parts, qualified."""
        return tuple(
            f"{name}{PART}{target}"
            for name, part in self.parts.items()
            for target in part.targets or ("",)
        )

    @property
    def references(self) -> Sequence[ReferenceObject]:
        """Those of all parts, each once."""
        found: dict[tuple[str, str], ReferenceObject] = {}
        for part in self.parts.values():
            for reference in part.references:
                other = found.setdefault(_key(reference), reference)
                if len(reference.parameters) > len(other.parameters):
                    found[_key(reference)] = reference
        return tuple(found.values())

    def with_references(self, references: Sequence[ReferenceObject]) -> Mixed:
        """The same with its reference objects about other references."""
        of = {_key(reference): reference for reference in references}
        return Mixed(
            {
                name: part.with_references([of[_key(f)] for f in part.references])
                for name, part in self.parts.items()
            }
        )

    def extended(self, T: Floats, data: Measurements) -> Mixed:
        """Every part extended by its measurements, with what those before located."""
        mixed = self
        for name, (rows, seen) in by_part(data).items():
            part = mixed.parts[name].extended(T[rows], seen)
            mixed = Mixed({**mixed.parts, name: part})
        return mixed

    def predict(self, T: Floats, instrument: Floats, target: Targets) -> Floats:
        """Values of all parts side by side, shape (N, D)."""
        result = np.zeros((len(T), self.width))
        for name, rows, names in self._split(target):
            part, columns = self.parts[name], self._layout[name][0]
            result[rows, columns] = part.predict(
                T[rows], instrument[self._instrument[name]], names
            )
        return result

    def observable(self, T: Floats, instrument: Floats, target: Targets) -> Booleans:
        """Whether each measurement's part can measure there."""
        result = np.ones(len(T), bool)
        for name, rows, names in self._split(target):
            part = self.parts[name]
            result[rows] = part.observable(
                T[rows], instrument[self._instrument[name]], names
            )
        return result

    def disturb(self, values: Floats, noise: Floats) -> Floats:
        """Every part's own values with its own noise."""
        result = np.array(values)
        for name, part in self.parts.items():
            columns, components = self._layout[name]
            result[:, columns] = part.disturb(values[:, columns], noise[:, components])
        return result

    def residual(self, T: Floats, instrument: Floats, data: Measurements) -> Floats:
        """Residuals of all parts side by side, shape (N, d)."""
        result = np.zeros((len(T), self._components))
        for name, (rows, seen) in by_part(data).items():
            part, components = self.parts[name], self._layout[name][1]
            result[rows, components] = part.residual(
                T[rows], instrument[self._instrument[name]], seen
            )
        return result

    def linearize(
        self, T: Floats, instrument: Floats, data: Measurements
    ) -> Linearization:
        """Linearizations of all parts side by side."""
        shape = (len(T), self._components)
        residual, J_pose = np.zeros(shape), np.zeros((*shape, 6))
        J_instrument = np.zeros((*shape, len(instrument)))
        for name, (rows, seen) in by_part(data).items():
            index, components = self._instrument[name], self._layout[name][1]
            found = self.parts[name].linearize(T[rows], instrument[index], seen)
            residual[rows, components] = found.residual
            J_pose[rows, components] = found.J_pose
            block = np.zeros((*found.residual.shape, len(instrument)))
            block[:, :, index] = found.J_instrument
            J_instrument[rows, components] = block
        return Linearization(residual, J_pose, J_instrument)

    def batches(self, data: Measurements, weights: Floats) -> Sequence[Batch]:
        """Those of all parts; none where one has none."""
        result: list[Batch] = []
        for name, (rows, seen) in by_part(data).items():
            part, components = self.parts[name], self._layout[name][1]
            found: Sequence[Batch] = []
            if isinstance(part, BatchedModel):
                found = part.batches(seen, weights[rows, components])
            if not found:
                return []
            result += [_within(batch, rows, self._instrument[name]) for batch in found]
        return result

    def register(
        self, F: Floats, data: Measurements, base: pin.SE3 | None, tool: pin.SE3 | None
    ) -> tuple[Mixed, pin.SE3, pin.SE3]:
        """Part by part: each takes over what those before it have located.

        A model with its own measurement frame comes first, since sites stand in it.
        """
        mixed = self

        def turn(name: str) -> tuple[bool, bool, bool]:
            part = self.parts[name]
            # Points are located about a tool that others may tell more of.
            mounted = isinstance(part, Mounted)
            return mounted, not part.declaration.external, not part.sees_tool

        for name in sorted(by_part(data), key=turn):
            (rows, seen), part = by_part(data)[name], mixed.parts[name]
            found, new_base, new_tool = part.register(F[rows], seen, base, tool)
            # A part that sees no base or tool frame has nothing to say of it.
            if part.declaration.external or not self.declaration.external:
                base = base or new_base
            if part.sees_tool:
                tool = tool or new_tool
            located = {_key(f): f for f in found.references if f.located}
            mixed = mixed.with_references(
                [located.get(_key(f), f) for f in mixed.references]
            )
        return mixed, base or pin.SE3.Identity(), tool or pin.SE3.Identity()

    def unstated(self, target: Targets) -> Floats:
        """Standard deviations of measurements that state none, shape (N, d)."""
        result = np.full((len(target), self._components), np.inf)
        for name, rows in rows_by_part(target).items():
            result[rows, self._layout[name][1]] = np.nan
        return result

    @cached_property
    def _layout(self) -> Mapping[str, tuple[slice, slice]]:
        """Columns of the values and components of the residual of every part."""
        result, a, b = {}, 0, 0
        for name, part in self.parts.items():
            c, d = a + part.width, b + part.quantities[-1].columns.stop
            result[name] = slice(a, c), slice(b, d)
            a, b = c, d
        return result

    @property
    def _components(self) -> int:
        """Components of the residual."""
        return int(self.quantities[-1].columns.stop)

    @cached_property
    def _instrument(self) -> Mapping[str, NDArray[np.intp]]:
        """Where each part's parameters stand among those of all."""
        references = self.references
        at = dict(zip(map(_key, references), slices(references), strict=True))
        empty = [np.zeros(0, np.intp)]
        return {
            name: np.concatenate(
                empty
                + [
                    np.arange(at[_key(f)].start, at[_key(f)].stop)
                    for f in part.references
                ]
            )
            for name, part in self.parts.items()
        }

    def _split(
        self, target: Targets
    ) -> Iterator[tuple[str, NDArray[np.intp], tuple[str, ...]]]:
        """Name, rows and plain targets of every part that has rows."""
        for name, rows in rows_by_part(target).items():
            start = len(name) + 1
            yield name, rows, tuple(target[k][start:] for k in rows.tolist())


def assumed_sigma(measurement: MeasurementModel, noise: Mapping[str, float]) -> Floats:
    """Standard deviation of the residual components where rows state none, (d,)."""
    return np.concatenate(
        [
            np.full(
                quantity.columns.stop - quantity.columns.start,
                noise.get(quantity.noise or quantity.name, quantity.sigma),
            )
            for quantity in measurement.quantities
        ]
    )


def absent(measurement: MeasurementModel, target: Targets) -> Floats | None:
    """Standard deviations of mixed rows that state none, see `Measurements.sigma`."""
    if not isinstance(measurement, Mixed):
        return None
    return measurement.unstated(target)


def relative_rows(measurement: MeasurementModel, target: Targets) -> Booleans:
    """The rows that are measured relative to a start, shape (N,)."""
    return _rows_where(measurement, target, lambda part: part.declaration.relative)


def contact_rows(measurement: MeasurementModel, target: Targets) -> Booleans:
    """The rows at which the tool touches something, shape (N,)."""
    return _rows_where(measurement, target, lambda part: part.declaration.contact)


def _rows_where(
    measurement: MeasurementModel,
    target: Targets,
    holds: Callable[[MeasurementModel], bool],
) -> Booleans:
    """The rows of whose measurement model something holds, shape (N,).

    Args:
        measurement: The measurement model.
        target: Target of each row.
        holds: Whether it does of a model, a part of a mixed one.
    """
    if not isinstance(measurement, Mixed):
        return np.full(len(target), holds(measurement))
    result = np.zeros(len(target), bool)
    for name, rows in rows_by_part(target).items():
        result[rows] = holds(measurement.parts[name])
    return result


def qualified(
    names: Sequence[str], targets: Sequence[str]
) -> dict[str, tuple[str, ...]]:
    """The plain targets of every part.

    Args:
        names: Names of the parts.
        targets: Targets that are qualified by these.
    """
    found: dict[str, dict[str, None]] = {name: {} for name in names}
    for target in dict.fromkeys(targets):
        part, _, plain = target.partition(PART)
        found[part][plain] = None
    return {name: tuple(plain) for name, plain in found.items()}


def _within(
    batch: Batch, rows: NDArray[np.intp], instrument: NDArray[np.intp]
) -> Batch:
    """A batch of a part among all rows and all parameters.

    Args:
        batch: The batch form of the part's rows.
        rows: Positions of these in the data.
        instrument: Positions of the part's parameters among the instrument's.
    """
    return replace(
        batch,
        rows=rows[batch.rows],
        geometry=lambda values: batch.geometry(values[:, instrument]),
    )


def _key(reference: ReferenceObject) -> tuple[str, str]:
    return reference.section, reference.name
