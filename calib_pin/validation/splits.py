"""How measurements are split to check a fit: what must stay together, and the folds."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.problem import known_values
from calib_pin.estimation.scopes import own_name
from calib_pin.measurement_models import declared
from calib_pin.observations import AT, Observations, fitted_and_held_out
from calib_pin.setup import Setup
from calib_pin.validation.stretches import stretches

FOLDS = 5
"""Parts of a cross-validation."""

FEWEST = 4
"""Configurations of every target without which there is no cross-validation."""

FEWEST_OF_FRAME = 3
"""Configurations that a split leaves of every station, tool and chain where there are
several: three positions locate a frame."""

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

    measurements: Observations
    places: NDArray[np.int64]
    stretched: bool
    groups: NDArray[np.int64]
    clusters: NDArray[np.int64]

    @classmethod
    def of(cls, measurements: Observations, setup: Setup) -> Grouping:
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

    def shuffled(self, seed: int) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """The G groups in random order, one stratum after the other.

        Groups of one stratum have measurements of the same blocks, so that whatever
        takes its share of each has its share of every station, tool and chain.

        Returns:
            Labels of the groups and of the stratum of each, shape (G,).
        """
        data, count = self.measurements, int(self.groups.max(initial=-1)) + 1
        seen = np.zeros((count, len(data.blocks)), bool)
        seen[self.groups, data.block_of] = True
        strata = np.unique(seen, axis=0, return_inverse=True)[1].reshape(-1)
        order = np.random.default_rng(seed).permutation(count)
        order = order[np.argsort(strata[order], kind="stable")]
        return order, strata[order]

    def spared(self, mask: NDArray[np.bool_]) -> NDArray[np.bool_]:
        """A part to hold out without the groups that a frame cannot do without.

        Args:
            mask: The part, shape (N,).

        Returns:
            The mask of one that leaves configurations of every station, tool and chain.
        """
        data, mask = self.measurements, mask.copy()
        configuration, trusted = data.groups(), data.weight > 0.0
        for kind in ("station", "tool", "chain"):
            names = [
                key.chain
                if kind == "chain"
                else own_name(key, data.keys, getattr(key, kind))
                for key in data.keys
            ]
            of_block = np.unique(names, return_inverse=True)[1].reshape(-1)
            if not of_block.any():
                continue
            # Distinct configurations of every frame among those that are left.
            of_row, count = of_block[data.block_of], int(configuration.max()) + 1
            pairs = np.unique((of_row * count + configuration)[~mask & trusted])
            left = np.bincount(pairs // count, minlength=len(data.blocks))
            needed = mask & (left < FEWEST_OF_FRAME)[of_row]
            mask &= ~np.isin(self.groups, self.groups[needed])
        return mask

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
    rows, labels = grouping.measurements, grouping.groups
    order, _ = grouping.shuffled(seed)
    count = FOLDS
    if (grouping.places >= 0).any():
        count = min(FOLDS, len(order))
    if len(order) < count:
        return []
    fold = np.empty(len(order), np.int64)
    fold[order] = np.arange(len(order)) % count
    # Only what is estimated must be seen in every part.
    elsewhere = (seen & (grouping.places < 0) for seen in _estimated(fitted, rows))
    sought = [np.where(seen, rows.groups(), -1) for seen in elsewhere if seen.any()]
    # What priors hold counts among what is known and among what is needed.
    held = fitted.problem.further.priors > 0
    needed = fitted.rank if held else fitted.structure.rank
    masks = []
    for k in range(count):
        mask = grouping.spared(fold[labels] == k)
        if not mask.any():
            continue
        rest = replace(fitted.problem, data=rows.rows(~mask))
        if known_values(rest) <= needed or any(
            len(np.unique(seen[~mask & (seen >= 0)])) < FEWEST for seen in sought
        ):
            return []
        masks.append(mask)
    return masks


def _estimated(fitted: Fit, rows: Observations) -> list[NDArray[np.bool_]]:
    """Masks of the measurements of each target that has something to estimate, (N,).

    Args:
        fitted: The fit.
        rows: The N measurements.
    """
    found: dict[tuple[str, ...], NDArray[np.bool_]] = {}
    for block, part in zip(rows.blocks, rows.slices, strict=True):
        model = fitted.problem.parts[block.key]
        free = {
            reference.name: model.scope.reference(reference)
            for reference in model.measurement.references
            if any(parameter.free for parameter in reference.parameters)
        }
        for name in block.target.distinct:
            halves = tuple(free[half] for half in name.split(AT) if half in free)
            if halves:
                # From another station it may be another thing, or the same one.
                mask = found.setdefault((name, *halves), np.zeros(len(rows), bool))
                mask[part] |= block.target.where(name)
    return list(found.values())


def _merged(place: NDArray[np.int64], other: NDArray[np.int64]) -> NDArray[np.int64]:
    """Labels of places, and of stretches or configurations elsewhere, shape (N,)."""
    labels = np.where(place >= 0, place, place.max(initial=-1) + 1 + other)
    return np.unique(labels, return_inverse=True)[1].reshape(-1)


def places(measurements: Observations, setup: Setup) -> NDArray[np.int64]:
    """Label of the place at which each measurement has its ball in a socket, (N,).

    Sockets belong to one place that share their station and what stands before the last
    slash of their names, or a known distance. -1 for other measurements, and for all
    where there are fewer than three places.
    """
    sockets = [np.full(len(block), -1) for block in measurements.blocks]
    number: dict[str, int] = {}
    home: list[str] = []
    for codes, block in zip(sockets, measurements.blocks, strict=True):
        if declared(block.model).naming.configurations == 1:
            continue
        for target in block.target.distinct:
            if name := target.rpartition(AT)[2]:
                k = number.setdefault(_at(block.station, name), len(home))
                if k == len(home):
                    home.append(_at(block.station, name.rpartition("/")[0] or name))
                codes[block.target.where(target)] = k
    for distance in setup.distances:
        for station in dict.fromkeys(["", *(key.station for key in measurements.keys)]):
            ends = [_at(station, name) for name in distance.between]
            first, second = (home[number[e]] if e in number else e for e in ends)
            home = [first if name == second else name for name in home]
    of = {name: k for k, name in enumerate(dict.fromkeys(home))}
    if len(of) < FEWEST_PLACES:
        return np.full(len(measurements), -1)
    labels = np.array([*(of[name] for name in home), -1], np.int64)
    return np.asarray(labels[np.concatenate(sockets)])


def _at(station: str, name: str) -> str:
    """The name of something at a station among those of all."""
    return f"{station}/{name}" if station else name


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
    training, marked = fitted_and_held_out(measurements)
    reason = "no {} is left to fit: all are for validation"
    _require_fitted(training, marked, reason, column="set")
    if validation is not None:
        if len(validation) == 0:
            raise InputError("there are no measurements to validate with")
        for model in validation.models:
            if model not in training.models:
                raise InputError(
                    f"cannot check '{', '.join(training.models)}' measurements with "
                    f"'{model}' ones"
                )
        _require_fitted(
            training, validation, "these cannot be checked: no {} is fitted"
        )
        return training, validation, "file"
    if holdout is not None:
        mask = _held_out(training, setup, holdout, seed)
        kept, left = training.rows(~mask), training.rows(mask)
        _require_fitted(kept, left, "no {} is left to fit: the holdout took all")
        return kept, left, "holdout"
    return training, marked if len(marked) else None, "set"


def _held_out(
    measurements: Observations, setup: Setup, holdout: float, seed: int
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
    labels, (order, stratum) = grouping.groups, grouping.shuffled(seed)
    # The same share of every stratum, whatever its size.
    _, start, sizes = np.unique(stratum, return_index=True, return_counts=True)
    share = (np.arange(len(order)) - start[stratum] + 0.5) / sizes[stratum]
    order = order[np.argsort(share, kind="stable")]
    count = max(1, round(holdout * len(measurements)))
    size = np.cumsum(np.bincount(labels)[order])
    chosen = np.zeros(len(order), bool)
    chosen[order[: int(np.searchsorted(size, count)) + 1]] = True
    mask = grouping.spared(chosen[labels])
    if mask.all():
        raise OptionError("holdout leaves no measurement to fit", value=holdout)
    return mask


def _require_fitted(
    training: Observations, left: Observations, why: str, column: str | None = None
) -> None:
    """Refuse validation measurements of a kind of which there is none to fit.

    Only the station of the instrument may be another one.

    Args:
        training: The measurements to fit.
        left: Those to validate with.
        why: The reason, with braces where the kind belongs.
        column: The column that says so.

    Raises:
        InputError: If there are such.
    """
    fitted = {key._replace(station="") for key in training.keys}
    for block in left.blocks:
        model, chain, _, tool = block.key
        if len(block) and block.key._replace(station="") not in fitted:
            kind = f"'{model}' measurement"
            kind += f" of the chain '{chain}'" if chain else ""
            kind += f" with the tool '{tool}'" if tool else ""
            raise block.error(0, why.format(kind), column=column)
