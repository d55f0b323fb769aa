"""Which error parameters can be known, and how people call them.

Everything here works on identification Jacobians whose columns are multiplied by the
scale of their parameter. Columns are never divided by their norm: a column that is
zero but for rounding would come out as good as any other.

Two ranks are kept apart. The *structural* rank belongs to the robot and the way it is
measured: the Jacobian at zero errors over many random configurations, decided near
machine precision. The *practical* rank belongs to these measurements: a direction
counts if its posterior standard deviation is below `WEAK` times its scale.

A person does not think of an error of a joint along x of its frame, but of the zero of
the joint, of the length and twist of the link before it, of the offset along its axis
(Denavit and Hartenberg), and of a tilt that these cannot express (Hayati). Here the
translations and rotations of every joint are turned into these directions: along the
common normal of its axis and the one before, along the axis, and across both.

A redundant model has directions that nothing can see, and real measurements leave some
more that they can hardly tell. Moving them would shift links by centimeters for nothing
in return, so they stay at nominal.
"""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass, field
from functools import cached_property
from typing import NamedTuple

import numpy as np

from calib_pin.estimation.terms import FRAME, Terms
from calib_pin.kinematics.chain import Chain
from calib_pin.kinematics.spatial import Floats, invert, skew
from calib_pin.parameterizations.base import Screw, expected_size
from calib_pin.parameters import ParameterSet

CRUMB = 1e-6
"""Ratio to the heaviest term of a sum below which a term is rounding."""


@dataclass(frozen=True)
class Combination:
    """A sum of parameters that is identifiable while its terms may not be.

    Attributes:
        terms: Position of each parameter and its coefficient, 1 for the first that
            matters.
        unit: Unit of the sum, that of this term.
    """

    terms: tuple[tuple[int, float], ...]
    unit: str

    def row(self, size: int) -> Floats:
        """Coefficients as a vector, shape (size,)."""
        result = np.zeros(size)
        for position, coefficient in self.terms:
            result[position] = coefficient
        return result

    def expression(self, names: tuple[str, ...]) -> str:
        """The sum as a formula with numeric coefficients."""
        text = ""
        for position, coefficient in self.terms:
            size = f"{abs(coefficient):.4g}"
            sign = " - " if coefficient < 0.0 else " + "
            text += sign + ("" if size == "1" else f"{size} ") + names[position]
        return text[3:] if text.startswith(" + ") else f"-{text[3:]}"


@dataclass(frozen=True)
class Structure:
    """Structural identifiability of a robot that is measured in one way.

    Attributes:
        singular_values: Of the scaled structural Jacobian, descending.
        rank: Number of singular values above rounding.
        robot: Singular values of the robot's directions with the nuisances projected
            out, descending.
        configurations: Number of configurations they belong to.
        relations: Rows S V^T of the rank: they carry the same relations between
            columns as the scaled structural Jacobian, without its noise; shape (rank,
            free parameters).
        parameters: The parameters.
        scaled: Whether measurements tell how large the robot is.
        alike: Parameters of stations that were left out, with those of one like them.
    """

    singular_values: Floats
    rank: int
    robot: Floats
    configurations: int
    relations: Floats
    parameters: ParameterSet
    scaled: bool = True
    equivalent: Mapping[int, int] = field(default_factory=dict)

    @property
    def gap(self) -> float:
        """Ratio of the last singular value kept to the first one dropped."""
        s, r = self.singular_values, self.rank
        return float(s[r - 1] / s[r]) if 0 < r < len(s) and s[r] > 0.0 else np.inf

    @cached_property
    def combinations(self) -> tuple[Combination, ...]:
        """The identifiable combinations, one per rank, in order."""
        parameters = self.parameters
        free, of_free = parameters.free, np.cumsum(parameters.free) - 1
        order = np.array([k for k in parameters.eliminated if free[k]], np.int64)
        _, C = combinations(self.relations[:, of_free[order]], self.rank)
        ordered = [parameters[k] for k in order.tolist()]
        # The scale of a frame is that of an unknown stand, not of an error.
        sizes = [expected_size(p.unit) if p.nuisance else p.scale for p in ordered]
        result = []
        for row in C / parameters.scales[order]:
            weights = np.abs(row) * sizes
            kept = np.flatnonzero(weights > CRUMB * weights.max())
            # The first term that matters has the coefficient 1.
            lead = int(kept[0])
            values = (row[kept] / row[lead]).tolist()
            terms = tuple(zip(order[kept].tolist(), values, strict=True))
            result.append(Combination(terms, ordered[lead].unit))
        return tuple(result)

    @cached_property
    def unidentifiable(self) -> tuple[int, ...]:
        """Positions of the free parameters without any effect."""
        used = {k for combination in self.combinations for k, _ in combination.terms}
        free = np.flatnonzero(self.parameters.free)
        return tuple(int(k) for k in free if k not in used)


def structure(
    J: Floats, parameters: ParameterSet, configurations: int = 1
) -> Structure:
    """Analyze a structural Jacobian.

    Args:
        J: Jacobian at zero errors over many random configurations, shape (M, P).
        parameters: The parameters; columns of fixed ones are ignored.
        configurations: Number of configurations that J belongs to.
    """
    free = parameters.free
    A = J[:, free] * parameters.scales[free]
    # The triangular factor has the same singular values and row space.
    _, s, Vt = np.linalg.svd(np.linalg.qr(A, mode="r"), full_matrices=False)
    tolerance = rounding(A) * (s[0] if len(s) else 0.0)
    rank = int((s > tolerance).sum())
    robot, relations = _visible(J, parameters)[0], s[:rank, None] * Vt[:rank]
    return Structure(s, rank, robot, configurations, relations, parameters)


def combinations(A: Floats, rank: int) -> tuple[list[int], Floats]:
    """Independent columns in their given order and how the others follow from them.

    Elimination without pivoting: a column that depends on columns before it is folded
    into them, and one that nearly does unless the rank needs it. The order is the
    reader's, so the sums are predictable; pivoting would pick other columns at every
    change of a number.

    Args:
        A: Matrix of full row rank, shape (r, P).
        rank: Its rank r.

    Returns:
        Positions of the r independent columns, and C, shape (r, P), with
        `A = A[:, pivots] @ C`.
    """
    norms = np.linalg.norm(A, axis=0)
    absent = norms <= 1e-11 * norms.max(initial=0.0)
    pivots: list[int] = []
    basis = np.empty((len(A), len(A)), order="F")
    # Columns that are clearly independent first: rounded angles in a URDF leave a
    # dependent one 1e-6 of its length, and sums about such a column are all alike.
    for threshold in (1e-3, 1e-5, 1e-7, 1e-9, 1e-10):
        for k in np.flatnonzero(~absent):
            if len(pivots) == min(rank, len(A)):
                break
            Q = basis[:, : len(pivots)]
            rest = A[:, k] - Q @ (Q.T @ A[:, k])
            rest -= Q @ (Q.T @ rest)
            length = np.linalg.norm(rest)
            if length > threshold * norms[k]:
                basis[:, len(pivots)] = rest / length
                pivots.append(int(k))
    pivots.sort()
    C = np.zeros((0, A.shape[1]))
    if pivots:
        C = np.asarray(np.linalg.lstsq(A[:, pivots], A, rcond=None)[0])
    C[:, absent] = 0.0
    return pivots, C


def observability(s: Floats, count: int) -> dict[str, float]:
    """Observability indices of singular values s_1 >= ... >= s_m > 0.

    O1 (Borm, Menq), O2 (Driels, Pathre), O3 (Nahvi et al.), O4 (Nahvi, Hollerbach),
    O5 (Sun, Hollerbach).

    Args:
        s: Singular values of the scaled identification Jacobian, shape (m,).
        count: Number of measurements n.
    """
    if len(s) == 0 or s[-1] <= 0.0:
        return dict.fromkeys(("O1", "O2", "O3", "O4", "O5"), 0.0)
    return {
        "O1": float(np.exp(np.mean(np.log(s))) / np.sqrt(count)),
        "O2": float(s[-1] / s[0]),
        "O3": float(s[-1]),
        "O4": float(s[-1] ** 2 / s[0]),
        "O5": float(1.0 / np.sum(1.0 / s)),
    }


KINDS = (
    *("joint offset", "link length", "link offset", "link twist"),
    *("axis tilt", "axis shift"),
)
"""Kinds of geometric errors, those that describe a robot best first."""

PARALLEL = 0.02
"""Sine of the angle below which two axes count as parallel."""

NEAR = 1e-4
"""Distance below which two lines count as one [m]."""


class Label(NamedTuple):
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
        axis: Its axis, shape (3,); None for the tip.
        before: Name of the joint before; empty for the first.
        origin: A point of the axis before, shape (3,).
        along: Direction of that, shape (3,).
        link: Link between both.
    """

    joint: str
    axis: Floats | None
    before: str
    origin: Floats
    along: Floats
    link: str

    @cached_property
    def normal(self) -> Floats:
        """The common normal of both axes, shape (3,)."""
        return self.directions(self.along if self.axis is None else self.axis)[0]

    def directions(self, axis: Floats) -> tuple[Floats, Floats, Floats]:
        """Common normal, direction across it, and axis; a right-handed frame."""
        # From the axis before to the own one, which passes through the origin.
        apart = self.origin if self.axis is None else -self.origin
        normal = skew(self.along) @ (axis if self.axis is None else self.axis)
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
        turns = dict(zip(chain.joints, chain.revolute, strict=True))
        together = defaultdict[tuple[int, str], list[tuple[int, Screw]]](list)
        inner = slice(FRAME, len(term.error.screws) - FRAME)
        positions = term.index[inner].tolist()
        for position, screw in zip(positions, term.error.screws[inner], strict=True):
            stem = screw.parameter.name.rpartition(".")[0]
            parameter = parameters[position]
            if parameter.free and not parameter.nuisance and position not in labels:
                together[screw.frame, stem].append((position, screw))
                labels[position] = _correction_label(screw)
        for (frame, _), entries in together.items():
            place = places[frame - 1]
            geometric = [(k, s) for k, s in entries if s.basis is None]
            positions = [k for k, _ in geometric]
            twists = np.array([s.twist for _, s in geometric]).reshape(-1, 6)
            block = _named_directions(twists, parameters.scales[positions], place)
            turned[np.ix_(positions, positions)] = block
            for k, twist in zip(positions, block.T @ twists, strict=True):
                labels[k] = _geometric_label(twist, place, turns)
            for k, _ in entries:
                # What describes links and joints comes first, then the rest.
                kind = labels[k].kind
                urgency = (*KINDS, kind).index(kind) - KINDS.index("link twist")
                ranked.setdefault(k, (max(urgency, 0), len(ranked)))
    return Columns(turned, labels, tuple(sorted(ranked, key=ranked.__getitem__)))


def _correction_label(screw: Screw) -> Label:
    """A joint correction, by its name."""
    owner, kind, component = screw.parameter.name.rsplit(".", 2)
    joint = owner.removeprefix("joint:")
    if kind == "hysteresis":
        return Label(component, joint)  # Its component says what it is.
    return Label(kind, f"{joint} {component}")


def _places(chain: Chain) -> list[_Place]:
    """The joints of a chain and, last, its tip."""
    zero = np.zeros((1, len(chain.joints)))
    frames = [np.eye(4), *chain.joint_frames(), chain.poses(zero)[0]]
    axes, joints = [np.array([0.0, 0.0, 1.0]), *chain.axes], ["", *chain.joints]
    links = [chain.base, *(_moved_link(chain, joint) for joint in chain.joints)]
    ends = zip([*joints[1:], ""], [*axes[1:], None], strict=True)
    result = []
    for k, (joint, axis) in enumerate(ends):
        before = invert(frames[k + 1]) @ frames[k]
        line = before[:3, 3], before[:3, :3] @ axes[k]
        result.append(_Place(joint, axis, joints[k], *line, links[k]))
    return result


def _moved_link(chain: Chain, joint: str) -> str:
    """The first link that a joint moves."""
    model = chain.robot.model
    index = model.getJointId(joint)
    bodies = (f.name for f in model.frames if f.parentJoint == index)
    names = (name.rpartition(":")[2] for name in bodies)
    return next((name for name in names if name in chain.robot.links), joint)


def _named_directions(twists: Floats, scales: Floats, place: _Place) -> Floats:
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
        axis = place.along
    towards = np.array(place.directions(axis)).T
    for rows, part in ((shifts, slice(0, 3)), (turns, slice(3, 6))):
        axes = twists[rows, part]
        triple = len(rows) == 3 and np.ptp(scales[rows]) == 0.0
        if triple and np.abs(axes @ axes.T - np.eye(3)).max() < 1e-9:
            result[np.ix_(rows, rows)] = axes @ towards
    return result


def _geometric_label(twist: Floats, place: _Place, turns: Mapping[str, bool]) -> Label:
    """The kind of an error by its screw, in the frame of the joint.

    Args:
        twist: The screw, shape (6,).
        place: The joint.
        turns: Whether each joint of the chain turns.
    """
    shift, turn = twist[:3], twist[3:]
    turning = math.hypot(*turn) > 1e-9
    direction = turn if turning else shift
    direction = direction / math.hypot(*direction)
    point = skew(turn) @ shift / (turn @ turn) if turning else np.zeros(3)

    def along(other: Floats) -> bool:
        return bool(abs(direction @ other) > 1.0 - 1e-4)

    for joint, axis, origin in (
        (place.joint, place.axis, np.zeros(3)),
        (place.before, place.along, place.origin),
    ):
        off = point - origin
        through = math.hypot(*(off - (off @ direction) * direction)) < NEAR
        if joint and axis is not None and along(axis) and (through or not turning):
            free = turning == turns[joint]
            axial = "axis tilt" if turning else "link offset"
            return Label("joint offset" if free else axial, joint)
    if place.before and along(place.normal):
        return Label("link twist" if turning else "link length", place.link)
    return Label("axis tilt" if turning else "axis shift", place.joint or "tip")


WEAK = 10.0
"""Posterior standard deviation, in scales, from which a direction is left alone."""

RANK = 1e-12
"""Singular values below this part of the largest are rounding."""


@dataclass(frozen=True)
class Directions:
    """Directions that a fit may move, in parameters divided by their scale.

    Attributes:
        nuisances: Unit vectors of the free nuisances, shape (P, f).
        robot: Robot directions that are estimated, shape (P, r).
        weak: Robot directions that stay at nominal, shape (P, w).
        revealed: Number of the robot directions, the last ones, that nominal geometry
            hides and that are estimated all the same; 0 for errors of expected size.
    """

    nuisances: Floats
    robot: Floats
    weak: Floats
    revealed: int = 0

    @property
    def basis(self) -> Floats:
        """Moved directions, shape (P, f + r)."""
        return np.column_stack([self.nuisances, self.robot])

    @property
    def full_basis(self) -> Floats:
        """Moved directions and those held at nominal, shape (P, f + r + w)."""
        return np.column_stack([self.nuisances, self.robot, self.weak])

    @property
    def hidden(self) -> Floats:
        """Robot directions that nominal geometry hides, shape (P, revealed)."""
        return self.robot[:, self.robot.shape[1] - self.revealed :]

    @property
    def count(self) -> int:
        """Number of directions that are moved."""
        return int(self.nuisances.shape[1] + self.robot.shape[1])


def nuisance_basis(parameters: ParameterSet) -> Floats:
    """The free parameters of base, tool and instrument by their scales, (P, f)."""
    return np.diag(parameters.scales)[:, parameters.free & parameters.nuisance]


def visible_directions(J: Floats, parameters: ParameterSet) -> Floats:
    """Robot directions that change something which the nuisances cannot absorb.

    The solution stays in these directions: what a frame can absorb, the frame
    absorbs, and what nothing can see keeps its nominal value.

    Args:
        J: Jacobian at zero errors over many random configurations, with the rows of
            the priors, shape (M, P).
        parameters: The parameters.

    Returns:
        Orthonormal directions of the parameters divided by their scale, shape (P, r).
    """
    _, Vt = _visible(J, parameters)
    result = np.zeros((len(parameters), len(Vt)))
    # Rounding must not move, by 1e-20, parameters that nothing moves.
    robot = parameters.free & ~parameters.nuisance
    result[robot] = np.where(np.abs(Vt) < 1e-13, 0.0, Vt).T
    return result


def visible_nuisances(J: Floats, parameters: ParameterSet) -> Floats:
    """Directions of base, tool and instrument that change something.

    Args:
        J: Jacobian as for `visible_directions`, shape (M, P).
        parameters: The parameters.

    Returns:
        Orthonormal directions of the parameters divided by their scale, shape (P, f).
    """
    free = parameters.free & parameters.nuisance
    A = (J * parameters.scales)[:, free]
    # The rows of A have the range of its transpose.
    directions = column_space(np.asarray(np.linalg.qr(A, mode="r")).T)
    result = np.zeros((len(parameters), directions.shape[1]))
    result[free] = directions
    return result


def practical_directions(
    J: Floats,
    r: Floats,
    count: int,
    parameters: ParameterSet,
    robot: Floats,
    sigma0: float | None = None,
) -> Directions:
    """Choose the robot directions that these measurements can estimate.

    The nuisances are projected out of the whitened, scaled Jacobian; a right singular
    direction with singular value s then has the posterior standard deviation
    `sigma0 / s`, in scales.

    Args:
        J: Whitened Jacobian at zero robot errors, shape (M, P).
        r: Whitened residual there, shape (M,); predicts sigma0 where it is None.
        count: Residual components; more than M where J and r are a reduced system.
        parameters: The parameters.
        robot: Structurally visible robot directions, shape (P, r).
        sigma0: Standard deviation of unit weight of a fit, where one is known.
    """
    A, nuisance = J * parameters.scales, parameters.free & parameters.nuisance
    U = column_space(A[:, nuisance])
    system = np.column_stack([A @ robot, r])
    # The triangular factor holds the same problem in few rows.
    triangle = np.asarray(np.linalg.qr(system - U @ (U.T @ system), mode="r"))
    rest = triangle[:, -1]
    left, s, Vt = np.linalg.svd(triangle[:, :-1], full_matrices=True)
    if sigma0 is None:
        # By the linear prediction of sigma0 with those that are better determined: to
        # start with few keeps a poor linearization from moving what no data hold.
        dof = count - U.shape[1] - 1 - np.arange(len(s))
        squares = rest @ rest - np.cumsum((left.T[: len(s)] @ rest) ** 2)
        predicted = np.sqrt(np.maximum(squares, 0.0) / np.maximum(dof, 1))
        kept = int(np.cumprod((s * WEAK > predicted) & (dof > 0)).sum())
    else:
        kept = int((s * WEAK > sigma0).sum())
    kept = min(kept, int((s > rounding(A) * s.max(initial=0.0)).sum()))
    nuisances = np.eye(len(parameters))[:, nuisance]
    return Directions(nuisances, robot @ Vt[:kept].T, robot @ Vt[kept:].T)


def half_covariance(J: Floats, basis: Floats, parameters: ParameterSet) -> Floats:
    """Factor H of the covariance `H H^T` of least squares at unit weight.

    It belongs to the references that the Jacobian is taken about, and so does what is
    multiplied by it. The columns of `J H` are orthonormal.

    Args:
        J: Whitened Jacobian at the solution, shape (M, P).
        basis: Directions that were moved, of the scaled parameters, shape (P, k).
        parameters: The parameters.

    Returns:
        The factor, shape (P, rank).
    """
    scaled = parameters.scales[:, None] * basis
    A = J @ scaled
    # What nothing shows, or was eliminated, costs nothing.
    used = A.any(axis=0)
    return np.asarray(scaled[:, used] @ inverse_root(A[:, used]))


def inverse_root(A: Floats) -> Floats:
    """Factor F of the pseudoinverse `(A^T A)^+ = F F^T`, (M, k) -> (k, rank)."""
    triangle = np.linalg.qr(A, mode="r")
    _, s, Vt = np.linalg.svd(triangle, full_matrices=False)
    rank = int((s > RANK * s.max(initial=0.0)).sum())
    return np.asarray(Vt[:rank].T / s[:rank])


def robot_singular_values(
    directions: Directions, J: Floats, parameters: ParameterSet
) -> Floats:
    """Singular values of the moved robot directions, the nuisances projected out.

    Args:
        directions: Directions that were fitted.
        J: Whitened Jacobian at its solution, shape (M, P).
        parameters: The parameters.
    """
    A = J * parameters.scales
    columns = projected(A @ directions.robot, A, parameters)
    return np.asarray(np.linalg.svd(np.linalg.qr(columns, mode="r"), compute_uv=False))


def _visible(J: Floats, parameters: ParameterSet) -> tuple[Floats, Floats]:
    """Singular values and right vectors of what nuisances cannot absorb, (r,), (r, R).

    Of the scaled columns of the R robot parameters, without rounding.
    """
    A = J * parameters.scales
    columns = A[:, parameters.free & ~parameters.nuisance]
    triangle = np.linalg.qr(projected(columns, A, parameters), mode="r")
    _, s, Vt = np.linalg.svd(triangle, full_matrices=False)
    # Relative to what stood there before: the projection leaves rounding behind.
    longest = np.linalg.eigvalsh(columns.T @ columns).max(initial=0.0) ** 0.5
    seen = s > rounding(A) * longest
    return s[seen], Vt[seen]


def rounding(A: Floats) -> float:
    """Relative size of singular values that rounding alone produces."""
    return float(10.0 * max(A.shape, default=1) * np.finfo(float).eps)


def projected(columns: Floats, A: Floats, parameters: ParameterSet) -> Floats:
    """Columns with what the nuisances can absorb of them taken away.

    Args:
        columns: Scaled columns, or residuals, shape (M, k).
        A: Whitened Jacobian times the scales, shape (M, P).
        parameters: The parameters.
    """
    U = column_space(A[:, parameters.free & parameters.nuisance])
    return np.asarray(columns - U @ (U.T @ columns))


def column_space(A: Floats) -> Floats:
    """Orthonormal basis of the columns of A, rounding left out."""
    # Those of stations that were eliminated are zero, and may be very many.
    A = A[:, A.any(axis=0)]
    if A.shape[1] == 0:
        return np.zeros((len(A), 0))
    U, s, _ = np.linalg.svd(A, full_matrices=False)
    return np.asarray(U[:, s > rounding(A) * s[0]])
