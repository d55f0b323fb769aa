"""How measurements are split to check a fit: what must stay together, and the folds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.problem import distinct_values
from calib_pin.measurement_models.side_by_side import by_part, repeated_targets
from calib_pin.observations import AT, PART, Measurements, fitted_and_held_out
from calib_pin.setup import Setup
from calib_pin.validation.stretches import stretches

FOLDS = 5
"""Parts of a cross-validation."""

FEWEST = 4
"""Configurations of every target without which there is no cross-validation."""

FEWEST_PLACES = 3
"""Places without which measurements are held out one by one, and not place by place."""

TELLING_PLACES = 5
"""Places from which the scatter among them says more than that among configurations:
Student's t of fewer has tails so wide that no gain shows."""


@dataclass(frozen=True)
class Grouping:
    """The measurements that belong together when they are split or tested.

    Attributes:
        measurements: The N measurements.
        places: Label of the place of each, -1 for none, see `places`, shape (N,).
        stretched: Whether they stand on a path, see `stretches`.
        groups: Label of what each must stay together with in a split, shape (N,): all
            measurements of a place where there are several, otherwise stretches of a
            path, otherwise repetitions of a configuration.
        clusters: Label of those whose errors are one observation in a test, shape (N,):
            the groups, but configurations where places are so few that they would test
            nothing.
    """

    measurements: Measurements
    places: NDArray[np.int64]
    stretched: bool
    groups: NDArray[np.int64]
    clusters: NDArray[np.int64]

    @classmethod
    def of(cls, measurements: Measurements, setup: Setup) -> Grouping:
        """The grouping of measurements, with the known distances of a setup."""
        place = places(measurements, setup)
        other = stretches(measurements)
        stretched = not bool((other < 0).all())
        if not stretched:
            other = measurements.groups()
        groups = clusters = _merged(place, other)
        if len(set(place[place >= 0].tolist())) < TELLING_PLACES:
            clusters = _merged(np.full(len(measurements), -1), other)
        return cls(measurements, place, stretched, groups, clusters)

    def shuffled(self, seed: int) -> NDArray[np.int64]:
        """The labels of the groups in random order."""
        count = int(self.groups.max(initial=-1)) + 1
        return np.random.default_rng(seed).permutation(count)

    def validation_name(self, count: int) -> str:
        """The name of a cross-validation in a number of folds."""
        if count == 0:
            return "none"
        if (self.places < 0).all():
            return f"{count}-fold{' by stretch' if self.stretched else ''}"
        if (self.places >= 0).all() and count == len(set(self.places)):
            return "leave-one-place-out"
        return f"{count}-fold by place"


def folds(grouping: Grouping, fitted: Fit, seed: int) -> list[NDArray[np.bool_]]:
    """Masks of the parts of a cross-validation; none where measurements do not suffice.

    Groups stay together. What is fitted without a part must still determine the robot
    and every plane.

    Args:
        grouping: The N measurements and their groups.
        fitted: The fit of all of them.
        seed: Seed of the split.

    Returns:
        One mask of shape (N,) for each part.
    """
    rows, labels, place = grouping.measurements, grouping.groups, grouping.places
    order = grouping.shuffled(seed)
    count = FOLDS
    if (place >= 0).any():
        count = min(FOLDS, len(order))
    if len(order) < count:
        return []
    fold = np.empty(len(order), np.int64)
    fold[order] = np.arange(len(order)) % count
    targets = np.array(rows.target)
    # Only what is estimated must be seen in every part.
    references = fitted.problem.measurement.references
    free = {f.name for f in references if any(p.free for p in f.parameters)}
    sought = {
        name
        for name in set(targets[place < 0])
        if free.intersection(name.rpartition(PART)[2].split(AT))
    }
    masks = []
    for k in range(count):
        mask = fold[labels] == k
        rest = replace(fitted.problem, data=rows.rows(~mask))
        if distinct_values(rest) <= fitted.structure.rank or any(
            rows.rows(~mask & (targets == name)).configurations < FEWEST
            for name in sought
        ):
            return []
        masks.append(mask)
    return masks


def _merged(place: NDArray[np.int64], other: NDArray[np.int64]) -> NDArray[np.int64]:
    """Labels of places, and of stretches or configurations elsewhere, shape (N,)."""
    labels = np.where(place >= 0, place, place.max(initial=-1) + 1 + other)
    return np.unique(labels, return_inverse=True)[1].reshape(-1)


def places(measurements: Measurements, setup: Setup) -> NDArray[np.int64]:
    """Label of the place at which each measurement has its ball in a socket, (N,).

    Sockets belong to one place that share what stands before the last slash of their
    names, or a known distance. -1 for other measurements, and for all where there are
    fewer than three places.
    """
    sockets = repeated_targets(measurements)
    names = [name.rpartition(AT)[2] for name in sockets]
    home = {name: name.rpartition("/")[0] or name for name in names}
    for distance in setup.distances:
        first, second = (home.get(name, name) for name in distance.between)
        home = {k: first if v == second else v for k, v in home.items()}
    of = {name: k for k, name in enumerate(dict.fromkeys(filter(None, home.values())))}
    if len(of) < FEWEST_PLACES:
        return np.full(len(measurements), -1)
    return np.array([of[home[name]] if name else -1 for name in names], np.int64)


def split(
    measurements: Measurements,
    setup: Setup,
    validation: Measurements | None,
    holdout: float | None,
    seed: int,
) -> tuple[Measurements, Measurements | None, str]:
    """Training measurements, validation measurements if any, and how they were chosen.

    Raises:
        InputError: If no measurement is left to fit, or none of one model.
        OptionError: If the holdout is out of range, or validation measurements are
            given as well.
    """
    if validation is not None and holdout is not None:
        raise OptionError("give validation measurements or a holdout, not both")
    training, marked = fitted_and_held_out(measurements)
    if len(training) == 0:
        raise InputError("no measurement is left to fit: all are marked for validation")
    _require_parts(training, marked, "all are marked for validation")
    if validation is not None:
        if len(validation) == 0:
            raise InputError("there are no measurements to validate with")
        if validation.model != measurements.model:
            raise InputError(
                f"cannot check '{measurements.model}' measurements with "
                f"'{validation.model}' ones"
            )
        return training, validation, "file"
    if holdout is not None:
        mask = _held_out(training, setup, holdout, seed)
        kept, left = training.rows(~mask), training.rows(mask)
        _require_parts(kept, left, "the holdout took all")
        return kept, left, "holdout"
    return training, marked if len(marked) else None, "set"


def _held_out(
    measurements: Measurements, setup: Setup, holdout: float, seed: int
) -> NDArray[np.bool_]:
    """The mask of a holdout, which takes whole groups, shape (N,).

    Raises:
        OptionError: If it is out of range or leaves nothing.
    """
    if not 0.0 < holdout < 1.0:
        raise OptionError(
            "holdout is out of range", value=holdout, allowed="between 0 and 1"
        )
    grouping = Grouping.of(measurements, setup)
    labels, order = grouping.groups, grouping.shuffled(seed)
    count = max(1, round(holdout * len(measurements)))
    size = np.cumsum(np.bincount(labels)[order])
    chosen = np.zeros(len(order), bool)
    chosen[order[: int(np.searchsorted(size, count)) + 1]] = True
    mask = np.asarray(chosen[labels])
    if mask.all():
        raise OptionError("holdout leaves no measurement to fit", value=holdout)
    return mask


def _require_parts(training: Measurements, left: Measurements, why: str) -> None:
    """Refuse mixed measurements of which one model has none to fit.

    Raises:
        InputError: If there is such a model.
    """
    for model, (_, measurements) in by_part(left).items():
        if model not in by_part(training):
            raise measurements.error(
                0, f"no '{model}' measurement is left to fit: {why}", column="set"
            )
