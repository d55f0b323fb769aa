"""Very many measurements by compiled kernels, chunk by chunk into triangular factors.

The Jacobian of a million measurements does not fit into memory, and nothing needs it: a
step of Gauss-Newton, a rank and a covariance follow from the triangular factor R of the
whitened columns [J r], into which rows are reflected chunk by chunk (sequential QR;
Golub and Van Loan, Matrix Computations, 5.2). It has their normal equations and all of
their digits.

The kernels work in the twists at the ends of the chain's segments and in the
corrections of the joints, whatever the parameterization; the parameters enter at the
end, by a matrix that does not depend on the rows:

    T(q, theta) = L_0(theta) Z_1(q_1) L_1(theta) ... Z_n(q_n) L_n(theta)

Z turns about z or shifts along it. Whatever stands between two joint motions becomes
one segment: constants multiplied together and moved to the left, and behind them the
screws of the parameters in their order, each transformed by the adjoint. Joints that a
chain traverses from child to parent have their sign in the motion and inverted screws.

Blocks that differ in their station alone are one stream of measurements: a station is a
pose before everything else, and meets no twist but its own.
"""

from __future__ import annotations

import copy
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property, partial
from itertools import pairwise
from typing import NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.compiled import blocks as compiled
from calib_pin.compiled import kernels, link_kernels, row_kernels
from calib_pin.compiled.threads import Threads
from calib_pin.estimation.terms import FRAME, Block, kept
from calib_pin.kinematics.spatial import Floats, adjoint, invert, se3_exp
from calib_pin.observations import Measurements
from calib_pin.parameterizations import Screw
from calib_pin.parameterizations.error_model import ErrorModel
from calib_pin.parameterizations.linearization import ordered_screws

CHUNK = 128 * compiled.BLOCK
"""Rows of a chunk. It is the same for any number of threads, so that sums have one
order, and so large that threads seldom wait for the interpreter."""

NEAR = 1e-4
"""Change of the parameters, in meters and radians or in tenths of a smaller scale,
within which measurements are linear: what is left is its square, 1e-8 m. The last steps
of a fit of very many measurements are shorter, and cost no pass over them: from its
sample the fit ends a million positions with a noise of 0.1 mm after one pass, a
thousandth of a standard deviation from where a second one ends."""


class ManyRows:
    """Measurements of blocks of one kind, whitened; see `evaluators.Evaluator`.

    Args:
        blocks: The S blocks, see `Term.kind`.
        sigma: Standard deviations of the residual components of all blocks of the
            problem, shape (M,).
    """

    reduces = True

    def __init__(self, blocks: Sequence[Block], sigma: Floats) -> None:
        """Cut the measurements into chunks."""
        self._refer(blocks)
        error = self._error
        joints = [error.screws[k].frame - 1 for k in error.joint_corrections]
        self._joints = np.array(joints, np.int64)
        # The twist along the joint's axis, of what stands before the joint.
        along = np.where(self._segments.revolute, 5, 2)
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
        self._sigma = _stacked(blocks, sigma)

    def _refer(self, blocks: Sequence[Block]) -> None:
        """Take blocks with their references."""
        self._blocks, term = blocks, blocks[0].term
        self._error = replace(
            term.error, base=pin.SE3.Identity(), screws=term.error.screws[FRAME:]
        )
        self._segments = Segments.of(self._error)
        self._measurement = term.measurement
        self._bases = np.array([block.term.error.base.homogeneous for block in blocks])
        # Parameters of each block, (S, p), with residual and Jacobian of each there.
        self._known: list[tuple[Floats, list[tuple[Floats, Floats]]]] = []

    @classmethod
    def of(cls, blocks: Sequence[Block], sigma: Floats, last: object) -> ManyRows:
        """Measurements by what the last evaluator of them has prepared, if it can.

        Args:
            blocks: The blocks; their references may be others.
            sigma: Standard deviations as above; those may be others as well.
            last: The evaluator, or None.
        """
        error = blocks[0].term.error
        if not isinstance(last, ManyRows):
            return cls(blocks, sigma)
        before = last._blocks[0].term.error
        same = error.chain is before.chain and error.screws is before.screws
        if not same or error.payload != before.payload:
            return cls(blocks, sigma)
        pairs, table = zip(blocks, last._blocks, strict=True), _stacked(blocks, sigma)
        moved = any(block.term is not other.term for block, other in pairs)
        if not moved and np.array_equal(table, last._sigma):
            return last
        result = copy.copy(last)
        if moved:
            result._refer(blocks)
        result._weigh(table)
        return result

    def _chunk(self, data: Measurements, start: int) -> _Chunk:
        """The rows from a start."""
        # Views: nothing is copied but the factors of joint corrections.
        every = slice(start, start + CHUNK)
        data = data.rows(every)
        factors = self._error.basis(data.q, data.conditions)
        factors *= self._segments.signs[self._joints]
        cuts = np.clip([0, *(self._stops - start)], 0, len(data)).tolist()
        pieces = [
            _Piece(block, slice(first, stop), factors[first:stop].T.copy())
            for block, (first, stop) in enumerate(pairwise(cuts))
            if stop > first
        ]
        return _Chunk(data, every, pieces)

    def _weigh(self, table: Floats) -> None:
        """Take other standard deviations, shape (N, d)."""
        # What was linearized holds on where they are a multiple.
        factor, known = self._sigma.min() / table.min(), self._known
        multiple = 0.0 < factor < np.inf
        if not multiple or not np.allclose(factor * table, self._sigma, 1e-12, 0.0):
            known = []
        self._known = [
            (values, [(factor * r, factor * J) for r, J in found])
            for values, found in known
        ]
        self._sigma = table

    def errors(self, theta: Floats) -> Sequence[Floats]:
        """Residuals of each block in their units, shape (N, d)."""
        at = self._at(theta)
        residual, poses = self._measurement.residual, self._poses
        return self._by_block(lambda c: residual(poses(c, at)[0], at.own, c.data))

    def points(self, theta: Floats) -> Sequence[Floats]:
        """Tool points of each block in the measurement frame, shape (N, 3)."""
        at = self._at(theta)
        return self._by_block(lambda chunk: self._poses(chunk, at)[0][:, :3, 3].copy())

    def _by_block(self, evaluate: Callable[[_Chunk], Floats]) -> Sequence[Floats]:
        """Values of every measurement, (N, ...) for each block."""
        found = np.concatenate(list(self._threads.map(evaluate, self._chunks)))
        return np.split(found, self._stops[:-1])

    def factorize(self, theta: Floats) -> Sequence[tuple[Floats, Floats]]:
        """The residual rows of each block reduced by orthogonal transformations.

        Of parameters that are near those of one of the last two passes, those of the
        nominal robot and of the fitted one, it is the linearization there, see `NEAR`.

        Returns:
            Residual, shape (M,), and Jacobian, shape (M, p), M <= p + 1.
        """
        values = theta[np.array([block.term.index for block in self._blocks])]
        scales = [parameter.scale for parameter in self._blocks[0].term.parameters]
        near = np.minimum(NEAR, 0.1 * np.array(scales))
        for known, found in self._known:
            steps = values - known
            if (np.abs(steps) <= near).all():
                pairs = zip(found, steps, strict=True)
                return [(r + J @ step, J) for (r, J), step in pairs]
        found = self._factors(theta)
        if all(np.isfinite(r).all() for r, _ in found):
            self._known = [(values, found), *self._known[:1]]
        return found

    def _factors(self, theta: Floats) -> list[tuple[Floats, Floats]]:
        """The same, of all rows."""
        at = self._at(theta)
        size = self._padded(len(at.own))

        def reduced(chunk: _Chunk) -> list[tuple[int, Floats]]:
            T, motions = self._poses(chunk, at)
            linear = self._measurement.linearize(T, at.own, chunk.data)
            others = np.concatenate(
                [linear.J_instrument, linear.residual[:, :, None]], axis=2
            )
            weights = 1.0 / self._sigma[chunk.rows]
            aside = weights == 0.0
            J_pose, others = kept(linear.J_pose, aside), kept(others, aside)
            found, link = [], at.links[0]
            for piece, moved in zip(chunk.pieces, motions, strict=True):
                R, rows = np.zeros((size, size)), piece.rows
                given = *moved, row_kernels.Corrections(self._along, piece.factors)
                of_rows = J_pose[rows], others[rows], weights[rows]
                row_kernels.triangular_factor(link, *given, *of_rows, R)
                found.append((piece.block, R))
            return found

        parts: list[list[Floats]] = [[] for _ in self._blocks]
        for pieces in self._threads.map(reduced, self._chunks):
            for block, R in pieces:
                parts[block].append(R)
        found = []
        for factors, B in zip(parts, self._to_parameters(theta), strict=True):
            R = np.asarray(np.linalg.qr(np.concatenate(factors) @ B, mode="r"))
            found.append((R[:, -1], R[:, :-1]))
        return found

    def _at(self, theta: Floats) -> _At:
        """The parameters for the kernels; but for their stations blocks share them."""
        of_robot, own = self._blocks[0].term.values(theta)
        inner = of_robot[FRAME:]
        link = self._segments.links(inner[None])[0]
        bases, _ = self._stations(theta)
        links = np.tile(link, (len(bases), 1, 1))
        links[:, 0] = (bases @ _pose(link[0]))[:, :3].reshape(-1, 12)
        return _At(links, inner[self._error.joint_corrections], own)

    def _poses(self, chunk: _Chunk, at: _At) -> tuple[Floats, list[_Motions]]:
        """Tool poses, shape (rows, 4, 4), and the joint motions of each piece."""
        T, found = np.empty((len(chunk.data), 4, 4)), []
        revolute, q = self._segments.revolute, chunk.data.q * self._segments.signs
        for piece in chunk.pieces:
            motion, starts = compiled.motions(q[piece.rows], revolute)
            if at.amounts.any():
                given = motion.copy(), starts, revolute, self._joints, piece.factors
                kernels.move(*given, at.amounts, motion)
            kernels.poses(at.links[piece.block], motion, starts, T[piece.rows])
            found.append((motion, starts))
        return T, found

    def _stations(self, theta: Floats) -> tuple[Floats, Floats]:
        """Base frames, (S, 4, 4), and twists of their parameters there, (S, 6, 6)."""
        terms = [block.term for block in self._blocks]
        values = theta[np.array([term.index[:FRAME] for term in terms])]
        twists = np.empty((len(terms), 6, FRAME))
        behind = np.tile(np.eye(4), (len(terms), 1, 1))
        for k in reversed(range(FRAME)):
            twist = terms[0].error.screws[k].twist
            twists[:, :, k] = adjoint(invert(behind)) @ twist
            behind = se3_exp(values[:, k, None] * twist) @ behind
        return self._bases @ behind, twists

    def _padded(self, own: int) -> int:
        """Columns of twists, instrument and residual, rounded up to two."""
        count = 6 * len(self._segments.constants) + len(self._joints) + own + 1
        return count + count % 2

    def _to_parameters(self, theta: Floats) -> Floats:
        """Matrices from the columns of kernels to parameters and residual, (S, ...)."""
        of_robot, instrument = self._blocks[0].term.values(theta)
        inner, own = of_robot[FRAME:], len(instrument)
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


def _stacked(blocks: Sequence[Block], sigma: Floats) -> Floats:
    """Standard deviations of the measurements of blocks, (M,) -> (N, d)."""
    tables = [block.table(sigma) for block in blocks]
    return tables[0] if len(tables) == 1 else np.concatenate(tables)


_Motions: TypeAlias = "tuple[Floats, NDArray[np.int64]]"
"""Joint motions and the first row of each block of them, see `compiled.blocks`."""


class _At(NamedTuple):
    """Parameter values as kernels take them.

    Attributes:
        links: Links of the chain from each station, shape (S, n + 1, 12).
        amounts: Amounts of the joint corrections, shape (C,).
        own: Parameters of the instrument, shape (K,).
    """

    links: Floats
    amounts: Floats
    own: Floats


class _Piece(NamedTuple):
    """Measurements of one block within a chunk.

    Attributes:
        block: Position of the block.
        rows: Where they stand in the chunk.
        factors: Change of a joint's motion by each correction's amount, (C, rows).
    """

    block: int
    rows: slice
    factors: Floats


class _Chunk(NamedTuple):
    """Some measurements, with what does not change between evaluations.

    Attributes:
        data: The measurements.
        rows: Where they stand among all of the blocks.
        pieces: Those of each block.
    """

    data: Measurements
    rows: slice
    pieces: list[_Piece]


def _pose(link: Floats) -> Floats:
    """A row of (R | p), shape (12,), as a pose, shape (4, 4)."""
    return np.vstack([link.reshape(3, 4), [0.0, 0.0, 0.0, 1.0]])


Factor: TypeAlias = "pin.SE3 | tuple[int, float]"
"""A constant, or a screw by its position with the sign it is applied with."""


@dataclass(frozen=True)
class Segments:
    """The segments of an error model with n joints and P parameters of its geometry.

    Joint corrections belong to the motions between them, not to a segment.

    Attributes:
        constants: Nominal links as rows of (R | p), shape (n + 1, 12).
        screws: Screws in the order they apply; `place` is the segment, 0..n, and the
            twist acts at its end.
        parameter: Parameter of each screw, shape (P,).
        signs: -1 for joints traversed from child to parent, else 1, shape (n,).
        revolute: True for joints that turn, shape (n,).
    """

    constants: Floats
    screws: tuple[Screw, ...]
    parameter: NDArray[np.int64]
    signs: Floats
    revolute: NDArray[np.bool_]

    @staticmethod
    def of(model: ErrorModel) -> Segments:
        """The segments of an error model without bends, see `compilable`."""
        constants: list[pin.SE3] = []
        screws: list[Screw] = []
        order: list[int] = []
        for segment, factors in enumerate(_split(model)):
            # From the right: what stands behind a screw carries its twist along.
            behind = pin.SE3.Identity()
            found: list[tuple[int, Screw]] = []
            for factor in reversed(factors):
                if isinstance(factor, pin.SE3):
                    behind = factor * behind
                    continue
                k, sign = factor
                twist = behind.toActionMatrixInverse() @ model.screws[k].twist
                screw = replace(model.screws[k], frame=segment, twist=sign * twist)
                found.append((k, screw))
            constants.append(behind)
            order += [k for k, _ in reversed(found)]
            screws += [screw for _, screw in reversed(found)]
        chain = model.chain
        return Segments(
            constants=np.array([c.homogeneous[:3].reshape(-1) for c in constants]),
            screws=tuple(screws),
            parameter=np.array(order, np.int64),
            signs=np.where(chain.reversed, -1.0, 1.0),
            revolute=chain.revolute,
        )

    @cached_property
    def places(self) -> NDArray[np.int64]:
        """Segment of each screw, shape (P,)."""
        return np.array([screw.frame for screw in self.screws], np.int64)

    @cached_property
    def twists(self) -> Floats:
        """Twist of each screw, shape (P, 6)."""
        return np.array([screw.twist for screw in self.screws]).reshape(-1, 6)

    def links(self, theta: Floats) -> Floats:
        """Links of a population of parameter values, (S, P) -> (S, n + 1, 12)."""
        result = np.empty((len(theta), *self.constants.shape))
        link_kernels.links(
            self.constants, self.places, self.parameter, self.twists, theta, result
        )
        return result

    def columns(self, theta: Floats) -> Floats:
        """Body twists at the ends of all segments by parameter, shape (6 n + 6, P)."""
        count = len(self.constants)
        twists, _ = ordered_screws(self.screws, theta[self.parameter], count)
        result = np.zeros((6 * count, len(theta)))
        for k, (screw, column) in enumerate(zip(self.screws, twists.T, strict=True)):
            rows = slice(6 * screw.frame, 6 * screw.frame + 6)
            result[rows, self.parameter[k]] = column
        return result


def _split(model: ErrorModel) -> Iterator[list[Factor]]:
    """Factors of `T(q, theta)` from base to tool, split at the joint motions."""
    chain = model.chain
    at: list[list[int]] = [[] for _ in range(len(model.chain.joints) + 3)]
    for k, screw in enumerate(model.screws):
        if screw.basis is None:
            at[screw.frame].append(k)
    base, tip = chain.ends
    factors: list[Factor] = [model.base, *_applied(at[0]), base.inverse()]
    for i in range(len(chain.joints)):
        placement, screws = chain.placements[i], at[i + 1]
        align = _to_axis(chain.axes[i])
        if chain.reversed[i]:
            yield [*factors, align]
            inverted: list[Factor] = [(k, -1.0) for k in reversed(screws)]
            factors = [align.inverse(), *inverted, placement.inverse()]
        else:
            yield [*factors, placement, *_applied(screws), align]
            factors = [align.inverse()]
    yield [*factors, tip, *_applied(at[-2]), model.tool, *_applied(at[-1])]


def _applied(screws: list[int]) -> list[Factor]:
    return [(k, 1.0) for k in screws]


def _to_axis(axis: Floats) -> pin.SE3:
    """A rotation that takes z to a unit axis."""
    turn = np.cross([0.0, 0.0, 1.0], axis)
    sine = float(np.linalg.norm(turn))
    direction = turn / sine if sine > 1e-12 else np.array([1.0, 0.0, 0.0])
    return pin.SE3(pin.exp3(direction * np.arctan2(sine, axis[2])), np.zeros(3))
