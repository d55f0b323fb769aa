"""Frames of stations and tools: which hang together, and which cannot be told apart."""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from typing import NamedTuple

import numpy as np

from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.identifiability import Combination, combinations
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.system import FRAME, Part
from calib_pin.observations import BlockKey, Indices
from calib_pin.validation.breakdown import CoupledFrames

UNTOLD = 0.01
"""Standard deviation from which a motion of a frame counts as unknown [m, rad]."""

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
        named = (
            tuple(f.name for f in group if f.kind in ("station", "tool"))
            for group in groups
        )
        told = tuple(filter(None, named))
        result[key] = told if len(groups) > whole and len(told) > 1 else ()
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
    groups = {node: [node] for node in nodes}
    for first, *others in links:
        for node in others:
            if (found := groups[node]) is not (whole := groups[first]):
                whole += found
                groups |= dict.fromkeys(found, whole)
    order = {node: k for k, node in enumerate(nodes)}
    different = {id(group): group for group in groups.values()}.values()
    return [sorted(group, key=order.__getitem__) for group in different]


def coupled_frames(fitted: Fit) -> tuple[CoupledFrames, ...]:
    """Frames that the measurements cannot tell apart, were the robot known.

    Linear combinations of the parameters of stations, tools and instruments that are
    known while their terms are not, as far as they are of several frames.
    """
    problem, parameters = fitted.problem, fitted.problem.parameters
    nuisances = np.flatnonzero(parameters.free & problem.referred)
    if not 0 < len(nuisances) <= UNKNOWNS or problem.own_of_stations:
        return ()
    A = (fitted.result.jac * parameters.scales)[:, nuisances]
    _, s, Vt = np.linalg.svd(np.linalg.qr(A, mode="r"), full_matrices=False)
    sigma0 = fitted.sigma0 if np.isfinite(fitted.sigma0) else 0.0
    told = s > max(sigma0 / UNTOLD, 1e-12 * s.max(initial=0.0))
    pivots, C = combinations(s[told, None] * Vt[told], int(told.sum()))
    frame_of = {
        int(k): frame
        for part in problem.parts.values()
        for frame, index in frames_of(part)
        for k in index
    }
    found = []
    for row, pivot in zip(C, pivots, strict=True):
        coefficients = row * parameters.scales[nuisances[pivot]]
        coefficients = coefficients / parameters.scales[nuisances]
        terms = tuple(
            (int(k), float(c))
            for k, c in zip(nuisances, coefficients, strict=True)
            if abs(c) > LEAST
        )
        frames = dict.fromkeys(frame_of[k] for k, _ in terms if k in frame_of)
        if len(frames) > 1:
            unit = parameters[int(nuisances[pivot])].unit
            known = Combination(terms, unit).expression(parameters.names)
            moves = []
            for frame in frames:
                own = [
                    parameters.names[k] for k, _ in terms if frame_of.get(k) == frame
                ]
                words = [MOTIONS[name.rpartition(".")[2]] for name in own]
                moves.append(f"a {' and a '.join(words)} of {frame.label}")
            sentence = f"{' cannot be told from '.join(moves)}; only {known} is known"
            names = tuple(frame.name for frame in frames)
            found.append(CoupledFrames(names, known, sentence))
    return tuple(found)
