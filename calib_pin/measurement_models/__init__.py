"""Measurement models: how the pose of the tool becomes a measured value.

A new one is a file with a `DeclaredModel` and its line in `catalog`, or an entry point
of another package, see `plugins`.
"""

from __future__ import annotations

from collections.abc import Sequence

from calib_pin.measurement_models.base import (
    Batch,
    BatchedModel,
    DeclaredModel,
    Linearization,
    MeasurementModel,
)
from calib_pin.measurement_models.catalog import MEASUREMENT_MODELS, declared
from calib_pin.measurement_models.declaration import (
    Declaration,
    Inference,
    Naming,
    Quantity,
)
from calib_pin.setup import Setup

__all__ = [
    "MEASUREMENT_MODELS",
    "Batch",
    "BatchedModel",
    "Declaration",
    "DeclaredModel",
    "Inference",
    "Linearization",
    "MeasurementModel",
    "Naming",
    "Quantity",
    "declared",
    "measurement_model",
]


def measurement_model(
    name: str, setup: Setup, targets: Sequence[str] = ()
) -> MeasurementModel:
    """The measurement model of a name.

    Args:
        name: Name of the model, such as `position`.
        setup: The setup of the user, such as its planes.
        targets: The targets that measurements name, each once.

    Raises:
        OptionError: If there is no such model, or the setup lacks what it needs.
    """
    declared(name)
    return MEASUREMENT_MODELS[name].from_setup(setup, tuple(targets))
