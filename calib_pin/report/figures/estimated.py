"""The estimates of the robot: parameters and linear combinations of them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.report.figures.labels import shortened
from calib_pin.validation.result import CoupledGroup, ParameterEstimate


@dataclass(frozen=True)
class Estimate:
    """A parameter or a linear combination that is known.

    Attributes:
        label: Its name in figures.
        unit: Its unit.
        value: Estimate.
        sigma: Standard deviation.
        terms: Names of parameters and their coefficients.
    """

    label: str
    unit: str
    value: float
    sigma: float
    terms: tuple[tuple[str, float], ...]


def of_robot(
    parameters: Sequence[ParameterEstimate],
    groups: Sequence[CoupledGroup],
    error: ErrorModel,
) -> list[Estimate]:
    """Identifiable parameters and combinations of the robot, from base to tip.

    A combination that begins with a frame or the instrument is theirs.

    Args:
        parameters: All parameters.
        groups: All coupled groups.
        error: Tells what belongs to the robot.
    """
    own = {parameter.name for parameter in error.parameters if not parameter.nuisance}
    place = {parameter.name: k for k, parameter in enumerate(parameters)}
    found: list[tuple[int, Estimate]] = []
    for p in parameters:
        if p.status == "identifiable" and p.name in own and _known(p.sigma):
            terms = ((p.name, 1.0),)
            found.append((place[p.name], _estimate(shortened(p.name), p, terms)))
    for g in groups:
        if g.terms[0][0] in own and _known(g.sigma):
            at = place[g.terms[0][0]]
            found.append((at, _estimate(f"combination {g.number}", g, g.terms)))
    return [estimate for _, estimate in sorted(found, key=lambda pair: pair[0])]


def _known(sigma: float | None) -> bool:
    return sigma is not None and bool(np.isfinite(sigma))


def _estimate(
    label: str,
    of: ParameterEstimate | CoupledGroup,
    terms: tuple[tuple[str, float], ...],
) -> Estimate:
    assert of.sigma is not None, "only what is known is an estimate"
    return Estimate(label, of.unit, of.value, of.sigma, terms)


def correlation(
    estimates: Sequence[Estimate], places: Mapping[str, int], covariance: Floats
) -> Floats:
    """Correlation of estimates, shape (n, n); NaN for one without a variance.

    Args:
        estimates: The n estimates.
        places: Positions of the parameters by name.
        covariance: Of the parameters, shape (P, P).
    """
    C = np.zeros((len(estimates), len(covariance)))
    for row, estimate in zip(C, estimates, strict=True):
        for name, coefficient in estimate.terms:
            row[places[name]] = coefficient
    S = C @ covariance @ C.T
    variance = np.diag(S)
    sigma = np.sqrt(np.where(variance > 0.0, variance, np.nan))
    return np.asarray(np.clip(S / np.outer(sigma, sigma), -1.0, 1.0))
