"""Residuals and derivatives of blocks of measurements."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from calib_pin.estimation.terms import Block
from calib_pin.estimation.tool_poses import ToolPoses, whitened, whitened_jacobian
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.error_model import ErrorModel, flexures

if TYPE_CHECKING:
    from calib_pin.estimation.many_rows import ManyRows

PIECE = 4096
"""Measurements whose Jacobian is held at once, where there are very many."""

Evaluator: TypeAlias = "RowByRow | ManyRows"
"""The measurements of some blocks as a function of all parameters, shape (P,).

What it says of each block is by the block's own parameters, shape (p,). Where it
`reduces`, `factorize` returns fewer rows than there are values.
"""

Evaluators: TypeAlias = Mapping[tuple[int, ...], Evaluator]
"""Evaluators of all blocks, by the positions of those of each."""


class RowByRow:
    """Measurements of a block by Pinocchio, a residual row for each value.

    Args:
        block: The block.
        sigma: Standard deviations of the residual components of all blocks of the
            problem, shape (M,).
        reduces: Whether only the triangular factor of the rows is wanted, which takes
            no more memory than a piece of them.
        last: The evaluator of the same measurements before, whose references or
            weights may have been others.
    """

    def __init__(
        self,
        block: Block,
        sigma: Floats,
        reduces: bool = False,
        last: Evaluator | None = None,
    ) -> None:
        """Prepare nothing: what does not change is computed where it is needed."""
        self._block, self._sigma = block, block.table(sigma)
        self.reduces = reduces
        self._tool = ToolPoses(block.term.error, block.data)
        if isinstance(last, RowByRow) and last._block.term is block.term:
            self._tool = last._tool

    def errors(self, theta: Floats) -> list[Floats]:
        """Residuals in their units, predicted minus measured, shape (N, d)."""
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
        block = self._block
        R = np.zeros((0, len(block.term.index) + 1))
        for start in range(0, len(block.data), PIECE):
            rows = slice(start, start + PIECE)
            data, sigma = block.data.rows(rows), self._sigma[rows].reshape(-1)
            piece = block._replace(data=data, values=slice(0, len(sigma)))
            r, J = RowByRow(piece, sigma)._rows(theta)
            more = np.vstack([R, np.column_stack([J, r])])
            R = np.asarray(np.linalg.qr(more, mode="r"))
        return [(R[:, -1], R[:, :-1])]

    def _rows(self, theta: Floats) -> tuple[Floats, Floats]:
        """Whitened residual, shape (N d,), and Jacobian, shape (N d, p)."""
        term, data = self._block.term, self._block.data
        of_robot, instrument = term.values(theta)
        tool = self._tool.linearize(of_robot)
        linear = term.measurement.linearize(tool.T, instrument, data)
        J = whitened_jacobian(tool, linear, self._sigma)
        r = whitened(linear.residual, self._sigma)
        return r.reshape(-1), J.reshape(-1, len(term.index))


def compilable(model: ErrorModel) -> bool:
    """Whether nothing but the joints' own motions changes row by row.

    Compiled kernels know corrections of these alone.
    """
    return model.learned is None and len(flexures(model)) == 0


def evaluators(
    blocks: Sequence[Block], sigma: Floats, many: bool, last: Evaluators
) -> Evaluators:
    """Evaluators of measurements.

    Compiled kernels take measurements that are many and that they can evaluate. Where
    places bend row by row, Pinocchio takes them piece by piece.

    Args:
        blocks: The measurements with their terms.
        sigma: Standard deviations of their residual components, shape (M,).
        many: Whether a Jacobian of all measurements would be too large to be handy.
        last: Those of the same measurements with other weights or about other
            references; what they have prepared is used again.
    """
    found: dict[object, list[int]] = {}
    for k, block in enumerate(blocks):
        plain = many and compilable(block.term.error) and not block.data.start.size
        found.setdefault(block.term.kind if plain else k, []).append(k)
    result: dict[tuple[int, ...], Evaluator] = {}
    for kind, positions in found.items():
        at, (first, *_) = tuple(positions), positions
        if isinstance(kind, int):
            data, error = blocks[first].data, blocks[first].term.error
            bent = many and len(flexures(error)) > 0 and len(data) > PIECE
            result[at] = RowByRow(blocks[first], sigma, bent, last.get(at))
            continue
        from calib_pin.estimation.many_rows import ManyRows

        result[at] = ManyRows.of([blocks[k] for k in at], sigma, last.get(at))
    return result
