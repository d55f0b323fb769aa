"""How rows are split to check a fit: what must stay together, and into which parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.fitted import Fit
from calib_pin.observations import AT, PART, Measurements
from calib_pin.setup import Setup
from calib_pin.validation.stretches import stretches

__all__ = [
    "FOLDS",
    "clusters",
    "folds",
    "groups",
    "places",
    "shuffled_groups",
    "validation_name",
]

FOLDS = 5
"""Parts of a cross-validation."""

FEWEST = 4
"""Configurations of every target without which there is no cross-validation."""

FEWEST_PLACES = 3
"""Places without which rows are set aside one by one, and not place by place."""

TELLING_PLACES = 5
"""Places from which the scatter among them says more than that among configurations:
Student's t of fewer has tails so wide that no gain shows."""


def folds(rows: Measurements, fitted: Fit, seed: int) -> list[NDArray[np.bool_]]:
    """Masks of the parts of a cross-validation; none where the rows do not suffice.

    Repetitions of a configuration stay together, and so do stretches of a path, and
    all sockets of one place if there are places enough: those that are left out are at
    their own. What is fitted without a part must still determine the robot and every
    plane.

    Args:
        rows: The N rows.
        fitted: The fit of all of them.
        seed: Seed of the split.

    Returns:
        One mask of shape (N,) for each part.
    """
    setup = fitted.problem.setup
    labels, order = shuffled_groups(rows, setup, seed)
    place = places(rows, setup)
    count = FOLDS
    if (place >= 0).any():
        count = min(FOLDS, len(order))
    if len(order) < count:
        return []
    fold = np.empty(len(order), np.int64)
    fold[order] = np.arange(len(order)) % count
    targets = np.array(rows.target)
    # Only what is estimated must be seen in every part.
    features = fitted.problem.measurement.features
    free = {f.name for f in features if any(p.free for p in f.parameters)}
    sought = {
        name
        for name in set(targets[place < 0])
        if free.intersection(name.rpartition(PART)[2].split(AT))
    }
    masks = []
    for k in range(count):
        mask = fold[labels] == k
        rest = replace(fitted.problem, data=rows.rows(~mask))
        if rest.distinct_values <= fitted.structure.rank or any(
            rows.rows(~mask & (targets == name)).configurations < FEWEST
            for name in sought
        ):
            return []
        masks.append(mask)
    return masks


def validation_name(
    rows: Measurements, setup: Setup, masks: Sequence[NDArray[np.bool_]]
) -> str:
    """What a cross-validation with these parts is called."""
    if not masks:
        return "none"
    place = places(rows, setup)
    if (place < 0).all():
        by = "" if (stretches(rows) < 0).all() else " by stretch"
        return f"{len(masks)}-fold{by}"
    if (place >= 0).all() and len(masks) == len(set(place)):
        return "leave-one-place-out"
    return f"{len(masks)}-fold by place"


def shuffled_groups(
    rows: Measurements, setup: Setup, seed: int
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Labels as of `groups`, and the labels in random order."""
    labels = groups(rows, setup)
    order = np.random.default_rng(seed).permutation(int(labels.max(initial=-1)) + 1)
    return labels, order


def groups(rows: Measurements, setup: Setup) -> NDArray[np.int64]:
    """Label of what each row must stay together with when rows are split, shape (N,).

    All rows of a place are one measurement of it, where there are several places.
    Successive configurations of a path are one stretch. Otherwise rows of one
    configuration are repetitions.
    """
    return _merged(places(rows, setup), rows)


def clusters(rows: Measurements, setup: Setup) -> NDArray[np.int64]:
    """Label of rows whose errors belong together in a test, shape (N,).

    They are the groups of a split, but for rows at so few places that these would test
    nothing: there every configuration counts.
    """
    place = places(rows, setup)
    if len(set(place[place >= 0].tolist())) < TELLING_PLACES:
        place = np.full(len(rows), -1)
    return _merged(place, rows)


def _merged(place: NDArray[np.int64], rows: Measurements) -> NDArray[np.int64]:
    """Labels of places, and of stretches or configurations elsewhere."""
    other = stretches(rows)
    other = rows.groups() if (other < 0).all() else other
    labels = np.where(place >= 0, place, place.max(initial=-1) + 1 + other)
    return np.unique(labels, return_inverse=True)[1].reshape(-1)


def places(rows: Measurements, setup: Setup) -> NDArray[np.int64]:
    """Label of the place at which each row has its ball in a socket, shape (N,).

    Sockets belong to one place that share what stands before the last slash of their
    names, or a known distance. -1 for other rows, and for all where there are fewer
    than three places.
    """
    sockets = rows.of("fixed-point")
    names = [name.rpartition(AT)[2] for name in sockets]
    home = {name: name.rpartition("/")[0] or name for name in names}
    for distance in setup.distances:
        first, second = (home.get(name, name) for name in distance.between)
        home = {k: first if v == second else v for k, v in home.items()}
    of = {name: k for k, name in enumerate(dict.fromkeys(filter(None, home.values())))}
    if len(of) < FEWEST_PLACES:
        return np.full(len(rows), -1)
    return np.array([of[home[name]] if name else -1 for name in names], np.int64)
