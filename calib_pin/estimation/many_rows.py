"""Residuals and normal equations of very many rows, chunk by chunk.

The Jacobian of a million rows does not fit into memory, and nothing needs it: a step
of Gauss-Newton, a rank and a covariance follow from a square system with the same
normal equations. Two ways lead there. `normal` adds up products of columns, which is
fast but loses half the digits: it drives the steps. `triangular` reduces the rows by
orthogonal transformations, chunk by chunk, and loses nothing: ranks are decided by it.

Both work in the twists at the ends of the chain's segments, whatever the
parameterization; the parameters enter at the end, by a matrix that does not depend on
the rows.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from calib_pin.compiled import blocks, kernels, row_kernels
from calib_pin.compiled.threads import Threads
from calib_pin.estimation.segments import Segments
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models import MeasurementModel
from calib_pin.observations import Measurements
from calib_pin.parameterizations.error_model import ErrorModel

__all__ = ["ManyRows"]

CHUNK = 128 * blocks.BLOCK
"""Rows of a chunk. It is the same for any number of threads, so that sums have one
order, and so large that threads seldom wait for the interpreter."""


class ManyRows:
    """Rows of one error model and measurement model, whitened.

    Args:
        error: The error model.
        measurement: The measurement model.
        data: The rows.
        sigma: Standard deviations of the residual components, shape (N, d).
    """

    def __init__(
        self,
        error: ErrorModel,
        measurement: MeasurementModel,
        data: Measurements,
        sigma: Floats,
    ) -> None:
        """Cut the rows into chunks and compute the joint motions once."""
        self._segments = Segments.of(error)
        self._measurement = measurement
        self._threads = Threads()
        self._chunks = list(
            self._threads.map(
                lambda start: _Chunk(self._segments, data, sigma, start),
                range(0, len(data), CHUNK),
            )
        )

    def errors(self, of_robot: Floats, own: Floats) -> Floats:
        """Residuals in their units, shape (N, d).

        Args:
            of_robot: Parameter values of the error model, shape (P,).
            own: Those of the measurement model, shape (K,).
        """
        chain = self._chain(of_robot)
        return np.concatenate(
            list(
                self._threads.map(
                    lambda chunk: self._measurement.residual(
                        chunk.poses(chain), own, chunk.data
                    ),
                    self._chunks,
                )
            )
        )

    def cost(self, of_robot: Floats, own: Floats) -> float:
        """Half the sum of squared whitened residuals."""
        chain = self._chain(of_robot)

        def square(chunk: _Chunk) -> float:
            T = chunk.poses(chain)
            r = self._measurement.residual(T, own, chunk.data) * chunk.weights
            return float(np.vdot(r, r))

        return 0.5 * sum(self._threads.map(square, self._chunks))

    def normal(self, of_robot: Floats, own: Floats) -> tuple[Floats, Floats]:
        """A square system with the normal equations of all rows.

        Singular values below 1e-8 of the largest, columns brought to one length, are
        rounding; they come out as zero.

        Returns:
            Residual, shape (P + K + 1,), and Jacobian, shape (P + K + 1, P + K).
        """
        total = np.zeros((size := self._padded(len(own)), size))
        for part in self._reduced(row_kernels.normal_equations, of_robot, own):
            total += part
        symmetric = np.tril(total) + np.tril(total, -1).T
        B = self._to_parameters(of_robot, len(own))
        # Whether a product of what is not finite warns depends on the processor.
        with np.errstate(invalid="ignore"):
            return _square_root(B.T @ symmetric @ B)

    def triangular(self, of_robot: Floats, own: Floats) -> tuple[Floats, Floats]:
        """The rows reduced by orthogonal transformations.

        Returns:
            Residual, shape (M,), and Jacobian, shape (M, P + K), M <= P + K + 1.
        """
        parts = list(self._reduced(row_kernels.triangular_factor, of_robot, own))
        B = self._to_parameters(of_robot, len(own))
        R = np.asarray(np.linalg.qr(np.concatenate(parts) @ B, mode="r"))
        return R[:, -1], R[:, :-1]

    def _reduced(
        self, kernel: Callable[..., None], of_robot: Floats, own: Floats
    ) -> Iterator[Floats]:
        """What a kernel makes of the columns of every chunk, shape (M, M) each."""
        chain = self._chain(of_robot)
        size = self._padded(len(own))

        def reduced(chunk: _Chunk) -> Floats:
            linear = self._measurement.linearize(chunk.poses(chain), own, chunk.data)
            others = np.concatenate(
                [linear.J_instrument, linear.residual[:, :, None]], axis=2
            )
            result = np.empty((size, size))
            kernel(
                chain,
                chunk.motion,
                chunk.starts,
                linear.J_pose,
                others,
                chunk.weights,
                result,
            )
            return result

        return self._threads.map(reduced, self._chunks)

    def _chain(self, of_robot: Floats) -> Floats:
        return np.asarray(self._segments.links(of_robot[None])[0])

    def _padded(self, own: int) -> int:
        """Columns of the twists, own parameters and residual, a multiple of four."""
        count = 6 * len(self._segments.constants) + own + 1
        return -(-count // 4) * 4

    def _to_parameters(self, of_robot: Floats, own: int) -> Floats:
        """Matrix from the columns of the kernels to parameters and residual."""
        columns = self._segments.columns(of_robot)
        twists, count = columns.shape
        result = np.zeros((self._padded(own), count + own + 1))
        result[:twists, :count] = columns
        result[twists : twists + own + 1, count:] = np.eye(own + 1)
        return result


class _Chunk:
    """Some rows, with what does not change between evaluations."""

    def __init__(
        self, segments: Segments, data: Measurements, sigma: Floats, start: int
    ) -> None:
        rows = slice(start, start + CHUNK)
        # Views: nothing is copied but the joint motions.
        self.data = replace(
            data,
            q=data.q[rows],
            values=data.values[rows],
            sigma=None,
            target=data.target[rows],
            payload=data.payload[rows],
            validate=data.validate[rows],
            lines=data.lines[rows],
            files=data.files[rows],
            weight=data.weight[rows],
        )
        self.weights = 1.0 / sigma[rows]
        self.motion, self.starts = blocks.motions(
            self.data.q * segments.signs, segments.revolute
        )

    def poses(self, chain: Floats) -> Floats:
        """Tool poses, shape (rows, 4, 4)."""
        T = np.empty((len(self.data), 4, 4))
        kernels.poses(chain, self.motion, self.starts, T)
        return T


def _square_root(K: Floats) -> tuple[Floats, Floats]:
    """A system (r, J) with `[J r]^T [J r] = K`, up to what rounding has destroyed."""
    r, J = np.zeros(len(K)), np.zeros((len(K), len(K) - 1))
    if not np.isfinite(K).all():
        return r + np.nan, J
    size = np.sqrt(np.diag(K))
    size = np.where(size > 0.0, size, 1.0)
    H, g = (K / np.outer(size, size))[:-1, :-1], K[:-1, -1] / size[:-1]
    values, vectors = np.linalg.eigh(H)
    kept = values > len(H) * np.finfo(float).eps * values[-1]
    root = np.sqrt(values[kept])
    J[: len(root)] = root[:, None] * vectors[:, kept].T * size[:-1]
    r[: len(root)] = vectors[:, kept].T @ g / root
    # What no parameter changes stands in a row of its own.
    r[-1] = np.sqrt(max(K[-1, -1] - float(r @ r), 0.0))
    return r, J
