"""Errors that depend on the side from which joints came: lost motion of gears.

A fit without hysteresis is asked, joint by joint, how far each stands behind its last
motion. Where a joint came from depends on where it is: high positions are reached from
below. So the side to be expected at a position is fitted along, as are smooth errors of
the joints where they show, and what the sides explain beside these counts. Measurements
between two reversals of a joint may share what the model lacks; each such run counts
once, and the sides of measurements before and behind must not explain nearly as much.
"""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib_pin.errors import enumerated
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.identifiability import column_space
from calib_pin.estimation.problem import EXACT
from calib_pin.estimation.statistics.distributions import f_tail, student_tail
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices, Signs
from calib_pin.parameterizations import needed_conditions
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.sentences import told
from calib_pin.validation.findings.setup_lines import written

CHANCE = 5e-3
"""Probability that any joint of a robot without lost motion is told."""

SMOOTH = 1e-2
"""Probability by chance from which smooth errors of the joints are fitted along."""

DEGREE = 3
"""Degree of the polynomial by which the side to be expected depends on a position."""

RUNS = 10
"""Least number of reversals of a joint of which something can be said."""

LAGS = 40
"""Lags by which sides of other measurements are tried."""

SEEN = 0.02
"""Least part of a joint's side that nothing else explains, of its sum of squares."""

LEAST = 0.02
"""Least part of the errors left that lost motion of a joint explains.

Of very many measurements less can be told, but makes no difference: 0.013 on the UR5.
"""

BY_ORDER = "the sides are taken from the order of the measurements in their files"


def approach_order(case: Case) -> Iterator[Finding]:
    """That lost motion was estimated by an order that nobody has stated."""
    by_order = case.data.conditions.source == "order"
    if by_order and "direction" in needed_conditions(case.setup.parameters):
        said = f"{BY_ORDER}: they must be those of measuring"
        remedy = "or state them in columns '<joint>.direction', or when each "
        remedy += "measurement was taken in a column 'time'"
        numbers = {"joints": ", ".join(case.data.joints)}
        yield told("approach-by-order", said, numbers, remedy, info=True)


def approach(case: Case) -> Iterator[Finding]:
    """Joints whose errors depend on the side from which they came."""
    fit, held = case.fit, case.fit.problem.data.conditions
    known = held.direction.size and "hysteresis" not in case.setup.parameters
    if not (known and case.informed and fit.rms > EXACT):
        return
    values, deviations, chances = lost_motions(case)
    names = case.data.joints
    found = [
        j
        for j in np.argsort(-values / deviations).tolist()
        if chances[j] * len(names) < CHANCE and values[j] > 0.0
    ]
    if not found:
        return
    said = []
    for j in found:
        unit = "mrad" if case.unit(names[j]) == "rad" else "mm"
        size, sigma = 1e3 * values[j], 1e3 * deviations[j]
        said.append(f"'{names[j]}' {size:.2g} +- {sigma:.1g} {unit}")
    lines = {"parameters": [*case.setup.parameters, "hysteresis"]}
    evidence = {names[j]: float(values[j]) for j in found}
    order = f" ({BY_ORDER})" if held.source == "order" else ""
    yield told(
        "backlash",
        "errors depend on the side from which joints came, lost motion: "
        f"{enumerated(said)}{order}",
        {**evidence, "joints": ", ".join(evidence)},
        f"estimate it: --parameters {','.join(lines['parameters'])}, or state in the "
        f"setup file: {written(lines)}",
        lines,
        "by-joint",
    )


def lost_motions(case: Case) -> tuple[Floats, Floats, Floats]:
    """Lost motion of each joint as a fit without it leaves it.

    Returns:
        Values and standard deviations [rad, m], and the probabilities that chance makes
        as much, shape (n,) each; of a joint whose deviation is infinite nothing can
        be said, or nothing that makes a difference.
    """
    fit, data = case.fit, case.fit.problem.data
    row, by_joints = fit.problem.layout.row, fit.by_joints
    sides = data.conditions.direction[row]
    count = sides.shape[1]
    values, chances = np.zeros(count), np.ones(count)
    deviations = np.full(count, np.inf)
    Q, r = fit.unexplained

    def unexplained(columns: Floats) -> Floats:
        X = np.zeros((len(r), columns.shape[1]))
        X[: len(columns)] = columns
        return np.asarray(X - Q @ (Q.T @ X))

    usual = _usual_sides(data.q, data.conditions.direction)[row]
    further = by_joints * usual
    smooth = np.hstack([further, _smooth(case, by_joints, data.q[row])])
    if fit.score(smooth).chance < SMOOTH:
        further = smooth
    U = column_space(unexplained(further))
    X = -0.5 * by_joints * sides
    squares = np.sum(X**2, axis=0)
    X = unexplained(X)
    X -= U @ (U.T @ X)
    told = np.flatnonzero(np.sum(X**2, axis=0) > SEEN * np.maximum(squares, 1e-300))
    dof = fit.left - U.shape[1] - len(told)
    if not len(told) or dof < 1:
        return values, deviations, chances
    B = np.linalg.pinv(X[:, told]).T
    left = r - U @ (U.T @ r)
    b = -(B.T @ left)
    rest = left + X[:, told] @ b
    plain = np.sqrt(float(rest @ rest) / dof * np.sum(B**2, axis=0))
    V = column_space(X[:, told])
    order = np.argsort(case.rank)
    for k, j in enumerate(told.tolist()):
        own = data.conditions.direction[order, j]
        turned = np.diff(own, prepend=0) != 0
        run = np.empty(len(order), np.int64)
        run[order] = np.cumsum(turned)
        sums = np.bincount(run[row], (B[:, k] * rest)[: len(row)])
        runs = len(np.unique(run[row]))
        if runs < RUNS:
            continue
        shared = np.sqrt(runs / (runs - 1.0) * float(sums @ sums))
        size = float(b[k] / plain[k])
        if size**2 < LEAST * (size**2 + dof):
            continue
        values[j], deviations[j] = b[k], max(plain[k], shared)
        chances[j] = max(
            student_tail(size, dof),
            student_tail(float(b[k] / max(shared, 1e-300)), runs - 1),
        )
        if chances[j] * count > CHANCE:
            continue
        # Along a path what the model lacks changes as slowly as sides do: those of
        # other measurements must explain far less.
        others = unexplained(by_joints[:, [j]] * _lagged(own, order)[row])
        others -= U @ (U.T @ others)
        others -= V @ (V.T @ others)
        norms = np.maximum(np.sum(others**2, axis=0), 1e-300)
        theirs = max(float(np.mean((others.T @ rest) ** 2 / norms)), 1e-300)
        gain = float(b[k] ** 2 / np.sum(B[:, k] ** 2))
        # Sides that hardly change are alike at neighboring lags.
        apart = min(others.shape[1], runs - 1)
        chances[j] = max(chances[j], f_tail(gain / theirs, 1, apart))
    return values, deviations, chances


def _lagged(sides: Signs, order: Indices) -> Floats:
    """Sides of other measurements, evenly farther in the files, (N,) -> (N, K).

    Args:
        sides: Sides of a joint in the order of the files.
        order: Position of each of these measurements.
    """
    count = min(LAGS, len(order) - 1)
    found = np.empty((len(order), count))
    for k in range(count):
        found[order, k] = np.roll(sides, (k + 1) * len(order) // (count + 1))
    return found


def _usual_sides(q: Floats, sides: Signs) -> Floats:
    """The mean side at the position of each joint, a polynomial of it, (N, n)."""
    found = np.zeros(q.shape)
    for x, side, usual in zip(q.T, sides.T, found.T, strict=True):
        center, width = 0.5 * (x.max() + x.min()), 0.5 * float(np.ptp(x))
        V = np.polynomial.chebyshev.chebvander((x - center) / (width or 1.0), DEGREE)
        usual[:] = V @ np.linalg.lstsq(V, side.astype(float), rcond=None)[0]
    return found


def _smooth(case: Case, by_joints: Floats, q: Floats) -> Floats:
    """Whitened residual by smooth errors of the joints at their positions, (M, K)."""
    columns = []
    for j, joint in enumerate(case.data.joints):
        x = q[:, j]
        waves = [np.sin(x), np.cos(x), np.sin(2.0 * x), np.cos(2.0 * x)]
        shapes = [x, *waves] if case.unit(joint) == "rad" else [x, x**2]
        columns += [by_joints[:, j] * shape for shape in shapes]
    return np.column_stack(columns)
