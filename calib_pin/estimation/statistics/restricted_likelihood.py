"""Variance components of a Gaussian model, by restricted maximum likelihood.

Values come in independent blocks,

    y = -X b + Z u,   u_j ~ N(0, s_k) of component k,

with unknown b (which all blocks share), factors Z of the errors, and variances s_k that
are wanted. With V their covariance, P = V^-1 - V^-1 X (X^T V^-1 X)^-1 X^T V^-1 and
V_k = Z_k Z_k^T, what no b explains has

    2 dL / d log s_k = s_k (y^T P V_k P y - tr(P V_k)),

the sum of the squares of u_k by their variance less their redundancy: the equations of
Helmert and Foerstner (Teunissen and Amiri-Simkooei 2008), and of MacKay's evidence
(Bayesian interpolation, 1992), which are the rounds `s_k <- s_k squares / redundancy`.
The information that steps of Newton's method need is the average of the observed and
the expected one, `s_k s_l y^T P V_k P V_l P y / 2` (Gilmour, Thompson and Cullis 1995).

What is known beforehand of a variance, by an inverse chi-square distribution, is like
so many further errors u_k with a sum of squares. Random effects X g are unknowns with
the errors `0 = g - u`.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats

Labels = NDArray[np.intp]

KNOWN = -1
"""Label of errors whose variance is one."""

ROUNDS = 100
"""Most steps; five to fifteen are usual."""

LONGEST = 2.0
"""Largest change of the logarithm of a variance in a step."""

DONE = 1e-6
"""Change of the logarithms that ends the iteration: far below their own errors."""

SMALLEST = 1e-8
"""Least variance, as a part of the one it started with: what is zero stays there."""

EXACT = 1e-12
"""Least variance at all; a millionth of the standard deviation given is rounding."""


@dataclass(frozen=True)
class Block:
    """Values that share no error with those of other blocks.

    Attributes:
        rows: Columns X and values y, shape (m, q + 1).
        labels: Component of each error, `KNOWN` or 0 to K - 1, shape (n,).
        factors: Values by errors of size one, Z, shape (m, n); None where every value
            has an error of its own.
    """

    rows: Floats
    labels: Labels
    factors: Floats | None = None


@dataclass(frozen=True)
class Components:
    """Blocks whose errors have K unknown variances.

    Attributes:
        blocks: The blocks.
        counts: Number of further errors that are known, shape (K,).
        squares: Sum of their squares, shape (K,).
    """

    blocks: Sequence[Block]
    counts: Floats
    squares: Floats

    def relabeled(self, labels: Labels) -> Components:
        """The same where components have variances in common.

        Args:
            labels: New component of each, or `KNOWN`, shape (K,).
        """
        new = np.append(labels, KNOWN)
        blocks = [replace(block, labels=new[block.labels]) for block in self.blocks]
        of = labels[:, None] == np.arange(labels.max() + 1)
        return Components(blocks, self.counts @ of, self.squares @ of)


@dataclass(frozen=True)
class Variances:
    """A Gaussian model at some variances, and what it says of them.

    Attributes:
        values: The variances, shape (K,).
        squares: Sums of the squared errors by their variance, shape (K,).
        redundancies: Redundancy of each component, shape (K,).
        information: Average information of the logarithms of variances, shape (K, K).
        likelihood: Logarithm of the restricted likelihood, up to a constant.
        unknowns: Estimates of b, shape (q,).
        half: H of their covariance H H^T, shape (q, q).
        whitened: `V^-1/2 (y + X b)`, shape (m,), `V^-1/2 X H`, (m, q), and `V^-1/2 Z`
            with errors of their size, (m, n), of every block; the last None where every
            value has an error of its own.
    """

    values: Floats
    squares: Floats
    redundancies: Floats
    information: Floats
    likelihood: float
    unknowns: Floats
    half: Floats
    whitened: Sequence[tuple[Floats, Floats, Floats | None]]

    @staticmethod
    def at(components: Components, values: Floats) -> Variances:
        """The model at variances, shape (K,)."""
        sizes, blocks = np.sqrt(np.append(values, 1.0)), components.blocks
        white = [_whitened(block, sizes[block.labels]) for block in blocks]
        R = _triangle(np.vstack([rows for rows, _, _ in white]))
        q = R.shape[1] - 1
        half = np.asarray(np.linalg.inv(R[:q, :q]), float)
        unknowns = -half @ R[:q, q]
        squares, redundancies = components.squares / values, components.counts.copy()
        information, shared = np.diag(squares), np.zeros((q, len(values)))
        missed = float(squares.sum())
        whitened = []
        for (rows, F, _), block in zip(white, blocks, strict=True):
            e, U = rows @ np.append(unknowns, 1.0), rows[:, :q] @ half
            whitened.append((e, U, F))
            of = (block.labels[:, None] == np.arange(len(values))).astype(float)
            if F is None:
                u, told, Q = e, 1.0 - np.sum(U**2, axis=1), e[:, None] * of
            else:
                u, told = F.T @ e, np.sum(F**2, axis=0) - np.sum((U.T @ F) ** 2, axis=0)
                Q = (F * u) @ of
            squares = squares + u**2 @ of
            redundancies += told @ of
            information += Q.T @ Q
            shared += U.T @ Q
            missed += float(e @ e)
        size = components.counts @ np.log(values) - 2.0 * _logarithm(half)
        size += 2.0 * sum(logarithm for _, _, logarithm in white)
        return Variances(
            values=values,
            squares=squares,
            redundancies=np.maximum(redundancies, 0.0),
            information=0.5 * (information - shared.T @ shared),
            likelihood=-0.5 * float(size + missed),
            unknowns=unknowns,
            half=half,
            whitened=whitened,
        )

    @property
    def covariance(self) -> Floats:
        """Of the unknowns, shape (q, q)."""
        return np.asarray(self.half @ self.half.T)

    @property
    def dof(self) -> Floats:
        """Degrees of freedom of chi-square that varies as the estimates do, (K,).

        That is relative to its mean; of a single component, its redundancy.
        """
        # Where two cannot be told apart the information is rounding.
        inverse = np.linalg.pinv(self.information, rcond=1e-10, hermitian=True)
        least = 2.0 / np.maximum(self.redundancies, 1e-300)
        return np.asarray(2.0 / np.maximum(np.diag(inverse), least))

    def errors(self, block: int) -> tuple[Floats, Floats]:
        """The most likely errors of a block with factors, in their deviations.

        Returns:
            The errors u, shape (n,), and the covariance that they have, shape (n, n).
        """
        e, U, F = self.whitened[block]
        assert F is not None
        return F.T @ e, F.T @ F - (F.T @ U) @ (U.T @ F)

    def steps(self, lower: Floats, upper: Floats) -> Iterator[Floats]:
        """Steps of the logarithms of variances to try, the boldest first, (K,) each."""
        score = 0.5 * (self.squares - self.redundancies)
        # What has reached a bound and would go on is done.
        end = np.where(score < 0.0, self.values <= lower, self.values >= upper)
        size = np.maximum(np.sqrt(np.diag(self.information)), 1e-100)
        N = self.information / np.outer(size, size)
        N[end], N[:, end] = 0.0, 0.0
        step = np.linalg.pinv(N, rcond=1e-10, hermitian=True) @ (score / size) / size
        yield np.clip(step, -LONGEST, LONGEST)
        # Rounds of the expectation always lead uphill, if slowly.
        small = np.finfo(float).tiny
        ratio = np.log((self.squares + small) / (self.redundancies + small))
        step = np.where(end, 0.0, np.clip(ratio, -LONGEST, LONGEST))
        for shorter in 0.3 ** np.arange(8):
            yield shorter * step


def estimate_variances(
    components: Components,
    start: Floats,
    lower: float | Floats | None = None,
    upper: float | Floats = np.inf,
) -> Variances:
    """Maximize the restricted likelihood.

    Args:
        components: The model; its columns have full rank together.
        start: First guesses, positive, shape (K,).
        lower: Least variances, shape (K,); default `SMALLEST` of those guesses.
        upper: Largest ones, shape (K,).
    """
    if lower is None:
        lower = np.maximum(SMALLEST * start, EXACT)
    lower, upper = (np.broadcast_to(bound, start.shape) for bound in (lower, upper))
    best = Variances.at(components, start)
    for _ in range(ROUNDS):
        for step in best.steps(lower, upper):
            if np.abs(step).max(initial=0.0) < DONE:
                return best
            values = np.clip(best.values * np.exp(step), lower, upper)
            found = Variances.at(components, values)
            if found.likelihood >= best.likelihood - DONE:
                break
        else:
            break
        best = found
    return best


def _whitened(block: Block, sizes: Floats) -> tuple[Floats, Floats | None, float]:
    """Rows and factors by the root of their covariance, with its log-determinant.

    Args:
        block: The block.
        sizes: Standard deviation of each error, shape (n,).
    """
    if block.factors is None:
        return block.rows / sizes[:, None], None, float(np.log(sizes).sum())
    F = block.factors * sizes
    root = _triangle(F.T)
    both = np.linalg.solve(root.T, np.hstack([block.rows, F]))
    rows, F = np.split(both, [block.rows.shape[1]], axis=1)
    return rows, F, _logarithm(root)


def _triangle(A: Floats) -> Floats:
    """Triangular factor R of A = Q R."""
    return np.asarray(np.linalg.qr(A, mode="r"))


def _logarithm(triangle: Floats) -> float:
    """Logarithm of the size of a determinant, by the diagonal."""
    return float(np.log(np.abs(np.diag(triangle))).sum())
