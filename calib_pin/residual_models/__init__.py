"""Learned corrections of non-geometric errors, by the names users write."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any, Literal

from calib_pin.residual_models.base import (
    LearnedCorrection,
    Linearized,
    ResidualModel,
    Shifts,
    Space,
    TrainingRows,
)
from calib_pin.setup.arguments import Parser

__all__ = [
    "RESIDUAL_MODELS",
    "LearnedCorrection",
    "Linearized",
    "Shifts",
    "Space",
    "TrainingRows",
    "restore",
]


Fitter = Callable[..., ResidualModel]
"""Fit of a residual model, as `network.fit_network`: of rows, a generator, progress."""


# The members bring scipy, which takes as long to load as Pinocchio; most calibrations
# learn nothing.
def _fit_network(*given: Any, **options: Any) -> ResidualModel:
    from calib_pin.residual_models.network import fit_network

    return fit_network(*given, **options)


def _fit_gaussian_process(*given: Any, **options: Any) -> ResidualModel:
    from calib_pin.residual_models.gaussian_process import fit_gaussian_process

    return fit_gaussian_process(*given, **options)


Kind = Literal["network", "gaussian-process"]

RESIDUAL_MODELS: Mapping[str, Fitter] = {
    "network": _fit_network,
    "gaussian-process": _fit_gaussian_process,
}
"""Fit of each residual model."""


def restore(document: object, joints: int) -> ResidualModel:
    """The residual model of a document; nothing in it is ever run.

    Args:
        document: A document of `ResidualModel.document`, perhaps through JSON.
        joints: Number n of joints of the chain that it belongs to.

    Raises:
        ValueError: With the reason, if it is anything else.
    """
    parser = Parser(document=True)
    parts = parser.parse(document, Mapping[str, Any], ("residual model",))
    kind = parser.parse(parts.get("kind"), Kind, ("kind",))
    if kind == "network":
        from calib_pin.residual_models.network import Network

        return Network.restore(parts, joints)
    from calib_pin.residual_models.gaussian_process import GaussianProcess

    return GaussianProcess.restore(parts, joints)
