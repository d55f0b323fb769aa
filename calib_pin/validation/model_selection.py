"""Model selection: from joint offsets to a learned correction, as far as it helps.

Every candidate is judged by a cross-validation in the same folds, which keep
repetitions of a configuration together. It helps if it lowers the error of the
candidates it extends by more than the standard error of the difference. Gears and
compliance pass for each other in part, so they are tried alone and together. In the end
the simplest candidate within one standard error of the best is chosen (Breiman et al.,
Classification and Regression Trees, 1984, section 3.4.3).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError, nearest
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
from calib_pin.setup import Setup
from calib_pin.validation.held_out import cross_validate
from calib_pin.validation.model_errors import ModelErrors
from calib_pin.validation.splits import FOLDS, Grouping, folds
from calib_pin.validation.summaries import Candidate, ModelSelection
from calib_pin.workers import SERIAL, Workers

OFFSETS = JointOffset.name

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

    The sizes are those of the whitened errors, mean of every cluster, shape (G,).
    """

    candidate: Candidate
    model: FittedModel | None = None
    parts: tuple[ModelErrors, ...] = ()
    sizes: Floats | None = None


@serial_blas
def select_model(
    chains: Chain | Chains,
    measurements: Observations,
    setup: Setup,
    seed: int,
    progress: Stages | None = None,
    workers: Workers = SERIAL,
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

    Raises:
        OptionError: If a name in the setup belongs to no candidate, or the measurements
            do not even suffice to judge the first one.
    """
    beyond = beyond_geometry()
    geometric = tuple(p for p in setup.parameters if p not in (OFFSETS, *beyond))
    geometric = geometric or Setup.parameters
    _require_patterns(chains, measurements, setup, (OFFSETS, *geometric, *beyond))
    learned = tuple(RESIDUAL_MODELS) if setup.learned is None else (setup.learned,)
    work = 3.0 + len(beyond) + LEARNING * len(learned)
    candidates = _Candidates(chains, measurements, setup, seed, progress, workers, work)

    offset = candidates.add("joint offset", (OFFSETS,))
    if offset.sizes is None:
        raise OptionError(f"no model can be selected: {offset.candidate.reason}")
    geometry = candidates.add("geometric", geometric, extends=(offset,))
    base = geometry if geometry.candidate.helps else offset
    kinds = base.candidate.parameters
    alone = [
        candidates.add(f"+ {name}", (*kinds, name), extends=(base,)) for name in beyond
    ]
    both = f"+ {' + '.join(beyond)}"
    candidates.add(both, (*kinds, *beyond), extends=(base, *alone))
    base = candidates.judged[candidates.simplest()]
    for name in learned:
        kinds = base.candidate.parameters
        candidates.add(f"+ {name}", kinds, name, extends=(base,))
    chosen = candidates.simplest()
    found = candidates.judged[chosen]
    assert found.model is not None
    every = tuple(judged.candidate for judged in candidates.judged)
    return SelectedModel(ModelSelection(every, chosen), found.model, found.parts)


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
        if found.sizes is not None:
            helps = all(_helps(found.sizes, below.sizes) for below in extends)
            found = replace(found, candidate=replace(found.candidate, helps=helps))
        self.judged.append(found)
        return found

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
        weight = measurements.weight
        counted = ModelErrors.joined([part.counted(weight) for part in parts])
        judged = replace(
            candidate,
            rank=model.fit.rank,
            errors=tuple(
                (q.name, q.unit, float(q.errors(counted.after).mean()))
                for q in model.problem.layout.quantities
            ),
            score=float(np.nanmean(sizes)),
            deviation=_standard_error(sizes),
        )
        return _Judged(judged, model, parts, sizes)

    def simplest(self) -> int:
        """Position of the simplest that helps within a deviation of the best."""
        fitted = [k for k, found in enumerate(self.judged) if found.sizes is not None]
        candidates = [found.candidate for found in self.judged]
        best = min(fitted, key=lambda k: candidates[k].score)
        limit = candidates[best].score + candidates[best].deviation
        good = [
            k for k in fitted if candidates[k].helps and candidates[k].score <= limit
        ]
        # Chance may leave the best one short of helping, and what it is compared with
        # out of reach.
        return min(
            good or [best],
            key=lambda k: (candidates[k].learned is not None, candidates[k].rank),
        )


def _helps(sizes: Floats, before: Floats | None) -> bool:
    """Whether errors are smaller by more than the standard error of the difference."""
    if before is None:
        return True
    gain = before - sizes
    return float(np.nanmean(gain)) > _standard_error(gain)


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
