"""The model ladder: from joint offsets to a learned correction, as far as it helps.

Every rung is judged by a cross-validation in the same parts, which keep repetitions of
a configuration together. It helps if it lowers the error of the rungs that it stands on
by more than the standard error of the difference. Gears and compliance pass for each
other in part, so they are tried alone and together. In the end the simplest rung within
one standard error of the best is kept (Breiman et al., Classification and Regression
Trees, 1984, section 3.4.3).
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError, nearest
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements
from calib_pin.parameterizations import beyond_geometry
from calib_pin.parameterizations.joint_offset import JointOffset
from calib_pin.parameters import matching
from calib_pin.progress import Progress, Stages, named, portion
from calib_pin.residual_models import RESIDUAL_MODELS
from calib_pin.setup import Setup
from calib_pin.validation.held_out import counting
from calib_pin.validation.result import Ladder, Rung
from calib_pin.validation.splits import FOLDS, clusters, folds
from calib_pin.validation.training import (
    Trained,
    cross_validate,
    parameter_names,
    train,
    with_parameters,
)
from calib_pin.validation.unseen import Unseen

__all__ = ["Climbed", "select_model"]

OFFSETS = JointOffset.name

LEARNING = 10.0
"""Time that a training with a residual model takes, in those without."""


@dataclass(frozen=True)
class Climbed:
    """The rung that is kept, and all that were tried.

    Attributes:
        ladder: The rungs.
        setup: The setup of the one that is kept.
        trained: It, trained on all rows.
        unseen: Its cross-validation, part by part.
    """

    ladder: Ladder
    setup: Setup
    trained: Trained
    unseen: tuple[Unseen, ...]


@dataclass(frozen=True)
class _Tried:
    """A rung with what was found on it; nothing where it could not be tried.

    Attributes:
        rung: The rung.
        setup: Its setup.
        trained: It, trained on all rows.
        unseen: Its cross-validation.
        sizes: Mean size of the whitened errors of every configuration, shape (G,).
    """

    rung: Rung
    setup: Setup
    trained: Trained | None = None
    unseen: tuple[Unseen, ...] = ()
    sizes: Floats | None = None


@serial_blas
def select_model(
    chain: Chain,
    rows: Measurements,
    setup: Setup,
    seed: int,
    progress: Stages | None = None,
) -> Climbed:
    """Judge every rung, and keep the simplest of the best.

    Args:
        chain: The nominal chain.
        rows: The rows to fit.
        setup: What is known; its geometric parameterizations make the second rung.
        seed: Seed of configurations, splits, and starts.
        progress: Told the stage and the part that is done, 0 to 1.

    Raises:
        OptionError: If a name in the setup belongs to no rung, or the rows do not even
            suffice to judge the first one.
    """
    beyond = beyond_geometry()
    geometric = tuple(p for p in setup.parameters if p not in (OFFSETS, *beyond))
    geometric = geometric or Setup.parameters
    _require_patterns(chain, rows, setup, (OFFSETS, *geometric, *beyond))
    learned = tuple(RESIDUAL_MODELS) if setup.learned is None else (setup.learned,)
    rungs = _Rungs(chain, rows, setup, seed, progress, len(learned))

    offset = rungs.step("joint offset", (OFFSETS,))
    if offset.sizes is None:
        raise OptionError(f"the model ladder has no footing: {offset.rung.reason}")
    geometry = rungs.step("geometric", geometric, on=(offset,))
    base = geometry if geometry.rung.helps else offset
    alone = [
        rungs.step(f"+ {name}", (*base.setup.parameters, name), on=(base,))
        for name in beyond
    ]
    everything = (*base.setup.parameters, *beyond)
    rungs.step(f"+ {' + '.join(beyond)}", everything, on=(base, *alone))
    base = rungs.tried[rungs.simplest()]
    for name in learned:
        rungs.step(f"+ {name}", base.setup.parameters, name, on=(base,))
    return rungs.settled()


class _Rungs:
    """The rungs that were tried, simplest first.

    Args:
        chain: The nominal chain.
        rows: The rows to fit.
        setup: What is known.
        seed: Seed of configurations, splits, and starts.
        progress: Told the stage and the part that is done.
        learned: Number of rungs on which something will be learned.
    """

    def __init__(
        self,
        chain: Chain,
        rows: Measurements,
        setup: Setup,
        seed: int,
        progress: Stages | None,
        learned: int,
    ) -> None:
        self.tried: list[_Tried] = []
        self._chain, self._rows, self._setup, self._seed = chain, rows, setup, seed
        self._progress = progress
        self._done, self._all = 0.0, 3.0 + len(beyond_geometry()) + LEARNING * learned

    def step(
        self,
        name: str,
        parameters: tuple[str, ...],
        learned: str | None = None,
        *,
        on: Sequence[_Tried] = (),
    ) -> _Tried:
        """Try a rung, and compare it with those that it stands on.

        Args:
            name: What the table calls it.
            parameters: Its parameterizations.
            learned: Its residual model.
            on: Rungs whose errors it must lower.
        """
        share = (1.0 if learned is None else LEARNING) / self._all
        tell = portion(named(self._progress, name), self._done, share)
        self._done += share
        setup = replace(self._setup, learned=learned)
        blank = Rung(name, parameters, learned)
        try:
            found = self._judged(blank, setup, tell)
        except InputError as error:
            reason = replace(blank, reason=error.reason)
            found = _Tried(reason, replace(setup, parameters=parameters))
        if found.sizes is not None:
            helps = all(_helps(found.sizes, below.sizes) for below in on)
            found = replace(found, rung=replace(found.rung, helps=helps))
        self.tried.append(found)
        return found

    def _judged(self, rung: Rung, setup: Setup, progress: Progress | None) -> _Tried:
        """Train a rung and look at rows it has not seen."""
        rows = self._rows
        setup = with_parameters(self._chain, rows, setup, rung.parameters)
        # All rows once, and then without each part.
        share = 1.0 / (1 + FOLDS)
        tell = portion(progress, 0.0, share)
        trained = train(self._chain, rows, setup, self._seed, tell)
        rows = counting(rows, trained.fit)
        masks = folds(rows, trained.fit, self._seed)
        if not masks:
            raise OptionError(
                f"{rows.configurations} configurations are too few to leave a part out"
            )
        parts = portion(progress, share, 1.0 - share)
        stages = None if parts is None else (lambda stage, part: parts(part))
        unseen = tuple(
            cross_validate(
                self._chain, rows, setup, masks, self._seed, trained.fit, stages
            )
        )
        sizes = _sizes(rows, trained.problem, unseen)
        judged = replace(
            rung,
            rank=trained.fit.rank,
            errors=tuple(
                _mean_errors(
                    trained.problem, [part.counted(rows.weight) for part in unseen]
                )
            ),
            score=float(np.nanmean(sizes)),
            deviation=_standard_error(sizes),
        )
        return _Tried(judged, setup, trained, unseen, sizes)

    def simplest(self) -> int:
        """Position of the simplest rung that helps within a deviation of the best."""
        judged = [k for k, found in enumerate(self.tried) if found.sizes is not None]
        rungs = [found.rung for found in self.tried]
        best = min(judged, key=lambda k: rungs[k].score)
        limit = rungs[best].score + rungs[best].deviation
        good = [k for k in judged if rungs[k].helps and rungs[k].score <= limit]
        # Chance may leave the best one short of helping, and what it is compared with
        # out of reach.
        return min(
            good or [best], key=lambda k: (rungs[k].learned is not None, rungs[k].rank)
        )

    def settled(self) -> Climbed:
        """The rung that is kept."""
        chosen = self.simplest()
        found = self.tried[chosen]
        assert found.trained is not None
        return Climbed(
            Ladder(tuple(f.rung for f in self.tried), chosen),
            found.setup,
            found.trained,
            found.unseen,
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


def _sizes(rows: Measurements, problem: Problem, unseen: Sequence[Unseen]) -> Floats:
    """Mean size of the whitened errors of every cluster of rows, shape (G,).

    NaN where all of a cluster is set aside.
    """
    positions = np.concatenate([part.positions for part in unseen])
    order = np.argsort(positions, kind="stable")
    after = np.concatenate([part.after for part in unseen])[order]
    sigma = replace(problem, data=rows).given_sigma[positions[order]]
    size = np.sqrt(np.nanmean((after / sigma) ** 2, axis=1))
    seen = positions[order]
    labels, kept = clusters(rows, problem.setup)[seen], rows.weight[seen] > 0.0
    counts = np.bincount(labels, kept)
    totals = np.bincount(labels, np.where(kept, size, 0.0))
    return np.where(counts > 0, totals / np.maximum(counts, 1), np.nan)


def _mean_errors(
    problem: Problem, unseen: Sequence[Unseen]
) -> Iterator[tuple[str, str, float]]:
    """Name, unit and mean error of every quantity."""
    after = np.concatenate([part.after for part in unseen])
    for quantity in problem.measurement.quantities:
        yield quantity.name, quantity.unit, float(quantity.errors(after).mean())


def _require_patterns(
    chain: Chain, rows: Measurements, setup: Setup, parameterizations: Sequence[str]
) -> None:
    """Refuse names and globs that match on no rung."""
    names: dict[str, None] = {}
    for name in parameterizations:
        try:
            names.update(dict.fromkeys(parameter_names(chain, rows, setup, (name,))))
        except OptionError:
            continue  # The rung will say so.
    for pattern in (*setup.fixed, *setup.bounds, *setup.prior):
        if not matching(pattern, list(names)):
            raise OptionError(
                f"no parameter matches '{pattern}'{nearest(pattern, names)}",
                file=setup.file or None,
            )
