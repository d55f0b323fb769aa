"""Hold what the measurements do not tell by the size that errors are expected to have.

Measurements in a corner of the workspace determine some directions of the error space
well and others hardly. To estimate the latter freely makes the robot worse everywhere
else; to leave them alone by a hard cut makes it a matter of a threshold. Here every
error of the robot has a normal prior about nominal, and the solution is the mode of the
posterior. Of all estimates it has the least expected error at every configuration. The
size of errors, one for each kind of parameter (placement, compliance, ...), is told by
the measurements where they can (evidence, or type II maximum likelihood: MacKay,
Bayesian interpolation, 1992): what a kind shows nowhere does not grow where the
measurements do not see it.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.directions import projected
from calib_pin.estimation.fitted import Evidence, Fit
from calib_pin.estimation.problem import EXACT
from calib_pin.estimation.row_blocks import Expected
from calib_pin.estimation.solve import refine
from calib_pin.estimation.statistics.distributions import chi_square_quantile
from calib_pin.estimation.statistics.restricted_likelihood import (
    KNOWN,
    Block,
    Components,
    estimate_variances,
)
from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import Status

STATED = 2.0
"""Directions that the stated size of errors is worth against those that are measured.

With as few the evidence of a handful of well determined directions prevails."""

LEAST, MOST = 1e-3, 1e3
"""Bounds of sizes, in scales."""

PARTS = 3
"""Sizes that stand for the distribution where predictions are averaged over it."""

NOTICED = 1e-3
"""Change of an estimate, in its own standard deviations, that nobody can notice."""

CLEAR = 10.0
"""Deviation of a direction, by that of the last of the best determined quarter, from
which it counts as evidence by more than noise.

The worse a direction is determined, the more of what the model lacks it collects: gears
with the size that noise alone allows made other motions of a real UR10 worse than
nominal (1.2 mm rms; 0.51 to 0.52 mm with any limit from 3 to 30).
"""

VISIBLE = 1e-9
"""Part of the largest singular value below which the rows do not see a direction."""


def expected_sizes(
    values: Floats, variances: Floats, half: Floats, kinds: NDArray[np.intp]
) -> tuple[Floats, Floats]:
    """The size of errors of each kind by their evidence, in scales.

    Estimates `b ~ N(0, sum_k tau_k^2 H_k H_k^T + diag(v))`; tau^2 itself is about 1
    beforehand (inverse chi-square with `STATED` degrees of freedom).

    Args:
        values: Estimates b, shape (k,).
        variances: Their variances v, shape (k,).
        half: What errors, one scale large, contribute to them: H, shape (k, p).
        kinds: Kind of each error, 0 to K - 1, shape (p,).

    Returns:
        The most likely sizes, shape (K,), and for each kind the middles of `PARTS`
        equally likely parts of its distribution beside the others, (K, PARTS).

    Examples:
        >>> none = np.zeros(0)
        >>> expected_sizes(none, none, np.zeros((0, 3)), np.zeros(3, int))[0]
        array([1.])
    """
    count, deviations = int(kinds.max(initial=-1)) + 1, np.sqrt(variances)
    block = Block(
        rows=(values / deviations)[:, None],
        labels=np.append(np.full(len(values), KNOWN), kinds),
        factors=np.hstack([np.eye(len(values)), half / deviations[:, None]]),
    )
    stated = np.full(count, STATED)
    components = Components([block], stated, stated)
    found = estimate_variances(components, np.ones(count), LEAST**2, MOST**2)
    # Beside the others at their likeliest sizes chi-square is as wide as this.
    dof = 2.0 * np.diag(found.information)
    middles = (np.arange(PARTS) + 0.5) / PARTS
    ratios = [[f / chi_square_quantile(f, middle) for middle in middles] for f in dof]
    parts = np.sqrt(found.values[:, None] * np.reshape(ratios, (count, PARTS)))
    # Steps of 2 % are far finer than any is known, and rounding moves no solution.
    return 10.0 ** np.round(0.5 * np.log10(found.values), 2), parts


def shrunk(fitted: Fit) -> Fit:
    """The mode of the posterior from a least-squares fit, with the evidence for it.

    Where the rows are exact or tell nothing there is none. Residual and Jacobian are
    without the rows of the prior.
    """
    problem, result, unit = fitted.problem, fitted.result, fitted.unit
    if not unit > EXACT or fitted.rank == 0:
        return fitted
    evidence = expected_errors(fitted)
    # A search that was cut short, or met far from a minimum, stays what it is.
    led = Status.CONVERGED, Status.ITERATIONS, Status.STALLED
    if not evidence.matters or result.status not in led:
        return replace(fitted, evidence=replace(evidence, matters=False))
    # Whitened like the rows, whose unit weight is not in their standard deviations.
    expected = replace(evidence.expected, sizes=evidence.expected.sizes / unit)
    basis = problem.parameters.scales[:, None] * fitted.directions.every
    found = refine(replace(problem, expected=expected), result.x, basis)
    # The rows of the prior stand before those of priors of the setup.
    stop = len(found.fun) - len(problem.further.priors)
    rows = np.delete(np.arange(len(found.fun)), np.s_[stop - len(expected) : stop])
    fun, jac = found.fun[rows], found.jac[rows]
    found = replace(found, fun=fun, jac=jac, cost=0.5 * float(fun @ fun))
    return replace(fitted, evidence=evidence, result=found.after(result))


def expected_errors(fitted: Fit) -> Evidence:
    """The prior of the robot's directions by the evidence of a least-squares fit.

    What has a prior of its own has no other.
    """
    parameters, directions = fitted.problem.parameters, fitted.directions
    theta, unit = fitted.theta, fitted.unit
    V = np.column_stack([directions.robot, directions.weak])
    V = V * ~np.isfinite(parameters.priors)[:, None]
    present = np.unique(parameters.kinds[V.any(axis=1)])
    own = np.isin(parameters.kinds, present)
    kinds = np.searchsorted(present, parameters.kinds[own])
    A = fitted.result.jac * parameters.scales
    system = projected(np.column_stack([A @ V, fitted.result.fun]), A, parameters)
    triangle = np.asarray(np.linalg.qr(system, mode="r"))
    U, s, Wt = np.linalg.svd(triangle[:, :-1], full_matrices=False)
    seen = s > VISIBLE * s.max(initial=0.0)
    s, Wt = s[seen], Wt[seen]
    deviations = unit / s
    current = Wt @ (V.T @ (theta / parameters.scales))
    # At the least squares what was moved has no gradient; what was not, has.
    values = current - (U[:, seen].T @ triangle[:, -1]) / s
    quarter = np.quantile(deviations**2, 0.25) if len(s) else np.inf
    beside = deviations**2 * (1.0 + deviations**2 / (CLEAR**2 * quarter))
    half = Wt @ V.T
    found, parts = expected_sizes(values, beside, half[:, own], kinds)
    sizes, likely = np.ones(len(V)), np.ones((PARTS, len(V)))
    sizes[own], likely[:, own] = found[kinds], parts[kinds].T
    P, t, _ = np.linalg.svd(half * sizes / deviations[:, None], full_matrices=False)
    kept = (P * (t / np.hypot(1.0, t)) ** 2) @ P.T
    change = kept @ (values / deviations) - current / deviations
    shift = change / np.sqrt(np.diag(kept))
    return Evidence(
        expected=Expected(V, sizes, parameters.scales),
        likely=likely,
        matters=bool(np.abs(shift).max(initial=0.0) > NOTICED),
        square=float(np.sum((values / deviations) ** 2)),
        count=len(values),
    )
