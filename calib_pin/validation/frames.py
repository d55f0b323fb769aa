"""Frames of stations and tools: which hang together, and which cannot be told apart."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from calib_pin.estimation.directions import visible_nuisances
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.identifiability import Combination, combinations
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.system import FRAME, Part
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Indices
from calib_pin.validation.breakdown import CoupledFrames

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


class Frame(NamedTuple):
    """A frame of a part, or something else that several parts may have.

    Attributes:
        kind: `station`, `tool`, or the section of a reference object.
        name: Name among the parameters; `base` or `tool` for the only one.
    """

    kind: str
    name: str

    @property
    def label(self) -> str:
        """Name in a sentence."""
        alone = self.name in ("base", "tool")
        return f"the {self.name}" if alone else f"the {self.kind} '{self.name}'"


def frames_of(part: Part) -> tuple[tuple[Frame, Indices], tuple[Frame, Indices]]:
    """Station and tool of a part, with the positions of their parameters, (6,)."""
    scope, count = part.scope, len(part.error.screws)
    tool = scope.tool.rpartition(".")[0]
    if not scope.offset.isIdentity():
        tool = part.key.tool
    return (
        (Frame("station", scope.station.rpartition(".")[0]), part.index[:FRAME]),
        (Frame("tool", tool), part.index[count - FRAME : count]),
    )


def ties(problem: Problem) -> Mapping[BlockKey, tuple[tuple[str, ...], ...]]:
    """The groups into which frames fall apart without each block; empty for none.

    Blocks with a frame or a reference object in common hang together; what is known is
    one thing.
    """
    links = {key: list(_links(problem, part)) for key, part in problem.parts.items()}
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


def _links(problem: Problem, part: Part) -> Iterator[Frame]:
    """Frames and reference objects of a part; those that are known are one."""
    free = problem.parameters.free
    for frame, index in frames_of(part):
        yield frame if free[index].any() else Frame("known", "")
    for reference in part.measurement.references:
        if reference.parameters:
            yield Frame(reference.section, part.scope.reference(reference))


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
        for part in problem.parts.values()
        for frame, index in frames_of(part)
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
