"""Where residual components belong: measurement, quantity, column of a table."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.declaration import Quantity
from calib_pin.observations import BlockKey, Observations


@dataclass(frozen=True)
class Component:
    """One quantity of one instrument at one station, whose noise is one unknown.

    Attributes:
        name: Name in reports: that of the quantity, with the model and the station
            behind it where others have the same.
        quantity: The quantity.
        model: Name of the measurement model.
        station: Name of the station.
    """

    name: str
    quantity: Quantity
    model: str
    station: str


@dataclass(frozen=True)
class Layout:
    """The M residual components of N measurements.

    Attributes:
        row: Measurement of each, shape (M,).
        component: Position of its quantity among `components`, shape (M,).
        column: Column of the table that is shown, shape (M,).
        components: The K quantities of all instruments.
        quantities: The quantities of all models, with their columns of the table.
        of_keys: Position among `components` of each residual component of the
            measurements of a block, shape (d,).
    """

    row: NDArray[np.int32]
    component: NDArray[np.int32]
    column: NDArray[np.int32]
    components: tuple[Component, ...]
    quantities: tuple[Quantity, ...]
    of_keys: Mapping[BlockKey, NDArray[np.int64]]

    @staticmethod
    def of(
        data: Observations, measured: Mapping[BlockKey, Sequence[Quantity]]
    ) -> Layout:
        """The layout of measurements.

        Args:
            data: The measurements.
            measured: The quantities of each block, also of those without measurements.
        """
        models = {key.model: quantities for key, quantities in measured.items()}
        shown, first = side_by_side(models)
        components = _components(measured)
        keys = [(c.model, c.station, c.quantity.name) for c in components]
        position = {key: k for k, key in enumerate(keys)}
        of_keys = {}
        for key, quantities in measured.items():
            own = [position[key.model, key.station, q.name] for q in quantities]
            widths = [q.columns.stop - q.columns.start for q in quantities]
            of_keys[key] = np.repeat(own, widths)
        parts = []
        for block, rows in zip(data.blocks, data.slices, strict=True):
            of_key = of_keys[block.key].astype(np.int32)
            place = first[block.model] + np.arange(len(of_key), dtype=np.int32)
            each = np.arange(rows.start, rows.stop, dtype=np.int32)
            row, tiled = np.repeat(each, len(of_key)), (of_key, place)
            parts.append((row, *(np.tile(of, len(block)) for of in tiled)))
        row, component, column = map(np.concatenate, zip(*parts, strict=True))
        return Layout(row, component, column, components, shown, of_keys)

    @cached_property
    def of_components(self) -> Sequence[NDArray[np.intp]]:
        """Where the residual components of each stand, ascending."""
        order = np.argsort(self.component, kind="stable")
        ends = np.cumsum(np.bincount(self.component, minlength=len(self.components)))
        return np.split(order, ends[:-1])

    @property
    def width(self) -> int:
        """Columns of the table that is shown."""
        return int(self.quantities[-1].columns.stop)

    def table(self, flat: Floats, count: int, absent: float = np.nan) -> Floats:
        """Components side by side, those of other models absent, (M,) -> (count, D)."""
        result = np.full((count, self.width), absent)
        result[self.row, self.column] = flat
        return result


def side_by_side(
    models: Mapping[str, Sequence[Quantity]],
) -> tuple[tuple[Quantity, ...], Mapping[str, int]]:
    """Columns of a table that is shown, which has those of all models.

    Args:
        models: The quantities of each model.

    Returns:
        The quantities of all with these columns, and the first column of each model.
    """
    names = Counter(q.name for found in models.values() for q in found)
    shown: list[Quantity] = []
    first: dict[str, int] = {}
    for model, quantities in models.items():
        first[model] = at = shown[-1].columns.stop if shown else 0
        for q in quantities:
            name = f"{q.name} ({model})" if names[q.name] > 1 else q.name
            columns = slice(at + q.columns.start, at + q.columns.stop)
            shown.append(replace(q, name=name, columns=columns))
    return tuple(shown), first


def alike(layout: Layout, known: Layout) -> NDArray[np.intp]:
    """Position of every component of a layout among those of a fit, shape (K,).

    At a station that was not fitted an instrument measures as it does at the first one.

    Args:
        layout: The layout; each of its instruments was fitted somewhere.
        known: The layout of the fit.
    """
    position: dict[tuple[str, ...], int] = {}
    for k, c in enumerate(known.components):
        position[c.model, c.quantity.name, c.station] = k
        position.setdefault((c.model, c.quantity.name), k)
    names = [(c.model, c.quantity.name, c.station) for c in layout.components]
    return np.array([position.get(n, position[n[:2]]) for n in names], np.intp)


def _components(
    measured: Mapping[BlockKey, Sequence[Quantity]],
) -> tuple[Component, ...]:
    """The quantities of all instruments, each once."""
    found = {
        (q.name, key.model, key.station): q
        for key, quantities in measured.items()
        for q in quantities
    }
    stations = Counter((name, model) for name, model, _ in found)
    models = Counter(name for name, _ in stations)
    result = []
    for (name, model, station), quantity in found.items():
        told = [model] if models[name] > 1 else []
        if station and stations[name, model] > 1:
            told.append(station)
        full = f"{name} ({', '.join(told)})" if told else name
        result.append(Component(full, quantity, model, station))
    return tuple(result)
