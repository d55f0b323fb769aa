"""How far measurements are from what was predicted, and which causes explain that.

Innovations `v ~ N(0, V)` are new measurements minus their prediction, with

    V = V_0 + sum_g s_g^2 E_g E_g',

V_0 by what was uncertain before, and causes g that act by independent effects of one
size s_g: the drift of a robot, the noise of the measurements, a joint that was hit, a
measurement that is wrong. A size that was expected beforehand counts like as many
effects as it is worth; the sizes are the most likely ones.

A sparse cause is accepted by its evidence: the likelihood with it, averaged over all
sizes that it may have, by that without. Were there no such cause, a ratio of k would
come about in at most one of k cases (Markov's inequality, as `E[L_1/L_0] = 1`).
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from calib_pin.estimation.statistics.restricted_likelihood import (
    KNOWN,
    Block,
    Components,
    estimate_variances,
)
from calib_pin.kinematics.spatial import Floats

SMALLEST = 1e-3
"""Least size, by the expected one."""

PROMISING = 6
"""Causes that are looked at closely, of all that might be accepted."""


@dataclass(frozen=True)
class Cause:
    """A cause of innovations.

    Attributes:
        name: Its name.
        effects: E, the innovations by its effects of size one, shape (r, k).
        size: Their expected size s.
        worth: Number of effects that the expected size is worth against those that
            show; infinite where the size is known.
        most: Largest size.
    """

    name: str
    effects: Floats
    size: float
    worth: float
    most: float = np.inf


@dataclass(frozen=True)
class Sparse:
    """A cause that is there or, far more likely, not.

    Attributes:
        name: Its name.
        effects: As for `Cause`.
        sizes: The sizes that it may have, equally likely, ascending.
        chance: How likely it is beside the others, before any evidence.
    """

    name: str
    effects: Floats
    sizes: Floats
    chance: float = 1.0

    def of(self, size: float) -> Cause:
        """The cause with a size."""
        return Cause(self.name, self.effects, size, np.inf)


@dataclass(frozen=True)
class Explanation:
    """Innovations and the causes that explain them.

    Attributes:
        values: The innovations v, shape (r,).
        known: Their covariance V_0 by what was uncertain before, shape (r, r).
        causes: The causes; their sizes count.
    """

    values: Floats
    known: Floats
    causes: tuple[Cause, ...]

    @property
    def covariance(self) -> Floats:
        """Covariance V of the innovations, shape (r, r)."""
        result = self.known.copy()
        for cause in self.causes:
            result += cause.size**2 * cause.effects @ cause.effects.T
        return result

    @property
    def square(self) -> float:
        """Chi-square of the innovations, of as many degrees of freedom as they are."""
        return float(self.values @ np.linalg.solve(self.covariance, self.values))

    @property
    def likelihood(self) -> float:
        """Logarithm of their density, but for a constant."""
        return float(_likelihoods(self.values, self.covariance[None])[0])

    def effects(self, cause: Cause) -> tuple[Floats, Floats]:
        """The likeliest effects of a cause, (k,), and their covariance, (k, k)."""
        E, square = cause.effects, cause.size**2
        by = square * np.linalg.solve(self.covariance, E).T
        return by @ self.values, square * np.eye(E.shape[1]) - square * by @ E

    def fitted(self) -> tuple[Explanation, tuple[float, ...]]:
        """The likeliest sizes, and the number of effects that tell each of them."""
        open_ = np.isfinite([cause.worth for cause in self.causes])
        acting = [self.causes[k] for k in np.flatnonzero(open_)]
        known = self.without({cause.name for cause in acting}).covariance
        variances, vectors = np.linalg.eigh(known)
        half = vectors * np.sqrt(np.maximum(variances, 0.0))
        factors = [half, *(cause.effects for cause in acting)]
        number = [factor.shape[1] for factor in factors]
        labels = np.repeat([KNOWN, *range(len(acting))], number)
        block = Block(self.values[:, None], labels, np.hstack(factors))
        numbers = [(cause.worth, cause.size, cause.most) for cause in acting]
        worth, size, most = np.reshape(numbers, (-1, 3)).T
        components = Components([block], worth, worth * size**2)
        least = (SMALLEST * size) ** 2
        found = estimate_variances(components, size**2, least, most**2)
        sizes = np.array([cause.size for cause in self.causes])
        told = np.zeros(len(sizes))
        sizes[open_], told[open_] = np.sqrt(found.values), found.redundancies - worth
        pairs = zip(self.causes, sizes.tolist(), strict=True)
        causes = tuple(replace(cause, size=size) for cause, size in pairs)
        return replace(self, causes=causes), tuple(told.tolist())

    def misfit(self, effects: Floats) -> float:
        """Chi-square of the innovations with effects of any size, shape (r, k)."""
        by = np.linalg.solve(self.covariance, np.column_stack([self.values, effects]))
        square, along = float(self.values @ by[:, 0]), effects.T @ by[:, 0]
        return square - float(along @ np.linalg.pinv(effects.T @ by[:, 1:]) @ along)

    def without(self, names: Collection[str]) -> Explanation:
        """The same without some causes."""
        causes = tuple(cause for cause in self.causes if cause.name not in names)
        return replace(self, causes=causes)

    def evidence(self, cause: Sparse) -> tuple[float, float]:
        """Logarithm of the mean likelihood with a cause, and its likeliest size."""
        EE = cause.effects @ cause.effects.T
        V = self.covariance + cause.sizes[:, None, None] ** 2 * EE
        found = _likelihoods(self.values, V)
        best = float(found.max())
        mean = best + float(np.log(np.mean(np.exp(found - best))))
        return mean, float(cause.sizes[int(np.argmax(found))])

    def expected(self, other: Explanation) -> float:
        """Logarithm of how likely the sizes are beforehand by those of another one."""
        result = 0.0
        pairs = zip(self.causes, other.causes, strict=False)
        for own, cause in pairs:
            if np.isfinite(own.worth):
                ratio = (cause.size / own.size) ** 2
                result -= 0.5 * own.worth * (np.log(ratio) + 1.0 / ratio - 1.0)
        return result


def explained(
    first: Explanation, causes: Sequence[Sparse], sure: float, most: int
) -> tuple[Explanation, tuple[Cause, ...], float]:
    """Innovations with the sparse causes that the evidence is sure of, one by one.

    One that those accepted after it have made needless is dropped again.

    Args:
        first: The innovations with the causes that always act, of expected sizes.
        causes: The sparse causes.
        sure: Ratio of the evidence for a cause, times its chance, from which it is
            accepted.
        most: Most sparse causes.

    Returns:
        The innovations with all causes of their likeliest sizes; the sparse ones among
        these, in the order in which they were accepted; and the logarithm of the
        evidence by that without them.
    """
    found, evidence = list[Cause](), 0.0
    left = {cause.name: cause for cause in causes}
    while left and len(found) < most:
        gain, cause = _best(first, found, [*left.values()])
        if gain < np.log(sure):
            break
        found.append(cause)
        evidence += gain
        del left[cause.name]
    by_name = {cause.name: cause for cause in causes}
    for cause in found[:-1]:
        others = [other for other in found if other is not cause]
        gain, _ = _best(first, others, [by_name[cause.name]])
        if gain < np.log(sure):
            found, evidence = others, evidence - gain
    result, _ = replace(first, causes=(*first.causes, *found)).fitted()
    return result, tuple(found), evidence


def _best(
    first: Explanation, found: Sequence[Cause], causes: Sequence[Sparse]
) -> tuple[float, Cause]:
    """The cause with the most evidence, by that without it, and its size.

    What always acts may have grown for want of the cause, and is fitted beside it.
    """
    now, _ = replace(first, causes=(*first.causes, *found)).fitted()
    promise = [now.evidence(cause)[0] + np.log(cause.chance) for cause in causes]
    order = np.argsort(promise)[::-1][:PROMISING]
    result = []
    for cause in (causes[k] for k in order):
        _, size = now.evidence(cause)
        beside = replace(first, causes=(*first.causes, *found, cause.of(size)))
        other, _ = beside.fitted()
        evidence, size = other.without({cause.name}).evidence(cause)
        evidence += first.expected(other) + float(np.log(cause.chance))
        result.append((evidence, cause.of(size)))
    gain, best = max(result, key=lambda pair: pair[0])
    return gain - now.likelihood - first.expected(now), best


def _likelihoods(v: Floats, V: Floats) -> Floats:
    """Logarithms of normal densities, shapes (r,) and (K, r, r) -> (K,)."""
    half = np.linalg.cholesky(V)
    logarithm = np.log(np.diagonal(half, axis1=1, axis2=2)).sum(axis=1)
    rest = np.linalg.solve(half, np.broadcast_to(v[:, None], (len(V), len(v), 1)))
    return np.asarray(-logarithm - 0.5 * np.sum(rest[:, :, 0] ** 2, axis=1))
