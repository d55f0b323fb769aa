"""Variances of groups of observations by restricted maximum likelihood.

Observations `r = -A x + e` come in groups; the errors of group k are independent and
have one unknown variance s_k, in units of what they were divided by; those of a last
group are known. With `M = (sum_k A_k^T A_k / s_k)^-1` the residuals `v = r + A x` of
weighted least squares have

    E[v_k^T v_k] / s_k = rho_k = n_k - tr(M A_k^T A_k) / s_k,

the redundancy of the group, and to solve these equations for s (Helmert, Foerstner) is
to maximize the likelihood of what no x can explain (Teunissen and Amiri-Simkooei 2008).
A step of Fisher's method of scoring on log s needs the matrix

    N_kl = |R_kl|^2 / 2,  R = I - A M A^T / s,

whose inverse is the covariance of the estimates of log s. All follows from the
products A_k^T A_k, so that the number of observations costs nothing.

Random effects are such groups as well: `r = -A x - X g + e` with g of variance s_g is
the same with the columns [A X] and the pseudo-observations `0 = g + e_g`.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats

ROUNDS = 50
"""Most steps of scoring; three to ten are usual."""

LONGEST = 2.0
"""Largest change of the logarithm of a variance in a step."""

DONE = 1e-6
"""Change of the logarithms that ends the iteration: far below their own errors."""

SMALLEST = 1e-8
"""Least variance, as a part of the one it started with: what is zero stays there."""

EXACT = 1e-12
"""Least variance at all; a millionth of the standard deviation given is rounding."""


@dataclass(frozen=True)
class Groups:
    """Groups of observations by the products of their columns.

    Attributes:
        counts: Observations of each group, shape (K,).
        products: `[A_k r_k]^T [A_k r_k]`, shape (K, p + 1, p + 1).
        known: The same of observations of variance one, shape (p + 1, p + 1).
    """

    counts: Floats
    products: Floats
    known: Floats

    def given(self, held: NDArray[np.bool_]) -> Groups:
        """The groups that are left where some have the variance one.

        Args:
            held: Which these are, boolean, shape (K,).
        """
        known = self.known + self.products[held].sum(axis=0)
        return Groups(self.counts[~held], self.products[~held], known)


@dataclass(frozen=True)
class Variances:
    """Estimated variances of K groups.

    Attributes:
        values: The variances, shape (K,).
        squares: Sums of squared residuals, shape (K,).
        redundancies: Redundancy of each group, shape (K,).
        dof: Degrees of freedom of chi-square that varies, relative to its mean, as the
            estimate does, shape (K,); the redundancy of a single group.
        likelihood: Logarithm of the restricted likelihood, up to a constant.
        covariance: Of x, shape (p, p).
    """

    values: Floats
    squares: Floats
    redundancies: Floats
    dof: Floats
    likelihood: float
    covariance: Floats


def estimate_variances(groups: Groups, start: Floats | None = None) -> Variances:
    """Maximize the restricted likelihood.

    Args:
        groups: The groups; their columns have full rank together.
        start: First guesses, positive, shape (K,); default from the residuals of
            least squares with equal variances.
    """
    values = _first(groups) if start is None else np.array(start)
    floor = np.maximum(SMALLEST * values, EXACT)
    state = _State.at(groups, values)
    for _ in range(ROUNDS):
        step = state.step()
        # What has fallen to nothing and would fall on is done.
        step[(values <= floor) & (step < 0.0)] = 0.0
        if np.abs(step).max(initial=0.0) < DONE:
            break
        for _ in range(8):
            trial = np.maximum(values * np.exp(step), floor)
            found = _State.at(groups, trial)
            if found.likelihood >= state.likelihood - DONE:
                break
            step *= 0.3
        values, state = trial, found
    return Variances(
        values=values,
        squares=state.squares * values,
        redundancies=state.redundancies,
        dof=2.0 / np.maximum(np.diag(np.linalg.pinv(state.information)), 1e-300),
        likelihood=state.likelihood,
        covariance=state.covariance,
    )


def _first(groups: Groups) -> Floats:
    """Squares by redundancy of least squares with variances of one, shape (K,)."""
    state = _State.at(groups, np.ones(len(groups.counts)))
    found = state.squares / np.maximum(state.redundancies, 1e-300)
    return np.maximum(np.where(state.redundancies > 1e-6, found, 1.0), EXACT)


@dataclass(frozen=True)
class _State:
    """Least squares with given variances.

    Attributes:
        squares: Sums of squared residuals by variance, shape (K,).
        redundancies: Redundancies, shape (K,).
        information: Of the logarithms of the variances, shape (K, K).
        likelihood: Logarithm of the restricted likelihood.
        covariance: Of x, shape (p, p).
    """

    squares: Floats
    redundancies: Floats
    information: Floats
    likelihood: float
    covariance: Floats

    @staticmethod
    def at(groups: Groups, values: Floats) -> _State:
        weighted = groups.products / values[:, None, None]
        total = groups.known + weighted.sum(axis=0)
        H, g = total[:-1, :-1], total[:-1, -1]
        M = np.linalg.inv(H)
        x = np.append(-M @ g, 1.0)
        squares = np.maximum(np.einsum("i,kij,j->k", x, weighted, x), 0.0)
        hats = M @ weighted[:, :-1, :-1]
        traces = np.trace(hats, axis1=1, axis2=2)
        redundancies = np.maximum(groups.counts - traces, 0.0)
        shared = np.einsum("kij,lji->kl", hats, hats, optimize=True)
        information = 0.5 * (shared + np.diag(groups.counts - 2.0 * traces))
        missed = squares.sum() + max(float(x @ groups.known @ x), 0.0)
        size = groups.counts @ np.log(values) + np.linalg.slogdet(H)[1]
        likelihood = -0.5 * float(size + missed)
        return _State(squares, redundancies, information, likelihood, M)

    def step(self) -> Floats:
        """A step of scoring on the logarithms, shape (K,)."""
        score = 0.5 * (self.squares - self.redundancies)
        step = np.linalg.pinv(self.information, rcond=1e-10, hermitian=True) @ score
        return np.asarray(np.clip(step, -LONGEST, LONGEST))


def with_effects(
    groups: Groups, kind_of: NDArray[np.str_], kinds: tuple[str, ...]
) -> Groups:
    """Groups with some kinds of random effects as pseudo-observations.

    Args:
        groups: Groups of rows whose last columns, but for the residual, are those of
            all effects in their expected sizes.
        kind_of: Kind of each effect, shape (S,).
        kinds: Those that have a variance; the others are left out.
    """
    width = groups.known.shape[0]
    first = width - 1 - len(kind_of)
    of_effects = first + np.arange(len(kind_of))
    out = of_effects[~np.isin(kind_of, kinds)]
    unit = np.zeros((len(kinds), width, width))
    for k, kind in enumerate(kinds):
        own = of_effects[kind_of == kind]
        unit[k, own, own] = 1.0
    counts = [np.sum(kind_of == kind) for kind in kinds]

    def kept(products: Floats) -> Floats:
        rows = np.delete(products, out, axis=-1)
        return np.asarray(np.delete(rows, out, axis=-2))

    return Groups(
        np.concatenate([groups.counts, counts]),
        kept(np.concatenate([groups.products, unit])),
        kept(groups.known),
    )
