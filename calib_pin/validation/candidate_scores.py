"""Scores of the candidates of a model selection, and which of them is chosen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.estimation.fit import FittedModel
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.validation.model_errors import ModelErrors
from calib_pin.validation.splits import Grouping
from calib_pin.validation.summaries import Candidate

USES = ("both", "near", "away")
"""Where a model must hold: near the fitted configurations, away from them, or both."""

SURE = 2.0
"""Standard errors of the difference from which a candidate is worse than another."""

TINY = 1e-300
"""What no score of measurements that differ at all falls below."""


@dataclass(frozen=True)
class Judged:
    """A candidate with its fit and cross-validation, without where it cannot be fitted.

    The sizes are those of the whitened errors, mean of every cluster, shape (G,), near
    the fitted configurations and away from them where that could be tried.
    """

    candidate: Candidate
    model: FittedModel | None = None
    parts: tuple[ModelErrors, ...] = ()
    sizes: tuple[Floats, ...] = ()


def helps(sizes: Sequence[Floats], before: Sequence[Floats], use: str) -> bool:
    """Whether errors are smaller somewhere by more than chance, and larger nowhere.

    More than the standard error of the difference, where the model is used.

    Args:
        sizes: Sizes of errors, see `Judged`.
        before: The same of the candidate that it extends.
        use: One of `USES`.
    """
    gains = asked([b - s for b, s in zip(before, sizes, strict=False)], use)
    told = [_mean(gain) for gain in gains]
    return not told or (
        any(mean > sigma for mean, sigma in told)
        and not any(mean < -sigma for mean, sigma in told)
    )


def simplest(found: Sequence[Judged], use: str) -> int:
    """Position of the simplest that helps and is not significantly worse.

    Than the best one, near or away. Where no candidate is that in both, the one
    that loses least.

    Args:
        found: The candidates, simplest first, at least one of them fitted.
        use: One of `USES`.
    """
    fitted = [k for k, one in enumerate(found) if one.sizes]
    candidates = [one.candidate for one in found]
    sizes = {k: asked(found[k].sizes, use) for k in fitted}
    most = max(map(len, sizes.values()))
    scores = {
        k: [_mean(each)[0] for each in own]
        for k, own in sizes.items()
        if len(own) == most
    }
    best = [min(scores, key=lambda k: scores[k][i]) for i in range(most)]

    def worse(k: int) -> bool:
        """Whether it is significantly worse than the best, near or away."""
        told = [
            _mean(own - sizes[other][i])
            for i, (own, other) in enumerate(zip(sizes[k], best, strict=True))
        ]
        return any(mean > SURE * sigma for mean, sigma in told)

    def loss(k: int) -> float:
        """By how much it is worse than the best, near or away."""
        pairs = zip(scores[k], best, strict=True)
        return max(
            score / max(scores[other][i], TINY)
            for i, (score, other) in enumerate(pairs)
        )

    # Chance may leave the best one short of helping, and what it is compared with
    # out of reach.
    helping = [k for k in scores if candidates[k].helps] or list(scores)
    good = [k for k in helping if not worse(k)]
    return min(
        good or [min(helping, key=loss)],
        key=lambda k: (candidates[k].learned is not None, candidates[k].rank),
    )


def asked(of_both: Sequence[Floats], use: str) -> Sequence[Floats]:
    """Those near and away from what was fitted, as far as the use asks for them."""
    if use == "near":
        return of_both[:1]
    return of_both[-1:] if use == "away" else of_both


def _mean(values: Floats) -> tuple[float, float]:
    """Mean and standard error of what is known; of nothing, nothing is certain."""
    if np.isnan(values).all():
        return 0.0, np.inf
    return float(np.nanmean(values)), standard_error(values)


def standard_error(values: Floats) -> float:
    """Standard error of the mean of what is known."""
    values = values[~np.isnan(values)]
    return float(values.std(ddof=1) / np.sqrt(len(values)))


def cluster_sizes(grouping: Grouping, problem: Problem, errors: ModelErrors) -> Floats:
    """Mean size of the whitened errors of every cluster of measurements, shape (G,).

    NaN where all of a cluster is set aside.
    """
    errors = errors.at(np.argsort(errors.positions, kind="stable"))
    measurements, positions = grouping.measurements, errors.positions
    there = replace(problem, data=measurements)
    sigma = there.layout.table(there.given_sigma, len(measurements))[positions]
    size = np.sqrt(np.nanmean((errors.after / sigma) ** 2, axis=1))
    labels = grouping.clusters[positions]
    kept = measurements.weight[positions] > 0.0
    count = int(grouping.clusters.max(initial=-1)) + 1
    counts = np.bincount(labels, kept, count)
    totals = np.bincount(labels, np.where(kept, size, 0.0), count)
    return np.where(counts > 0, totals / np.maximum(counts, 1), np.nan)
