"""Residuals and derivatives of blocks of measurements."""

from __future__ import annotations

import copy
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol, Self

import numpy as np

from calib_pin.estimation.terms import Block, Term
from calib_pin.estimation.tool_poses import (
    ToolPoses,
    kept,
    whitened,
    whitened_jacobian,
)
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import Linearization
from calib_pin.observations import BlockKey
from calib_pin.parameterizations.error_model import ErrorModel, flexures

PIECE = 4096
"""Measurements whose Jacobian is held at once, where there are very many."""


class Evaluator(Protocol):
    """The measurements of some blocks as a function of all parameters, shape (P,).

    What it says of each block is by the block's own parameters, shape (p,).

    Attributes:
        reduces: Whether `factorize` returns fewer rows than there are values.
    """

    reduces: bool

    def weighted(self, sigma: Floats) -> Self:
        """The same with other standard deviations of all blocks, shape (M,)."""
        ...

    def about(self, blocks: Sequence[Block]) -> Self | None:
        """The same measurements about other references; None where more has changed."""
        ...

    def errors(self, theta: Floats) -> Sequence[Floats]:
        """Residuals of each block in their units, predicted minus measured, (N, d)."""
        ...

    def points(self, theta: Floats) -> Sequence[Floats]:
        """Tool points of each block in the measurement frame, shape (N, 3)."""
        ...

    def factorize(self, theta: Floats) -> Sequence[tuple[Floats, Floats]]:
        """Whitened residual, shape (M,), and Jacobian, shape (M, p), of each block.

        Of very many measurements they are those of a smaller system with the same
        normal equations, its triangular factor.
        """
        ...


class RowByRow:
    """Measurements of a block by Pinocchio, a residual row for each value.

    Args:
        block: The block.
        sigma: Standard deviations of the residual components of all blocks of the
            problem, shape (M,).
        reduces: Whether only the triangular factor of the rows is wanted, which takes
            no more memory than a piece of them.
    """

    def __init__(self, block: Block, sigma: Floats, reduces: bool = False) -> None:
        """Prepare nothing: what does not change is computed where it is needed."""
        self._block, self._sigma = block, block.table(sigma)
        self.reduces = reduces

    def weighted(self, sigma: Floats) -> RowByRow:
        """The same with other standard deviations of all blocks, shape (M,)."""
        result = copy.copy(self)
        result._sigma = self._block.table(sigma)
        return result

    def about(self, blocks: Sequence[Block]) -> RowByRow | None:
        """Nothing: there is nothing prepared that would be worth keeping."""
        return None

    @cached_property
    def _tool(self) -> ToolPoses:
        return ToolPoses(self._block.term.error, self._block.data)

    def errors(self, theta: Floats) -> list[Floats]:
        """Residuals in their units, shape (N, d)."""
        term, data = self._block.term, self._block.data
        of_robot, instrument = term.values(theta)
        return [term.measurement.residual(self._tool(of_robot), instrument, data)]

    def points(self, theta: Floats) -> list[Floats]:
        """Tool points in the measurement frame, shape (N, 3)."""
        error, data = self._block.term.error, self._block.data
        of_robot, _ = self._block.term.values(theta)
        basis = error.basis(data.q, data.conditions)
        return [error.poses(data.q, of_robot, basis)[:, :3, 3]]

    def factorize(self, theta: Floats) -> list[tuple[Floats, Floats]]:
        """Whitened residual, shape (M,), and Jacobian, shape (M, p), M = N d if whole.

        Its rows are those of all values, or a triangular factor of them.
        """
        if not self.reduces:
            return [self._rows(theta)]
        R = np.zeros((0, len(self._block.term.index) + 1))
        for piece in self._pieces():
            r, J = piece._rows(theta)
            rows = np.vstack([R, np.column_stack([J, r])])
            R = np.asarray(np.linalg.qr(rows, mode="r"))
        return [(R[:, -1], R[:, :-1])]

    def _rows(self, theta: Floats) -> tuple[Floats, Floats]:
        """Whitened residual, shape (N d,), and Jacobian, shape (N d, p)."""
        term, data = self._block.term, self._block.data
        of_robot, instrument = term.values(theta)
        tool = self._tool.linearize(of_robot)
        linear = term.measurement.linearize(tool.T, instrument, data)
        aside = np.isinf(self._sigma)
        known = Linearization(
            linear.residual,
            kept(linear.J_pose, aside),
            kept(linear.J_instrument, aside),
        )
        J = whitened_jacobian(tool, known, self._sigma)
        r = whitened(linear.residual, self._sigma)
        return r, J.reshape(-1, len(term.index))

    def _pieces(self) -> Iterator[RowByRow]:
        """Some thousand measurements at a time."""
        block = self._block
        for start in range(0, len(block.data), PIECE):
            rows = slice(start, start + PIECE)
            data, sigma = block.data.rows(rows), self._sigma[rows]
            own = block._replace(data=data, values=slice(0, sigma.size))
            yield RowByRow(own, sigma.reshape(-1))


def compilable(model: ErrorModel) -> bool:
    """Whether nothing but the joints' own motions changes row by row.

    Compiled kernels know corrections of these alone.
    """
    return model.learned is None and len(flexures(model)) == 0


@dataclass(frozen=True)
class Evaluated:
    """The evaluators of a problem.

    Attributes:
        terms: The terms about whose references they are.
        sigma: Standard deviations of the residual components, shape (M,).
        many: Whether a Jacobian of all measurements would be too large to be handy.
        evaluators: They, with the positions of the blocks of each.
    """

    terms: Mapping[BlockKey, Term]
    sigma: Floats
    many: bool
    evaluators: Mapping[Evaluator, Sequence[int]]


def evaluated(
    terms: Mapping[BlockKey, Term],
    blocks: Sequence[Block],
    sigma: Floats,
    many: bool,
    last: Evaluated | None = None,
) -> Evaluated:
    """Evaluators of measurements.

    Args:
        terms: The terms.
        blocks: The measurements with these.
        sigma: Standard deviations of their residual components, shape (M,).
        many: Whether a Jacobian of all measurements would be too large to be handy.
        last: Those of the same measurements with other weights or about other
            references; they are used again.
    """
    found: Mapping[Evaluator, Sequence[int]] = {}
    if last is not None and last.many == many:
        found = last.evaluators
        if terms is not last.terms:
            found = _about(blocks, found)
        if not np.array_equal(last.sigma, sigma):
            found = {one.weighted(sigma): at for one, at in found.items()}
    return Evaluated(terms, sigma, many, found or _created(blocks, sigma, many))


def _about(
    blocks: Sequence[Block], found: Mapping[Evaluator, Sequence[int]]
) -> dict[Evaluator, Sequence[int]]:
    """Evaluators about the references of blocks; none where one has to begin anew."""
    result: dict[Evaluator, Sequence[int]] = {}
    for one, at in found.items():
        moved = one.about([blocks[k] for k in at])
        if moved is None:
            return {}
        result[moved] = at
    return result


def _created(
    blocks: Sequence[Block], sigma: Floats, many: bool
) -> dict[Evaluator, Sequence[int]]:
    """Evaluators, with the positions of the blocks of each.

    Compiled kernels take measurements that are many and that they can evaluate. Where
    places bend row by row, Pinocchio takes them piece by piece.

    Args:
        blocks: The blocks.
        sigma: Standard deviations of their residual components, shape (M,).
        many: Whether a Jacobian of all measurements would be too large to be handy.
    """
    if not many:
        return {RowByRow(block, sigma): [k] for k, block in enumerate(blocks)}
    from calib_pin.estimation.many_rows import ManyRows, alike

    found: dict[object, list[int]] = {}
    for k, block in enumerate(blocks):
        plain = compilable(block.term.error) and not block.data.start.size
        found.setdefault(alike(block.term) if plain else k, []).append(k)

    def alone(block: Block) -> RowByRow:
        bent = len(flexures(block.term.error)) and len(block.data) > PIECE
        return RowByRow(block, sigma, reduces=bool(bent))

    return {
        alone(blocks[positions[0]])
        if isinstance(kind, int)
        else ManyRows([blocks[k] for k in positions], sigma): positions
        for kind, positions in found.items()
    }
