"""A calibration by its stations, tools, chains and blocks of measurements."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.directions import (
    WEAK,
    column_space,
    rounding,
    visible_nuisances,
)
from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.estimation.fit import FittedModel
from calib_pin.estimation.fitted import Fit, likely_posteriors
from calib_pin.estimation.identifiability import Combination, combinations
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.terms import FRAME, Block, Term
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Indices
from calib_pin.parameterizations.linearization import ordered_screws
from calib_pin.validation.accuracy import QuantityErrors
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.findings.facts import still_joints
from calib_pin.validation.judgement import quantity_errors
from calib_pin.validation.model_errors import ModelErrors
from calib_pin.validation.result import (
    BlockSummary,
    Breakdown,
    ChainSummary,
    CoupledFrames,
    Frame,
    FrameSummary,
    ToolAccuracy,
    frames_of,
)

ROUNDING = 1e-12
"""Standard deviation below which a motion is given [m, rad]."""

ROWS, ENOUGH = 10_000, 60
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
        for key, term in problem.terms.items():
            found.setdefault(frames_of(term)[end][0], []).append(key)
        calibrated = CalibratedModel.create(self.model.problem, self.model.theta)
        for frame, keys in found.items():
            term, at = problem.terms[keys[0]], calibrated.of(keys[0])
            T, chain = (at.tool if end else at.error.base), term.error.chain
            _, index = frames_of(term)[end]
            screws = term.error.screws[-FRAME:] if end else term.error.screws[:FRAME]
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
            keys = [key for key in problem.terms if key.chain == name]
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
        for (term, data, _, _), of_block in zip(problem.blocks, ranks, strict=True):
            (station, _), (tool, _) = frames_of(term)
            yield BlockSummary(
                term.key.model,
                term.key.chain,
                station.name,
                tool.name,
                len(data),
                tuple(filter(None, data.target.distinct)),
                self._errors([term.key]),
                self._noise([term.key]),
                *of_block,
                apart[term.key],
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
    known = further.jacobian(fitted.theta)[: len(further) - len(further.priors)]
    indices = [np.unique(block.term.index) for block in problem.blocks]
    used = np.bincount(np.concatenate(indices), minlength=len(parameters))
    used[known.any(axis=0)] += 2
    nuisances = parameters.free & parameters.nuisance
    shared = np.eye(len(parameters))[:, nuisances & (used > 1)]
    every = np.column_stack([shared, robot, fitted.directions.weak])
    share = max(ENOUGH, ROWS // len(problem.blocks))
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
    problem, theta, term, data = fitted.problem, fitted.theta, block.term, block.data
    few = min(count, len(data))
    rows = np.linspace(0, len(data) - 1, few).astype(np.int64)
    sigma = block.table(problem.sigma)[rows]
    J = term.jacobian(theta, data.rows(rows), sigma)
    scales = problem.parameters.scales[term.index] * np.sqrt(len(data) / few)
    A = J.reshape(-1, J.shape[2]) * scales
    U = column_space(A[:, own[term.index]])
    columns = A @ every[term.index]
    return np.asarray(np.linalg.qr(columns - U @ (U.T @ columns), mode="r"))


LIMITS = {"m": 0.01, "rad": 0.01, "px": 10.0}
"""Standard deviations up to which a value of a frame or an instrument is known."""

FAR = 10.0
"""Times these from which a deviation says that nothing is known of its direction."""

OPEN = 1e-3
"""Part of a motion that measurements leave open from which it counts as unknown."""

SHARE = 0.05
"""Part of an unknown direction up to which a parameter hardly belongs to it."""

LEAST = 0.01
"""Least coefficient of a parameter that is told."""

UNKNOWNS = 400
"""Most parameters of stations, tools and instruments that are looked at."""

MOTIONS = {
    **{axis: f"shift along {axis}" for axis in "xyz"},
    **{f"r{axis}": f"turn about {axis}" for axis in "xyz"},
}
"""Parameters of a frame in words."""


def ties(problem: Problem) -> Mapping[BlockKey, tuple[tuple[str, ...], ...]]:
    """The groups into which frames fall apart without each block; empty for none.

    Blocks with a frame or a reference object in common hang together; what is known is
    one thing.
    """
    links = {key: list(_links(problem, term)) for key, term in problem.terms.items()}
    nodes = list(dict.fromkeys(node for found in links.values() for node in found))
    whole = len(_groups(nodes, links.values()))
    result = {}
    for key in links:
        groups = _groups(nodes, [found for k, found in links.items() if k != key])
        named = [
            tuple(f.name for f in group if f.kind in ("station", "tool"))
            for group in groups
            if {f.kind for f in group} & {"station", "tool"}
        ]
        torn = len(groups) > whole and len(named) > 1
        result[key] = tuple(named) if torn else ()
    return result


def _links(problem: Problem, term: Term) -> Iterator[Frame]:
    """Frames and reference objects of a part; those that are known are one."""
    free = problem.parameters.free
    for frame, index in frames_of(term):
        yield frame if free[index].any() else Frame("known", "")
    for reference in term.measurement.references:
        if reference.parameters:
            yield Frame(reference.section, term.frames.reference(reference))


def _groups(nodes: list[Frame], links: Iterable[list[Frame]]) -> list[list[Frame]]:
    """Connected components of a graph, in the order of its nodes."""
    groups = [{node} for node in nodes]
    for link in links:
        joined = [group for group in groups if not group.isdisjoint(link)]
        apart = [group for group in groups if group.isdisjoint(link)]
        groups = [*apart, set[Frame]().union(*joined)]
    order = {node: k for k, node in enumerate(nodes)}.__getitem__
    in_order = [sorted(group, key=order) for group in groups]
    return sorted(in_order, key=lambda group: order(group[0]))


def left_open(fitted: Fit, covariance: Floats) -> tuple[Floats, Floats]:
    """Directions of frames and instruments that measurements leave open.

    Args:
        fitted: The fit.
        covariance: Of its parameters, shape (P, P).

    Returns:
        Those that nothing shows, orthonormal in scaled parameters, shape (P, k); and
        deviations of others that are hardly known, by `LIMITS`, shape (P, l).
    """
    problem, parameters = fitted.problem, fitted.problem.parameters
    kept = parameters.free & problem.referred
    for eliminated in problem.own_of_stations.values():
        kept[eliminated] = False
    free = np.flatnonzero(kept)
    visible = visible_nuisances(fitted.result.jac, parameters)[free]
    rest = np.linalg.qr(visible, mode="complete")[0][:, visible.shape[1] :]
    limits = np.array([LIMITS.get(p.unit, np.inf) for p in parameters])
    relative = np.nan_to_num(covariance) / np.outer(limits, limits)
    # No other parameter can be beyond its limit.
    index = free[np.diag(relative)[free] > 1.0]
    squares, V = np.linalg.eigh(relative[np.ix_(index, index)])
    far = squares > FAR**2
    nothing = np.zeros((len(parameters), rest.shape[1]))
    little = np.zeros((len(parameters), int(far.sum())))
    nothing[free], little[index] = rest, V[:, far] * np.sqrt(squares[far])
    return nothing, little


def coupled_frames(
    fitted: Fit, covariance: Floats | None = None
) -> tuple[CoupledFrames, ...]:
    """Frames that the measurements cannot tell apart.

    Linear combinations of the parameters of stations, tools and instruments that are
    known while their terms are not, as far as they are of several frames.

    Args:
        fitted: The fit.
        covariance: Of its parameters, shape (P, P); default that of the fit.
    """
    problem, parameters = fitted.problem, fitted.problem.parameters
    given = fitted.covariance if covariance is None else covariance
    nothing, little = left_open(fitted, given)
    limits = np.array([LIMITS.get(p.unit, 0.0) for p in parameters])
    scaled = little * (limits / parameters.scales)[:, None]
    unknown = np.column_stack([nothing, scaled / np.linalg.norm(scaled, axis=0)])
    nuisances = np.flatnonzero(np.abs(unknown).max(axis=1, initial=0.0) > SHARE)
    if not 0 < len(nuisances) <= UNKNOWNS:
        return ()
    # Known are the sums along which nothing unknown lies.
    count = unknown.shape[1]
    Q, _ = np.linalg.qr(unknown[nuisances], mode="complete")
    pivots, C = combinations(Q[:, count:].T, len(nuisances) - count)
    frame_of = {
        int(k): frame
        for term in problem.terms.values()
        for frame, index in frames_of(term)
        for k in index
    }
    found = []
    scales, names = parameters.scales[nuisances], parameters.names
    for row, pivot in zip(C, pivots, strict=True):
        coefficients = (row * scales[pivot] / scales).tolist()
        pairs = zip(nuisances.tolist(), coefficients, strict=True)
        terms = tuple((k, c) for k, c in pairs if abs(c) > LEAST)
        frames = dict.fromkeys(frame_of[k] for k, _ in terms if k in frame_of)
        if len(frames) < 2:
            continue
        unit = parameters[int(nuisances[pivot])].unit
        known = Combination(terms, unit).expression(names)
        moves = []
        for frame in frames:
            own = (names[k] for k, _ in terms if frame_of.get(k) == frame)
            words = [MOTIONS[name.rpartition(".")[2]] for name in own]
            moves.append(f"a {' and a '.join(words)} of {frame.label}")
        sentence = f"{' cannot be told from '.join(moves)}; only {known} is known"
        found.append(CoupledFrames(tuple(f.name for f in frames), known, sentence))
    return tuple(found)
