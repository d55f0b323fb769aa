"""Measurements of all blocks before their parts, with their standard deviations."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib_pin.estimation.layout import Layout
from calib_pin.estimation.system import Part, System
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements, Observations
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


@dataclass(frozen=True)
class Measured(System):
    """A system and what its instruments have measured.

    Attributes:
        data: The measurements; a block of which there is a part for each key.
        setup: What the user states; here the noise where the data do not state it.
        units: Standard deviation of unit weight of every quantity of every instrument,
            shape (K,): what the stated or assumed standard deviations are multiplied
            by; empty for ones.
    """

    data: Observations
    setup: Setup = field(default_factory=Setup)
    units: Floats = field(default_factory=lambda: np.zeros(0))

    @cached_property
    def layout(self) -> Layout:
        """Measurement and quantity of each residual component."""
        quantities = {
            key: part.measurement.quantities for key, part in self.parts.items()
        }
        return Layout.of(self.data, quantities)

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
    def given_sigma(self) -> Floats:
        """Standard deviations that are stated or assumed, shape (M,)."""
        found = [
            (
                np.tile(assumed_sigma(part, self.setup), (len(data), 1))
                if data.sigma is None
                else data.sigma
            ).reshape(-1)
            for part, data, _, _ in self.blocks
        ]
        return found[0] if len(found) == 1 else np.concatenate(found)

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
