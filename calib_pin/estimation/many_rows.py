"""Residuals and normal equations of very many measurements, chunk by chunk.

The Jacobian of a million measurements does not fit into memory, and nothing needs it: a
step of Gauss-Newton, a rank and a covariance follow from a square system with the same
normal equations. Two ways lead there. `normal` adds up products of columns, which is
fast but loses half the digits: it drives the steps. `factorize` reduces the residual
rows by orthogonal transformations, chunk by chunk, and loses nothing: ranks are decided
by it.

Both work in the twists at the ends of the chain's segments, whatever the
parameterization; the parameters enter at the end, by a matrix that does not depend on
the rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial

import numpy as np

from calib_pin.compiled import blocks, kernels, row_kernels
from calib_pin.compiled.threads import Threads
from calib_pin.estimation.model import Model
from calib_pin.estimation.segments import Segments
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Measurements

CHUNK = 128 * blocks.BLOCK
"""Rows of a chunk. It is the same for any number of threads, so that sums have one
order, and so large that threads seldom wait for the interpreter."""


class ManyRows:
    """Measurements of one model, whitened; an `Evaluator` of `problem`.

    Args:
        model: The model.
        data: The measurements.
        sigma: Standard deviations of the residual components, shape (N, d).
    """

    def __init__(self, model: Model, data: Measurements, sigma: Floats) -> None:
        """Cut the measurements into chunks and compute the joint motions once."""
        self._segments = Segments.of(model.error)
        self._measurement, self._split = model.measurement, model.split
        self._threads = Threads()
        chunk = partial(_Chunk, self._segments, data, sigma)
        self._chunks = list(self._threads.map(chunk, range(0, len(data), CHUNK)))

    def errors(self, theta: Floats) -> Floats:
        """Residuals in their units, shape (N, d)."""
        chain, own = self._evaluated(theta)

        def errors(chunk: _Chunk) -> Floats:
            return self._measurement.residual(chunk.poses(chain), own, chunk.data)

        return np.concatenate(list(self._threads.map(errors, self._chunks)))

    def square(self, theta: Floats) -> float:
        """Sum of squares of the whitened residuals."""
        chain, own = self._evaluated(theta)

        def square(chunk: _Chunk) -> float:
            T = chunk.poses(chain)
            r = self._measurement.residual(T, own, chunk.data) * chunk.weights
            return float(np.vdot(r, r))

        return sum(self._threads.map(square, self._chunks), 0.0)

    def normal(self, theta: Floats) -> Floats:
        """Products of all pairs of columns of `[J r]`, shape (P + 1, P + 1)."""
        total = np.zeros((size := self._padded(len(self._split(theta)[1])), size))
        for part in self._reduced(row_kernels.normal_equations, theta):
            total += part
        symmetric = np.tril(total) + np.tril(total, -1).T
        B = self._to_parameters(theta)
        # Whether a product of what is not finite warns depends on the processor.
        with np.errstate(invalid="ignore"):
            return np.asarray(B.T @ symmetric @ B)

    def factorize(self, theta: Floats) -> tuple[Floats, Floats]:
        """The residual rows reduced by orthogonal transformations.

        Returns:
            Residual, shape (M,), and Jacobian, shape (M, P), M <= P + 1.
        """
        parts = list(self._reduced(row_kernels.triangular_factor, theta))
        B = self._to_parameters(theta)
        R = np.asarray(np.linalg.qr(np.concatenate(parts) @ B, mode="r"))
        return R[:, -1], R[:, :-1]

    def _reduced(self, kernel: Callable[..., None], theta: Floats) -> Iterator[Floats]:
        """The columns of every chunk reduced by a kernel, shape (M, M) each."""
        chain, own = self._evaluated(theta)
        size = self._padded(len(own))

        def reduced(chunk: _Chunk) -> Floats:
            linear = self._measurement.linearize(chunk.poses(chain), own, chunk.data)
            others = np.concatenate(
                [linear.J_instrument, linear.residual[:, :, None]], axis=2
            )
            result = np.empty((size, size))
            rows = linear.J_pose, others, chunk.weights
            kernel(chain, chunk.motion, chunk.starts, *rows, result)
            return result

        return self._threads.map(reduced, self._chunks)

    def _evaluated(self, theta: Floats) -> tuple[Floats, Floats]:
        """Links of the chain, shape (n + 1, 12), and the instrument parameters."""
        of_robot, own = self._split(theta)
        return self._segments.links(of_robot[None])[0], own

    def _padded(self, own: int) -> int:
        """Columns of twists, instrument and residual, rounded up to four."""
        count = 6 * len(self._segments.constants) + own + 1
        return -(-count // 4) * 4

    def _to_parameters(self, theta: Floats) -> Floats:
        """Matrix from the columns of the kernels to parameters and residual."""
        of_robot, instrument = self._split(theta)
        own = len(instrument)
        columns = self._segments.columns(of_robot)
        twists, count = columns.shape
        result = np.zeros((self._padded(own), count + own + 1))
        result[:twists, :count] = columns
        result[twists : twists + own + 1, count:] = np.eye(own + 1)
        return result


class _Chunk:
    """Some measurements, with what does not change between evaluations."""

    def __init__(
        self, segments: Segments, data: Measurements, sigma: Floats, start: int
    ) -> None:
        rows = slice(start, start + CHUNK)
        # Views: nothing is copied but the joint motions.
        self.data = data.rows(rows)
        self.weights = 1.0 / sigma[rows]
        self.motion, self.starts = blocks.motions(
            self.data.q * segments.signs, segments.revolute
        )

    def poses(self, chain: Floats) -> Floats:
        """Tool poses, shape (rows, 4, 4)."""
        T = np.empty((len(self.data), 4, 4))
        kernels.poses(chain, self.motion, self.starts, T)
        return T
