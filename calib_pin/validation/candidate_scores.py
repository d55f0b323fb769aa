"""Scores of the candidates of a model selection, and which of them is chosen."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.estimation.fit import FittedModel
from calib_pin.kinematics.spatial import Floats
from calib_pin.residual_models.base import root_mean_square
from calib_pin.validation.model_errors import ModelErrors
from calib_pin.validation.result import Candidate, HeldOutErrors, QuantityError
from calib_pin.validation.splits import Grouping

USES = ("both", "near", "away")
"""Where a model must hold: near the fitted configurations, away from them, or both."""

SURE = 2.0
"""Standard errors of the difference from which a candidate is worse than another.

The best of several is compared, which is better by chance more often than one. Of 200
simulated robots with errors of their geometry alone 1 was given another effect, of 32
with compliance as well none; 1.645 would have given one to 3 of the latter.
"""


TINY = 1e-300
"""No score of measurements that differ at all is smaller."""


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
    if use != "near" and len(sizes) < len(before):
        return False  # Nobody knows, away.
    gains = asked([b - s for b, s in zip(before, sizes, strict=False)], use)
    told = [_mean(gain) for gain in gains]
    return not told or (
        any(mean > sigma for mean, sigma in told)
        and not any(mean < -sigma for mean, sigma in told)
    )


def simplest(found: Sequence[Judged], use: str) -> int:
    """Position of the simplest that helps and is not significantly worse.

    Than the best one, near or away. Where no candidate is that in both, of those that
    are not worse away the simplest that is not worse than another of them near: what
    carries over badly does its harm where nobody looks.

    Args:
        found: The candidates, simplest first, at least one of them fitted.
        use: One of `USES`.
    """
    candidates = [one.candidate for one in found]
    # What could be tried near alone is not compared with what others are away.
    tried = max(len(one.sizes) for one in found)
    full = [k for k, one in enumerate(found) if len(one.sizes) == tried]
    sizes = {k: asked(found[k].sizes, use) for k in full}
    places = range(len(sizes[full[0]]))

    def as_good(among: Sequence[int], place: int) -> list[int]:
        """Those that are not significantly worse there than the best of them."""
        best = min(among, key=lambda k: _mean(sizes[k][place])[0])
        told = {k: _mean(sizes[k][place] - sizes[best][place]) for k in among}
        return [k for k in among if told[k][0] <= SURE * told[k][1]]

    # Chance may leave the best one short of helping, and what it is compared with out
    # of reach.
    helping = [k for k in full if candidates[k].helps] or full
    good = set(helping).intersection(*(as_good(full, place) for place in places))
    if not good:
        good = set(helping)
        for place in reversed(places):
            good = set(as_good(sorted(good), place))
    return min(
        good,
        key=lambda k: (candidates[k].learned is not None, candidates[k].rank, k),
    )


def mean_score(found: Judged, use: str) -> float:
    """Mean of the logarithms of the scores where a candidate is used."""
    means = [max(_mean(each)[0], TINY) for each in asked(found.sizes, use)]
    return float(np.mean(np.log(means)))


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


def scored(
    grouping: Grouping, model: FittedModel, parts: Sequence[ModelErrors]
) -> tuple[Floats, HeldOutErrors]:
    """Sizes of errors on held-out measurements, see `Judged`, and what they come to.

    Of a cluster of which all is set aside the size is NaN.
    """
    measurements, layout = grouping.measurements, model.problem.layout
    weight = measurements.weight
    counted = ModelErrors.joined([part.counted(weight) for part in parts])
    there = replace(model.problem, data=measurements)
    sigma = layout.table(there.given_sigma, len(measurements))[counted.positions]
    size = np.sqrt(np.nanmean((counted.after / sigma) ** 2, axis=1))
    label, kept = grouping.clusters[counted.positions], weight[counted.positions] > 0.0
    count = int(grouping.clusters.max(initial=-1)) + 1
    totals, counts = (
        np.bincount(label[kept], size[kept], count),
        np.bincount(label[kept], minlength=count),
    )
    sizes = np.where(counts > 0, totals / np.maximum(counts, 1), np.nan)
    lengths = [(q, q.errors(counted.after)) for q in layout.quantities]
    return sizes, HeldOutErrors(
        errors=tuple(
            QuantityError(q.name, q.unit, float(e.mean()), root_mean_square(e))
            for q, e in lengths
        ),
        score=float(np.nanmean(sizes)),
        deviation=standard_error(sizes),
    )
