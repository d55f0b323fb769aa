"""Joint priors as JSON: that of robots of one type, a file, and that of one robot.

    {"format": "calib-pin/fleet-prior", "version": 1,
     "robot": {"name", "joints": [{"name", "axis", "placement"}]},
     "robots": 200,       # that it was made from
     "parameters": [{"name", "unit", "mean", "sigma", "spread", "robots"}],
     "covariance": [],    # of the next robot's errors about the means
     "noise": {}}         # by quantity

That of an older calibration is part of the results that it began. Its format is
`calib-pin/robot-prior`; it has neither robots nor spreads.

All numbers are in SI units. What they mean stands at `setup.population`.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from calib_pin.io.files import read_bytes, write_atomically
from calib_pin.io.json_text import (
    Json,
    decoded,
    encode,
    format_keys,
    plain,
    reading,
    typed,
)
from calib_pin.setup import JointPrior, PopulationPrior

FORMAT, OF_ROBOT = "calib-pin/fleet-prior", "calib-pin/robot-prior"
"""The format of a prior by other robots, and of one by an older calibration."""

SYMMETRIC = 1e-9
"""Largest part of a correlation that may differ from its mirror image."""


def prior_document(prior: JointPrior) -> Json:
    """A prior as plain data."""
    name = FORMAT if isinstance(prior, PopulationPrior) else OF_ROBOT
    return {**format_keys(name), **plain(prior)}


def prior_of(document: Mapping[str, Any]) -> JointPrior:
    """The prior of plain data.

    Raises:
        KeyError, TypeError, ValueError, AttributeError: If it is none, see
            `json_text.reading`.
    """
    kind = JointPrior if document.get("format") == OF_ROBOT else PopulationPrior
    prior = typed(kind, document)
    C = np.array(prior.covariance)
    if not np.isfinite([*C.flat, *(p.mean for p in prior.parameters)]).all():
        raise ValueError("a number is missing, or infinite")
    if not all(0.0 < sigma < np.inf for sigma in prior.noise.values()):
        raise ValueError("'noise' has a standard deviation that is none")
    if C.shape != (count := len(set(prior.names)), len(prior.names)):
        raise ValueError(f"'covariance' does not have {count} rows and columns")
    deviations = np.diag(np.linalg.cholesky(C))
    if np.abs((C - C.T) / np.outer(deviations, deviations)).max() > SYMMETRIC:
        raise ValueError("'covariance' is not symmetric")
    return prior


def read_population_prior(path: str | Path) -> PopulationPrior:
    """The prior of a file.

    Args:
        path: The file.

    Raises:
        InputError: If it is no such file, of a later version, or damaged.
    """
    document = decoded(read_bytes(path), "fleet's prior", FORMAT, path)
    with reading(path, "prior"):
        prior = prior_of(document)
    assert isinstance(prior, PopulationPrior)
    return replace(prior, file=str(path))


def write_population_prior(
    prior: PopulationPrior, path: str | Path, *, force: bool = False
) -> None:
    """Write a prior to a file.

    Args:
        prior: The prior.
        path: The new file.
        force: Replace an existing file.

    Raises:
        OptionError: If the file exists.
        OutputError: If it cannot be written.
    """
    write_atomically(Path(path), encode(prior_document(prior)), force=force)
