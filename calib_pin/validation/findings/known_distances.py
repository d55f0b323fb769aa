"""Known distances that the measurements contradict."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.identifiability import half_covariance
from calib_pin.estimation.nominal import analyze_structure
from calib_pin.kinematics.spatial import Floats
from calib_pin.setup import DistanceSetup
from calib_pin.units import DISPLAY

CONTRADICTED = 2e-3
"""By how much measurements may contradict a known distance before the trust goes [m].

The errors that no parameter describes do: two sockets of a plate, 50 mm apart, come out
up to 1.1 mm wrong at places where a real robot was not calibrated.
"""

MISSED = 3e-4
"""From which there is a warning [m]."""

BEYOND = 3.0
"""The same in errors left, rms."""

SIGNIFICANT = 4.5
"""Standard deviations from which it is no chance: by chance one in 150 000 is."""

ROUNDING = 1e-12
"""Least part of a distance that others decide, or of squares; less is rounding."""


def contradicted(
    fitted: Fit, errors: float, robust: Fit | None = None
) -> Iterator[Finding]:
    """The known distance that the measurements contradict most, if they do.

    Of a distance with the whitened residual v that decides the part h of itself, the
    measurements alone say v sigma / (1 - h) else, and the normalized residual is
    w = v / sqrt(1 - h). The one of the largest w is the wrong one, and what it makes
    of the others says nothing (data snooping, Baarda 1968).

    Args:
        fitted: The fit.
        errors: Errors that are left, rms [unit of the first quantity].
        robust: The one that has set all measurements of an end aside, if it is without.
    """
    known = fitted.problem.further.distances
    if not len(known):
        return
    v = known.residual(fitted.theta)
    left = _decided_by_others(fitted, known.jacobian(fitted.theta))
    if fitted.robust.squared is not None and left.min() <= ROUNDING:
        # All measurements of an end are set aside, for one of both must be wrong.
        yield from contradicted(fitted.robust.squared, errors, fitted)
        return
    w = np.abs(v) / np.sqrt(left)
    k = int(np.argmax(w))
    stated = known.stated[k]
    apart = float(v[k] * stated.sigma / left[k])
    metric = fitted.problem.layout.quantities[0].unit == "m" == stated.unit
    least = max(MISSED, BEYOND * errors if metric else 0.0)
    if abs(apart) < min(least, CONTRADICTED) or w[k] < SIGNIFICANT:
        return
    # A wrong distance takes all measurements for coarse ones.
    if not _scaled_without(robust or fitted, stated):
        return
    ends, (unit, factor) = " - ".join(stated.between), DISPLAY[stated.unit]
    what = stated.key.removesuffix("s")
    yield Finding(
        "known-distance",
        "error" if abs(apart) > CONTRADICTED else "warning",
        f"the measurements contradict the known {what} {ends}: without it they find "
        f"{factor * (stated.value + apart):.1f} {unit} instead of "
        f"{factor * stated.value:.1f} {unit} ({w[k]:.0f} standard deviations)",
        {
            "between": ends,
            "value": stated.value,
            "sigma": stated.sigma,
            "found": stated.value + apart,
            "normalized_residual": float(w[k]),
        },
        f"measure this {what} again, or state its true sigma",
    )


def _decided_by_others(fitted: Fit, J: Floats) -> Floats:
    """Part 1 - h of each known distance that is not decided by itself, shape (D,).

    J is that of the whitened distances, shape (D, P).
    """
    # By noise alone, or what a distance decides would be more than all.
    _, result, moved = fitted.held
    half = half_covariance(result.jac, moved, fitted.problem.parameters)
    h = np.sum((J @ half) ** 2, axis=1)
    return np.asarray(np.maximum(1.0 - h, ROUNDING))


def _scaled_without(fitted: Fit, distance: DistanceSetup) -> bool:
    """Whether the scale is known without a distance; else it is what gives it.

    Contacts alone draw a robot together, so what they say of the scale is no check.
    """
    setup, parameters = fitted.problem.setup, fitted.problem.parameters
    others = tuple(d for d in setup.distances if d is not distance)
    problem = replace(
        fitted.problem, setup=replace(setup, distances=others), expected=None
    )
    # What is touched must be where the tool can touch it.
    about = np.where(parameters.nuisance, fitted.before, 0.0)
    return analyze_structure(problem, about, np.random.default_rng(0))[0].scaled
