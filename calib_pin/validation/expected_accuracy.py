"""Accuracy to expect of the nominal and the corrected robot, by the state of a fit."""

from __future__ import annotations

from dataclasses import replace
from itertools import starmap
from math import erf

import numpy as np

from calib_pin.estimation.evidence import ExpectedAccuracy, PoseErrors
from calib_pin.estimation.fit import FittedModel
from calib_pin.estimation.fitted import Fit, likely_posteriors
from calib_pin.estimation.system import Part
from calib_pin.estimation.tip_accuracy import without_frames
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.validation.summaries import ToolAccuracy

MEASURED, SAMPLES = 100, 300
"""Configurations at which the tool is predicted, measured ones and others."""

SURE = 0.95
"""Probability of a bound, and from which a configuration counts as better."""

DRAWS = 400
"""Draws of an error by which a bound is found, for each size of errors."""


def tool_accuracy(
    model: FittedModel, part: Part, data: Observations, rng: np.random.Generator
) -> ToolAccuracy:
    """The accuracy to expect of a chain where it was measured and elsewhere."""
    blocks = tuple(b for b in data.blocks if b.chain == part.key.chain)
    kept = Observations(blocks).sample(MEASURED).q[:, part.columns] if blocks else None
    spread = part.error.chain.random_configurations(SAMPLES, rng)
    loaded = part.error.carrying(model.problem.setup.heaviest)
    part = replace(part, error=loaded)
    measured, workspace = (
        None if q is None else expected_accuracy(model.fit, part, model.theta, q, rng)
        for q in (kept, spread)
    )
    return ToolAccuracy(None, measured, workspace)


def expected_accuracy(
    fitted: Fit,
    part: Part,
    theta: Floats,
    q: Floats,
    rng: np.random.Generator,
) -> ExpectedAccuracy:
    """Accuracy of a chain of the nominal and the corrected robot.

    With the mean mu and the covariance C of the errors, and G the mean of `J^T J`, the
    nominal robot's expected square is `mu^T G mu + tr(G C)` and that of the corrected
    one `tr(G C)`. Their difference for the true errors, `mu^T G mu + 2 mu^T G z` with
    `z ~ N(0, C)`, is normal, and so is the probability that the corrected robot is the
    better one. All is averaged over the likely sizes of errors.

    Args:
        fitted: The fit.
        part: A part of its problem about the solution, of the chain.
        theta: Parameter values about that, shape (P,).
        q: Configurations of the chain, shape (N, n) [rad, m].
        rng: Draws the errors by which the bound is found.
    """
    parameters = fitted.problem.parameters
    index = part.of_error
    scales, nuisance = parameters.scales[index], parameters.nuisance[index]
    robot = parameters.free[index] & ~nuisance
    _, J = part.error.jacobian(q, theta[index])
    own = without_frames(J * scales, J)[:, :, robot]
    effects = np.zeros((*J.shape[:2], 0))
    if fitted.effects is not None:
        absorbed = fitted.posterior.by_effects[index]
        absorbed = np.where(nuisance[:, None], 0.0, absorbed)
        there = fitted.effects.twists(part, q)
        effects = without_frames(J @ absorbed - there, J)
    mean, own_scales = (theta[index] / scales)[robot], scales[robot, None]
    halves = [
        likely.by_noise[index[robot]] / own_scales
        for likely in likely_posteriors(fitted)
    ]
    C = np.array([half @ half.T for half in halves])
    sizes = zip(
        *(
            _sizes(mean, own[:, k], effects[:, k], _scatter(fitted, part, unit), C, rng)
            for k, unit in ((slice(0, 3), "m"), (slice(3, 6), "rad"))
        ),
        strict=True,
    )
    better, share = _better(mean, own[:, :3], effects[:, :3], C)
    nominal, calibrated, bound, unmodeled = starmap(PoseErrors, sizes)
    return ExpectedAccuracy(nominal, calibrated, bound, unmodeled, better, share)


def _sizes(
    mean: Floats,
    J: Floats,
    effects: Floats,
    scatter: float,
    C: Floats,
    rng: np.random.Generator,
) -> tuple[float, float, float, float]:
    """Errors of position or orientation: nominal, calibrated, bound, and unmodeled.

    Args:
        mean: The estimated errors, shape (p,).
        J: Derivative by the scaled errors of the robot, shape (N, 3, p).
        effects: Errors by independent effects that the model lacks, beyond the part
            that the fit has absorbed, shape (N, 3, S).
        scatter: Variance of each component that is left beside these.
        C: Covariances of the errors for several sizes of them, shape (S, p, p).
        rng: Random generator of the bound.
    """
    G = np.einsum("ndi,ndj->ij", J, J, optimize=True) / len(J)
    squares = [np.maximum(np.linalg.eigvals(G @ c).real, 0.0) for c in C]
    left = float(np.mean([s.sum() for s in squares]))
    by_effects = np.einsum("ndi,ndj->ij", effects, effects, optimize=True) / len(J)
    lacking = np.maximum(np.linalg.eigvalsh(by_effects), 0.0)
    draws = [
        np.concatenate([s, lacking])
        @ rng.chisquare(1.0, (len(s) + len(lacking), DRAWS))
        for s in squares
    ]
    # At so many configurations, what scatters is about its mean.
    others = float(lacking.sum()) + 3.0 * scatter
    gain = np.sum((J @ mean) ** 2, axis=1).mean()
    bound = np.quantile(np.concatenate(draws), SURE) + 3.0 * scatter
    nominal, calibrated, bounded, unmodeled = np.sqrt(
        [gain + left + others, left + others, bound, others]
    ).tolist()
    return nominal, calibrated, bounded, unmodeled


def _better(mean: Floats, J: Floats, effects: Floats, C: Floats) -> tuple[float, float]:
    """Probability of the corrected robot to be better, and share where it surely is.

    The differences of single configurations, and of the whole, are normal along one
    direction of the errors each: `gain + 2 (along^T z + beside^T g)` with `z ~ N(0, C)`,
    all C equally likely, and effects `g ~ N(0, I)`.
    """
    moved = J @ mean
    parts = (
        np.sum(moved**2, axis=1),
        np.einsum("nd,ndi->ni", moved, J),
        np.einsum("nd,ndi->ni", moved, effects),
    )
    # The last one is the whole.
    gain, along, beside = (np.concatenate([p, p.mean(axis=0)[None]]) for p in parts)
    variances = np.sum((along @ C) * along, axis=2) + np.sum(beside**2, axis=1)
    ratios = gain / np.sqrt(np.maximum(8.0 * variances, 1e-300))
    chances = 0.5 + 0.5 * np.vectorize(erf)(ratios).mean(axis=0)
    return float(chances[-1]), float(np.mean(chances[:-1] >= SURE))


def _scatter(fitted: Fit, part: Part, unit: str) -> float:
    """Variance of a component that neither noise nor the known effects explain.

    Of the first quantity in a unit that the chain of a part is measured by; zero where
    noise is neither stated nor repeated, so that nothing tells both apart.
    """
    components = {
        k
        for key, of_key in fitted.problem.layout.of_keys.items()
        if key.chain == part.key.chain
        for k in of_key.tolist()
    }
    for k, noise in enumerate(fitted.noise):
        if k in components and noise.unit == unit:
            found = (noise.unmodeled or 0.0) ** 2
            if fitted.effects is not None:
                explained = max(1.0 - float(fitted.effects.noise[k]), 0.0)
                found -= explained * (noise.factor * noise.given) ** 2
            return max(found, 0.0)
    return 0.0
