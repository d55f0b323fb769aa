"""Residuals and normal equations of very many measurements, chunk by chunk.

The Jacobian of a million measurements does not fit into memory, and nothing needs it: a
step of Gauss-Newton, a rank and a covariance follow from a square system with the same
normal equations. Two ways lead there. `normal` adds up products of columns, which is
fast but loses half the digits: it drives the steps. `factorize` reduces the residual
rows by orthogonal transformations, chunk by chunk, and loses nothing: ranks are decided
by it.

Both work in the twists at the ends of the chain's segments and in the corrections of
the joints, whatever the parameterization; the parameters enter at the end, by a matrix
that does not depend on the rows.

What does not change between evaluations is kept: of every row 24 bytes for each joint,
its motion, and 8 for each joint correction, the value of its basis function.

Blocks that differ in their station alone are one stream of measurements: a station is a
pose before everything else, and meets no twist but its own.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, fields, is_dataclass, replace
from functools import partial

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.compiled import blocks as compiled
from calib_pin.compiled import kernels, row_kernels
from calib_pin.compiled.threads import Threads
from calib_pin.estimation.measured import Block
from calib_pin.estimation.model import kept
from calib_pin.estimation.segments import Segments
from calib_pin.estimation.system import FRAME, Part
from calib_pin.kinematics.spatial import Floats, adjoint, invert, se3_exp
from calib_pin.observations import Measurements

CHUNK = 128 * compiled.BLOCK
"""Rows of a chunk. It is the same for any number of threads, so that sums have one
order, and so large that threads seldom wait for the interpreter."""


def alike(part: Part) -> tuple[object, ...]:
    """Things that are the same in parts which `ManyRows` evaluates together."""
    model = part.measurement
    if not is_dataclass(model):
        return (part.key,)
    values = [getattr(model, field.name) for field in fields(model)]
    return (
        part.key._replace(station=""),
        part.error.tool.homogeneous.tobytes(),
        part.error.payload,
        part.index[FRAME:].tobytes(),
        type(model),
        *(tuple(map(id, v)) if isinstance(v, tuple) else id(v) for v in values),
    )


class ManyRows:
    """Measurements of alike blocks, whitened; an `Evaluator` of `problem`.

    Args:
        blocks: The S blocks, see `alike`.
        sigma: Standard deviations of the residual components of all blocks of the
            problem, shape (M,).
    """

    def __init__(self, blocks: Sequence[Block], sigma: Floats) -> None:
        """Cut the measurements into chunks and compute the joint motions once."""
        self._refer(blocks)
        segments = self._segments
        corrections = self._error.joint_corrections
        joints = [self._error.screws[k].frame - 1 for k in corrections]
        self._joints = np.array(joints, np.int64)
        # The twist along the joint's axis, of what stands before the joint.
        along = np.where(segments.revolute, 5, 2)
        self._along = 6 * self._joints + along[self._joints]
        self._threads = Threads()
        data = blocks[0].data
        if len(blocks) > 1:
            data = Measurements.concatenate(
                [replace(block.data, station="", sigma=None) for block in blocks]
            )
        self._stops = np.cumsum([len(block.data) for block in blocks])
        starts = range(0, len(data), CHUNK)
        self._chunks = list(self._threads.map(partial(self._chunk, data), starts))
        self._weigh(sigma)

    def _refer(self, blocks: Sequence[Block]) -> None:
        """Take blocks with their references."""
        self._blocks, part = blocks, blocks[0].part
        self._error = replace(
            part.error, base=pin.SE3.Identity(), screws=part.error.screws[FRAME:]
        )
        self._segments = Segments.of(self._error)
        self._measurement = part.measurement
        self._bases = np.array([block.part.error.base.homogeneous for block in blocks])

    def about(self, blocks: Sequence[Block]) -> ManyRows | None:
        """The same measurements about other references; None where more has changed."""
        before, parts = self._blocks[0].part.error, [block.part for block in blocks]
        error = parts[0].error
        same = error.chain is before.chain and error.screws is before.screws
        same = same and error.payload == before.payload and error.learned is None
        if not same or len(set(map(alike, parts))) > 1:
            return None
        result = copy.copy(self)
        result._refer(blocks)
        result._last = b"", np.zeros(0)
        return result

    def weighted(self, sigma: Floats) -> ManyRows:
        """The same measurements with other standard deviations, shape (M,)."""
        result = copy.copy(self)
        result._weigh(sigma)
        return result

    def _chunk(self, data: Measurements, start: int) -> _Chunk:
        """The rows from a start, without weights."""
        # Views: nothing is copied but the joint motions.
        data = data.rows(slice(start, start + CHUNK))
        signs = self._segments.signs
        q, factors = data.q * signs, self._error.basis(data.q, data.conditions)
        factors *= signs[self._joints]
        cuts = np.clip(self._stops - start, 0, len(data))
        pieces, first = [], 0
        for block, stop in enumerate(cuts.tolist()):
            if stop > first:
                rows = slice(first, stop)
                motion, starts = compiled.motions(q[rows], self._segments.revolute)
                own = np.ascontiguousarray(factors[rows].T)
                pieces.append(_Piece(block, rows, motion, starts, own))
                first = stop
        return _Chunk(data, tuple(pieces), np.zeros((0, 0)))

    def _weigh(self, sigma: Floats) -> None:
        self._last: tuple[bytes, Floats] = b"", np.zeros(0)
        tables = [block.table(sigma) for block in self._blocks]
        weights = 1.0 / (tables[0] if len(tables) == 1 else np.concatenate(tables))
        self._chunks = [
            replace(chunk, weights=weights[start : start + CHUNK])
            for chunk, start in zip(
                self._chunks, range(0, len(weights), CHUNK), strict=True
            )
        ]

    def errors(self, theta: Floats) -> Sequence[Floats]:
        """Residuals of each block in their units, shape (N, d)."""
        links, own, moved = self._links(theta), self._own(theta), self._moving(theta)

        def errors(chunk: _Chunk) -> Floats:
            T = moved(chunk).poses(links)
            return self._measurement.residual(T, own, chunk.data)

        found = np.concatenate(list(self._threads.map(errors, self._chunks)))
        return np.split(found, self._stops[:-1])

    def square(self, theta: Floats) -> float:
        """Sum of squares of the whitened residuals."""
        links, own, moved = self._links(theta), self._own(theta), self._moving(theta)

        def square(chunk: _Chunk) -> float:
            T = moved(chunk).poses(links)
            residual = self._measurement.residual(T, own, chunk.data)
            r = kept(residual, chunk.weights == 0.0) * chunk.weights
            return float(np.vdot(r, r))

        return sum(self._threads.map(square, self._chunks), 0.0)

    def normal(self, theta: Floats) -> Floats:
        """Products of the columns of each block, shape (S, p + 1, p + 1).

        The last ones are remembered: one solve begins where another has ended.
        """
        if self._last[0] == theta.tobytes():
            return self._last[1]
        size = self._padded(len(self._own(theta)))
        total = np.zeros((len(self._blocks), size, size))
        for block, part in self._reduced(row_kernels.normal_equations, theta):
            total[block] += part
        symmetric = np.tril(total) + np.swapaxes(np.tril(total, -1), 1, 2)
        B = self._to_parameters(theta)
        # Whether a product of what is not finite warns depends on the processor.
        with np.errstate(invalid="ignore"):
            products = np.asarray(np.swapaxes(B, 1, 2) @ symmetric @ B)
        products.setflags(write=False)
        self._last = theta.tobytes(), products
        return products

    def factorize(self, theta: Floats) -> list[tuple[Floats, Floats]]:
        """The residual rows of each block reduced by orthogonal transformations.

        Returns:
            Residual, shape (M,), and Jacobian, shape (M, p), M <= p + 1.
        """
        parts: list[list[Floats]] = [[] for _ in self._blocks]
        for block, part in self._reduced(row_kernels.triangular_factor, theta):
            parts[block].append(part)
        found = []
        for pieces, B in zip(parts, self._to_parameters(theta), strict=True):
            R = np.asarray(np.linalg.qr(np.concatenate(pieces) @ B, mode="r"))
            found.append((R[:, -1], R[:, :-1]))
        return found

    def _reduced(
        self, kernel: Callable[..., None], theta: Floats
    ) -> Iterator[tuple[int, Floats]]:
        """The columns of pieces of blocks reduced by a kernel, shape (M, M) each."""
        links, own, moved = self._links(theta), self._own(theta), self._moving(theta)
        size = self._padded(len(own))

        def reduced(chunk: _Chunk) -> list[tuple[int, Floats]]:
            chunk = moved(chunk)
            linear = self._measurement.linearize(chunk.poses(links), own, chunk.data)
            others = np.concatenate(
                [linear.J_instrument, linear.residual[:, :, None]], axis=2
            )
            aside = chunk.weights == 0.0
            J_pose, others = kept(linear.J_pose, aside), kept(others, aside)
            found = []
            for piece in chunk.pieces:
                result, rows = np.empty((size, size)), piece.rows
                corrections = row_kernels.Corrections(self._along, piece.factors)
                of_rows = J_pose[rows], others[rows], chunk.weights[rows]
                at = links[0], piece.motion, piece.starts, corrections
                kernel(*at, *of_rows, result)
                found.append((piece.block, result))
            return found

        for pieces in self._threads.map(reduced, self._chunks):
            yield from pieces

    def _own(self, theta: Floats) -> Floats:
        """The instrument parameters, which all blocks share."""
        part = self._blocks[0].part
        return part.values(theta)[1]

    def _inner(self, theta: Floats) -> Floats:
        """Parameters of the chain between the frames of stations and instruments."""
        part = self._blocks[0].part
        return part.values(theta)[0][FRAME:]

    def _moving(self, theta: Floats) -> Callable[[_Chunk], _Chunk]:
        """A function that gives chunks the joint motions with their corrections."""
        amounts = self._inner(theta)[self._error.joint_corrections]
        revolute, joints = self._segments.revolute, self._joints

        def moved(piece: _Piece) -> _Piece:
            motion = np.empty_like(piece.motion)
            at = piece.motion, piece.starts, revolute
            kernels.move(*at, joints, piece.factors, amounts, motion)
            return replace(piece, motion=motion)

        if not amounts.any():
            return lambda chunk: chunk
        return lambda chunk: replace(chunk, pieces=tuple(map(moved, chunk.pieces)))

    def _stations(self, theta: Floats) -> tuple[Floats, Floats]:
        """Base frames, (S, 4, 4), and twists of their parameters there, (S, 6, 6)."""
        parts = [block.part for block in self._blocks]
        values = theta[np.array([part.index[:FRAME] for part in parts])]
        twists = np.empty((len(parts), 6, FRAME))
        behind = np.tile(np.eye(4), (len(parts), 1, 1))
        for k in reversed(range(FRAME)):
            twist = parts[0].error.screws[k].twist
            twists[:, :, k] = adjoint(invert(behind)) @ twist
            behind = se3_exp(values[:, k, None] * twist) @ behind
        return self._bases @ behind, twists

    def _links(self, theta: Floats) -> Floats:
        """Links of the chain from each station, shape (S, n + 1, 12)."""
        inner = self._segments.links(self._inner(theta)[None])[0]
        bases, _ = self._stations(theta)
        result = np.tile(inner, (len(bases), 1, 1))
        result[:, 0] = (bases @ _pose(inner[0]))[:, :3].reshape(-1, 12)
        return result

    def _padded(self, own: int) -> int:
        """Columns of twists, instrument and residual, rounded up to four."""
        count = 6 * len(self._segments.constants) + len(self._joints) + own + 1
        return -(-count // 4) * 4

    def _to_parameters(self, theta: Floats) -> Floats:
        """Matrices from the columns of kernels to parameters and residual, (S, ...)."""
        inner, own = self._inner(theta), len(self._own(theta))
        columns = self._segments.columns(inner)
        twists, count = len(columns), FRAME + len(inner)
        result = np.zeros((len(self._blocks), self._padded(own), count + own + 1))
        first = _pose(self._segments.links(inner[None])[0, 0])
        result[:, :6, :FRAME] = adjoint(invert(first)) @ self._stations(theta)[1]
        result[:, :twists, FRAME:count] = columns
        corrections = self._error.joint_corrections
        others = twists + len(corrections)
        result[:, np.arange(twists, others), FRAME + corrections] = 1.0
        result[:, others : others + own + 1, count:] = np.eye(own + 1)
        return result


@dataclass(frozen=True)
class _Piece:
    """Measurements of one block within a chunk.

    Attributes:
        block: Position of the block.
        rows: Where they stand in the chunk.
        motion: Joint motions, see `compiled.blocks`.
        starts: First row of each block of these, among the rows.
        factors: Change of a joint's motion by each correction's amount, (C, rows).
    """

    block: int
    rows: slice
    motion: Floats
    starts: NDArray[np.int64]
    factors: Floats


@dataclass(frozen=True)
class _Chunk:
    """Some measurements, with what does not change between evaluations.

    Attributes:
        data: The measurements.
        pieces: Those of each block.
        weights: Inverse standard deviations, shape (rows, d).
    """

    data: Measurements
    pieces: tuple[_Piece, ...]
    weights: Floats

    def poses(self, links: Floats) -> Floats:
        """Tool poses by the links from each station, shape (rows, 4, 4)."""
        T = np.empty((len(self.data), 4, 4))
        for piece in self.pieces:
            kernels.poses(links[piece.block], piece.motion, piece.starts, T[piece.rows])
        return T


def _pose(link: Floats) -> Floats:
    """A row of (R | p), shape (12,), as a pose, shape (4, 4)."""
    return np.vstack([link.reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])
