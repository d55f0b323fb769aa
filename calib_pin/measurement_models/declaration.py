"""A measurement model, declared once: its columns, residual, target and scope.

Files, messages, simulation, planning and reports ask the declaration for the property
that matters to them, never for the name of a model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Literal

import numpy as np

from calib_pin.kinematics.spatial import Floats

QUATERNION = ("qx", "qy", "qz", "qw")
"""Columns of the values that hold an orientation."""

ROTATION_VECTOR = ("rx", "ry", "rz")
"""Components of the residual of an orientation."""

DEVIATION, DIAL = "deviation", "dial"
"""How far a contact is off, and the same as a gauge shows it: pushed in is positive."""

INSTRUMENT = "the unit and the calibration of the instrument"
"""Where the lengths of an instrument that measures lengths come from."""


@dataclass(frozen=True)
class Quantity:
    """One physical quantity within the residual.

    Attributes:
        name: Name in reports, such as `position`.
        unit: `m`, `rad` or `px`.
        columns: The residual components that belong to it.
        sigma: Standard deviation assumed where none is stated.
    """

    name: str
    unit: str
    columns: slice
    sigma: float

    @property
    def dimension(self) -> int:
        """How many residual components it has."""
        return int(self.columns.stop - self.columns.start)

    def errors(self, residual: Floats) -> Floats:
        """Size of the error of each measurement of this quantity, (N, d) -> (n,).

        The others have NaN.
        """
        sizes = np.linalg.norm(residual[:, self.columns], axis=1)
        return np.asarray(sizes[~np.isnan(sizes)])


@dataclass(frozen=True)
class Naming:
    """The objects that the `target` of measurements names.

    Attributes:
        noun: Its name in messages, such as `socket`.
        required: Whether every measurement has to name one, all or none of a file, or
            whether that is left to the model.
        configurations: Configurations that every unknown target needs to tell anything.
    """

    noun: str = "target"
    required: Literal["every", "all or none", "no"] = "no"
    configurations: int = 1


@dataclass(frozen=True)
class Declaration:
    """A measurement model as users and other rooms see it.

    Attributes:
        name: Name as users write it.
        help: One line for users.
        components: Names of the residual components; `sigma_<component>` is a column.
        quantities: The quantities of the residual, in order.
        oriented: Whether an orientation is measured beside the other columns, in any of
            the ways in which a file may state it; its components are `rx ry rz`.
        contact: Whether nothing is measured but that the residual is zero, up to noise.
            Measurements then are configurations at which the tool touches something.
            Where a gauge says how far it is off, that is the residual, see `readings`.
        relative: Whether a measurement starts at one configuration and ends at another,
            so that poses are those of the tool in the tool at its start.
        external: Whether the instrument stands outside, with a measurement frame of its
            own. Then the base frame is unknown unless the setup says otherwise.
        tracks: Part of the tool that an external instrument follows, or empty. One
            that follows nothing (a camera) has frames of its own among others.
        at_once: Whether all targets that the instrument sees at a configuration are
            measured there, as the corners of a board are in an image; others have one
            at a time, such as the plane that a beam meets.
        separable: Whether a target may be wrong while others of its configuration are
            right, as a corner in an image may; those of others fail together.
        naming: Meaning of `target`.
        inferred: How columns show this model: some of them, or only all together, as
            one of a name as short as `u` may mean something else; else only its name.
        yardstick: Where measured lengths come from; empty where none are measured.
        unmeasurable: Why a configuration cannot be measured, after a colon.
    """

    name: str
    help: str
    components: tuple[str, ...]
    quantities: tuple[Quantity, ...]
    oriented: bool = False
    contact: bool = False
    relative: bool = False
    external: bool = False
    tracks: Literal["", "point", "pose"] = ""
    at_once: bool = False
    separable: bool = False
    naming: Naming = Naming()
    inferred: Literal["", "part", "all"] = ""
    yardstick: str = ""
    unmeasurable: str = (
        "the tool does not come into contact from there within the joint limits"
    )

    @property
    def units(self) -> Mapping[str, str]:
        """The unit of each residual component."""
        return {
            name: quantity.unit
            for quantity in self.quantities
            for name in self.components[quantity.columns]
        }

    @property
    def columns(self) -> Mapping[str, str]:
        """The measured columns and their units, beside those of an orientation."""
        turned = ROTATION_VECTOR if self.oriented else ()
        return {
            name: unit
            for name, unit in self.units.items()
            if not self.contact and name not in turned
        }

    @property
    def readings(self) -> Sequence[tuple[str, str]]:
        """The columns of each component of a contact's deviation, where a gauge reads.

        The first is positive away from what is touched or, of several components, along
        the axes of the measurement frame; the second is that of a gauge, positive where
        it is pushed in.
        """
        several = len(self.components) > 1
        axes = [f"_{name}" * several for name in self.components if self.contact]
        return [(DEVIATION + axis, DIAL + axis) for axis in axes]

    @property
    def values(self) -> tuple[str, ...]:
        """The columns of `Measurements.values`."""
        return (*self.columns, *(QUATERNION if self.oriented else ()))

    @property
    def plannable(self) -> bool:
        """Whether each configuration is measured by itself and without contact."""
        return not self.contact and not self.relative
