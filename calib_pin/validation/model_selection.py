"""Model selection: from joint offsets to a learned correction, as far as it helps.

Every candidate is judged by two cross-validations, each in the same folds: *near* the
fitted configurations by random folds, which keep repetitions of a configuration
together, and *away* from them by whole regions of joint space (`validation.regions`).
Physics carries over; what interpolates may or may not, and only the second tells. A
candidate helps if it lowers the error of the candidates it extends by more than the
standard error of the difference, and raises it nowhere by as much. Gears and compliance
pass for each other in part, so they are tried alone, together, and together without
what is not missed. In the end the simplest candidate is chosen that is not
significantly worse than the best, near, away, or in both, as the robot is to be used:
by the differences in the same measurements, which tell more than the scores (Breiman et
al., Classification and Regression Trees, 1984, section 3.4.3, compare these).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError, nearest, require_known
from calib_pin.estimation.fit import FittedModel, fit_model
from calib_pin.estimation.formulation import parameter_names, with_parameters
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.parameterizations import beyond_geometry
from calib_pin.parameterizations.placement import JointOffset
from calib_pin.parameters import matching
from calib_pin.progress import Progress, Stages, named, portion
from calib_pin.residual_models import RESIDUAL_MODELS
from calib_pin.residual_models.base import root_mean_square
from calib_pin.setup import Setup
from calib_pin.validation.held_out import cross_validate
from calib_pin.validation.model_errors import ModelErrors
from calib_pin.validation.regions import regions
from calib_pin.validation.splits import FOLDS, Grouping, folds
from calib_pin.validation.summaries import (
    Away,
    AwayErrors,
    Candidate,
    ModelSelection,
)
from calib_pin.workers import SERIAL, Workers

OFFSETS = JointOffset.name

USES = ("both", "near", "away")
"""Where a model must hold: near the fitted configurations, away from them, or both."""

SURE = 2.0
"""Standard errors of the difference from which a candidate is worse than another."""

TINY = 1e-300
"""What no score of measurements that differ at all falls below."""

LEARNING = 10.0
"""Time that a training with a residual model takes, in those without."""


@dataclass(frozen=True)
class SelectedModel:
    """The model that was selected.

    Attributes:
        selection: All candidates, and which of them is chosen.
        model: That one, fitted to all measurements.
        parts: Its cross-validation, fold by fold.
    """

    selection: ModelSelection
    model: FittedModel
    parts: tuple[ModelErrors, ...]


@dataclass(frozen=True)
class _Judged:
    """A candidate with its fit and cross-validation, without where it cannot be fitted.

    The sizes are those of the whitened errors, mean of every cluster, shape (G,), near
    the fitted configurations and away from them where that could be tried.
    """

    candidate: Candidate
    model: FittedModel | None = None
    parts: tuple[ModelErrors, ...] = ()
    sizes: tuple[Floats, ...] = ()


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
    beyond = beyond_geometry()
    geometric = tuple(p for p in setup.parameters if p not in (OFFSETS, *beyond))
    geometric = geometric or Setup.parameters
    _require_patterns(chains, measurements, setup, (OFFSETS, *geometric, *beyond))
    learned = tuple(RESIDUAL_MODELS) if setup.learned is None else (setup.learned,)
    work = 2.0 + len(beyond) * (len(beyond) + 1) / 2 + LEARNING * len(learned)
    given = chains, measurements, setup, seed, progress, workers, use, work
    candidates = _Candidates(*given)

    offset = candidates.add("joint offset", (OFFSETS,))
    if not offset.sizes:
        raise OptionError(f"no model can be selected: {offset.candidate.reason}")
    geometry = candidates.add("geometric", geometric, extends=(offset,))
    base = geometry if geometry.candidate.helps else offset
    candidates.combine(base, beyond)
    base = candidates.judged[candidates.simplest()]
    for name in learned:
        kinds = base.candidate.parameters
        candidates.add(f"+ {name}", kinds, name, extends=(base,))
    chosen = candidates.simplest()
    found = candidates.judged[chosen]
    assert found.model is not None
    every = tuple(judged.candidate for judged in candidates.judged)
    q = measurements.q
    near = zip(q.min(axis=0).tolist(), q.max(axis=0).tolist(), strict=True)
    ranges = dict(zip(measurements.joints, near, strict=True))
    selection = ModelSelection(every, chosen, use, ranges)
    return SelectedModel(selection, found.model, found.parts)


@dataclass
class _Candidates:
    """The candidates that were judged, simplest first; see `select_model`.

    The work, all and done, counts in candidates without a learned correction.
    """

    chains: Chain | Chains
    measurements: Observations
    setup: Setup
    seed: int
    progress: Stages | None
    workers: Workers
    use: str
    all: float
    done: float = 0.0
    judged: list[_Judged] = field(default_factory=list)

    def add(
        self,
        name: str,
        parameters: tuple[str, ...],
        learned: str | None = None,
        *,
        extends: Sequence[_Judged] = (),
    ) -> _Judged:
        """Judge a candidate, and compare it with those that it extends."""
        share = (1.0 if learned is None else LEARNING) / self.all
        tell = portion(named(self.progress, name), self.done, share)
        self.done += share
        blank = Candidate(name, parameters, learned)
        try:
            found = self._judge(blank, tell)
        except InputError as error:
            found = _Judged(replace(blank, reason=error.reason))
        if found.sizes:
            helps = all(self._helps(found.sizes, below.sizes) for below in extends)
            found = replace(found, candidate=replace(found.candidate, helps=helps))
        self.judged.append(found)
        return found

    def combine(self, base: _Judged, kinds: Sequence[str]) -> None:
        """Judge kinds alone, all together, and these without what is not missed."""
        stated = base.candidate.parameters
        tried: dict[tuple[str, ...], _Judged] = {(): base}

        def judged(added: tuple[str, ...], *extends: _Judged) -> _Judged:
            if added not in tried:
                name = f"+ {' + '.join(added)}"
                parts = (*stated, *added)
                tried[added] = self.add(name, parts, extends=extends)
            return tried[added]

        alone = [judged((kind,), base) for kind in kinds]
        current, found = tuple(kinds), judged(tuple(kinds), base, *alone)
        while len(current) > 2 and found.sizes:
            fewer = [tuple(kind for kind in current if kind != one) for one in current]
            left = [judged(some, base) for some in fewer]
            spared = [
                k
                for k, other in enumerate(left)
                if other.sizes and not self._helps(found.sizes, other.sizes)
            ]
            if not spared:
                break
            best = min(spared, key=lambda k: left[k].candidate.score)
            current, found = fewer[best], left[best]

    def _judge(self, candidate: Candidate, progress: Progress | None) -> _Judged:
        """Fit a candidate to all measurements once, and then without each fold."""
        chains, measurements, seed = self.chains, self.measurements, self.seed
        setup = replace(self.setup, learned=candidate.learned)
        setup = with_parameters(chains, measurements, setup, candidate.parameters)
        share = 1.0 / (1 + FOLDS)
        tell = portion(progress, 0.0, share)
        model = fit_model(chains, measurements, setup, seed, tell)
        measurements = model.weighted(measurements)
        grouping = Grouping.of(measurements, setup)
        masks = folds(grouping, model.fit, seed)
        if not masks:
            count = measurements.configurations
            raise OptionError(f"{count} configurations are too few to hold out a fold")
        rest = portion(progress, share, 1.0 - share)
        stages = None if rest is None else (lambda stage, part: rest(part))
        whole, workers = model.fit, self.workers
        parts = tuple(
            cross_validate(
                chains, measurements, setup, masks, seed, whole, stages, workers
            )
        )
        sizes = _sizes(grouping, model.problem, ModelErrors.joined(parts))
        weight, quantities = measurements.weight, model.problem.layout.quantities
        counted = ModelErrors.joined([part.counted(weight) for part in parts])
        judged = replace(
            candidate,
            rank=model.fit.rank,
            errors=tuple(
                (q.name, q.unit, float(q.errors(counted.after).mean()))
                for q in quantities
            ),
            score=float(np.nanmean(sizes)),
            deviation=_standard_error(sizes),
        )
        apart = tuple(
            part
            for part in cross_validate(
                chains,
                measurements,
                setup,
                regions(grouping, seed),
                seed,
                whole,
                None,
                workers,
            )
            if not part.reason and len(part.positions)
        )
        if not apart:
            return _Judged(judged, model, parts, (sizes,))
        far = _sizes(grouping, model.problem, ModelErrors.joined(apart))
        counted = ModelErrors.joined([part.counted(weight) for part in apart])
        lengths = [(q, q.errors(counted.after)) for q in quantities]
        away = Away(
            errors=tuple(
                AwayErrors(q.name, q.unit, float(e.mean()), root_mean_square(e))
                for q, e in lengths
            ),
            score=float(np.nanmean(far)),
            deviation=_standard_error(far),
        )
        return _Judged(replace(judged, away=away), model, parts, (sizes, far))

    def _helps(self, sizes: Sequence[Floats], before: Sequence[Floats]) -> bool:
        """Whether errors are smaller somewhere by more than chance, and larger nowhere.

        More than the standard error of the difference, where the model is used.
        """
        gains = self._asked([b - s for b, s in zip(before, sizes, strict=False)])
        told = [_mean(gain) for gain in gains]
        return not told or (
            any(mean > sigma for mean, sigma in told)
            and not any(mean < -sigma for mean, sigma in told)
        )

    def simplest(self) -> int:
        """Position of the simplest that helps and is not significantly worse.

        Than the best one, near or away. Where no candidate is that in both, the one
        that loses least.
        """
        fitted = [k for k, found in enumerate(self.judged) if found.sizes]
        candidates = [found.candidate for found in self.judged]
        sizes = {k: self._asked(self.judged[k].sizes) for k in fitted}
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

    def _asked(self, of_both: Sequence[Floats]) -> Sequence[Floats]:
        """Those near and away from what was fitted, as far as the use asks for them."""
        if self.use == "near":
            return of_both[:1]
        return of_both[-1:] if self.use == "away" else of_both


def _mean(values: Floats) -> tuple[float, float]:
    """Mean and standard error of what is known."""
    return float(np.nanmean(values)), _standard_error(values)


def _standard_error(values: Floats) -> float:
    values = values[~np.isnan(values)]
    return float(values.std(ddof=1) / np.sqrt(len(values)))


def _sizes(grouping: Grouping, problem: Problem, errors: ModelErrors) -> Floats:
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
    counts = np.bincount(labels, kept)
    totals = np.bincount(labels, np.where(kept, size, 0.0))
    return np.where(counts > 0, totals / np.maximum(counts, 1), np.nan)


def _require_patterns(
    chains: Chain | Chains,
    measurements: Observations,
    setup: Setup,
    parameterizations: Sequence[str],
) -> None:
    """Refuse names and globs that no candidate has."""
    names: list[str] = []
    for name in parameterizations:
        try:
            names += parameter_names(chains, measurements, setup, (name,))
        except OptionError:
            continue  # The candidate will say so.
    for pattern in (*setup.fixed, *setup.bounds, *setup.prior_by_glob):
        if not matching(pattern, names):
            raise OptionError(
                f"no parameter matches '{pattern}'{nearest(pattern, names)}",
                file=setup.file or None,
            )
