"""Error parameters in the directions that people think in.

A person does not think of an error of a joint along x of its frame, but of the zero of
the joint, of the length and twist of the link before it, of the offset along its axis
(Denavit and Hartenberg), and of a tilt that these cannot express (Hayati). Here the
translations and rotations of every joint are turned into these directions: along the
common normal of its axis and the one before, along the axis, and across both.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from calib_pin.estimation.terms import FRAME, Terms
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats, invert, skew
from calib_pin.parameterizations.base import Screw
from calib_pin.parameters import ParameterSet

KINDS = (
    *("joint offset", "link length", "link offset", "link twist"),
    *("axis tilt", "axis shift"),
)
"""Kinds of geometric errors, those that describe a robot best first."""

PARALLEL = 0.02
"""Sine of the angle below which two axes count as parallel."""

NEAR = 1e-4
"""Distance below which two lines count as one [m]."""


@dataclass(frozen=True)
class Label:
    """An error as a person names it.

    Attributes:
        kind: One of `KINDS`, or what a joint correction belongs to, such as
            `transmission`, or is, `backlash`.
        of: Name of the joint; of the link for its length and twist.
    """

    kind: str
    of: str


@dataclass(frozen=True)
class Columns:
    """Robot parameters turned into named directions.

    Attributes:
        turned: Orthogonal matrix B of all parameters, shape (P, P): values in the named
            directions are `B^T theta`.
        labels: Label of each direction, by its position.
        order: Positions of these directions in the order of elimination: those that
            describe a robot best first, from base to tip.
    """

    turned: Floats
    labels: dict[int, Label]
    order: tuple[int, ...]


@dataclass(frozen=True)
class _Place:
    """A joint between its axis and the one before, in its own frame.

    Attributes:
        joint: Its name; empty for the tip.
        revolute: Whether it turns.
        axis: Its axis, shape (3,); None for the tip.
        before: Name of the joint before; empty for the first.
        turned_before: Whether that one turns.
        line: Point and direction of the axis before.
        link: Link between both.
    """

    joint: str
    revolute: bool
    axis: Floats | None
    before: str
    turned_before: bool
    line: tuple[Floats, Floats]
    link: str

    def directions(self, axis: Floats) -> tuple[Floats, Floats, Floats]:
        """Common normal, direction across it, and axis; a right-handed frame."""
        point, other = self.line
        # From the axis before to the own one, which passes through the origin.
        apart = -point if self.axis is not None else point
        normal = skew(other) @ (self.axis if self.axis is not None else axis)
        if np.linalg.norm(normal) < PARALLEL:
            normal = apart - (apart @ axis) * axis
            if np.linalg.norm(normal) < NEAR:
                first = np.eye(3)[int(np.argmin(np.abs(axis)))]
                normal = first - (first @ axis) * axis
        elif normal @ apart < -NEAR * np.linalg.norm(normal):
            normal = -normal
        normal = normal - (normal @ axis) * axis
        normal = normal / np.linalg.norm(normal)
        return normal, skew(axis) @ normal, axis


def geometric_columns(system: Terms, parameters: ParameterSet) -> Columns:
    """The directions of all robot parameters of a system.

    Args:
        system: The robot and how it is measured.
        parameters: Its parameters; those that are not free keep their directions.
    """
    count = len(parameters)
    turned, labels = np.eye(count), dict[int, Label]()
    ranked = dict[int, tuple[int, int]]()
    for term in system.terms.values():
        chain = term.error.chain
        places = _places(chain)
        together = defaultdict[tuple[int, str], list[tuple[int, Screw]]](list)
        inner = slice(FRAME, len(term.error.screws) - FRAME)
        for position, screw in zip(
            term.index[inner].tolist(), term.error.screws[inner], strict=True
        ):
            stem = screw.parameter.name.rpartition(".")[0]
            own = parameters[position]
            if own.free and not own.nuisance and position not in labels:
                together[screw.frame, stem].append((position, screw))
                labels[position] = Label(*_beyond(screw))
        for (frame, _), entries in together.items():
            geometric = [(k, s) for k, s in entries if s.basis is None]
            positions = [k for k, _ in geometric]
            twists = np.array([s.twist for _, s in geometric]).reshape(-1, 6)
            block = _aligned(twists, parameters.scales[positions], places[frame - 1])
            turned[np.ix_(positions, positions)] = block
            for k, twist in zip(positions, block.T @ twists, strict=True):
                labels[k] = _named(twist, places[frame - 1])
            for k, _ in entries:
                ranked.setdefault(k, (_urgency(labels[k].kind), len(ranked)))
    return Columns(turned, labels, tuple(sorted(ranked, key=ranked.__getitem__)))


def _urgency(kind: str) -> int:
    """Elimination takes what describes links and joints first, then the rest."""
    return max((*KINDS, kind).index(kind) - KINDS.index("link twist"), 0)


def _beyond(screw: Screw) -> tuple[str, str]:
    """Kind and owner of a joint correction, by its name."""
    owner, kind, component = screw.parameter.name.rsplit(".", 2)
    joint = owner.removeprefix("joint:")
    if kind == "hysteresis":
        return component, joint  # Its component says what it is.
    return kind, f"{joint} {component}"


def _places(chain: Chain) -> Sequence[_Place]:
    """The joints of a chain and, last, its tip."""
    zero = np.zeros((1, len(chain.joints)))
    frames = [np.eye(4), *chain.joint_frames(), chain.poses(zero)[0]]
    axes = [np.array([0.0, 0.0, 1.0]), *chain.axes, None]
    joints = "", *chain.joints, ""
    revolute = False, *map(bool, chain.revolute), False
    links = [chain.base, *(_moved_link(chain, joint) for joint in chain.joints)]
    found = []
    for k in range(1, len(frames)):
        before = invert(frames[k]) @ frames[k - 1]
        line = before[:3, 3], before[:3, :3] @ axes[k - 1]
        here = joints[k], revolute[k], axes[k]
        found.append(_Place(*here, joints[k - 1], revolute[k - 1], line, links[k - 1]))
    return found


def _moved_link(chain: Chain, joint: str) -> str:
    """The first link that a joint moves."""
    model = chain.robot.model
    index = model.getJointId(joint)
    bodies = (f.name for f in model.frames if f.parentJoint == index)
    names = (name.rpartition(":")[2] for name in bodies)
    return next((name for name in names if name in chain.robot.links), joint)


def _aligned(twists: Floats, scales: Floats, place: _Place) -> Floats:
    """Orthogonal matrix that turns screws of one frame into named directions.

    Only of full triples of translations or of rotations about one point; others keep
    their directions.
    """
    result = np.eye(len(twists))
    shifts = np.flatnonzero(np.linalg.norm(twists[:, 3:], axis=1) < 1e-9)
    turns = np.flatnonzero(np.linalg.norm(twists[:, 3:], axis=1) > 0.5)
    axis = place.axis
    moments = np.linalg.norm(twists[turns, :3], axis=1).max(initial=0.0)
    # Rotations about the frame before are errors of the link behind its axis.
    if axis is None or (len(turns) == 3 and moments > NEAR):
        axis = place.line[1]
    towards = np.array(place.directions(axis)).T
    for rows, own in ((shifts, slice(0, 3)), (turns, slice(3, 6))):
        given = twists[rows, own]
        alike = len(rows) == 3 and np.ptp(scales[rows]) == 0.0
        if alike and np.allclose(given @ given.T, np.eye(3), atol=1e-9):
            result[np.ix_(rows, rows)] = given @ towards
    return result


def _named(twist: Floats, place: _Place) -> Label:
    """The kind of an error by its screw, in the frame of the joint."""
    shift, turn = twist[:3], twist[3:]
    turning = bool(np.linalg.norm(turn) > 1e-9)
    direction = turn if turning else shift
    direction = direction / np.linalg.norm(direction)
    point = skew(turn) @ shift / (turn @ turn) if turning else np.zeros(3)
    origin, other = place.line
    own = place.axis is not None and _along(direction, place.axis)
    axial = "axis tilt" if turning else "link offset"
    if own and (not turning or _distance(point, direction) < NEAR):
        free = turning == place.revolute
        return Label("joint offset" if free else axial, place.joint)
    through = not turning or _distance(point - origin, direction) < NEAR
    if place.before and through and _along(direction, other):
        free = turning == place.turned_before
        return Label("joint offset" if free else axial, place.before)
    joint = place.joint or "tip"
    normal = place.directions(other if place.axis is None else place.axis)[0]
    if place.before and _along(direction, normal):
        return Label("link twist" if turning else "link length", place.link)
    return Label("axis tilt" if turning else "axis shift", joint)


def _along(direction: Floats, other: Floats) -> bool:
    return bool(abs(direction @ other) > 1.0 - 1e-4)


def _distance(point: Floats, direction: Floats) -> float:
    return float(np.linalg.norm(point - (point @ direction) * direction))
