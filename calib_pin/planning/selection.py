"""A set of configurations chosen among candidates, as exchange methods see it."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy

import numpy as np
from numpy.typing import NDArray

from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.criteria import Criterion, Determinant
from calib_pin.planning.information import Information, log_determinants, products_of


class Selection:
    """A subset of C candidates with its information, its cost and what would change it.

    Satisfies `solvers.Subset`.

    Args:
        rows: Rows of the candidates, shape (C, d, m).
        nuisances: Number of leading columns that are projected out.
        criterion: Criterion to minimize.
        known: Information that is there already, shape (m, m).
        chosen: Candidates to begin with.
        measured: Number of rows that the known information comes from.

    Attributes:
        chosen: The members, in the order in which they were added.
    """

    def __init__(
        self,
        rows: Floats,
        nuisances: int,
        criterion: Criterion,
        known: Floats,
        chosen: Sequence[int] = (),
        measured: int = 0,
    ) -> None:
        """Sum what the members tell."""
        self.chosen = list(chosen)
        self._rows, self._known = rows, known
        # Component by component: trials work on contiguous tables of all candidates.
        self._by_component = np.ascontiguousarray(np.swapaxes(rows, 0, 1))
        self._nuisances, self._criterion = nuisances, criterion
        self._measured = measured
        self._found: Information | None = None
        self._update()

    @property
    def cost(self) -> float:
        """Cost of the subset; infinite where it does not determine everything."""
        return np.inf if self._found is None else self._criterion.cost(self._found)

    @property
    def left(self) -> int:
        """Number of candidates that are not members."""
        return len(self._rows) - len(self.chosen)

    @property
    def value(self) -> float:
        """The value of the criterion."""
        found = self._information()
        if found is None:
            return np.inf
        return self._criterion.value(found, self._measured + len(self.chosen))

    def best_to_add(self) -> tuple[int, float]:
        """The candidate to add and the cost after that."""
        barred = np.zeros(len(self._rows), bool)
        barred[self.chosen] = True
        return self._best(self._by_component, 1.0, barred)

    def best_to_remove(self) -> tuple[int, float]:
        """The member to remove and the cost after that."""
        of_members = self._by_component[:, self.chosen]
        position, cost = self._best(of_members, -1.0, np.zeros(len(self.chosen), bool))
        return self.chosen[position], cost

    def add(self, candidate: int) -> None:
        """Add a candidate."""
        self.chosen.append(candidate)
        self._change(candidate, 1.0)

    def remove(self, candidate: int) -> None:
        """Remove a member."""
        self.chosen.remove(candidate)
        self._change(candidate, -1.0)

    def reset(self, chosen: list[int]) -> None:
        """Become another subset."""
        self.chosen = list(chosen)
        self._update()

    def _change(self, candidate: int, sign: float) -> None:
        self._update()

    def _best(
        self, rows: Floats, sign: float, barred: NDArray[np.bool_]
    ) -> tuple[int, float]:
        if self._found is None:
            return int(np.flatnonzero(~barred)[0]), np.inf
        return self._criterion.trials(self._found, rows, sign).best(barred)

    def _update(self) -> None:
        self._found = self._information()

    def _information(self) -> Information | None:
        # Summed anew each time: differences of information matrices lose digits.
        U = self._rows[self.chosen].reshape(-1, self._rows.shape[2])
        return Information.of(self._known + U.T @ U, self._nuisances)


class DeterminantSelection(Selection):
    """The same for the determinant (O1), whose trials follow from change to change."""

    _leverages: Leverages | None = None
    _home: list[int] | None = None
    _at_home: Leverages

    @property
    def cost(self) -> float:
        """Cost of the subset; infinite where it does not determine everything."""
        if self._leverages is None:
            return np.inf
        return self._cost(self._leverages.volume)

    def best_to_remove(self) -> tuple[int, float]:
        """The member to remove and the cost after that."""
        if self._leverages is None:
            return super().best_to_remove()
        volumes = self._leverages.volumes(-1.0, self.chosen)
        volumes[np.isnan(volumes)] = -np.inf
        best = int(volumes.argmax())
        return self.chosen[best], self._cost(volumes[best])

    def reset(self, chosen: list[int]) -> None:
        """Become another subset."""
        if chosen == self._home:
            # Excursions come back to where they began.
            self.chosen, self._leverages = list(chosen), self._at_home.copy()
        else:
            super().reset(chosen)

    def best_to_add(self) -> tuple[int, float]:
        """The candidate to add and the cost after that."""
        if self._leverages is None:
            return super().best_to_add()
        volumes = self._leverages.volumes(1.0)
        volumes[self.chosen] = -np.inf
        best = int(volumes.argmax())
        return best, self._cost(volumes[best])

    def _cost(self, volume: float) -> float:
        size = int(self._rows.shape[2]) - self._nuisances
        return -0.5 * float(volume) / size

    def _change(self, candidate: int, sign: float) -> None:
        if self._leverages is None or not self._leverages.change(candidate, sign):
            self._update()

    def _update(self) -> None:
        super()._update()
        self._leverages = None
        if self._found is not None:
            self._leverages = Leverages(self._found, self._by_component)
            self._home, self._at_home = list(self.chosen), self._leverages.copy()


def selection(
    rows: Floats,
    nuisances: int,
    criterion: Criterion,
    known: Floats,
    chosen: Sequence[int] = (),
    measured: int = 0,
) -> Selection:
    """A subset under a criterion; see `Selection`."""
    kind = DeterminantSelection if isinstance(criterion, Determinant) else Selection
    return kind(rows, nuisances, criterion, known, chosen, measured)


STEEP = 1e-3
"""Factor of a determinant in one direction below which a change loses digits: beyond,
and beyond its inverse, everything is computed anew."""


class Leverages:
    """Leverages of C candidates in a subset of them.

    Args:
        found: The information of the subset.
        rows: Rows of the candidates, component by component, shape (d, C, m).

    Attributes:
        volume: Logarithm of det(S), the information about the robot alone.
    """

    def __init__(self, found: Information, rows: Floats) -> None:
        """Compute the leverages of all candidates."""
        f, Y = found.nuisances, rows @ found.inverse
        # Column by column, so that products run along the candidates.
        columns = np.ascontiguousarray(np.moveaxis(rows, 2, 0))
        self._columns = columns, columns[:f]
        inverse = found.inverse @ found.inverse.T
        of_nuisances = found.inverse[:f, :f]
        self._inverses = [inverse, of_nuisances @ of_nuisances.T]
        # Lower parts of G by M, and by M_nn: shape (pairs, 2, C).
        self._lower = np.tril_indices(len(rows))
        nuisance = products_of(Y[:, :, :f])
        self._leverages = np.stack([nuisance + products_of(Y[:, :, f:]), nuisance], 1)
        self.volume = 2.0 * float(np.log(np.diag(found.factor)[f:]).sum())

    def copy(self) -> Leverages:
        """A copy that changes on its own."""
        result = copy(self)
        result._inverses = [inverse.copy() for inverse in self._inverses]
        result._leverages = self._leverages.copy()
        return result

    def volumes(self, sign: float, some: Sequence[int] | slice = slice(None)) -> Floats:
        """The values of `volume` after a candidate joins (1) or leaves (-1).

        Args:
            sign: 1 or -1.
            some: Positions of the candidates, K of them.

        Returns:
            Volumes, shape (K,); NaN where nothing would be determined.
        """
        of_all, of_nuisances = log_determinants(self._leverages[:, :, some], sign)
        return np.asarray(self.volume + (of_all - of_nuisances))

    def change(self, candidate: int, sign: float) -> bool:
        """Let a candidate join (1) or leave (-1).

        Returns:
            False, and nothing has changed, if that would lose too many digits.
        """
        a, b = self._lower
        _, size, count = self._columns[0].shape
        K = np.tile(np.eye(size), (2, 1, 1))
        K[:, a, b] += sign * self._leverages[:, :, candidate].T
        K[:, b, a] = K[:, a, b]
        factors = np.linalg.eigvalsh(K)
        if factors.min() < STEEP or factors.max() > 1.0 / STEEP:
            return False
        of_all, of_nuisances = np.log(factors).sum(axis=1)
        self.volume += float(of_all - of_nuisances)
        K_inverse = np.linalg.inv(K)
        for k, columns in enumerate(self._columns):
            X = self._inverses[k] @ columns[:, :, candidate]
            moved = X.T @ columns.reshape(len(columns), size * count)
            solved = K_inverse[k] @ moved
            self._inverses[k] -= sign * (X @ K_inverse[k] @ X.T)
            shape = size, size, count
            change = moved.reshape(shape)[:, a] * solved.reshape(shape)[:, b]
            self._leverages[:, k] -= sign * change.sum(axis=0)
        return True
