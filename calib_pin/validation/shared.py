"""A calibration by its stations, tools, chains and blocks of measurements."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.estimation.fit import FittedModel
from calib_pin.estimation.fitted import likely_posteriors
from calib_pin.estimation.system import FRAME, Part
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Indices
from calib_pin.parameterizations.linearization import ordered_screws
from calib_pin.validation.accuracy import QuantityErrors
from calib_pin.validation.block_ranks import block_ranks
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
        unknown=tuple(told.unknown()),
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
            free = problem.parameters.free[index]
            yield FrameSummary(
                name=frame.name,
                link=chain.tip if end else chain.base,
                measurements=self.count(keys),
                errors=self.errors(keys),
                noise=self.noise(keys),
                xyz=tuple(T.translation.tolist()),
                rpy=tuple(pin.rpy.matrixToRpy(T.rotation).tolist()),
                sigma=self._deviations(part, end, index, T),
                estimated=bool(free.any()),
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
                self.count(keys),
                self.errors(keys),
                tuple(joint for joint in chain.joints if joint in still),
            )

    def blocks(self) -> Iterator[BlockSummary]:
        """The blocks."""
        problem = self.model.fit.problem
        apart, ranks = ties(problem), block_ranks(self.model.fit)
        for (part, data, _, _), rank in zip(problem.blocks, ranks, strict=True):
            (station, _), (tool, _) = frames_of(part)
            yield BlockSummary(
                part.key.model,
                part.key.chain,
                station.name,
                tool.name,
                len(data),
                tuple(filter(None, data.target.distinct)),
                self.errors([part.key]),
                self.noise([part.key]),
                rank.alone,
                rank.added,
                apart[part.key],
            )

    def count(self, keys: Collection[BlockKey]) -> int:
        """Number of measurements of some blocks."""
        return sum(len(b) for b in self.model.fit.problem.data.blocks if b.key in keys)

    def errors(self, keys: Collection[BlockKey]) -> tuple[QuantityErrors, ...]:
        """Accuracy of the measurements of some blocks."""
        data = self.model.fit.problem.data
        own = np.array([block.key in keys for block in data.blocks])[data.block_of]
        known = self.every.at(own).counted(data.weight)
        return quantity_errors(self.model.problem.layout.quantities, known)

    def noise(self, keys: Collection[BlockKey]) -> tuple[VarianceComponent, ...]:
        """Variance components of some blocks."""
        fitted = self.model.fit
        own = {k for key in keys for k in fitted.problem.layout.of_keys[key].tolist()}
        return tuple(noise for k, noise in enumerate(fitted.noise) if k in own)

    def _deviations(
        self, part: Part, end: int, index: Indices, T: pin.SE3
    ) -> tuple[float, ...]:
        """Standard deviations of a frame, see `FrameSummary.sigma`."""
        fitted = self.model.fit
        covariance = self.covariance[np.ix_(index, index)]
        if not np.isfinite(covariance).all():
            return ()
        screws = part.error.screws[-FRAME:] if end else part.error.screws[:FRAME]
        twists, _ = ordered_screws(screws, fitted.theta[index], screws[0].frame + 1)
        motions = np.kron(np.eye(2), T.rotation) @ twists
        variances = np.einsum("ki,ij,kj->k", motions, covariance, motions)
        sigma = np.sqrt(np.maximum(variances, 0.0))
        sigma[sigma < ROUNDING] = 0.0
        sigma[self._unknown(index, motions)] = np.nan
        return tuple(sigma.tolist())

    def unknown(self) -> Iterator[str]:
        """Names of the parameters of frames and instruments that are left open."""
        problem, parameters = self.model.fit.problem, self.model.fit.problem.parameters
        index = np.flatnonzero(problem.referred & parameters.free)
        if np.isfinite(self.covariance).all():
            for k in index[self._unknown(index, np.eye(len(index)))]:
                yield parameters.names[k]

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
