"""A calibration by its stations, tools, chains and blocks of measurements."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.directions import WEAK, column_space, rounding
from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.estimation.fit import FittedModel
from calib_pin.estimation.fitted import Fit, likely_posteriors
from calib_pin.estimation.measured import Block
from calib_pin.estimation.system import FRAME
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Indices
from calib_pin.parameterizations.linearization import ordered_screws
from calib_pin.validation.accuracy import QuantityErrors
from calib_pin.validation.breakdown import (
    BlockSummary,
    Breakdown,
    ChainSummary,
    FrameSummary,
)
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.findings.unmoved_joints import still_joints
from calib_pin.validation.frames import (
    OPEN,
    Frame,
    coupled_frames,
    frames_of,
    left_open,
    ties,
)
from calib_pin.validation.judgement import quantity_errors
from calib_pin.validation.model_errors import ModelErrors
from calib_pin.validation.summaries import ToolAccuracy

ROUNDING = 1e-12
"""Standard deviation below which a motion is given [m, rad]."""

ROWS, LEAST = 10_000, 60
"""Measurements that ranks look at: of all blocks, and least of each."""


@serial_blas
def breakdown(
    model: FittedModel, errors: ModelErrors, accuracies: Mapping[str, ToolAccuracy]
) -> Breakdown:
    """A calibration part by part.

    Args:
        model: The fitted model.
        errors: Errors of the measurements that were fitted.
        accuracies: The expected errors of the tool by chain.
    """
    told = _Parts(model, errors)
    return Breakdown(
        accuracies=accuracies,
        stations=tuple(told.frames(0)),
        tools=tuple(told.frames(1)),
        chains=tuple(told.chains()),
        blocks=tuple(told.blocks()),
        coupled_frames=coupled_frames(model.fit, told.covariance),
        unknown=told.unknown(),
    )


@dataclass(frozen=True)
class _Parts:
    """The parts of a fitted model with the errors of the measurements."""

    model: FittedModel
    every: ModelErrors

    def frames(self, end: int) -> Iterator[FrameSummary]:
        """The stations, end 0, or the tools, end 1."""
        problem = self.model.fit.problem
        found: dict[Frame, list[BlockKey]] = {}
        for key, part in problem.parts.items():
            found.setdefault(frames_of(part)[end][0], []).append(key)
        calibrated = CalibratedModel.create(self.model.problem, self.model.theta)
        for frame, keys in found.items():
            part, at = problem.parts[keys[0]], calibrated.of(keys[0])
            T, chain = (at.tool if end else at.error.base), part.error.chain
            _, index = frames_of(part)[end]
            screws = part.error.screws[-FRAME:] if end else part.error.screws[:FRAME]
            theta = self.model.fit.theta[index]
            twists, _ = ordered_screws(screws, theta, screws[0].frame + 1)
            yield FrameSummary(
                name=frame.name,
                link=chain.tip if end else chain.base,
                measurements=self._count(keys),
                errors=self._errors(keys),
                noise=self._noise(keys),
                xyz=tuple(T.translation.tolist()),
                rpy=tuple(pin.rpy.matrixToRpy(T.rotation).tolist()),
                sigma=self._deviations(index, np.kron(np.eye(2), T.rotation) @ twists),
                estimated=bool(problem.parameters.free[index].any()),
            )

    def chains(self) -> Iterator[ChainSummary]:
        """The chains."""
        problem = self.model.fit.problem
        still = set(still_joints(problem))
        for name in problem.chains.names:
            chain = problem.chains[name]
            keys = [key for key in problem.parts if key.chain == name]
            yield ChainSummary(
                name,
                chain.base,
                chain.tip,
                chain.joints,
                self._count(keys),
                self._errors(keys),
                tuple(joint for joint in chain.joints if joint in still),
            )

    def blocks(self) -> Iterator[BlockSummary]:
        """The blocks."""
        problem = self.model.fit.problem
        apart, ranks = ties(problem), block_ranks(self.model.fit)
        for (part, data, _, _), of_block in zip(problem.blocks, ranks, strict=True):
            (station, _), (tool, _) = frames_of(part)
            yield BlockSummary(
                part.key.model,
                part.key.chain,
                station.name,
                tool.name,
                len(data),
                tuple(filter(None, data.target.distinct)),
                self._errors([part.key]),
                self._noise([part.key]),
                *of_block,
                apart[part.key],
            )

    def _count(self, keys: Collection[BlockKey]) -> int:
        """Number of measurements of some blocks."""
        return sum(len(b) for b in self.model.fit.problem.data.blocks if b.key in keys)

    def _errors(self, keys: Collection[BlockKey]) -> tuple[QuantityErrors, ...]:
        """Accuracy of the measurements of some blocks."""
        data = self.model.fit.problem.data
        own = np.array([block.key in keys for block in data.blocks])[data.block_of]
        known = self.every.at(own).counted(data.weight)
        return quantity_errors(self.model.problem.layout.quantities, known)

    def _noise(self, keys: Collection[BlockKey]) -> tuple[VarianceComponent, ...]:
        """Variance components of some blocks."""
        fitted = self.model.fit
        own = {k for key in keys for k in fitted.problem.layout.of_keys[key].tolist()}
        return tuple(noise for k, noise in enumerate(fitted.noise) if k in own)

    def _deviations(self, index: Indices, motions: Floats) -> tuple[float, ...]:
        """Standard deviations of a frame along some motions, (6, 6)."""
        covariance = self.covariance[np.ix_(index, index)]
        if not np.isfinite(covariance).all():
            return ()
        variances = np.einsum("ki,ij,kj->k", motions, covariance, motions)
        sigma = np.sqrt(np.maximum(variances, 0.0))
        sigma[sigma < ROUNDING] = 0.0
        sigma[self._unknown(index, motions)] = np.nan
        return tuple(sigma.tolist())

    def unknown(self) -> tuple[str, ...]:
        """Names of the parameters of frames and instruments that are left open."""
        problem, parameters = self.model.fit.problem, self.model.fit.problem.parameters
        index = np.flatnonzero(problem.referred & parameters.free)
        if not np.isfinite(self.covariance).all():
            return ()
        return tuple(
            parameters.names[k] for k in index[self._unknown(index, np.eye(len(index)))]
        )

    def _unknown(self, index: Indices, rows: Floats) -> NDArray[np.bool_]:
        """Which sums of some parameters, rows (k, len(index)), nobody knows, (k,)."""
        parts = (rows @ found[index] for found in self._left_open)
        nothing, little = (np.linalg.norm(part, axis=1) for part in parts)
        none = nothing > OPEN * np.linalg.norm(rows, axis=1)
        return np.asarray(none | (little > 1.0))

    @cached_property
    def covariance(self) -> Floats:
        """Of all parameters, averaged over the likely sizes of errors, (P, P)."""
        found = likely_posteriors(self.model.fit)
        return np.asarray(np.mean([one.covariance for one in found], axis=0))

    @cached_property
    def _left_open(self) -> tuple[Floats, Floats]:
        return left_open(self.model.fit, self.covariance)


def block_ranks(fitted: Fit) -> list[tuple[int, int]]:
    """Numbers of errors of the robot that blocks tell, of each alone and added.

    Those are added that the others do not tell without it. A direction counts as in a
    fit: by its standard deviation, see `directions.WEAK`. What only one block has, such
    as the frame of its station, it absorbs by itself; the rest of a block is a
    triangular factor.
    """
    problem, robot = fitted.problem, fitted.directions.robot
    if len(problem.blocks) == 1:
        return [(robot.shape[1], robot.shape[1])]
    parameters, further = problem.parameters, problem.further
    known = further.jacobian(fitted.theta)[: len(further) - further.priors]
    indices = [np.unique(block.part.index) for block in problem.blocks]
    used = np.bincount(np.concatenate(indices), minlength=len(parameters))
    used[known.any(axis=0)] += 2
    nuisances = parameters.free & parameters.nuisance
    shared = np.eye(len(parameters))[:, nuisances & (used > 1)]
    every = np.column_stack([shared, robot, fitted.directions.weak])
    share = max(LEAST, ROWS // len(problem.blocks))
    factors = [
        _factor(fitted, block, nuisances & (used == 1), every, share)
        for block in problem.blocks
    ]
    distances = known * parameters.scales @ every
    sigma0 = fitted.sigma0 if np.isfinite(fitted.sigma0) else 0.0

    def rank(*parts: Floats) -> int:
        A = np.concatenate([*parts, distances])
        U = column_space(A[:, : shared.shape[1]])
        rest = A[:, shared.shape[1] :]
        s = np.linalg.svd(rest - U @ (U.T @ rest), compute_uv=False)
        return int((s > max(sigma0 / WEAK, rounding(A) * np.linalg.norm(A, 2))).sum())

    whole, found = rank(*factors), []
    for k, own in enumerate(factors):
        others = (*factors[:k], *factors[k + 1 :])
        found.append((rank(own), whole - rank(*others)))
    return found


def _factor(
    fitted: Fit, block: Block, own: NDArray[np.bool_], every: Floats, count: int
) -> Floats:
    """Triangular factor of a block without what it absorbs by itself, (k, k).

    Args:
        fitted: The fit.
        block: The block.
        own: Parameters that a single block absorbs, shape (P,).
        every: Scaled directions that are looked at, shape (P, k).
        count: Number of measurements that stand for all.
    """
    problem, theta, part, data = fitted.problem, fitted.theta, block.part, block.data
    few = min(count, len(data))
    rows = np.linspace(0, len(data) - 1, few).astype(np.int64)
    sigma = block.table(problem.sigma)[rows]
    J = part.jacobian(theta[part.index], data.rows(rows), sigma)
    scales = problem.parameters.scales[part.index] * np.sqrt(len(data) / few)
    A = J.reshape(-1, J.shape[2]) * scales
    U = column_space(A[:, own[part.index]])
    columns = A @ every[part.index]
    return np.asarray(np.linalg.qr(columns - U @ (U.T @ columns), mode="r"))
