"""Fits that wrong measurements cannot corrupt.

Every configuration has a weight, for all that is measured in one fails together, but
for images: each of their corners has one, and with the most of them they are out as a
whole. The weights minimize a truncated cost,

    sum_g min(z_g^2, c^2),

where z_g is the size of the residuals of configuration g in standard deviations. It has
many minima; the right one is found by graduated non-convexity (Yang, Antonante,
Tzoumas and Carlone, Graduated non-convexity for robust spatial perception, 2020): a
sequence of weighted least squares with the weights of Geman and McClure (equation 12),

    w_g = (c^2 / (z_g^2 + c^2))^2,

from a cost that is nearly convex to one that redescends. What is graduated is the scale
of z, their mu: it is estimated anew at every step, from the millimeters of the nominal
robot down to the noise, and the first step starts from a registration by consensus.
The outcome decides which configurations are accepted; the final fit is the ordinary
least squares of these, so all that is said of it holds, and the decision is repeated
about it until it stands.

A closed-form registration of all rows is as wrong as the worst of them. For a consensus
it is made from small random subsets of the configurations, each is improved by its
better half (concentration steps of least trimmed squares: Rousseeuw and Van Driessen,
Computing LTS regression for large data sets, 2006, section 3), until two of them agree;
the one whose better half fits best is taken. The errors of the nominal robot,
millimeters, are noise to it.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from math import ceil

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import CalibPinError, require_known
from calib_pin.estimation.evidence import Outlier
from calib_pin.estimation.fitted import Fit, RobustDecision
from calib_pin.estimation.places import expected_places
from calib_pin.estimation.problem import (
    EXACT,
    SAMPLE,
    Problem,
    known_values,
    measured_count,
    reweighted,
)
from calib_pin.estimation.registration import registered
from calib_pin.estimation.robust.causes import causes
from calib_pin.estimation.robust.studentized import (
    Studentized,
    failing,
    squared_or_infinite,
    studentized,
)
from calib_pin.estimation.row_blocks import Priors
from calib_pin.estimation.solve import Solver
from calib_pin.estimation.stages import balanced
from calib_pin.kinematics.spatial import Floats
from calib_pin.parameterizations.base import expected_size

LOSSES = ("auto", "squared", "huber", "gnc")
"""Names of the losses."""


@dataclass(frozen=True)
class RobustOptions:
    """Limits of what is set aside, and of the search for it.

    Attributes:
        chance: Probability, with normal noise, that one of all good configurations
            is set aside. What no parameter describes, gears and compliance, has
            more than a normal distribution beyond four or five deviations: with
            0.01 TIAGo loses a good configuration of 37 and gains 16 % of error on
            others. Of one component in a hundred this is 5.3 deviations.
        stated_chance: The same where noise is all there is, as measurements state
            it.
        carried: Root mean square by robust scale from which few carry much of
            chi-square. With normal noise and forty configurations of one component
            it is above once in ten jobs; real robots, with tails, have up to 1.1.
        held: Scale, in stated deviations, up to which there is no more than noise.
        cut: Probability of a good configuration beyond c while the solution is
            sought.
        bent: Probability of a good configuration beyond where Huber's loss bends.
        breakdown: Share of configurations beyond which those set aside may as well
            be the right ones. Medians hold up to one half; with four of ten wrong
            a few good ones may go as well.
        lost: Share of the corners of an image beyond which all of it is wrong.
        size: Expected errors of the robot while the solution is sought, in scales:
            it holds what measurements do not tell, and hardly anything else.
        largest_share: Largest share of configurations that a scale is taken from
            while it is sought.
        longest_step: Longest step of a frame or an instrument [m, rad], for steps
            are not damped.
        rounding: Part of the largest eigenvalue that rounding leaves.
        steps: Most weighted steps; 12 are usual.
        still: Largest change of a weight after which they stand.
        rounds: Most decisions about which configurations are accepted; two are
            usual.
        trials: Most subsets for a consensus; one in ten is free of wrong configurations
            if four of ten are.
        same: Relative difference in squares of two subsets that agree: a nominal
            robot's errors make many minima close to the right one, and the wrong ones
            are far off.
        looked_at: Measurements that are looked at; more do not make a better start.
        corners: The same of corners in images.
        images: Images of a subset: three tell where a camera is, and its intrinsics.
    """

    chance: float = 1e-5
    stated_chance: float = 0.01
    carried: float = 1.2
    held: float = 1.3
    cut: float = 0.01
    bent: float = 0.1
    breakdown: float = 0.45
    lost: float = 0.5
    size: float = 5.0
    largest_share: float = 0.8
    longest_step: float = 0.5
    rounding: float = 1e-13
    steps: int = 40
    still: float = 0.01
    rounds: int = 8
    trials: int = 30
    same: float = 0.5
    looked_at: int = 200
    corners: int = 2000
    images: int = 5


OPTIONS = RobustOptions()


def robustly(problem: Problem, solver: Solver) -> Fit:
    """Fit a problem with the loss of its setup.

    Without anything to set aside it is the least-squares fit itself.

    Args:
        problem: The problem, not registered.
        solver: The solver; its generator draws the subsets of the registration.

    Raises:
        OptionError: If the setup names a loss that does not exist.
    """
    loss = problem.setup.loss
    require_known("loss", loss, LOSSES)
    # Prepared once: references, weights and units may change.
    _ = problem.many
    squared = balanced(problem, solver)
    if not squared.sigma0 > EXACT:
        # Without redundancy, or without errors, every measurement is met.
        return squared
    found = _judged(squared, np.ones(int(failing(problem).max()) + 1, bool))
    scale = found.robust_scale()
    plain = RobustDecision(_outliers(squared, found, scale))
    if loss == "squared" or (loss == "auto" and not _suspicious(squared, found, scale)):
        return replace(squared, robust=plain)
    about, theta, weight = _sought(problem, loss, squared.rank, solver.rng)
    if loss == "huber":
        if (weight == 1.0).all():
            return squared
        fitted = balanced(_weighted(problem, weight), solver)
        found = _judged(fitted, weight > 0.0)
        scale = found.robust_scale()
    else:
        accepted = _selected(about, theta, weight)
        for _ in range(OPTIONS.rounds):
            few = _weighted(squared.problem, accepted)
            # They must be a majority that determines the robot.
            disagreeing = 1.0 - accepted.mean() > OPTIONS.breakdown
            if disagreeing or known_values(few) <= squared.rank:
                plain = replace(plain, disagreement=float(1.0 - accepted.mean()))
                return replace(squared, robust=plain)
            if accepted.all():
                return squared
            fitted = balanced(_weighted(problem, accepted), solver)
            about_it = _judged(fitted, accepted)
            its_scale = _scale(about_it, accepted)
            passed = _passed(about_it, its_scale)
            if np.array_equal(passed, accepted):
                break
            accepted = passed
        found, scale = about_it, its_scale
    outliers = _outliers(fitted, found, scale)
    return replace(fitted, robust=RobustDecision(outliers, squared))


def _weighted(problem: Problem, weight: NDArray[np.generic]) -> Problem:
    """The problem with a weight for each configuration, shape (G,)."""
    return reweighted(problem, weight.astype(float)[failing(problem)])


def _plain(problem: Problem) -> Problem:
    """The problem with all measurements at full weight."""
    return reweighted(problem, np.ones(len(problem.data)))


def _judged(fitted: Fit, accepted: NDArray[np.bool_]) -> Studentized:
    """All configurations about a fit of the accepted ones, shape (G,)."""
    held, _, moved = fitted.held
    problem = _plain(held)
    basis = problem.parameters.scales[:, None] * moved
    rows = accepted[failing(problem)]
    return studentized(problem, fitted.theta, basis, rows)


def _passed(found: Studentized, scale: Floats) -> NDArray[np.bool_]:
    """The configurations whose residuals may be chance at a scale, (Q,) -> (G,)."""
    stated = bool((scale <= OPTIONS.held * found.least).all())
    chance = OPTIONS.stated_chance if stated else OPTIONS.chance
    tail = chance / max(len(found.whole), 1)
    passed = np.asarray(found.statistic(scale) <= found.limit(tail))
    lost = np.bincount(found.whole, ~passed) / np.bincount(found.whole)
    return np.asarray(passed & (lost <= OPTIONS.lost)[found.whole])


def _scale(found: Studentized, accepted: NDArray[np.bool_]) -> Floats:
    """Scale of the accepted configurations, shape (G,) -> (Q,).

    Wrong ones of a few deviations among them must not make room for larger ones, so it
    is at most the one by the median.
    """
    return np.minimum(found.scale(accepted), found.robust_scale())


def _suspicious(fitted: Fit, found: Studentized, scale: Floats) -> bool:
    """Whether a least-squares fit may have been corrupted by some configurations.

    A few stand out against the median, or carry the most of chi-square together, or so
    much is left that they may hide.
    """
    carried = found.scale(np.ones(len(found.whole), bool)) > OPTIONS.carried * scale
    if not _passed(found, scale).all() or carried.any():
        return True
    problem, layout = fitted.problem, fitted.problem.layout
    for size, rows, component in zip(
        scale, layout.of_components, layout.components, strict=True
    ):
        sigma = problem.sigma[rows]
        sigma = sigma[np.isfinite(sigma)]
        usual = expected_size(component.quantity.unit)
        if len(sigma) and size * np.median(sigma) > usual:
            return True
    return False


def _sought(
    problem: Problem, loss: str, rank: int, rng: np.random.Generator
) -> tuple[Problem, Floats, Floats]:
    """The solution of a robust loss over the whole model, by consensus and steps.

    The measurements determine as many directions as the rank says.

    Returns:
        The problem about the consensus, with the scales that were found in its units
        and the robot held by its expected size; the solution, shape (P,); the weight
        of each configuration, shape (G,).
    """
    parameters = problem.parameters
    robot = np.eye(len(parameters))[:, parameters.free & ~parameters.nuisance]
    sizes = np.full(len(parameters), OPTIONS.size)
    places = expected_places(problem, parameters)
    expected = Priors.expected(robot, sizes, parameters.scales, places)
    every = _consensus(_plain(problem), rng)
    every = replace(every, expected=expected, units=np.zeros(0))
    few = replace(every, data=every.data.sample(SAMPLE)) if every.many else every
    theta, weight = np.zeros(len(parameters)), np.zeros(0)
    # A model of p parameters meets p values exactly, so more than half must count
    # (Rousseeuw and Leroy, Robust regression, 1987, theorem 6 of chapter 3).
    share = min(0.5 * (1.0 + (rank + 1) / measured_count(few)), OPTIONS.largest_share)
    for _ in range(OPTIONS.steps):
        r, J = few.linearize_rows(theta)
        found = _unfitted(few, r)
        scale = found.robust_scale(share)
        before, weight = weight, _weights(found, scale, loss)
        if len(before) and np.abs(weight - before).max() < OPTIONS.still:
            break
        layout = few.layout
        rows = np.sqrt(weight)[found.labels][layout.row] / scale[layout.component]
        theta = theta + _step(few, r, J, rows)
    if few is not every:
        weight = _weights(_unfitted(every, every.residual(theta)), scale, loss)
    return replace(every, units=scale), theta, weight


def _weights(found: Studentized, scale: Floats, loss: str) -> Floats:
    """Weights of configurations for their residuals, shape (G,)."""
    squares = found.statistic(scale)
    if loss == "huber":
        with np.errstate(divide="ignore"):
            return np.minimum(1.0, np.sqrt(found.limit(OPTIONS.bent) / squares))
    cut = found.limit(OPTIONS.cut)
    return np.asarray((cut / (squares + cut)) ** 2)


def _unfitted(problem: Problem, r: Floats) -> Studentized:
    """Residuals as they are, of a model that hardly follows single configurations."""
    told = np.isfinite(problem.sigma)
    squares = squared_or_infinite(r[: len(told)])
    return Studentized(problem, squares, told.astype(float))


def _step(problem: Problem, r: Floats, J: Floats, weight: Floats) -> Floats:
    """A Gauss-Newton step with weights for the rows, shape (M,) -> (P,).

    By normal equations, for it only has to lead to the right configurations.
    """
    parameters = problem.parameters
    count = len(weight)
    basis = np.diag(parameters.scales)[:, parameters.free]
    used = np.flatnonzero((weight > 0.0) & np.isfinite(r[:count]))
    A = np.concatenate([weight[used, None] * J[used], J[count:]]) @ basis
    b = np.concatenate([weight[used] * r[used], r[count:]])
    eigenvalues, V = np.linalg.eigh(A.T @ A)
    kept = eigenvalues > OPTIONS.rounding * eigenvalues[-1]
    along = V[:, kept].T @ (A.T @ b) / eigenvalues[kept]
    step = -(basis @ (V[:, kept] @ along))
    longest = np.abs(step[parameters.nuisance]).max(initial=OPTIONS.longest_step)
    return np.asarray(step * (OPTIONS.longest_step / longest))


def _selected(problem: Problem, theta: Floats, weight: Floats) -> NDArray[np.bool_]:
    """The configurations that agree with a solution, judged without themselves, (G,).

    The first fit depends on it: without these steps 62 measurements of a Panda with a
    ball in sockets leave 6 % more error; simulated outliers make no difference.

    The problem has scales in its units, the weights are those of configurations, (G,).
    """
    parameters = problem.parameters
    basis = np.diag(parameters.scales)[:, parameters.free]
    # There the weight of Geman and McClure is where z is c.
    accepted = weight >= 0.25
    for _ in range(OPTIONS.rounds):
        if accepted.mean() < 1.0 - OPTIONS.breakdown:
            break
        rows = accepted[failing(problem)]
        held = _weighted(problem, accepted)
        if held.many:
            held = replace(held, data=held.data.sample(SAMPLE))
        alike = np.ones(len(held.layout.row))
        # The solution of accepted configurations is a redescending one away.
        for _ in range(2):
            theta = theta + _step(held, *held.linearize_rows(theta), alike)
        found = studentized(problem, theta, basis, rows)
        scale = _scale(found, accepted)
        passed = _passed(found, scale)
        if np.array_equal(passed, accepted):
            break
        accepted = passed
        problem = replace(problem, units=problem.units * scale)
    return accepted


def _outliers(fitted: Fit, found: Studentized, scale: Floats) -> tuple[Outlier, ...]:
    """The measurements of the configurations that do not fit, worst first.

    The weights are in the data of the fit; the scale is by quantity, shape (Q,).
    """
    problem = fitted.problem
    data = problem.data
    out = ~_passed(found, scale)[found.labels] | (data.weight == 0.0)
    rows, sizes = np.flatnonzero(out), found.sizes(scale)
    shared = causes(problem, fitted.theta, out, found, scale)
    order = rows[np.argsort(-sizes[rows], kind="stable")].tolist()
    numbers = sizes[order].tolist(), data.weight[order].tolist()
    told = [shared.get(row, "") for row in order]
    return tuple(map(Outlier, map(data.source, order), order, *numbers, told))


def _consensus(problem: Problem, rng: np.random.Generator) -> Problem:
    """The problem about references that most of its rows agree with.

    Every target keeps half of its own rows, for without them nothing says where it is.

    Args:
        problem: The problem, with the robot at nominal.
        rng: Random generator of the subsets.
    """
    images = all(b.term.measurement.declaration.separable for b in problem.blocks)
    count = OPTIONS.corners if images else OPTIONS.looked_at
    few = replace(problem, data=problem.data.sample(count))
    things = few.data.things()
    _, first = np.unique(things, return_index=True)
    targets = [np.flatnonzero(things == things[k]) for k in np.sort(first)]
    # Of each target one row more than what is unknown needs.
    parameters, values = few.parameters, measured_count(few) / max(len(few.data), 1)
    unknown = int((parameters.free & parameters.nuisance).sum())
    size = max(ceil(unknown / (max(values, 1.0) * len(targets))) + 1, 3)
    labels = few.data.groups()

    def drawn() -> NDArray[np.intp]:
        """Rows of some images, each of which tells a pose by all its corners.

        Else of every target, of different configurations where there are.
        """
        if images:
            some = rng.permutation(few.data.configurations)[: OPTIONS.images]
            return np.flatnonzero(np.isin(labels, some))
        chosen = []
        for own in targets:
            order = rng.permutation(own)
            _, first = np.unique(labels[order], return_index=True)
            chosen.append(order[np.sort(first)][:size])
        return np.sort(np.concatenate(chosen))

    best, least, agreed = problem, np.inf, 0
    for _ in range(OPTIONS.trials):
        about, total = _concentrated(few, drawn(), targets)
        if about is None:
            continue
        agreed += abs(total - least) <= OPTIONS.same * least < np.inf
        if total < least:
            best, least = about, total
        # Two subsets of images that are wrong may agree.
        if agreed >= (3 if images else 1):
            break
    return problem.with_terms(best.terms)


def _concentrated(
    problem: Problem, rows: NDArray[np.intp], targets: list[NDArray[np.intp]]
) -> tuple[Problem | None, float]:
    """Register by some rows, then by the better half of each target, until it stands.

    Returns:
        The problem about its references, and the squares of its better half; None
        where the rows do not say where everything is.
    """
    theta = np.zeros(len(problem.parameters))
    about, total = None, np.inf
    for _ in range(2):
        try:
            found = registered(replace(problem, data=problem.data.rows(rows)), theta)
        except (CalibPinError, np.linalg.LinAlgError):
            break
        about, before = replace(found, data=problem.data), rows
        squares = _squares(about, theta)
        rows = np.sort(np.concatenate([_better(squares, own) for own in targets]))
        total = float(squares[rows].sum())
        if np.array_equal(rows, before):
            break
    return about, total


def _better(squares: Floats, rows: NDArray[np.intp]) -> NDArray[np.intp]:
    """The half of some rows that has the smaller squares, and at least three."""
    count = max(ceil(0.5 * len(rows)), min(len(rows), 3))
    return rows[np.argsort(squares[rows], kind="stable")[:count]]


def _squares(problem: Problem, theta: Floats) -> Floats:
    """Sum of whitened squares of each row, shape (N,); infinite if not predicted."""
    row = problem.layout.row
    with np.errstate(over="ignore", invalid="ignore"):
        squares = squared_or_infinite(problem.residual(theta)[: len(row)])
    return np.asarray(np.bincount(row, squares, len(problem.data)), float)
