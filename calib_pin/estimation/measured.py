"""Measurements of all blocks before their parts, with their standard deviations."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, fields
from functools import cached_property
from typing import Any, NamedTuple

import numpy as np

from calib_pin.estimation.layout import Layout
from calib_pin.estimation.system import Part, System
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Measurements, Observations
from calib_pin.setup import Setup


class Block(NamedTuple):
    """A block of measurements before its part.

    Attributes:
        part: The part.
        data: The measurements, with the joints of the part's chain.
        rows: Where they stand among all measurements.
        values: Where their residual components stand among all.
    """

    part: Part
    data: Measurements
    rows: slice
    values: slice

    def table(self, flat: Floats) -> Floats:
        """Components of all measurements as a table of these, (M,) -> (N, d)."""
        return np.asarray(flat[self.values].reshape(len(self.data), -1))


@dataclass(eq=False)
class Shared:
    """Known to all problems with the same measurements, as soon as one asks.

    Attributes:
        layout: Measurement and quantity of each residual component.
        given_sigma: Standard deviations that are stated or assumed, shape (M,).
        evaluated: The last evaluators: of which parts, with which standard deviations,
            whether of very many measurements, with the positions of their blocks.
    """

    layout: Layout | None = None
    given_sigma: Floats | None = None
    evaluated: tuple[object, Floats, bool, dict[Any, Sequence[int]]] | None = None


@dataclass(frozen=True, eq=False)
class Prepared:
    """Measurements before their parts; very many take time to prepare.

    Attributes:
        parts: The part of each block, by what its measurements have in common.
        data: The measurements.
        setup: What the user states.
        shared: What does not change with weights and references.
    """

    parts: Mapping[BlockKey, Part]
    data: Observations
    setup: Setup
    shared: Shared = field(default_factory=Shared)

    def of(
        self, parts: Mapping[BlockKey, Part], data: Observations, setup: Setup
    ) -> Prepared:
        """The same of others, with as much in common as these have."""
        if parts is self.parts and data is self.data and setup is self.setup:
            return self
        alike = setup is self.setup and list(parts) == list(self.parts)
        alike = alike and same_but_weights(data, self.data)
        return Prepared(parts, data, setup, self.shared if alike else Shared())

    @property
    def layout(self) -> Layout:
        """Measurement and quantity of each residual component."""
        if self.shared.layout is None:
            quantities = {
                key: part.measurement.quantities for key, part in self.parts.items()
            }
            self.shared.layout = Layout.of(self.data, quantities)
        return self.shared.layout

    @property
    def given_sigma(self) -> Floats:
        """Standard deviations that are stated or assumed, shape (M,)."""
        if self.shared.given_sigma is None:
            found = [
                (
                    np.tile(assumed_sigma(part, self.setup), (len(data), 1))
                    if data.sigma is None
                    else data.sigma
                ).reshape(-1)
                for part, data, _, _ in self.blocks
            ]
            self.shared.given_sigma = (
                found[0] if len(found) == 1 else np.concatenate(found)
            )
        return self.shared.given_sigma

    @cached_property
    def blocks(self) -> tuple[Block, ...]:
        """Every block of measurements with its part."""
        result, start = [], 0
        for data, rows in zip(self.data.blocks, self.data.slices, strict=True):
            part = self.parts[data.key]
            own = part.of_chain(data)
            assert isinstance(own, Measurements)
            stop = start + len(data) * part.components
            result.append(Block(part, own, rows, slice(start, stop)))
            start = stop
        return tuple(result)


def same_but_weights(data: Observations, other: Observations) -> bool:
    """Whether observations share all of their arrays but the weights."""
    if len(data.blocks) != len(other.blocks):
        return False
    names = [field.name for field in fields(Measurements) if field.name != "weight"]
    pairs = zip(data.blocks, other.blocks, strict=True)
    return all(getattr(a, n) is getattr(b, n) for a, b in pairs for n in names)


@dataclass(frozen=True)
class Measured(System):
    """A system and what its instruments have measured.

    Attributes:
        data: The measurements; a block of which there is a part for each key.
        setup: What the user states; here the noise where the data do not state it.
        units: Standard deviation of unit weight of every quantity of every instrument,
            shape (K,): what the stated or assumed standard deviations are multiplied
            by; empty for ones.
        prepared: What does not change with weights, units and priors; passed on.
    """

    data: Observations
    setup: Setup = field(default_factory=Setup)
    units: Floats = field(default_factory=lambda: np.zeros(0))
    prepared: Prepared | None = field(default=None, repr=False, compare=False)

    def __post_init__(self) -> None:
        """Take over what was prepared of these measurements."""
        known = self.prepared or Prepared(self.parts, self.data, self.setup)
        known = known.of(self.parts, self.data, self.setup)
        object.__setattr__(self, "prepared", known)

    @property
    def layout(self) -> Layout:
        """Measurement and quantity of each residual component."""
        return self._prepared.layout

    @property
    def blocks(self) -> tuple[Block, ...]:
        """Every block of measurements with its part."""
        return self._prepared.blocks

    @property
    def given_sigma(self) -> Floats:
        """Standard deviations that are stated or assumed, shape (M,)."""
        return self._prepared.given_sigma

    @property
    def _prepared(self) -> Prepared:
        assert self.prepared is not None
        return self.prepared

    @cached_property
    def sigma(self) -> Floats:
        """Standard deviation of every residual component, shape (M,).

        It is what whitens: the given one with the unit weight of its quantity, infinite
        for measurements that are set aside.
        """
        sigma, weight = self.given_sigma, self.data.weight
        if len(self.units):
            sigma = sigma * self.units[self.layout.component]
        if (weight == 1.0).all():
            return sigma
        with np.errstate(divide="ignore"):
            return np.asarray(sigma / np.sqrt(weight)[self.layout.row])

    @cached_property
    def values(self) -> int:
        """Number of measured values that count."""
        return int(np.isfinite(self.sigma).sum())


def assumed_sigma(part: Part, setup: Setup) -> Floats:
    """Standard deviations of the components of measurements that state none, (d,)."""
    return np.concatenate(
        [
            np.full(
                quantity.columns.stop - quantity.columns.start,
                setup.noise.get(quantity.name, quantity.sigma),
            )
            for quantity in part.measurement.quantities
        ]
    )
