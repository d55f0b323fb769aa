"""The judgement of a fitted model: its accuracy, what is wrong with it, the verdict."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from itertools import starmap
from math import erf

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.evidence import ExpectedAccuracy, Finding, PoseErrors
from calib_pin.estimation.fit import FittedModel
from calib_pin.estimation.fitted import Fit, likely_posteriors
from calib_pin.estimation.system import Part
from calib_pin.estimation.tip_accuracy import without_frames
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.declaration import Quantity
from calib_pin.observations import Observations
from calib_pin.progress import Progress
from calib_pin.validation.accuracy import Accuracy, QuantityErrors
from calib_pin.validation.findings import find
from calib_pin.validation.findings.case import Case, Others
from calib_pin.validation.held_out import HeldOut
from calib_pin.validation.model_errors import ModelErrors
from calib_pin.validation.summaries import ToolAccuracy
from calib_pin.validation.verdict import Grounds, verdict

MEASURED, SAMPLES = 100, 300
"""Configurations at which the tool is predicted, measured ones and others."""


@dataclass(frozen=True)
class Judgement:
    """A verdict with what it is based on; see `CalibrationResult`.

    Accuracies are those to expect, without the predicted uncertainty of tips.
    """

    status: str
    reason: str
    errors: tuple[QuantityErrors, ...]
    findings: tuple[Finding, ...]
    accuracies: Mapping[str, ToolAccuracy]


def judge(
    chains: Chain | Chains,
    model: FittedModel,
    fitted_errors: ModelErrors,
    held_out: HeldOut,
    seed: int,
    progress: Progress | None = None,
    others: Others = tuple,
    seek: bool = True,
) -> Judgement:
    """Judge a fitted model.

    Args:
        chains: The nominal chains.
        model: The model.
        fitted_errors: Errors of the measurements that were fitted.
        held_out: Its check on held-out measurements.
        seed: Seed of configurations.
        progress: Told how far the search for explanations is.
        others: Other robots that may have been measured.
        seek: Whether to seek faults of the measurements that no robot explains; they
            have been sought with another model otherwise.
    """
    fitted, data = model.fit, model.fit.problem.data
    chains = Chains.of(chains)
    parts = held_out.counted
    errors = quantity_errors(
        model.problem.layout.quantities,
        fitted_errors.counted(data.weight),
        ModelErrors.joined(parts) if parts else None,
    )
    validation = held_out.measurements if held_out.apart else None
    counting = data.weight > 0.0
    accuracies = dict.fromkeys(model.problem.by_chain, ToolAccuracy())
    if fitted.noise:
        kept = data.rows(counting)
        accuracies = {
            name: _expected(model, part, kept, np.random.default_rng(seed))
            for name, part in model.problem.by_chain.items()
        }
    case = Case.of(fitted, chains, validation, progress, others, accuracies)
    found = find(case, seek)
    findings = (*found.causes, *held_out.findings, *found.others)
    groups = data.groups()
    seen = np.count_nonzero(np.bincount(groups[counting]))
    aside = 1.0 - seen / max(groups.max() + 1, 1)
    status, reason = verdict(
        Grounds(
            fitted,
            errors,
            held_out.gains,
            findings,
            {name: a.workspace for name, a in accuracies.items() if a.workspace},
            max(aside, fitted.robust.disagreement),
            found.causes,
        )
    )
    return Judgement(status, reason, errors, findings, accuracies)


def _expected(
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


def quantity_errors(
    quantities: Iterable[Quantity],
    fitted: ModelErrors,
    held_out: ModelErrors | None = None,
) -> tuple[QuantityErrors, ...]:
    """Accuracy before and after, of fitted and of held-out measurements.

    Of the quantities that fitted measurements have.
    """
    found = []
    for quantity in quantities:
        before, after = _accuracies(quantity, fitted)
        if before is not None and after is not None:
            pair = _accuracies(quantity, held_out) if held_out else (None, None)
            found.append(
                QuantityErrors(quantity.name, quantity.unit, before, after, *pair)
            )
    return tuple(found)


def _accuracies(
    quantity: Quantity, errors: ModelErrors
) -> tuple[Accuracy | None, Accuracy | None]:
    """Accuracy before and after; None where no measurement has the quantity."""
    # Of mixed measurements, those held out may all be of another model.
    before, after = (
        Accuracy.of(sizes) if len(sizes) else None
        for sizes in map(quantity.errors, (errors.before, errors.after))
    )
    return before, after


SURE = 0.95
"""Probability of a bound, and from which a configuration counts as better."""

DRAWS = 400
"""Draws of an error by which a bound is found, for each size of errors."""


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
    mean, C = (theta[index] / scales)[robot], _covariances(fitted, index[robot])
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
    direction of the errors each.
    """
    moved = J @ mean
    gain = np.sum(moved**2, axis=1)
    along = np.einsum("nd,ndi->ni", moved, J)
    beside = np.einsum("nd,ndi->ni", moved, effects)
    chances = _chance(
        gain.mean()[None], along.mean(axis=0)[None], beside.mean(axis=0)[None], C
    )
    return float(chances[0]), float(np.mean(_chance(gain, along, beside, C) >= SURE))


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


def _chance(gain: Floats, along: Floats, beside: Floats, C: Floats) -> Floats:
    """Probability that `gain + 2 (along^T z + beside^T g)` is positive, shape (N,).

    With `z ~ N(0, C)`, all C of shape (S, p, p) equally likely, and effects
    `g ~ N(0, I)`; along has the shape (N, p), beside (N, S).
    """
    variances = np.sum((along @ C) * along, axis=2)
    variances += np.sum(beside**2, axis=1)
    ratios = gain / np.sqrt(np.maximum(8.0 * variances, 1e-300))
    chances = np.array([[0.5 + 0.5 * erf(x) for x in row] for row in ratios])
    return np.asarray(chances.mean(axis=0))


def _covariances(fitted: Fit, index: NDArray[np.intp]) -> Floats:
    """Of scaled errors by their positions, for each likely size, (S, p, p)."""
    scales = fitted.problem.parameters.scales[index]
    halves = [
        found.by_noise[index] / scales[:, None] for found in likely_posteriors(fitted)
    ]
    return np.array([half @ half.T for half in halves])
