"""How measurements are split to check a fit: what must stay together, and the folds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.problem import distinct_values
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.side_by_side import by_part, repeated_targets
from calib_pin.observations import AT, PART, Measurements, fitted_and_held_out
from calib_pin.setup import Setup

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


@dataclass(frozen=True)
class StretchOptions:
    """Limits of what counts as a path, and how it is cut.

    Attributes:
        close: Mean square of successive distances, by that of random pairs, of a
            path. Random order has 1. Whatever is measured along a path, in
            clusters, or line by line on a grid has less than 0.4 (UR10 Series A
            0.39 and 0.19, the grid of the UR5 0.25, Pandas 0.29 and 0.20); poses
            that somebody chose and ordered at will have more than 0.5 (TALOS 0.56,
            TIAGo 0.95 and 0.76, UR10 Series B 0.81).
        chance: Standard deviations by which it must fall short of 1 (von Neumann's
            ratio).
        unlike: The same ratio at the distance in the file from which they count as
            unlike: 1 - 1/e, where an exponential correlation has decayed to 1/e.
        blocks: Blocks that a file is cut into where its correlation allows it.
        fewest_blocks: Blocks that a file is cut into in any case: as many as there
            are folds.
        jump: Length of a step that is a jump, by that of the step at hand.
        fewest: Configurations whose order can tell anything: chance must not look
            like a path.
    """

    close: float = 0.5
    chance: float = 3.0
    unlike: float = 0.63
    blocks: int = 20
    fewest_blocks: int = 5
    jump: float = 2.0
    fewest: int = 10


OPTIONS = StretchOptions()


def stretches(rows: Measurements) -> NDArray[np.int64]:
    """Label of the stretch of the file in which each row stands, shape (N,).

    It is a path if successive configurations z (joint positions in units of their
    scatter) are closer than chance would have them: the variogram

        g(h) = mean |z_(i+h) - z_i|^2 / mean |z_j - z_i|^2

    is 1 for every h in random order; g(1) is half of von Neumann's ratio (1941), with a
    standard deviation of at most 1 / sqrt(N). Then the file is cut into blocks as long
    as the correlation of its configurations: the first h with g(h) > 1 - 1/e. A
    repetition belongs to the block where its configuration first stands.

    Returns:
        The labels, from 0; all -1 where the order tells nothing.
    """
    none = np.full(len(rows), -1)
    if len(rows) < OPTIONS.fewest:
        return none
    configuration = rows.groups()
    _, first = np.unique(configuration, return_index=True)
    order = np.sort(first)
    file = np.unique(np.array(rows.files), return_inverse=True)[1][order]
    q, scatter = rows.q[order], rows.q[order].std(axis=0)
    moves = scatter > 1e-9
    # In units of the scatter, without joints that stand still.
    z = (q - q.mean(axis=0))[:, moves] / scatter[moves]
    count = len(order)
    if count < OPTIONS.fewest or not z.any():
        return none
    near = _variogram(z, file, 1)
    if near > min(OPTIONS.close, 1.0 - OPTIONS.chance / np.sqrt(count)):
        return none
    longest = count // OPTIONS.fewest_blocks
    # Every lag of the short ones; of the long ones a tenth apart.
    lags = np.unique(np.geomspace(1, longest, 24 + count.bit_length() * 4).astype(int))
    length = next(
        (h for h in lags.tolist()[1:] if _variogram(z, file, h) > OPTIONS.unlike),
        longest,
    )
    length = max(length, min(count // OPTIONS.blocks, 2 * length), 1)
    block = _blocks(z, file, length)
    of = np.empty(count, np.int64)
    of[configuration[order]] = block
    return of[configuration]


def _variogram(z: Floats, file: NDArray[np.int64], lag: int) -> float:
    """Mean square distance at a distance in the file, by that of random pairs."""
    inside = file[lag:] == file[:-lag]
    if not inside.any():
        return 1.0
    squares = np.sum((z[lag:] - z[:-lag])[inside] ** 2, axis=1)
    # Of two independent configurations: twice the variance, which is 1 per joint.
    return float(squares.mean() / (2.0 * z.shape[1]))


def _blocks(z: Floats, file: NDArray[np.int64], length: int) -> NDArray[np.int64]:
    """Label of blocks of about equal length that end with their file.

    A jump near the nominal end, between two clusters or lines, is where the next block
    begins.
    """
    begins = np.zeros(len(file), bool)
    begins[0] = True
    begins[1:] = np.diff(file) != 0
    step = np.zeros(len(file))
    step[1:] = np.sum(np.diff(z, axis=0) ** 2, axis=1)
    starts = np.flatnonzero(begins)
    for start, stop in zip(starts, [*starts[1:], len(file)], strict=True):
        count = max(1, round((stop - start) / length))
        ends = start + np.arange(1, count) * (stop - start) // count
        for end in ends.tolist():
            low = end - (length - 1) // 2
            high = min(end + length // 2 + 1, stop)
            jump = low + int(np.argmax(step[low:high]))
            begins[jump if step[jump] > OPTIONS.jump**2 * step[end] else end] = True
    return np.asarray(np.cumsum(begins) - 1)
