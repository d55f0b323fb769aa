"""Learned corrections of what geometry cannot explain, by the names users write."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Protocol

import numpy as np

from calib_pin.progress import Progress
from calib_pin.residual_models.base import (
    Linearized,
    ResidualModel,
    Space,
    TrainingRows,
)
from calib_pin.residual_models.correction import LearnedCorrection
from calib_pin.residual_models.documents import checked, stated
from calib_pin.residual_models.gaussian_process import (
    GaussianProcess,
    GaussianProcessOptions,
    fit_gaussian_process,
)
from calib_pin.residual_models.network import Network, NetworkOptions, fit_network
from calib_pin.residual_models.region import TrainedRegion

__all__ = [
    "RESIDUAL_MODELS",
    "GaussianProcess",
    "GaussianProcessOptions",
    "LearnedCorrection",
    "Linearized",
    "Network",
    "NetworkOptions",
    "ResidualModel",
    "Space",
    "TrainedRegion",
    "TrainingRows",
    "fit_gaussian_process",
    "fit_network",
    "restore",
]


class Fitter(Protocol):
    """How a residual model is fitted."""

    def __call__(
        self,
        rows: TrainingRows,
        rng: np.random.Generator,
        *,
        progress: Progress | None = None,
    ) -> ResidualModel:
        """A model of the rows."""
        ...


RESIDUAL_MODELS: Mapping[str, Fitter] = {
    "network": fit_network,
    "gaussian-process": fit_gaussian_process,
}
"""How each residual model is fitted."""

_RESTORED: Mapping[str, Callable[[Mapping[str, Any], int], ResidualModel]] = {
    "network": Network.restore,
    "gaussian-process": GaussianProcess.restore,
}


def restore(document: object, joints: int) -> ResidualModel:
    """The residual model of a document; nothing in it is ever run.

    Args:
        document: What `ResidualModel.document` gave, perhaps through JSON.
        joints: Number n of joints of the chain that it belongs to.

    Raises:
        ValueError: With the reason, if it is anything else.
    """
    parts = checked(document, "residual model")
    return _RESTORED[stated(parts, "kind", tuple(_RESTORED))](parts, joints)
