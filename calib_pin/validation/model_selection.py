"""Model selection: from joint offsets to a learned correction, as far as it helps.

Every candidate is judged by two cross-validations, each in the same folds: *near* the
fitted configurations by random folds, which keep repetitions of a configuration
together, and *away* from them by whole regions of joint space (`splits.regions`).
Physics carries over; what interpolates may or may not, and only the second tells. A
candidate helps if it lowers the error of the candidates it extends by more than the
standard error of the difference, and raises it nowhere by as much. Gears and compliance
pass for each other in part, so they are tried alone and together. In the end the
simplest candidate is chosen that is not significantly worse than the best, near, away,
or in both, as the robot is to be used: by the differences in the same measurements,
which tell more than the scores (Breiman et al., Classification and Regression Trees,
1984, section 3.4.3, compare these).
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError, nearest, require_known
from calib_pin.estimation.fit import fit_model
from calib_pin.estimation.fitted import Fit, as_weighted
from calib_pin.estimation.formulation import parameter_names, with_parameters
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.parameterizations import (
    PARAMETERIZATIONS,
    needed_conditions,
    outside_urdf,
)
from calib_pin.parameterizations.compliance import Compliance
from calib_pin.parameterizations.placement import JointOffset
from calib_pin.parameterizations.transmission import MotorRipple, Transmission
from calib_pin.parameters import matching
from calib_pin.progress import Progress, Stages, named, portion
from calib_pin.residual_models import RESIDUAL_MODELS
from calib_pin.setup import Setup
from calib_pin.validation.held_out import cross_validate
from calib_pin.validation.model_errors import ModelErrors
from calib_pin.validation.result import (
    Candidate,
    HeldOutErrors,
    ModelSelection,
    QuantityError,
)
from calib_pin.validation.splits import Grouping, folds, regions
from calib_pin.workers.base import SERIAL, Workers

PLACES = {"both": slice(None), "near": slice(0, 1), "away": slice(-1, None)}
"""Errors near the fitted configurations and away from them that a use asks for."""

USES = tuple(PLACES)
"""Where a model must hold: near the fitted configurations, away from them, or both."""

SURE = 2.0
"""Standard errors of the difference from which a candidate is worse than another.

The best of several is compared, which is better by chance more often than one. Of 200
simulated robots with errors of their geometry alone 1 was given another effect, of 32
with compliance as well none; 1.645 would have given one to 3 of the latter.
"""

OFFSETS = JointOffset.name

TOGETHER = (Transmission.name, Compliance.name)
"""Effects that are tried together whether they help alone or not."""

QUICK, SLOW = 0.05, 0.7
"""Parts of the time left that a candidate takes, the second with a learned
correction."""


@dataclass(frozen=True)
class Judged:
    """A candidate with its fit and cross-validation, without where it cannot be fitted.

    Attributes:
        candidate: The candidate.
        fit: Its fit of all measurements.
        parts: Its cross-validation, fold by fold.
        sizes: Sizes of the whitened errors, mean of every cluster, shape (G,), near the
            fitted configurations and away from them where that could be tried.
    """

    candidate: Candidate
    fit: Fit | None = None
    parts: tuple[ModelErrors, ...] = ()
    sizes: tuple[Floats, ...] = ()


class SelectedModel(NamedTuple):
    """The model that was selected.

    Attributes:
        selection: All candidates, and which of them is chosen.
        fit: Its fit of all measurements.
        parts: Its cross-validation, fold by fold.
    """

    selection: ModelSelection
    fit: Fit
    parts: tuple[ModelErrors, ...]


@serial_blas
def select_model(
    chains: Chain | Chains,
    measurements: Observations,
    setup: Setup,
    seed: int,
    progress: Stages | None = None,
    workers: Workers = SERIAL,
    use: str = USES[0],
) -> SelectedModel:
    """Judge every candidate, and choose the simplest of the best.

    Args:
        chains: The nominal chains.
        measurements: The measurements to fit.
        setup: Known quantities; its geometric parameterizations make the second
            candidate.
        seed: Seed of configurations, splits, and starts.
        progress: Told the stage and the part that is done, 0 to 1.
        workers: Who fits the folds.
        use: Where the model must hold, one of `USES`.

    Raises:
        OptionError: If there is no such use, a name in the setup belongs to no
            candidate, or the measurements do not even suffice to judge the first one.
    """
    require_known("use", use, USES)
    beyond, others = _further_effects(measurements, setup), (OFFSETS, *outside_urdf())
    geometric = tuple(p for p in setup.parameters if p not in others)
    geometric = geometric or Setup.parameters
    learned = tuple(RESIDUAL_MODELS) if setup.learned is None else (setup.learned,)
    candidates = _Candidates(chains, measurements, setup, seed, progress, workers, use)
    candidates.require_patterns((OFFSETS, *geometric, *beyond))
    offset = candidates.add(Candidate("joint offset", (OFFSETS,), None))
    if not offset.sizes:
        raise OptionError(f"no model can be selected: {offset.candidate.reason}")
    geometry = candidates.add(Candidate("geometric", geometric, None), offset)
    candidates.combine(geometry if geometry.candidate.helps else offset, beyond)
    judged = candidates.judged
    # Learning makes up for what is left near; away, what it builds on decides.
    base = judged[simplest(judged, use if use == "near" else "away")]
    for name in learned:
        candidates.add(Candidate(f"+ {name}", base.candidate.parameters, name), base)
    chosen, q = judged[simplest(judged, use)], measurements.q
    ends = zip(q.min(axis=0).tolist(), q.max(axis=0).tolist(), strict=True)
    ranges = dict(zip(measurements.joints, ends, strict=True))
    all_candidates = tuple(entry.candidate for entry in judged)
    assert chosen.fit is not None
    selection = ModelSelection(chosen.candidate.name, use, ranges, all_candidates)
    return SelectedModel(selection, chosen.fit, chosen.parts)


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
    gains = [b - s for b, s in zip(before, sizes, strict=False)]
    means = [_mean(gain) for gain in gains[PLACES[use]]]
    better = any(mean > sigma for mean, sigma in means)
    return not means or (better and all(mean >= -sigma for mean, sigma in means))


def simplest(candidates: Sequence[Judged], use: str) -> int:
    """Position of the simplest that helps and is not significantly worse.

    Than the best one, near or away. Where no candidate is that in both, of those that
    are not worse away the simplest that is not worse than another of them near: what
    carries over badly does its harm where nobody looks.

    Args:
        candidates: The candidates, simplest first, at least one of them fitted.
        use: One of `USES`.
    """
    # What could be tried near alone is not compared with what others are away.
    most = max(len(c.sizes) for c in candidates)
    full = [k for k, c in enumerate(candidates) if len(c.sizes) == most]
    sizes = {k: candidates[k].sizes[PLACES[use]] for k in full}
    places = range(len(sizes[full[0]]))

    def as_good(among: Sequence[int], place: int) -> list[int]:
        """Those that are not significantly worse there than the best of them."""
        best = min(among, key=lambda k: _mean(sizes[k][place])[0])
        excess = {k: _mean(sizes[k][place] - sizes[best][place]) for k in among}
        return [k for k in among if excess[k][0] <= SURE * excess[k][1]]

    # Chance may leave the best one short of helping, and what it is compared with out
    # of reach.
    helping = [k for k in full if candidates[k].candidate.helps] or full
    good = set(helping).intersection(*(as_good(full, place) for place in places))
    if not good:
        good = set(helping)
        for place in reversed(places):
            good = set(as_good(sorted(good), place))
    fitted = ((candidates[k].candidate, k) for k in good)
    return min((c.learned is not None, c.rank, k) for c, k in fitted)[2]


def mean_score(candidate: Judged, use: str) -> float:
    """Mean of the logarithms of the scores where a candidate is used."""
    means = [max(_mean(each)[0], 1e-300) for each in candidate.sizes[PLACES[use]]]
    return float(np.mean(np.log(means)))


def _mean(values: Floats) -> tuple[float, float]:
    """Mean and standard error of what is known; of nothing, nothing is certain."""
    values = values[~np.isnan(values)]
    if not len(values):
        return 0.0, np.inf
    return float(values.mean()), float(values.std(ddof=1) / np.sqrt(len(values)))


def scored(
    grouping: Grouping, fitted: Fit, parts: Sequence[ModelErrors]
) -> tuple[Floats, HeldOutErrors]:
    """Sizes of errors on held-out measurements, see `Judged`, and what they come to.

    Of a cluster of which all is set aside the size is NaN.
    """
    rows, layout = grouping.measurements, fitted.problem.layout
    errors = ModelErrors.joined([part.counted(rows.weight) for part in parts])
    sigma = replace(fitted.problem, data=rows).given_sigma
    sigma = layout.table(sigma, len(rows))[errors.positions]
    size = np.sqrt(np.nanmean((errors.after / sigma) ** 2, axis=1))
    counted = rows.weight[errors.positions] > 0.0
    label, count = grouping.clusters, int(grouping.clusters.max(initial=-1)) + 1
    label = label[errors.positions][counted]
    with np.errstate(invalid="ignore"):
        totals = np.bincount(label, size[counted], count)
        sizes: Floats = totals / np.bincount(label, minlength=count)
    pairs = ((q, errors.accuracy(q)[1]) for q in layout.quantities)
    quantities = (QuantityError(q.name, q.unit, a.mean, a.rms) for q, a in pairs if a)
    return sizes, HeldOutErrors(tuple(quantities), *_mean(sizes))


@dataclass
class _Candidates:
    """The candidates that were judged, simplest first; see `select_model`.

    How many there will be is not known beforehand: each takes its part of the time that
    is left, after the part `done`.
    """

    chains: Chain | Chains
    measurements: Observations
    setup: Setup
    seed: int
    progress: Stages | None
    workers: Workers
    use: str
    done: float = 0.0
    judged: list[Judged] = field(default_factory=list)

    def add(self, candidate: Candidate, *extends: Judged) -> Judged:
        """Judge a candidate, and compare it with those that it extends."""
        share = (1.0 - self.done) * (QUICK if candidate.learned is None else SLOW)
        tell = portion(named(self.progress, candidate.name), self.done, share)
        self.done += share
        try:
            judged = self._judge(candidate, extends, tell)
        except InputError as error:
            judged = Judged(replace(candidate, reason=error.reason))
        self.judged.append(judged)
        return judged

    def combine(self, base: Judged, kinds: Sequence[str]) -> None:
        """Judge kinds alone, then the neighbors of the best as long as one is better.

        Neighbors have one kind more or less, or another with the same parameters in its
        place: a larger effect may have hidden others when they were alone, and what
        came first may have stood for what came later. Gears and compliance, which may
        hide each other, are tried together in any case.
        """
        tried: dict[frozenset[str], Judged] = {}
        of_names = {kind: PARAMETERIZATIONS[kind].kind for kind in kinds}

        def judge(added: frozenset[str]) -> None:
            if added in tried or not added:
                return
            ordered = tuple(kind for kind in kinds if kind in added)
            fewer = (added - {kind} for kind in ordered)
            below = [tried[less] for less in fewer if less in tried]
            names = (*base.candidate.parameters, *ordered)
            candidate = Candidate(f"+ {' + '.join(ordered)}", names, None)
            tried[added] = self.add(candidate, base, *below)

        current, best = None, frozenset[str]()
        while current != best:
            current = best
            for kind in kinds:
                # What has parameters of the same names cannot join.
                rest = {k for k in current if of_names[k] != of_names[kind]}
                judge(frozenset(rest))
                judge(frozenset(rest | {kind}))
            judge(frozenset(TOGETHER).intersection(kinds))
            helping = ((k, c) for k, c in tried.items() if c.candidate.helps)
            scores = {key: mean_score(c, self.use) for key, c in helping}
            best = min(scores, key=scores.__getitem__, default=best)

    def _judge(
        self, candidate: Candidate, extends: Iterable[Judged], tell: Progress | None
    ) -> Judged:
        """Fit a candidate to all measurements, and leave parts of them out."""
        inputs = self.chains, self.measurements
        setup = replace(self.setup, learned=candidate.learned)
        setup = with_parameters(*inputs, setup, candidate.parameters)
        fitted = fit_model(*inputs, setup, self.seed, tell)
        measurements = as_weighted(fitted, self.measurements)
        grouping, given = Grouping.of(measurements, setup), (fitted, measurements)
        masks = folds(grouping, fitted, self.seed)
        if not masks:
            count = measurements.configurations
            raise OptionError(f"{count} configurations are too few to hold out a fold")
        near, away = (
            tuple(cross_validate(*given, held_out, self.seed, None, self.workers))
            for held_out in (masks, regions(grouping, self.seed))
        )
        away = tuple(part for part in away if not part.reason and len(part.positions))
        scores = [scored(grouping, fitted, parts) for parts in (near, away) if parts]
        sizes, (errors, *others) = zip(*scores, strict=True)
        better = all(helps(sizes, below.sizes, self.use) for below in extends)
        figures = vars(errors) | {"away": others[0] if others else None}
        candidate = replace(candidate, rank=fitted.rank, helps=better, **figures)
        return Judged(candidate, fitted, near, sizes)

    def require_patterns(self, parameterizations: Sequence[str]) -> None:
        """Refuse names and globs that no candidate has."""
        names, setup = list[str](), self.setup
        for name in parameterizations:
            alone = replace(setup, parameters=(name,))
            with suppress(OptionError):  # The candidate will say so.
                names += parameter_names(self.chains, self.measurements, alone)
        for pattern in (*setup.fixed, *setup.bounds, *setup.prior_by_glob):
            if not matching(pattern, names):
                reason = f"no parameter matches '{pattern}'{nearest(pattern, names)}"
                raise OptionError(reason, file=setup.file or None)


def _further_effects(measurements: Observations, setup: Setup) -> tuple[str, ...]:
    """Effects that may join the geometry: those for which enough is stated."""
    recorded = [block.conditions for block in measurements.blocks]

    def sufficient(name: str) -> bool:
        needed = needed_conditions((name,))
        known = all(len(getattr(c, kind)) for kind in needed for c in recorded)
        return known and (name != MotorRipple.name or bool(setup.gear_ratios))

    return tuple(filter(sufficient, outside_urdf()))
