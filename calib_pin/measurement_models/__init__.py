"""Measurement models: how the pose of the tool becomes a measured value.

A new one is a file with a `DeclaredModel` and its line in `catalog`, or an entry point
of another package, see `plugins`.
"""

from __future__ import annotations

from collections.abc import Sequence

from calib_pin.measurement_models.base import (
    Batch,
    BatchedModel,
    Curvature,
    CurvedModel,
    DeclaredModel,
    Linearization,
    MeasurementModel,
)
from calib_pin.measurement_models.catalog import MEASUREMENT_MODELS, declared, tracked
from calib_pin.measurement_models.declaration import (
    Declaration,
    Inference,
    Naming,
    Quantity,
)
from calib_pin.measurement_models.mixed import Mixed, qualified
from calib_pin.observations import PLUS
from calib_pin.setup import Setup

__all__ = [
    "MEASUREMENT_MODELS",
    "Batch",
    "BatchedModel",
    "Curvature",
    "CurvedModel",
    "Declaration",
    "DeclaredModel",
    "Inference",
    "Linearization",
    "MeasurementModel",
    "Mixed",
    "Naming",
    "Quantity",
    "declared",
    "measurement_model",
    "tracked",
]


def measurement_model(
    name: str, setup: Setup, targets: Sequence[str] = ()
) -> MeasurementModel:
    """The measurement model of a name, or of several with a plus between them.

    Args:
        name: Name of the model, such as `position` or `position+fixed-point`.
        setup: The setup of the user, such as its planes.
        targets: The targets that measurements name; of several models qualified by
            theirs, see `mixed.qualified`.

    Raises:
        OptionError: If there is no such model, or the setup lacks what it needs.
    """
    names = name.split(PLUS)
    for part in names:
        declared(part)  # Of several, an unknown one is named before anything is made.
    if len(names) == 1:
        seen = tuple(dict.fromkeys(targets))
        return MEASUREMENT_MODELS[name].from_setup(setup, seen)
    return Mixed.create(
        {
            part: MEASUREMENT_MODELS[part].from_setup(setup, seen)
            for part, seen in qualified(names, targets).items()
        }
    )
