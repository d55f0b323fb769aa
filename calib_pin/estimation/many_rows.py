"""Very many measurements, or members of a population, by compiled kernels.

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
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any, NamedTuple, TypeAlias

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.compiled import blocks as compiled
from calib_pin.compiled import kernels, link_kernels, row_kernels
from calib_pin.compiled.threads import Threads
from calib_pin.estimation.terms import Block, Term, zeroed
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import Batch
from calib_pin.observations import Conditions, Measurements
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


PASSES = 3
"""Passes that are remembered: of the nominal robot, of the fitted one, and of that
about other references."""


class ManyRows:
    """Measurements of a block, whitened; see `problem.Evaluator`.

    Args:
        block: The block.
        sigma: Standard deviations of the residual components of all blocks of the
            problem, shape (M,).
        last: The last evaluator of the same measurements, whose references and weights
            may be others; what it has prepared is used again.
    """

    def __init__(self, block: Block, sigma: Floats, last: Any = None) -> None:
        """Cut the measurements into chunks."""
        self._block, self._sigma = block, block.table(sigma)
        error, data = block.term.error, block.data
        same = isinstance(last, ManyRows) and last._block.term.error is error
        self._segments = segments = last._segments if same else Segments(error)
        # The twist along the joint's axis, of what stands before the joint.
        along = np.where(segments.revolute, 5, 2)[segments.joints]
        self._along = 6 * segments.joints + along
        self._threads, self._chunks = Threads(), list[_Chunk]()
        self._passes: list[_Pass] = []
        if isinstance(last, ManyRows) and last._prepared_for(error):
            self._threads, self._chunks = last._threads, last._chunks
            self._passes = [
                known.for_weights(block.term, self._sigma) for known in last._passes
            ]
            return

        def chunk(start: int) -> _Chunk:
            # Views: nothing is copied but the factors of joint corrections.
            rows = slice(start, start + CHUNK)
            part = data.rows(rows)
            factors = error.basis(part.q, part.conditions) * segments.factors
            return _Chunk(part, rows, factors.T.copy())

        starts = range(0, len(data), CHUNK)
        self._chunks += self._threads.map(chunk, starts)

    def _prepared_for(self, error: ErrorModel) -> bool:
        """Whether only frames of an error model are others."""
        prepared = self._block.term.error
        same = error.chain is prepared.chain and error.screws is prepared.screws
        return same and error.payload == prepared.payload

    def errors(self, theta: Floats) -> Floats:
        """Residuals in their units, predicted minus measured, shape (N, d)."""
        at, residual = self._at(theta), self._block.term.measurement.residual
        return self._every(
            lambda c: residual(self._poses(c, at)[0], at.instrument, c.data)
        )

    def points(self, theta: Floats) -> Floats:
        """Tool points in the measurement frame, shape (N, 3)."""
        at = self._at(theta)
        return self._every(lambda chunk: self._poses(chunk, at)[0][:, :3, 3].copy())

    def _every(self, evaluate: Callable[[_Chunk], Floats]) -> Floats:
        """Values of every measurement, shape (N, ...)."""
        return np.concatenate(list(self._threads.map(evaluate, self._chunks)))

    def factorize(self, theta: Floats) -> tuple[Floats, Floats]:
        """The residual rows reduced by orthogonal transformations.

        Of parameters that are near those of one of the last passes, it is the
        linearization there, see `NEAR` and `PASSES`.

        Returns:
            Residual, shape (M,), and Jacobian, shape (M, p), M <= p + 1.
        """
        term = self._block.term
        values = theta[term.index]
        near = np.minimum(NEAR, 0.1 * np.array([p.scale for p in term.parameters]))
        for last in self._passes:
            step = values - last.values
            if last.sigma is self._sigma and (np.abs(step) <= near).all():
                return last.r + last.J @ step, last.J
        r, J = self._factors(theta)
        if np.isfinite(r).all():
            latest = _Pass(term, self._sigma, values, r, J)
            self._passes = [latest, *self._passes[: PASSES - 1]]
        return r, J

    def _factors(self, theta: Floats) -> tuple[Floats, Floats]:
        """The same, of all rows."""
        at, measurement = self._at(theta), self._block.term.measurement
        columns = self._segments.columns(theta[self._block.term.of_error])
        # Twists, corrections, instrument and residual; kernels take an even number.
        extra, (first, count) = len(at.instrument) + 1, columns.shape
        to_parameters = np.zeros((first + extra + (first + extra) % 2, count + extra))
        to_parameters[:first, :count] = columns
        to_parameters[first : first + extra, count:] = np.eye(extra)

        def reduced(chunk: _Chunk) -> Floats:
            T, motion, starts = self._poses(chunk, at)
            linear = measurement.linearize(T, at.instrument, chunk.data)
            residual = linear.residual[:, :, None]
            others = np.concatenate([linear.J_instrument, residual], axis=2)
            weights = 1.0 / self._sigma[chunk.rows]
            aside, R = weights == 0.0, np.zeros((len(to_parameters),) * 2)
            corrections = row_kernels.Corrections(self._along, chunk.factors)
            inputs = at.links, motion, starts, corrections
            rows = zeroed(linear.J_pose, aside), zeroed(others, aside), weights
            row_kernels.triangular_factor(*inputs, *rows, R)
            return R

        factors = np.concatenate([*self._threads.map(reduced, self._chunks)])
        R = np.asarray(np.linalg.qr(factors @ to_parameters, mode="r"))
        return R[:, -1], R[:, :-1]

    def _at(self, theta: Floats) -> _At:
        """Parameter values as kernels take them."""
        term = self._block.term
        robot, instrument = term.values(theta)
        links = self._segments.links(robot[None])[0]
        return _At(links, robot[term.error.joint_corrections], instrument)

    def _poses(
        self, chunk: _Chunk, at: _At
    ) -> tuple[Floats, Floats, NDArray[np.int64]]:
        """Tool poses, (rows, 4, 4), joint motions and the first row of their blocks."""
        segments, T = self._segments, np.empty((len(chunk.data), 4, 4))
        revolute = segments.revolute
        motion, starts = compiled.motions(chunk.data.q * segments.signs, revolute)
        if at.amounts.any():
            inputs = motion.copy(), starts, revolute, segments.joints, chunk.factors
            kernels.move(*inputs, at.amounts, motion)
        kernels.poses(at.links, motion, starts, T)
        return T, motion, starts


class _Pass(NamedTuple):
    """Linearization of all rows.

    Attributes:
        term: The term about its references.
        sigma: Standard deviations of the components, shape (N, d).
        values: Parameter values, shape (p,).
        r: Residual there, as of `ManyRows.factorize`, shape (M,).
        J: Its derivative, shape (M, p).
    """

    term: Term
    sigma: Floats
    values: Floats
    r: Floats
    J: Floats

    def for_weights(self, term: Term, sigma: Floats) -> _Pass:
        """The same with deviations of which its own are a multiple, if it is."""
        least = self.sigma.min(), sigma.min()
        if self.term is not term or not np.isfinite(least).all():
            return self
        factor = least[0] / least[1]
        low, high = (factor * (1.0 + part) * sigma for part in (-1e-12, 1e-12))
        if not ((low <= self.sigma) & (self.sigma <= high)).all():
            return self
        return self._replace(sigma=sigma, r=factor * self.r, J=factor * self.J)


class _At(NamedTuple):
    """Links of the chain, (n + 1, 12), joint corrections, (C,), instrument, (K,)."""

    links: Floats
    amounts: Floats
    instrument: Floats


class _Chunk(NamedTuple):
    """Some measurements, with what does not change between evaluations.

    Attributes:
        data: The measurements.
        rows: Where they stand among all of the block.
        factors: Change of a joint's motion by each correction's amount, (C, rows).
    """

    data: Measurements
    rows: slice
    factors: Floats


Factor: TypeAlias = "pin.SE3 | tuple[int, float]"
"""A constant, or a screw by its position with the sign it is applied with."""


class Segments:
    """The segments of an error model with n joints, P parameters, C joint corrections.

    Joint corrections belong to the motions between them, not to a segment.

    Args:
        model: An error model without bends, see `compilable`.

    Attributes:
        constants: Nominal links as rows of (R | p), shape (n + 1, 12).
        screws: Screws in the order they apply; `frame` is the segment, 0..n, and the
            twist acts at its end.
        parameter: Parameter of each screw.
        signs: -1 for joints traversed from child to parent, else 1, shape (n,).
        revolute: True for joints that turn, shape (n,).
        joints: Joint of each correction, shape (C,).
        factors: Sign of that, shape (C,).
    """

    def __init__(self, model: ErrorModel) -> None:
        """Multiply together what stands between the joint motions."""
        screws: list[Screw] = []
        order: list[int] = []
        constants: list[Floats] = []
        for segment, factors in reversed([*enumerate(_split(model))]):
            # From the right: what stands behind a screw carries its twist along.
            behind = pin.SE3.Identity()
            for factor in reversed(factors):
                if isinstance(factor, pin.SE3):
                    behind = factor * behind
                    continue
                k, sign = factor
                twist = sign * behind.toActionMatrixInverse() @ model.screws[k].twist
                screws.append(Screw(model.screws[k].parameter, segment, twist))
                order.append(k)
            constants.append(behind.homogeneous[:3].reshape(-1))
        self.constants, self.screws = np.array(constants[::-1]), screws[::-1]
        self.parameter = np.array(order[::-1], np.int64)
        self._places = np.array([screw.frame for screw in self.screws], np.int64)
        self._twists = np.array([s.twist for s in self.screws]).reshape(-1, 6)
        self.signs = np.where(model.chain.reversed, -1.0, 1.0)
        self.revolute, self._corrections = model.chain.revolute, model.joint_corrections
        joints = [model.screws[k].frame - 1 for k in self._corrections]
        self.joints = np.array(joints, np.int64)
        self.factors = self.signs[self.joints]

    def links(self, theta: Floats) -> Floats:
        """Links of a population of parameter values, (S, P) -> (S, n + 1, 12)."""
        result = np.empty((len(theta), *self.constants.shape))
        inputs = self.constants, self._places, self.parameter, self._twists
        link_kernels.links(*inputs, np.ascontiguousarray(theta), result)
        return result

    def columns(self, theta: Floats) -> Floats:
        """Matrix from parameters to twists and corrections, shape (6 n + 6 + C, P).

        The body twists are those at the ends of all segments.
        """
        twists, _ = ordered_screws(
            self.screws, theta[self.parameter], len(self.constants)
        )
        first, count = 6 * len(self.constants), len(self.joints)
        result = np.zeros((first + count, len(theta)))
        rows = 6 * self._places[:, None] + np.arange(6)
        result[rows, self.parameter[:, None]] = twists.T
        result[np.arange(first, first + count), self._corrections] = 1.0
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
    return pin.SE3(pin.Quaternion.FromTwoVectors(np.eye(3)[2], axis), np.zeros(3))


class PopulationPart:
    """The measurements of one batch, for a whole population; see `PopulationCost`."""

    def __init__(self, block: Block, segments: Segments, batch: Batch) -> None:
        """Compute what does not depend on the parameters."""
        self._batch, self._segments, self._term = batch, segments, block.term
        self._comparison = kernels.COMPARISONS.index(batch.comparison)
        start, conditions = block.data.start, block.data.conditions.rows(batch.rows)

        def move(q: Floats, at: Conditions) -> tuple[Floats, NDArray[np.int64], Floats]:
            factors = block.term.error.basis(q, at) * segments.factors
            motion, starts = compiled.motions(q * segments.signs, segments.revolute)
            return motion, starts, factors.T.copy()

        motion, starts, factors = move(block.data.q[batch.rows], conditions)
        begin, begin_factors = motion[:0], factors[:, :0]
        if start.size:
            begin, _, begin_factors = move(start[batch.rows], conditions.at_start)
        self._rows = kernels.Rows(
            starts=starts,
            motion=motion,
            begin=begin,
            revolute=segments.revolute,
            joints=segments.joints,
            factors=factors,
            begin_factors=begin_factors,
            point=batch.point,
            site=batch.site,
            values=batch.values.T.copy(),
            weights=batch.weights.T.copy(),
        )

    def costs(self, theta: Floats) -> Floats:
        """Half the sums of squares of these measurements, shape (S, P) -> (S,)."""
        robot, instrument = self._term.values(theta)
        links = self._segments.links(robot)
        amounts = robot[:, self._term.error.joint_corrections]
        geometry, result = self._batch.geometry(instrument), np.empty(len(instrument))
        of_members = links, amounts, geometry.points, geometry.sites
        kernels.population_costs(self._comparison, *of_members, self._rows, result)
        return result
