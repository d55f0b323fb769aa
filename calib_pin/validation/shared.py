"""A calibration by its stations, tools, chains and blocks of measurements."""

from __future__ import annotations

from collections.abc import Collection, Iterable, Iterator, Mapping

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.evidence import VarianceComponent
from calib_pin.estimation.fit import FittedModel
from calib_pin.estimation.fitted import Fit, likely_posteriors
from calib_pin.estimation.identifiability import (
    WEAK,
    Combination,
    column_space,
    combinations,
    rounding,
    visible_nuisances,
)
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.terms import FRAME, Block, Term
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Indices
from calib_pin.parameterizations.linearization import ordered_screws
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
    QuantityErrors,
    ToolAccuracy,
    frames_of,
)

ROWS, ENOUGH = 10_000, 60
"""Measurements that ranks look at: of all blocks, and least of each."""

LIMITS = {"m": 0.01, "rad": 0.01, "px": 10.0}
"""Standard deviations up to which a value of a frame or an instrument is known."""

FAR = 10.0
"""Times these from which a deviation says that nothing is known of its direction."""

SHARE = 0.05
"""Part of an unknown direction up to which a parameter hardly belongs to it."""

UNKNOWNS = 400
"""Most parameters of stations, tools and instruments that are looked at."""

MOTIONS = {
    **{axis: f"shift along {axis}" for axis in "xyz"},
    **{f"r{axis}": f"turn about {axis}" for axis in "xyz"},
}
"""Parameters of a frame in words."""


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


class _Parts:
    """The parts of a fitted model with the errors of the measurements.

    Attributes:
        covariance: Of all parameters, averaged over the likely sizes of errors, shape
            (P, P).
        open: The directions that are left open, see `left_open`.
    """

    def __init__(self, model: FittedModel, errors: ModelErrors) -> None:
        """Of a model, and the errors of all measurements that it was fitted to."""
        self.model, self.errors, self.fit = model, errors, model.fit
        self.problem = model.fit.problem
        likely = [one.covariance for one in likely_posteriors(model.fit)]
        self.covariance: Floats = np.mean(likely, axis=0)
        self.known = bool(np.isfinite(self.covariance).all())
        self.open = left_open(model.fit, self.covariance)

    def frames(self, end: int) -> Iterator[FrameSummary]:
        """The stations, end 0, or the tools, end 1."""
        found: dict[Frame, list[BlockKey]] = {}
        for key, term in self.problem.terms.items():
            found.setdefault(frames_of(term)[end][0], []).append(key)
        calibrated = CalibratedModel.create(self.model.problem, self.model.theta)
        for frame, keys in found.items():
            term, at = self.problem.terms[keys[0]], calibrated.of(keys[0])
            T, chain = (at.tool if end else at.error.base), term.error.chain
            _, index = frames_of(term)[end]
            screws = term.error.screws[-FRAME:] if end else term.error.screws[:FRAME]
            theta = self.fit.theta[index]
            twists, _ = ordered_screws(screws, theta, screws[0].frame + 1)
            yield FrameSummary(
                frame.name,
                chain.tip if end else chain.base,
                *self._of(keys),
                xyz=tuple(T.translation.tolist()),
                rpy=tuple(pin.rpy.matrixToRpy(T.rotation).tolist()),
                sigma=self._deviations(index, np.kron(np.eye(2), T.rotation) @ twists),
                estimated=bool(self.problem.parameters.free[index].any()),
            )

    def chains(self) -> Iterator[ChainSummary]:
        """The chains."""
        still = set(still_joints(self.problem))
        for name in self.problem.chains.names:
            chain = self.problem.chains[name]
            count, errors, _ = self._of([k for k in self.problem.terms if k[1] == name])
            own = tuple(joint for joint in chain.joints if joint in still)
            ends = name, chain.base, chain.tip, chain.joints
            yield ChainSummary(*ends, count, errors, own)

    def blocks(self) -> Iterator[BlockSummary]:
        """The blocks."""
        apart, ranks = ties(self.problem), block_ranks(self.fit)
        for (term, data, _, _), of_block in zip(
            self.problem.blocks, ranks, strict=True
        ):
            (station, _), (tool, _) = frames_of(term)
            names = term.key.model, term.key.chain, station.name, tool.name
            count, errors, noise = self._of([term.key])
            targets = tuple(filter(None, data.target.distinct))
            known = *names, count, targets, errors, noise, *of_block, apart[term.key]
            yield BlockSummary(*known)

    def _of(
        self, keys: Collection[BlockKey]
    ) -> tuple[int, tuple[QuantityErrors, ...], tuple[VarianceComponent, ...]]:
        """Number of measurements of some blocks, their accuracy, and noise."""
        data, layout = self.problem.data, self.problem.layout
        own = np.array([block.key in keys for block in data.blocks])[data.block_of]
        known = self.errors.at(own).counted(data.weight)
        errors = quantity_errors(self.model.problem.layout.quantities, known)
        kinds = {k for key in keys for k in layout.of_keys[key].tolist()}
        noise = tuple(one for k, one in enumerate(self.fit.noise) if k in kinds)
        return int(own.sum()), errors, noise

    def _deviations(self, index: Indices, motions: Floats) -> tuple[float, ...]:
        """Standard deviations of a frame along some motions, (6, 6)."""
        if not np.isfinite(covariance := self.covariance[np.ix_(index, index)]).all():
            return ()
        variances = np.einsum("ki,ij,kj->k", motions, covariance, motions)
        sigma = np.sqrt(np.maximum(variances, 0.0))
        sigma[sigma < 1e-12] = 0.0  # Rounding: it is given.
        sigma[self._unknown(index, motions)] = np.nan
        return tuple(sigma.tolist())

    def unknown(self) -> tuple[str, ...]:
        """Names of the parameters of frames and instruments that are left open."""
        parameters = self.problem.parameters
        index = np.flatnonzero(self.problem.referred & parameters.free & self.known)
        open_ = index[self._unknown(index, np.eye(len(index)))]
        return tuple(parameters.names[k] for k in open_)

    def _unknown(self, index: Indices, rows: Floats) -> NDArray[np.bool_]:
        """Which sums of some parameters, rows (k, len(index)), nobody knows, (k,)."""
        parts = (rows @ found[index] for found in self.open)
        nothing, little = (np.linalg.norm(part, axis=1) for part in parts)
        # A thousandth of a motion that nothing shows.
        none = nothing > 1e-3 * np.linalg.norm(rows, axis=1)
        return np.asarray(none | (little > 1.0))


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
    distances = known * parameters.scales @ every
    sigma0 = fitted.sigma0 if np.isfinite(fitted.sigma0) else 0.0

    def factor(block: Block) -> Floats:
        """Triangular factor of a block without what it absorbs by itself, (k, k)."""
        index, count = block.term.index, len(block.data)
        few = min(max(ENOUGH, ROWS // len(problem.blocks)), count)
        rows = np.linspace(0, count - 1, few).astype(np.int64)
        sigma = block.table(problem.sigma)[rows]
        J = block.term.jacobian(fitted.theta, block.data.rows(rows), sigma)
        scales = parameters.scales[index] * np.sqrt(count / few)
        A = J.reshape(-1, J.shape[2]) * scales
        U = column_space(A[:, (nuisances & (used == 1))[index]])
        columns = A @ every[index]
        return np.asarray(np.linalg.qr(columns - U @ (U.T @ columns), mode="r"))

    def rank(parts: list[Floats]) -> int:
        A = np.concatenate([*parts, distances])
        U = column_space(A[:, : shared.shape[1]])
        rest = A[:, shared.shape[1] :]
        s = np.linalg.svd(rest - U @ (U.T @ rest), compute_uv=False)
        return int((s > max(sigma0 / WEAK, rounding(A) * np.linalg.norm(A, 2))).sum())

    factors = [*map(factor, problem.blocks)]
    whole = rank(factors)
    return [
        (rank([own]), whole - rank([*factors[:k], *factors[k + 1 :]]))
        for k, own in enumerate(factors)
    ]


def ties(problem: Problem) -> Mapping[BlockKey, tuple[tuple[str, ...], ...]]:
    """The groups into which frames fall apart without each block; empty for none.

    Blocks with a frame or a reference object in common hang together; what is known is
    one thing.
    """
    links = {key: [*_links(problem, term)] for key, term in problem.terms.items()}
    nodes = dict.fromkeys(node for own in links.values() for node in own)
    alone, result = [[node] for node in nodes], {}
    whole = len(_groups([*alone, *links.values()]))
    for key in links:
        groups = _groups([*alone, *(own for k, own in links.items() if k != key)])
        frames = ([f for f in own if f.kind in ("station", "tool")] for own in groups)
        named = tuple(tuple(f.name for f in own) for own in frames if own)
        torn = len(groups) > whole and len(named) > 1
        result[key] = named if torn else ()
    return result


def _links(problem: Problem, term: Term) -> Iterator[Frame]:
    """Frames and reference objects of a part; those that are known are one."""
    free = problem.parameters.free
    for frame, index in frames_of(term):
        yield frame if free[index].any() else Frame("known", "")
    for reference in term.measurement.references:
        if reference.parameters:
            yield Frame(reference.section, term.frames.reference(reference))


def _groups(links: Iterable[list[Frame]]) -> list[list[Frame]]:
    """Connected components of a graph, in the order in which its nodes come first."""
    of, groups = dict[Frame, int](), dict[int, list[Frame]]()
    for link in links:
        joined = {of.setdefault(node, len(of)) for node in link}
        of = {node: min(joined) if k in joined else k for node, k in of.items()}
    for node, k in of.items():
        groups.setdefault(k, []).append(node)
    return list(groups.values())


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


def coupled_frames(fitted: Fit, covariance: Floats) -> tuple[CoupledFrames, ...]:
    """Frames that the measurements cannot tell apart.

    Linear combinations of the parameters of stations, tools and instruments that are
    known while their terms are not, as far as they are of several frames.

    Args:
        fitted: The fit.
        covariance: Of its parameters, shape (P, P).
    """
    problem, parameters = fitted.problem, fitted.problem.parameters
    nothing, little = left_open(fitted, covariance)
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
        terms = tuple((k, c) for k, c in pairs if abs(c) > 0.01)
        moves = dict[Frame, list[str]]()
        for k in (k for k, _ in terms if k in frame_of):
            words = MOTIONS[names[k].rpartition(".")[2]]
            moves.setdefault(frame_of[k], []).append(f"a {words}")
        if len(moves) < 2:
            continue
        unit = parameters[int(nuisances[pivot])].unit
        known = Combination(terms, unit).expression(names)
        said = (f"{' and '.join(own)} of {at.label}" for at, own in moves.items())
        sentence = f"{' cannot be told from '.join(said)}; only {known} is known"
        found.append(CoupledFrames(tuple(f.name for f in moves), known, sentence))
    return tuple(found)
