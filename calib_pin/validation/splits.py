"""How measurements are split to check a fit: what must stay together, and the parts.

A part is held out *near* the fitted configurations, a random fold of groups that stay
together, or *away* from them. Random folds ask how well a model interpolates: next to
everything that is held out something was fitted. A robot also works where nothing was
measured, so whole regions of joint space are held out as well.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.problem import known_values
from calib_pin.estimation.terms import owner_of
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import declared
from calib_pin.observations import AT, Observations, fitted_and_held_out
from calib_pin.observations.labels import Booleans, Indices, firsts, numbered
from calib_pin.setup import Setup

FOLDS = 5
"""Parts of a cross-validation."""

MOST = 4000
"""Measurements that a part of a cross-validation holds out, in whole groups, at most
about twice as many: the error of twenty thousand is known to half a percent."""

FEWEST = 4
"""Configurations of every target without which there is no cross-validation, and of a
region without which it tells nothing."""

FEWEST_HELD_OUT = 5
"""Fewest distinct configurations for a check, and places from which the scatter among
them says more than that among configurations: Student's t of fewer has tails so wide
that no gain shows."""

THREE = 3
"""Configurations that a split leaves of every station, tool and chain where there are
several, for three positions locate a frame; and places without which measurements are
held out one by one, and not place by place."""

CLOSE = 0.5
"""Mean square of successive distances, by that of random pairs, of a path.

Random order has 1. Whatever is measured along a path, in clusters, or line by line on a
grid has less than 0.4 (UR10 Series A 0.39 and 0.19, the grid of the UR5 0.25, Pandas
0.29 and 0.20); poses that somebody chose and ordered at will have more than 0.5 (TALOS
0.56, TIAGo 0.95 and 0.76, UR10 Series B 0.81)."""

OUTER = 0.25
"""Part of the measurements in the outer part of the range of a joint."""

CLUSTERS = 4
"""Clusters of configurations that are held out."""


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

    measurements: Observations
    places: Indices
    stretched: bool
    groups: Indices
    clusters: Indices

    @classmethod
    def of(cls, measurements: Observations, setup: Setup) -> Grouping:
        """The grouping of measurements, with the known distances of a setup."""
        place, other = places(measurements, setup), stretches(measurements)
        stretched = bool((other >= 0).any())
        if not stretched:
            other = measurements.groups()
        groups = labels(place, np.where(place < 0, other, -1))
        telling = len(np.unique(place[place >= 0])) >= FEWEST_HELD_OUT
        return cls(measurements, place, stretched, groups, groups if telling else other)

    def shuffled(self, seed: int) -> tuple[Indices, Indices]:
        """The G groups in random order, one stratum after the other.

        Groups of one stratum have measurements of the same blocks, so that whatever
        takes its share of each has its share of every station, tool and chain.

        Returns:
            Labels of the groups and of the stratum of each, shape (G,).
        """
        data, count = self.measurements, int(self.groups.max(initial=-1)) + 1
        seen = np.zeros((count, len(data.blocks)), bool)
        seen[self.groups, data.block_of] = True
        strata = labels(*seen.T)
        order = np.random.default_rng(seed).permutation(count)
        order = order[np.argsort(strata[order], kind="stable")]
        return order, strata[order]

    def spared(self, mask: Booleans) -> Booleans:
        """A part to hold out without the groups that a frame cannot do without.

        Args:
            mask: The part, shape (N,).

        Returns:
            The mask of one that leaves configurations of every station, tool and chain.
        """
        data, mask = self.measurements, mask.copy()
        keys, configuration = data.keys, data.groups()
        count = int(configuration.max(initial=-1)) + 1
        ends = [(owner_of(k, keys, k.station), owner_of(k, keys, k.tool)) for k in keys]
        for names in (*zip(*ends, strict=True), [key.chain for key in keys]):
            frame, fitted = labels(names)[data.block_of], ~mask & (data.weight > 0.0)
            if not frame.any():
                continue
            # Distinct configurations of every frame among those that are left.
            pairs = np.unique((frame * count + configuration)[fitted])
            counts = np.bincount(pairs // count, minlength=len(keys))
            needed = mask & (counts < THREE)[frame]
            mask &= ~np.isin(self.groups, self.groups[needed])
        return mask

    def validation_name(self, count: int) -> str:
        """The name of a cross-validation in a number of folds."""
        if count == 0:
            return "none"
        if (self.places < 0).all():
            return f"{count}-fold{' by stretch' if self.stretched else ''}"
        if (self.places >= 0).all() and count == len(np.unique(self.places)):
            return "leave-one-place-out"
        return f"{count}-fold by place"


def labels(*columns: object) -> Indices:
    """Label of each row of some columns, equal for equal ones, from 0, shape (N,)."""
    result = np.zeros(1, np.int64)
    for column in columns:
        # One column after the other: to sort rows takes ten times as long.
        _, codes = np.unique(np.asarray(column), return_inverse=True)
        codes = result * (codes.max(initial=0) + 1) + codes.reshape(-1)
        result = numbered(codes)[1]
    return np.asarray(result)


def folds(grouping: Grouping, fitted: Fit, seed: int) -> list[Booleans]:
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
    rows, (order, _) = grouping.measurements, grouping.shuffled(seed)
    placed = (grouping.places >= 0).any()
    count = min(FOLDS, len(order)) if placed else FOLDS
    if len(order) < count:
        return []
    fold = np.empty(len(order), np.int64)
    fold[order] = np.arange(len(order)) % count
    parts = (grouping.spared(fold[grouping.groups] == k) for k in range(count))
    masks = [_thinned(mask, grouping.groups) for mask in parts if mask.any()]
    # Only what is estimated must be seen in every part.
    targets = [seen & (grouping.places < 0) for seen in _target_masks(fitted, rows)]
    # What priors hold counts among what is known and among what is needed.
    held = len(fitted.problem.further.priors) > 0
    needed = fitted.rank if held else fitted.structure.rank
    aside = int((rows.weight == 0.0).sum())
    for mask in masks:
        counts = (len(numbered(rows.groups()[t & ~mask])[0]) for t in targets)
        if any(0 < number < FEWEST for number in counts):
            return []
        # Every group that is left is a configuration or more.
        if len(order) - int(mask.sum()) - aside <= needed:
            rest = replace(fitted.problem, data=rows.rows(~mask))
            if known_values(rest) <= needed:
                return []
    return masks


def _thinned(mask: Booleans, groups: Indices) -> Booleans:
    """As many groups of a part as tell its errors, evenly spread, shape (N,)."""
    distinct, _ = numbered(groups[mask])
    return mask & np.isin(groups, distinct[:: max(1, int(mask.sum()) // MOST)])


def _target_masks(fitted: Fit, rows: Observations) -> Iterator[Booleans]:
    """Masks of the N measurements of each target that has something to estimate, (N,).

    From another station it may be another thing, or the same one.
    """
    masks: dict[tuple[str, ...], Booleans] = {}
    for block, part in zip(rows.blocks, rows.slices, strict=True):
        term = fitted.problem.terms[block.key]
        references = term.measurement.references
        estimated = [r for r in references if any(p.free for p in r.parameters)]
        free = {r.name: term.frames.reference(r) for r in estimated}
        for name in block.target.distinct:
            if halves := [free[half] for half in name.split(AT) if half in free]:
                mask = masks.setdefault((name, *halves), np.zeros(len(rows), bool))
                mask[part] |= block.target.where(name)
    return iter(masks.values())


def regions(grouping: Grouping, seed: int) -> list[Booleans]:
    """Masks of regions of joint space, of shape (N,) each; they may overlap.

    Of each joint an outer part of its range, and clusters of configurations. Fitted on
    Series A of a UR10 they predict, of geometry with compliance and of a Gaussian
    process on top, 0.55 and 0.26 mm; on Series B, other motions on another day, they
    have 0.45 and 0.31 mm. Random folds said 0.43 and 0.10 mm.

    Args:
        grouping: The N measurements; repetitions of a configuration stay together.
        seed: Seed of the first centers of clusters.
    """
    q = grouping.measurements.q
    spread, masks = q.std(axis=0), []
    moved = [k for k in np.argsort(-spread, kind="stable") if spread[k] > 1e-6]
    for turn, joint in enumerate(moved[:7]):
        # Alternately its upper and its lower end.
        values = q[:, joint] if turn % 2 else -q[:, joint]
        masks.append(values > np.quantile(values, 1.0 - OUTER, method="lower"))
    if moved:
        label = _clusters(np.concatenate([np.sin(q), np.cos(q)], axis=1), seed)
        masks += [label == k for k in range(CLUSTERS)]
    configuration = grouping.measurements.groups()
    spared = {mask.tobytes(): mask for mask in map(grouping.spared, masks)}
    # What is fitted without more than half is another calibration (of 37 postures of a
    # TIAGo, 33 are in one cluster).
    smaller = [mask for mask in spared.values() if mask.mean() <= 0.5]
    return [mask for mask in smaller if len(np.unique(configuration[mask])) >= FEWEST]


def _clusters(points: Floats, seed: int) -> Indices:
    """Label of the cluster of each point, (N, k) -> (N,) (Lloyd 1982).

    The first centers are far from one another (Gonzalez 1985), which leaves nothing
    but the first of them to chance.
    """
    centers = points[np.random.default_rng(seed).integers(len(points), size=1)]

    def squares() -> Floats:
        return np.asarray(((points[:, None] - centers) ** 2).sum(axis=2))

    while len(centers) < CLUSTERS:
        centers = np.vstack([centers, points[squares().min(axis=1).argmax()]])
    for _ in range(20):  # They need not settle to the last configuration.
        label = squares().argmin(axis=1)
        for k in np.unique(label):
            centers[k] = points[label == k].mean(axis=0)
    return np.asarray(label)


def stretches(rows: Observations) -> Indices:
    """Label of the stretch of the file in which each row stands, shape (N,).

    It is a path if successive configurations z (joint positions in units of their
    scatter) are closer than chance would have them: the variogram

        g(h) = mean |z_(i+h) - z_i|^2 / mean |z_j - z_i|^2

    is 1 for every h in random order; g(1) is half of von Neumann's ratio (1941), with a
    standard deviation of at most 1 / sqrt(N). Then the file is cut into blocks as long
    as the correlation of its configurations: the first h with g(h) > 1 - 1/e. A
    repetition belongs to the block where its configuration first stands. Chains that
    are measured in turn have a path each.

    Returns:
        The labels, from 0; all -1 where the order tells nothing.
    """
    configuration, unknown = rows.groups(), np.full(len(rows), -1)
    chain = labels([key.chain for key in rows.keys])
    path = labels(rows.files.codes, chain[rows.block_of])
    in_order = rows.in_order[np.argsort(path[rows.in_order], kind="stable")]
    order = in_order[firsts(configuration[in_order])]
    file, q, count = path[order], rows.q[order], len(order)
    scatter = q.std(axis=0) if count else np.zeros(0)
    moves = scatter > 1e-9
    # Chance must not look like a path.
    if count < 2 * FEWEST_HELD_OUT or not moves.any():
        return unknown
    # In units of the scatter, without joints that stand still.
    z = q[:, moves] / scatter[moves]
    if _variogram(z, file, 1) > min(CLOSE, 1.0 - 3.0 / np.sqrt(count)):
        return unknown
    longest = count // FOLDS
    # Every lag of the short ones; of the long ones a tenth apart.
    lags = np.unique(np.geomspace(1, longest, 24 + count.bit_length() * 4).astype(int))
    unlike = (h for h in lags.tolist()[1:] if _variogram(z, file, h) > 0.63)
    length = next(unlike, longest)
    # Four blocks a fold, where the correlation allows it.
    length = max(length, min(count // (4 * FOLDS), 2 * length), 1)
    stretch = np.empty(count, np.int64)
    stretch[configuration[order]] = _blocks(z, file, length)
    return stretch[configuration]


def _variogram(z: Floats, file: Indices, lag: int) -> float:
    """Mean square distance at a distance in the file, by that of random pairs."""
    inside = file[lag:] == file[:-lag]
    if not inside.any():
        return 1.0
    steps = z[lag:] - z[:-lag]
    squares = np.einsum("ni,ni->n", steps, steps)[inside]
    # Of two independent configurations: twice the variance, which is 1 per joint.
    return float(squares.mean() / (2.0 * z.shape[1]))


def _blocks(z: Floats, file: Indices, length: int) -> Indices:
    """Label of blocks of about equal length that end with their file.

    A jump near the nominal end, between two clusters or lines, is where the next block
    begins.
    """
    begins = np.diff(file, prepend=-1) != 0
    step = np.append(0.0, np.sum(np.diff(z, axis=0) ** 2, axis=1))
    starts = np.flatnonzero(begins)
    for start, stop in zip(starts, [*starts[1:], len(file)], strict=True):
        count = max(1, round((stop - start) / length))
        for end in (start + np.arange(1, count) * (stop - start) // count).tolist():
            low = end - (length - 1) // 2
            jump = low + int(np.argmax(step[low : min(end + length // 2 + 1, stop)]))
            # Twice as long as the step at hand.
            begins[jump if step[jump] > 4.0 * step[end] else end] = True
    return np.asarray(np.cumsum(begins) - 1)


def places(measurements: Observations, setup: Setup) -> Indices:
    """Label of the place at which each measurement has its ball in a socket, (N,).

    Sockets belong to one place that share their station and what stands before the last
    slash of their names, or a known distance. -1 for other measurements, and for all
    where there are fewer than three places.
    """
    home, sockets = dict[str, str](), list[tuple[str, Indices]]()
    for block, part in zip(measurements.blocks, measurements.slices, strict=True):
        if declared(block.model).naming.configurations == 1:
            continue
        for target in block.target.distinct:
            if name := target.rpartition(AT)[2]:
                socket = f"{block.station}/{name}".lstrip("/")
                place = socket.rpartition("/")[0]
                home.setdefault(socket, socket if place == block.station else place)
                index = np.flatnonzero(block.target.where(target))
                sockets.append((socket, part.start + index))
    for distance in setup.distances:
        for station in dict.fromkeys(["", *(key.station for key in measurements.keys)]):
            ends = [f"{station}/{name}".lstrip("/") for name in distance.between]
            first, second = (home.get(end, end) for end in ends)
            home = {s: first if p == second else p for s, p in home.items()}
    label = np.full(len(measurements), -1)
    number = {place: k for k, place in enumerate(dict.fromkeys(home.values()))}
    if len(number) >= THREE:
        for socket, index in sockets:
            label[index] = number[home[socket]]
    return label


def split(
    measurements: Observations,
    setup: Setup,
    validation: Observations | None,
    holdout: float | None,
    seed: int,
) -> tuple[Observations, Observations | None, str]:
    """Training measurements, validation measurements if any, and how they were chosen.

    Raises:
        InputError: If no measurement is left to fit, or none of a model, chain or tool
            that is to be validated.
        OptionError: If the holdout is out of range, or validation measurements are
            given as well.
    """
    if validation is not None and holdout is not None:
        raise OptionError("give validation measurements or a holdout, not both")
    training, held = fitted_and_held_out(measurements)
    why, method = "no {} is left to fit: all are for validation", "set"
    # Whatever else is held out: what only the column 'set' holds back is never fitted.
    _require_fitted(training, held, why, column=method)
    if validation is not None:
        if len(validation) == 0:
            raise InputError("there are no measurements to validate with")
        held, method = validation, "file"
        why = "these cannot be checked: no {} is fitted"
    elif holdout is not None:
        mask = _held_out(training, setup, holdout, seed)
        training, held, method = training.rows(~mask), training.rows(mask), "holdout"
        why = "no {} is left to fit: the holdout took all"
    _require_fitted(training, held, why)
    return training, held if len(held) else None, method


def _require_fitted(
    training: Observations, held: Observations, why: str, column: str | None = None
) -> None:
    """Refuse measurements to validate with of a kind of which there is none to fit.

    Only the station of the instrument may be another one.

    Args:
        training: The measurements to fit.
        held: Those to validate with.
        why: The reason, with braces where the kind belongs.
        column: The column that says so.

    Raises:
        InputError: If there are such.
    """
    fitted = {key._replace(station="") for key in training.keys}
    for block in held.blocks:
        model, chain, _, tool = block.key
        if len(block) and block.key._replace(station="") not in fitted:
            kind = f"'{model}' measurement"
            kind += f" of the chain '{chain}'" if chain else ""
            kind += f" with the tool '{tool}'" if tool else ""
            raise block.error(0, why.format(kind), column=column)


def _held_out(
    measurements: Observations, setup: Setup, holdout: float, seed: int
) -> Booleans:
    """The mask of a holdout, which takes whole groups, shape (N,).

    Raises:
        OptionError: If it is out of range or leaves nothing.
    """
    if not 0.0 < holdout < 1.0:
        allowed = "between 0 and 1"
        raise OptionError("holdout is out of range", value=holdout, allowed=allowed)
    grouping = Grouping.of(measurements, setup)
    labels, (order, stratum) = grouping.groups, grouping.shuffled(seed)
    # The same share of every stratum, whatever its size.
    _, start, sizes = np.unique(stratum, return_index=True, return_counts=True)
    share = (np.arange(len(order)) - start[stratum] + 0.5) / sizes[stratum]
    order = order[np.argsort(share, kind="stable")]
    size = np.cumsum(np.bincount(labels)[order])
    last = int(np.searchsorted(size, max(1, round(holdout * len(measurements)))))
    mask = grouping.spared(np.isin(labels, order[: last + 1]))
    if mask.all():
        raise OptionError("holdout leaves no measurement to fit", value=holdout)
    held = measurements.rows(mask).configurations
    if held < FEWEST_HELD_OUT:
        reason = f"the holdout is of {held} configurations, too few for a check"
        least = np.ceil(100.0 * FEWEST_HELD_OUT / measurements.configurations) / 100.0
        allowed = f"at least {FEWEST_HELD_OUT} configurations, {least:.2g} here"
        raise OptionError(reason, value=holdout, allowed=allowed)
    return mask
