"""Whether an instrument drifts, and how much, as the measurements say.

Its increments (`parameterizations/drift`) are random effects beside the noise: all
shifts have one unknown variance, all turns another. So are gears and compliance that
the model lacks (`statistics/systematic`): where the robot was measured along a path
they are as smooth over the time as a drift. The fit of a still instrument gives the
residuals; restricted maximum likelihood gives all variances, and the likelihood ratio
says whether a drift is more than chance beside the others. What is not is zero from
then on, so that an instrument that stands still costs no accuracy.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.conditions import at_conditions, require_conditions
from calib_pin.estimation.directions import half_covariance
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.statistics.restricted_likelihood import (
    EXACT,
    Groups,
    Variances,
    estimate_variances,
    with_effects,
)
from calib_pin.estimation.statistics.systematic import candidates, sampled
from calib_pin.estimation.statistics.variance_components import current_units, grouped
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.parameterizations.drift import USUAL, InstrumentDrift
from calib_pin.setup import DriftSetup, Setup

SIGNIFICANT = 6.63
"""Twice the gain in log-likelihood that a drift must bring: chance brings as much once
in two hundred (half of it has none at all, Self and Liang 1987), and once in a hundred
for either of two."""

KINDS = ("shift", "turn")
"""Names of all that may drift, as a setup states it."""


@serial_blas
def with_drift(
    chains: Chains, measurements: Observations, setup: Setup, seed: int
) -> Setup:
    """The setup with what it leaves to the measurements, and the drift they show.

    Args:
        chains: The nominal chains.
        measurements: The measurements to fit.
        setup: The setup; what it states of the drift stands.
        seed: Seed of the fit of an instrument that stands still.

    Raises:
        InputError: If a measurement does not state a condition that is needed.
    """
    require_conditions(measurements, setup)
    setup = at_conditions(chains, measurements, setup)
    unknown = [kind for kind in KINDS if getattr(setup.drift, kind) is None]
    if InstrumentDrift.name not in setup.parameters or not unknown:
        return setup
    still = _sized(setup.drift, dict.fromkeys(unknown, 0.0))
    plain = replace(setup, drift=still, learned=None)
    fitted = fit(make_problem(chains, measurements, plain), np.random.default_rng(seed))
    sizes = _sizes(fitted, chains, setup, unknown)
    return replace(setup, drift=_sized(still, sizes))


def _sizes(
    fitted: Fit, chains: Chains, setup: Setup, unknown: list[str]
) -> dict[str, float]:
    """Standard deviations of what drifts by more than chance."""
    sample = replace(fitted.problem, data=sampled(fitted.problem))
    fun, jac = sample.linearize_rows(fitted.theta)
    measured = fun[: len(sample.layout.row)]
    moving = _moving(sample, chains, setup, unknown)
    drifting = {p.name: p for p in moving.given if p.name not in sample.given.names}
    if not drifting or float(measured @ measured) <= EXACT * sample.values:
        return {}
    values = dict(zip(sample.given.names, fitted.theta, strict=True))
    _, J = moving.linearize_rows(moving.given.vector(values))
    columns = [moving.given.index(name) for name in drifting]
    X = np.zeros((len(fun), len(columns)))
    X[: len(measured)] = J[: len(measured), columns]
    X *= moving.given.scales[columns]
    half = half_covariance(jac, fitted.directions.basis, sample.parameters)
    robot, of_robot = np.zeros((len(fun), 0)), np.zeros(0, str)
    effects = candidates(sample)
    if effects is not None:
        rows = np.zeros((len(fun), len(effects.names)))
        rows[: len(measured)] = effects.rows(sample, fitted.theta)
        if np.isfinite(rows).all():
            robot, of_robot = rows, effects.kinds
    groups = grouped(sample, np.column_stack([jac @ half, robot, X, fun]))
    of_unit = dict(zip(("m", "rad"), KINDS, strict=True))
    of_drift = np.array([of_unit[p.unit] for p in drifting.values()])
    kind_of = np.concatenate([of_robot, of_drift])
    return _significant(groups, kind_of, current_units(sample) ** 2)


def _moving(
    sample: Problem, chains: Chains, setup: Setup, unknown: list[str]
) -> Problem:
    """The problem with a drift of the usual size, about the same references."""
    drift = _sized(setup.drift, dict.fromkeys(unknown, USUAL))
    found = make_problem(chains, sample.data, replace(sample.setup, drift=drift))
    parts = {
        key: replace(
            part,
            error=part.error.with_frames(
                sample.parts[key].error.base, sample.parts[key].error.tool
            ),
            measurement=sample.parts[key].measurement,
        )
        for key, part in found.parts.items()
    }
    return replace(found, parts=parts, units=sample.units)


def _sized(drift: DriftSetup, sizes: Mapping[str, float]) -> DriftSetup:
    """A drift with other sizes of some kinds."""
    shift, turn = (sizes.get(kind, getattr(drift, kind)) for kind in KINDS)
    return replace(drift, shift=shift, turn=turn)


def _significant(
    groups: Groups, kind_of: NDArray[np.str_], start: Floats
) -> dict[str, float]:
    """Sizes of what drifts and raises the likelihood enough, the best one first."""
    others = tuple(dict.fromkeys(kind_of[~np.isin(kind_of, KINDS)].tolist()))

    def estimated(drifting: tuple[str, ...]) -> Variances:
        kinds = (*others, *drifting)
        given = np.concatenate([start, np.ones(len(kinds))])
        return estimate_variances(with_effects(groups, kind_of, kinds), given)

    chosen: tuple[str, ...] = ()
    best = estimated(chosen)
    for _ in KINDS:
        left = [kind for kind in KINDS if kind in kind_of and kind not in chosen]
        tried = {(*chosen, kind): estimated((*chosen, kind)) for kind in left}
        kinds = max(tried, key=lambda key: tried[key].likelihood, default=())
        if not kinds or tried[kinds].likelihood - best.likelihood < 0.5 * SIGNIFICANT:
            break
        chosen, best = kinds, tried[kinds]
    variances = best.values[len(start) + len(others) :]
    return {
        kind: USUAL * float(np.sqrt(variance))
        for kind, variance in zip(chosen, variances, strict=True)
    }
