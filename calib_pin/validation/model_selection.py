"""Model selection: from joint offsets to a learned correction, as far as it helps.

Every candidate is judged by two cross-validations, each in the same folds: *near* the
fitted configurations by random folds, which keep repetitions of a configuration
together, and *away* from them by whole regions of joint space (`validation.regions`).
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

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError, nearest, require_known
from calib_pin.estimation.fit import FittedModel, fit_model
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
from calib_pin.residual_models.base import root_mean_square
from calib_pin.setup import Setup
from calib_pin.validation.candidate_scores import (
    USES,
    Judged,
    cluster_sizes,
    helps,
    mean_score,
    simplest,
    standard_error,
)
from calib_pin.validation.held_out import cross_validate
from calib_pin.validation.model_errors import ModelErrors
from calib_pin.validation.regions import regions
from calib_pin.validation.splits import FOLDS, Grouping, folds
from calib_pin.validation.summaries import (
    Candidate,
    HeldOutErrors,
    MeanError,
    ModelSelection,
    QuantityError,
)
from calib_pin.workers import SERIAL, Workers

OFFSETS = JointOffset.name

TOGETHER = (Transmission.name, Compliance.name)
"""Effects that are tried together whether they help alone or not."""

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
    geometric = tuple(
        p for p in setup.parameters if p not in (OFFSETS, *outside_urdf())
    )
    beyond = _further(measurements, setup)
    geometric = geometric or Setup.parameters
    _require_patterns(chains, measurements, setup, (OFFSETS, *geometric, *beyond))
    learned = tuple(RESIDUAL_MODELS) if setup.learned is None else (setup.learned,)
    learning = LEARNING * len(learned)
    work = 2.0 + len(beyond) * (len(beyond) + 1) / 2 + learning
    given = chains, measurements, setup, seed, progress, workers, use, work, learning
    candidates = _Candidates(*given)

    offset = candidates.add("joint offset", (OFFSETS,))
    if not offset.sizes:
        raise OptionError(f"no model can be selected: {offset.candidate.reason}")
    geometry = candidates.add("geometric", geometric, extends=(offset,))
    base = geometry if geometry.candidate.helps else offset
    candidates.combine(base, beyond)
    # Learning makes up for what is left near; away, what it builds on decides.
    base = candidates.judged[simplest(candidates.judged, _carrying(use))]
    for name in learned:
        kinds = base.candidate.parameters
        candidates.add(f"+ {name}", kinds, name, extends=(base,))
    chosen = simplest(candidates.judged, use)
    found = candidates.judged[chosen]
    assert found.model is not None
    every = tuple(judged.candidate for judged in candidates.judged)
    q = measurements.q
    near = zip(q.min(axis=0).tolist(), q.max(axis=0).tolist(), strict=True)
    ranges = dict(zip(measurements.joints, near, strict=True))
    selection = ModelSelection(every[chosen].name, use, ranges, every)
    return SelectedModel(selection, found.model, found.parts)


def _carrying(use: str) -> str:
    """The use by which a model is chosen that a correction is learned beside."""
    return use if use == "near" else "away"


@dataclass
class _Candidates:
    """The candidates that were judged, simplest first; see `select_model`.

    How many there will be is not known beforehand: each takes its part of what is left.

    Attributes:
        work: Work that is left, in candidates without a learned correction.
        learning: The part of it that is kept for learned corrections.
        done: Part of the time that has passed.
    """

    chains: Chain | Chains
    measurements: Observations
    setup: Setup
    seed: int
    progress: Stages | None
    workers: Workers
    use: str
    work: float
    learning: float
    done: float = 0.0
    judged: list[Judged] = field(default_factory=list)

    def add(
        self,
        name: str,
        parameters: tuple[str, ...],
        learned: str | None = None,
        *,
        extends: Sequence[Judged] = (),
    ) -> Judged:
        """Judge a candidate, and compare it with those that it extends."""
        if learned is None:
            own, work = 1.0, max(self.work, self.learning + 1.0)
        else:
            own, work = LEARNING, self.learning
            self.learning -= LEARNING
        self.work, share = work - own, (1.0 - self.done) * own / work
        tell = portion(named(self.progress, name), self.done, share)
        self.done += share
        blank = Candidate(name, parameters, learned)
        try:
            found = self._judge(blank, tell)
        except InputError as error:
            found = Judged(replace(blank, reason=error.reason))
        if found.sizes:
            better = all(helps(found.sizes, below.sizes, self.use) for below in extends)
            found = replace(found, candidate=replace(found.candidate, helps=better))
        self.judged.append(found)
        return found

    def combine(self, base: Judged, kinds: Sequence[str]) -> None:
        """Judge kinds alone, then the best with one more as long as that helps.

        Gears and compliance, which may hide each other, are tried together in any case.
        At last each is left out again.
        """
        stated = base.candidate.parameters
        tried: dict[tuple[str, ...], Judged] = {}

        def judged(added: tuple[str, ...], *extends: Judged) -> Judged:
            added = tuple(kind for kind in kinds if kind in added)
            if added not in tried:
                name = f"+ {' + '.join(added)}"
                tried[added] = self.add(name, (*stated, *added), extends=extends)
            return tried[added]

        alone = {kind: judged((kind,), base) for kind in kinds}
        both = tuple(kind for kind in TOGETHER if kind in kinds)
        if len(both) > 1:
            judged(both, base, *(alone[kind] for kind in both))

        def best() -> tuple[str, ...]:
            found = {key: one for key, one in tried.items() if one.candidate.helps}
            return min(found, key=lambda k: mean_score(found[k], self.use), default=())

        current: tuple[str, ...] = ()
        while current != best():
            current = best()
            of_names = {PARAMETERIZATIONS[kind].kind for kind in current}
            for kind in kinds:
                # What has parameters of the same names cannot join. A larger effect may
                # have hidden the others when they were alone.
                if PARAMETERIZATIONS[kind].kind not in of_names:
                    judged((*current, kind), tried[current])
        # What came first may have stood for what came later, or for a part of itself.
        current = ()
        while current != best() and len(best()) > 1:
            current = best()
            for one in current:
                left = tuple(kind for kind in current if kind != one)
                judged(left, base)
                for kind in kinds:
                    alike = PARAMETERIZATIONS[kind].kind == PARAMETERIZATIONS[one].kind
                    if alike and kind != one:
                        judged((*left, kind), base)

    def _judge(self, candidate: Candidate, progress: Progress | None) -> Judged:
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
        whole, workers = model, self.workers
        parts = tuple(
            cross_validate(
                chains, measurements, setup, masks, seed, whole, stages, workers
            )
        )
        sizes, near = _scored(grouping, model, parts)
        judged = replace(
            candidate,
            rank=model.fit.rank,
            errors=tuple(MeanError(e.name, e.unit, e.mean) for e in near.errors),
            score=near.score,
            deviation=near.deviation,
        )
        masks = regions(grouping, seed)
        found = cross_validate(
            chains, measurements, setup, masks, seed, whole, None, workers
        )
        apart = [part for part in found if not part.reason and len(part.positions)]
        if not apart:
            return Judged(judged, model, parts, (sizes,))
        far, away = _scored(grouping, model, apart)
        return Judged(replace(judged, away=away), model, parts, (sizes, far))


def _scored(
    grouping: Grouping, model: FittedModel, parts: Sequence[ModelErrors]
) -> tuple[Floats, HeldOutErrors]:
    """Sizes of errors on held-out measurements, see `Judged`, and what they come to."""
    sizes = cluster_sizes(grouping, model.problem, ModelErrors.joined(parts))
    weight = grouping.measurements.weight
    counted = ModelErrors.joined([part.counted(weight) for part in parts])
    quantities = model.problem.layout.quantities
    lengths = [(q, q.errors(counted.after)) for q in quantities]
    return sizes, HeldOutErrors(
        errors=tuple(
            QuantityError(q.name, q.unit, float(e.mean()), root_mean_square(e))
            for q, e in lengths
        ),
        score=float(np.nanmean(sizes)),
        deviation=standard_error(sizes),
    )


def _further(measurements: Observations, setup: Setup) -> tuple[str, ...]:
    """Effects that may join the geometry: those for which enough is stated."""
    return tuple(
        name
        for name in outside_urdf()
        if all(
            len(getattr(block.conditions, condition))
            for condition in needed_conditions((name,))
            for block in measurements.blocks
        )
        and (name != MotorRipple.name or setup.gear_ratios)
    )


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
