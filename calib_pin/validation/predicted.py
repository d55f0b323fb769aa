"""Errors of rows that were not fitted: their predicted variances, and PRESS."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.robust.studentized import spectrum
from calib_pin.kinematics.spatial import Floats

ENTRIES = 4_000_000
"""Entries of a Jacobian that are looked at together."""

UNDETERMINED = 1e-9
"""Part of a group's rows that the others predict, below which they do not: rounding."""


@serial_blas
def predicted_variance(
    fitted: Fit, problem: Problem, theta: Floats, estimated: Sequence[int] = ()
) -> Floats:
    """Variance of the errors of rows that were not fitted, in their units.

    The noise of the rows and what the fit leaves uncertain, `sigma^2 + J C J^T`, with
    what gears and compliance do beyond what the fit has absorbed of them. What
    was estimated from these rows themselves, K, takes its part of both away: the
    variance of `(I - K K^+)(e + J d)`.

    Args:
        fitted: The fit that predicts.
        problem: The problem of the N rows.
        theta: Parameter values, shape (P,).
        estimated: Positions of parameters that were estimated from these rows.

    Returns:
        Variances, shape (N, d); infinite for what a row lacks, NaN where the fit knows
        no covariance.
    """
    sigma, deviations = problem.sigma, fitted.posterior
    if not np.isfinite(deviations.by_noise).all():
        return np.full(sigma.shape, np.nan)
    names = {name: k for k, name in enumerate(fitted.problem.parameters.names)}
    # What is new there has no covariance: it was estimated from the rows.
    own = [k for k, n in enumerate(problem.parameters.names) if n in names]
    of_fit = [names[problem.parameters.names[k]] for k in own]
    moved = np.column_stack([deviations.by_noise, deviations.by_effects])
    factor = np.zeros((len(theta), moved.shape[1]))
    factor[own] = moved[of_fit]
    factor[list(estimated)] = 0.0
    size = problem.components
    variances = np.empty(size)
    for k, quantity in enumerate(problem.measurement.quantities):
        variances[quantity.columns] = fitted.unit**2 * deviations.noise[k]
    whitened = np.empty(sigma.shape)
    for part in _parts(np.arange(len(sigma)), problem, bool(len(estimated))):
        some = replace(problem, data=problem.data.rows(part))
        J = some.linearize_rows(theta)[1][: len(part) * size]
        uncertain, noise = J @ factor, np.tile(variances, len(part))
        if deviations.systematic is not None:
            # The fit has absorbed a part of what gears and compliance do there.
            there = deviations.systematic.rows(some, theta)
            uncertain[:, -there.shape[1] :] -= there
        if len(estimated):
            K = _range(J[:, list(estimated)])
            uncertain = uncertain - K @ (K.T @ uncertain)
            noise = noise * (1.0 - np.sum(K**2, axis=1))
        total = noise + np.sum(uncertain**2, axis=1)
        whitened[part] = total.reshape(len(part), size)
    return np.asarray(whitened * sigma**2)


@serial_blas
def press(
    problem: Problem,
    theta: Floats,
    linear: tuple[Floats, Floats],
    factor: Floats,
    labels: NDArray[np.int64],
) -> tuple[Floats, Floats]:
    """Errors of each group of rows by a fit of the others, without fitting anew.

    With the whitened residual r, its Jacobian J and the normal matrix N of all that is
    known (rows, known distances, priors), the errors of a group g are
    `(I - H_gg)^-1 r_g`, where `H_gg = J_g N^-1 J_g^T`, with the covariance
    `(I - H_gg)^-1` (Allen 1974; Cook and Weisberg 1982, section 2.2). That is exact
    where the problem is linear. What only the group's own rows tell, as the place of a
    socket of theirs, is where they put it.

    Args:
        problem: The fitted problem.
        theta: Its solution, shape (P,).
        linear: Whitened residual and Jacobian there, the N rows first.
        factor: F of `N^-1 = F F^T`, shape (P, k).
        labels: Group of each row, shape (N,).

    Returns:
        Errors and, for noise of unit weight, their variances, shape (N, d) each. Rows
        that are set aside keep their error, with an infinite variance.
    """
    sigma, size = problem.sigma, problem.components
    whitened, variance = np.empty(sigma.shape), np.empty(sigma.shape)
    fun, jac = (part[: sigma.size] for part in linear)
    own, columns = fun.reshape(-1, size), (jac @ factor).reshape(*sigma.shape, -1)
    order = np.argsort(labels, kind="stable")
    counts = np.bincount(labels)
    for count in np.unique(counts[counts > 0]).tolist():
        rows = order[counts[labels[order]] == count]
        r = own[rows].reshape(-1, count * size)
        U, squares = spectrum(columns[rows].reshape(*r.shape, -1))
        left = 1.0 - squares
        known = left > UNDETERMINED
        gain = np.where(known, 1.0 / np.where(known, left, 1.0), 0.0) - 1.0
        along = gain * np.einsum("gms,gm->gs", U, r)
        whitened[rows] = (r + np.einsum("gms,gs->gm", U, along)).reshape(-1, size)
        total = 1.0 + np.einsum("gms,gs->gm", U**2, gain)
        variance[rows] = total.reshape(-1, size)
    with np.errstate(invalid="ignore"):
        errors = whitened * sigma
    aside = ~np.isfinite(sigma)
    errors[aside] = problem.masked_errors(theta)[aside]
    return errors, np.where(aside, np.inf, variance * np.where(aside, 1.0, sigma) ** 2)


def _range(A: Floats) -> Floats:
    """Orthonormal basis of columns, rounding left out."""
    lengths = np.linalg.norm(A, axis=0)
    U, s, _ = np.linalg.svd(A / np.where(lengths > 0.0, lengths, 1.0), False)
    return np.asarray(U[:, s > 1e-10 * s.max(initial=0.0)])


def _parts(
    rows: NDArray[np.intp], problem: Problem, together: bool
) -> Iterator[NDArray[np.intp]]:
    """Rows in parts that are handy."""
    step = max(1, ENTRIES // (problem.components * len(problem.parameters)))
    if together:
        step = max(len(rows), 1)
    for start in range(0, len(rows), step):
        yield rows[start : start + step]
