"""Residuals and derivatives of blocks of measurements."""

from __future__ import annotations

import copy
from collections.abc import Iterable, Sequence
from functools import cached_property
from typing import Protocol, Self

import numpy as np

from calib_pin.estimation.measured import Block
from calib_pin.estimation.model import (
    ToolPoses,
    kept,
    whitened,
    whitened_jacobian,
)
from calib_pin.estimation.segments import compilable
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import Linearization
from calib_pin.parameterizations.error_model import flexures

PIECE = 4096
"""Measurements whose Jacobian is held at once, where there are very many."""


class Evaluator(Protocol):
    """The measurements of some blocks as a function of all parameters, shape (P,).

    What it says of each block is by the block's own parameters, shape (p,).
    """

    def weighted(self, sigma: Floats) -> Self:
        """The same with other standard deviations of all blocks, shape (M,)."""
        ...

    def about(self, blocks: Sequence[Block]) -> Self | None:
        """The same measurements about other references; None where more has changed."""
        ...

    def errors(self, theta: Floats) -> Sequence[Floats]:
        """Residuals of each block in their units, predicted minus measured, (N, d)."""
        ...

    def square(self, theta: Floats) -> float:
        """Sum of squares of the whitened residuals."""
        ...

    def normal(self, theta: Floats) -> Sequence[Floats] | Floats:
        """Products of the columns of Jacobian and residual, (p + 1, p + 1) each.

        Half the digits are lost, which is good enough for a step.
        """
        ...

    def factorize(self, theta: Floats) -> Sequence[tuple[Floats, Floats]]:
        """Whitened residual, shape (M,), and Jacobian, shape (M, p), of each block.

        Of very many measurements they are those of a smaller system with the same
        normal equations, to full precision.
        """
        ...


class RowByRow:
    """Measurements of a block by Pinocchio, a residual row for each value.

    Args:
        block: The block.
        sigma: Standard deviations of the residual components of all blocks of the
            problem, shape (M,).
    """

    def __init__(self, block: Block, sigma: Floats) -> None:
        """Prepare nothing: what does not change is computed where it is needed."""
        self._block, self._sigma = block, block.table(sigma)

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
        return ToolPoses(self._block.part.error, self._block.data)

    def errors(self, theta: Floats) -> list[Floats]:
        """Residuals in their units, shape (N, d)."""
        part, data = self._block.part, self._block.data
        of_robot, instrument = part.values(theta)
        return [part.measurement.residual(self._tool(of_robot), instrument, data)]

    def residual(self, theta: Floats) -> Floats:
        """Whitened residual, shape (N d,)."""
        return whitened(self.errors(theta)[0], self._sigma)

    def square(self, theta: Floats) -> float:
        """Sum of squares of the whitened residuals."""
        r = self.residual(theta)
        return float(r @ r)

    def normal(self, theta: Floats) -> list[Floats]:
        """Products of the columns of Jacobian and residual, (p + 1, p + 1)."""
        ((r, J),) = self.factorize(theta)
        columns = np.column_stack([J, r])
        return [np.asarray(columns.T @ columns)]

    def factorize(self, theta: Floats) -> list[tuple[Floats, Floats]]:
        """Whitened residual, shape (N d,), and Jacobian, shape (N d, p)."""
        part, data = self._block.part, self._block.data
        of_robot, instrument = part.values(theta)
        tool = self._tool.linearize(of_robot)
        linear = part.measurement.linearize(tool.T, instrument, data)
        aside = np.isinf(self._sigma)
        known = Linearization(
            linear.residual,
            kept(linear.J_pose, aside),
            kept(linear.J_instrument, aside),
        )
        J = whitened_jacobian(tool, known, self._sigma)
        r = whitened(linear.residual, self._sigma)
        return [(r, J.reshape(-1, len(part.index)))]


class InPieces:
    """Very many measurements of a block by Pinocchio, some thousand at a time.

    Compiled kernels know nothing of places that bend row by row. It takes its time, and
    no more memory than a piece.

    Args:
        block: The block.
        sigma: Standard deviations of the residual components of all blocks of the
            problem, shape (M,).
    """

    def __init__(self, block: Block, sigma: Floats) -> None:
        """Cut the measurements into pieces."""
        self._pieces = []
        for start in range(0, len(block.data), PIECE):
            data = block.data.rows(slice(start, start + PIECE))
            first = block.values.start + start * block.part.components
            stop = first + len(data) * block.part.components
            piece = block._replace(data=data, values=slice(first, stop))
            self._pieces.append(RowByRow(piece, sigma))

    def weighted(self, sigma: Floats) -> InPieces:
        """The same with other standard deviations of all blocks, shape (M,)."""
        result = copy.copy(self)
        result._pieces = [piece.weighted(sigma) for piece in self._pieces]
        return result

    def about(self, blocks: Sequence[Block]) -> InPieces | None:
        """Nothing: there is nothing prepared that would be worth keeping."""
        return None

    def errors(self, theta: Floats) -> list[Floats]:
        """Residuals in their units, shape (N, d)."""
        return [np.concatenate([piece.errors(theta)[0] for piece in self._pieces])]

    def square(self, theta: Floats) -> float:
        """Sum of squares of the whitened residuals."""
        return sum((piece.square(theta) for piece in self._pieces), 0.0)

    def normal(self, theta: Floats) -> list[Floats]:
        """Products of the columns of Jacobian and residual, (p + 1, p + 1)."""
        first, *others = self._pieces
        (total,) = first.normal(theta)
        for piece in others:
            total += piece.normal(theta)[0]
        return [total]

    def factorize(self, theta: Floats) -> list[tuple[Floats, Floats]]:
        """Residual, shape (M,), and Jacobian, shape (M, p), of a smaller system."""
        R: Floats | None = None
        for piece in self._pieces:
            ((r, J),) = piece.factorize(theta)
            rows = np.column_stack([J, r])
            rows = rows if R is None else np.concatenate([R, rows])
            R = np.asarray(np.linalg.qr(rows, mode="r"))
        assert R is not None
        return [(R[:, -1], R[:, :-1])]


def compiled(evaluators: Iterable[Evaluator]) -> bool:
    """Whether compiled kernels are among some evaluators."""
    return not all(isinstance(one, RowByRow | InPieces) for one in evaluators)


def evaluated(
    blocks: Sequence[Block], sigma: Floats, many: bool
) -> dict[Evaluator, list[int]]:
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
        plain = compilable(block.part.error) and not block.data.start.size
        found.setdefault(alike(block.part) if plain else k, []).append(k)

    def alone(block: Block) -> RowByRow | InPieces:
        bent = len(flexures(block.part.error)) and len(block.data) > PIECE
        return (InPieces if bent else RowByRow)(block, sigma)

    return {
        alone(blocks[positions[0]])
        if isinstance(kind, int)
        else ManyRows([blocks[k] for k in positions], sigma): positions
        for kind, positions in found.items()
    }
