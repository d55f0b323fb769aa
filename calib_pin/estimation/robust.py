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

A residual of a fitted row is smaller than its error, because the fit has followed the
error; the higher the leverage, the smaller the residual. With the hat matrix H of the
accepted rows, the whitened residuals `r_g` of an accepted configuration g have the
covariance `I - H_gg`, and those of one that was not fitted `I + H_gg` (Huber and
Ronchetti, Robust Statistics, 2009, 7.2):

    z_g^2 = r_g^T (I -+ H_gg)^-1 r_g

is chi-square distributed. For an accepted configuration it is the distance from a fit
without that configuration.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import ceil
from typing import TypeAlias

import numpy as np
from numpy.typing import NDArray

from calib_pin.errors import CalibPinError, require_known
from calib_pin.estimation.evidence import Outlier
from calib_pin.estimation.fitted import Fit, RobustDecision, balanced, with_prior
from calib_pin.estimation.identifiability import inverse_root
from calib_pin.estimation.nominal import registered
from calib_pin.estimation.problem import (
    EXACT,
    SAMPLE,
    Problem,
    current_units,
    known_values,
    measured_count,
)
from calib_pin.estimation.row_blocks import Priors, expected_places
from calib_pin.estimation.solve import Solver
from calib_pin.estimation.statistics.distributions import chi_square_quantile
from calib_pin.estimation.terms import RowByRow
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices, Observations, states_sigmas
from calib_pin.observations.labels import firsts, numbered
from calib_pin.parameterizations.base import expected_size
from calib_pin.setup import LOSSES

Flags: TypeAlias = NDArray[np.bool_]


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
            it; of one to be beyond c while the solution is sought, and of any pair
            of outliers to fit exchanged.
        carried: Root mean square by robust scale from which few carry much of
            chi-square. With normal noise and forty configurations of one component
            it is above once in ten jobs; real robots, with tails, have up to 1.1.
        held: Scale, in stated deviations, up to which there is no more than noise.
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
        alone: Part of a residual's variance below which its leverage is one: the fit
            meets it. In deviations it is the smallest credible scale.
        steps: Most weighted steps; 12 are usual.
        still: Largest change of a weight after which they stand.
        rounds: Most decisions about which configurations are accepted; two are
            usual.
        trials: Most subsets for a consensus; one in ten is free of wrong configurations
            if four of ten are.
        same: Relative difference in squares of two subsets that agree: a nominal
            robot's errors make many minima close to the right one, and the wrong ones
            are far off.
        looked_at: Measurements that are looked at; more do not make a better start, and
            of more outliers pairs that were exchanged are not the trouble.
        corners: The same of corners in images.
        images: Images of a subset: three tell where a camera is, and its intrinsics.
        fits: Part of its own size that the residual of an exchanged value may have.
    """

    chance: float = 1e-5
    stated_chance: float = 0.01
    carried: float = 1.2
    held: float = 1.3
    breakdown: float = 0.45
    lost: float = 0.5
    size: float = 5.0
    largest_share: float = 0.8
    longest_step: float = 0.5
    rounding: float = 1e-13
    alone: float = 1e-6
    steps: int = 40
    still: float = 0.01
    rounds: int = 8
    trials: int = 30
    same: float = 0.5
    looked_at: int = 200
    corners: int = 2000
    images: int = 5
    fits: float = 0.2


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
    squared = balanced(problem, solver)
    if not squared.sigma0 > EXACT:
        # Without redundancy, or without errors, every measurement is met.
        return squared
    z = _studentized_about(squared, np.ones(int(failing(problem).max()) + 1, bool))
    scale = z.robust_scale()
    plain = RobustDecision(_outliers(squared, z, scale))
    if loss == "squared" or (loss == "auto" and not _suspicious(squared, z, scale)):
        return replace(squared, robust=plain)
    accepted = _agreeing(*_robust_start(problem, squared.rank, solver.rng))
    fitted = squared
    for _ in range(OPTIONS.rounds):
        # They must be a majority that determines the robot.
        out = 1.0 - float(accepted.mean())
        few = _weighted(squared.problem, accepted)
        if out > OPTIONS.breakdown or known_values(few) <= squared.rank:
            return replace(squared, robust=replace(plain, disagreement=out))
        if accepted.all():
            return squared
        fitted = balanced(_weighted(problem, accepted), solver)
        z = _studentized_about(fitted, accepted)
        scale = _scale(z, accepted)
        plausible = _plausible(z, scale)
        if np.array_equal(plausible, accepted):
            break
        accepted = plausible
    return replace(fitted, robust=RobustDecision(_outliers(fitted, z, scale), squared))


# Residuals in their deviations.


class Studentized:
    """Normalized residuals of N rows in G configurations and Q quantities.

    Args:
        problem: The problem of the rows.
        r: Normalized residuals, independent with unit variance if the standard
            deviations of the rows are right, shape (M,); not numbers where nothing is
            predicted.
        counts: Degrees of freedom of each, 0 to 1, shape (M,).

    Attributes:
        labels: Configuration of each row, or the row of an image itself, shape (N,).
        whole: Configuration in which each of these was measured, shape (G,).
        layout: Row and quantity of each residual component.
        components: Squares of the residuals, infinite where nothing is predicted.
        configuration: Configuration of each of the C cells: what a configuration has
            of a quantity, shape (C,).
        quantity: Quantity of each cell, shape (C,).
        squares: Sum of the squares in each, shape (C,).
        counts: Number of independent components in each, shape (C,).
        least: Smallest credible scale, by quantity, shape (Q,).
    """

    def __init__(self, problem: Problem, r: Floats, counts: Floats) -> None:
        """Add up what configurations have of quantities."""
        self.layout, self.labels = problem.layout, failing(problem)
        self.whole = np.zeros(int(self.labels.max(initial=-1)) + 1, np.int64)
        self.whole[self.labels] = problem.data.groups()
        width, row = len(self.layout.components), self.layout.row
        keys = self.labels[row] * width + self.layout.component
        cells, place = numbered(keys)
        self.configuration, self.quantity = cells // width, cells % width
        with np.errstate(over="ignore"):
            self.components = np.where(np.isfinite(r), r**2, np.inf)
        sums = (np.bincount(place, w, len(cells)) for w in (self.components, counts))
        self.squares, self.counts = (np.asarray(total, float) for total in sums)
        self.least = np.full(width, OPTIONS.alone)
        if states_sigmas(problem.data):
            # Residuals smaller than the stated sigma do not contradict it.
            self.least = 1.0 / current_units(problem)

    def robust_scale(self, share: float = 0.5) -> Floats:
        """Scale by the median over configurations, by quantity, shape (Q,).

        Consistent for normal noise whatever the number of components, and correct
        within a factor while at least half of the configurations are good.

        Args:
            share: Quantile of the configurations that is used; 0.5 is the median.
        """
        result = self.least.copy()
        used = np.flatnonzero(self.counts >= 0.5)  # Fewer tell no noise.
        used = used[np.argsort(self.quantity[used], kind="stable")]
        ratios = self.squares[used] / _quantiles(self.counts[used], 1.0 - share)
        ends = np.cumsum(np.bincount(self.quantity[used], minlength=len(result)))
        for k, group in enumerate(np.split(ratios, ends[:-1])):
            if len(group):
                place = int(share * (len(group) - 1))
                result[k] = np.sqrt(np.partition(group, place)[place])
        return np.asarray(np.maximum(result, self.least))

    def scale(self, accepted: Flags) -> Floats:
        """Scale by the mean square of accepted configurations, shape (G,) -> (Q,)."""
        used, width = accepted[self.configuration], len(self.least)
        squares, counts = (
            np.bincount(self.quantity[used], values[used], width)
            for values in (self.squares, self.counts)
        )
        with np.errstate(invalid="ignore", divide="ignore"):
            return np.asarray(np.fmax(np.sqrt(squares / counts), self.least))

    def statistic(self, scale: Floats) -> Floats:
        """z^2 of each configuration at a scale by quantity, shape (G,)."""
        # Infinite errors do not fit, even where most are.
        with np.errstate(over="ignore", invalid="ignore"):
            squares = self.squares / scale[self.quantity] ** 2
        squares[~np.isfinite(self.squares)] = np.inf
        return np.asarray(np.bincount(self.configuration, squares), float)

    def sizes(self, scale: Floats) -> Floats:
        """Normalized residual z of each row at a scale by quantity, shape (N,)."""
        scaled = self.components / scale[self.layout.component] ** 2
        return np.sqrt(np.bincount(self.layout.row, scaled, len(self.labels)))

    def limit(self, tail: float) -> Floats:
        """Quantile of z^2 of each configuration at a tail probability, shape (G,)."""
        counts = np.asarray(np.bincount(self.configuration, self.counts), float)
        return _quantiles(counts, tail)


def failing(problem: Problem) -> Indices:
    """Labels of rows that fail together, 0 to G - 1, shape (N,)."""
    labels, rows = problem.data.groups(), np.arange(len(problem.data))
    blocks = [b for b in problem.blocks if b.term.measurement.declaration.separable]
    if not blocks:
        return labels
    labels = labels + len(rows)
    for block in blocks:
        labels[block.rows] = rows[block.rows]
    return numbered(labels)[1]


def studentized(
    problem: Problem, theta: Floats, basis: Floats, accepted: Flags
) -> Studentized:
    """Normalized residuals of all rows about a fit of some of them.

    With very many rows every leverage is negligible, so they are not linearized.

    Args:
        problem: The problem with all its rows at full weight.
        theta: Solution of the fit, shape (P,).
        basis: Directions that were fitted, shape (P, k).
        accepted: The rows that were fitted, shape (N,).
    """
    if problem.many:
        return _unstudentized(problem, problem.residual(theta))
    layout, counts = problem.layout, np.isfinite(problem.sigma).astype(float)
    fun, jac = problem.linearize_rows(theta)
    count = len(counts)
    r, A = fun[:count], jac @ basis
    measured = A[:count]
    bad = ~(np.isfinite(r) & np.isfinite(jac[:count]).all(axis=1))
    measured[bad] = 0.0
    fitted = measured[accepted[layout.row]]
    B = measured @ inverse_root(np.concatenate([fitted, A[count:]]))
    lost, r = bad & (counts > 0.0), np.where(bad, 0.0, r)
    for rows in by_size(failing(problem)[layout.row]):
        sign = np.where(accepted[layout.row[rows[:, 0]]], -1.0, 1.0)
        U, eigenvalues = spectrum(B[rows])
        share = 1.0 + sign[:, None] * eigenvalues
        alone = share < OPTIONS.alone
        factor = np.where(alone, 0.0, 1.0 / np.sqrt(np.where(alone, 1.0, share)))
        along = np.einsum("gmk,gm->gk", U, r[rows])
        r[rows] += np.einsum("gmk,gk->gm", U, (factor - 1.0) * along)
        counts[rows] -= np.einsum("gmk,gk->gm", U**2, alone.astype(float))
    r[lost] = np.nan
    return Studentized(problem, r, counts)


def _unstudentized(problem: Problem, r: Floats) -> Studentized:
    """Residuals as they are, of a model that hardly follows single configurations."""
    used = np.isfinite(problem.sigma)
    return Studentized(problem, r[: len(used)], used.astype(float))


def by_size(labels: Indices) -> Iterator[Indices]:
    """Positions of the members of G groups of one size m after the other, (G, m).

    Groups of one size are factored together.

    Args:
        labels: Group of each member, shape (M,).
    """
    order, sizes = np.argsort(labels, kind="stable"), np.bincount(labels)
    of_member = sizes[labels[order]]
    for size in np.unique(of_member).tolist():
        yield order[of_member == size].reshape(-1, size)


def spectrum(B: Floats) -> tuple[Floats, Floats]:
    """Eigenvectors and eigenvalues of B B^T that span the range of B.

    Args:
        B: Factors, shape (G, m, k).

    Returns:
        Eigenvectors, shape (G, m, l), and eigenvalues, shape (G, l), l = min(m, k).
    """
    if B.shape[1] <= B.shape[2]:
        eigenvalues, U = np.linalg.eigh(B @ np.swapaxes(B, 1, 2))
        return U, eigenvalues
    U, s, _ = np.linalg.svd(B, full_matrices=False)
    return U, s**2


def _quantiles(counts: Floats, tail: float) -> Floats:
    """Chi-square quantiles by rounded degrees of freedom; infinite for zero."""
    rounded, place = np.unique(np.round(counts), return_inverse=True)
    each = [chi_square_quantile(n, tail) if n > 0 else np.inf for n in rounded.tolist()]
    return np.array(each, float)[place]


# Decisions.


def _weighted(problem: Problem, accepted: Flags | None = None) -> Problem:
    """The problem of accepted configurations, shape (G,); default all of them."""
    each = np.ones(len(problem.data))
    if accepted is not None:
        each = accepted.astype(float)[failing(problem)]
    return replace(problem, data=problem.data.weighted(each))


def _studentized_about(fitted: Fit, accepted: Flags) -> Studentized:
    """All configurations about a fit of the accepted ones, shape (G,)."""
    held, _, directions = with_prior(fitted)
    basis = held.parameters.scales[:, None] * directions
    rows = accepted[failing(held)]
    return studentized(_weighted(held), fitted.theta, basis, rows)


def _plausible(z: Studentized, scale: Floats) -> Flags:
    """The configurations whose residuals may be chance at a scale, (Q,) -> (G,)."""
    noise_only = bool((scale <= OPTIONS.held * z.least).all())
    chance = OPTIONS.stated_chance if noise_only else OPTIONS.chance
    tail = chance / max(len(z.whole), 1)
    plausible = np.asarray(z.statistic(scale) <= z.limit(tail))
    lost = np.bincount(z.whole, ~plausible) / np.bincount(z.whole)
    return np.asarray(plausible & (lost <= OPTIONS.lost)[z.whole])


def _scale(z: Studentized, accepted: Flags) -> Floats:
    """Scale of the accepted configurations, shape (G,) -> (Q,).

    Wrong ones of a few deviations among them must not make room for larger ones, so it
    is at most the one by the median.
    """
    return np.minimum(z.scale(accepted), z.robust_scale())


def _suspicious(fitted: Fit, z: Studentized, scale: Floats) -> bool:
    """Whether a least-squares fit may have been corrupted by some configurations.

    A few stand out against the median, or carry the most of chi-square together, or so
    much is left that they may hide.
    """
    carried = z.scale(np.ones(len(z.whole), bool)) > OPTIONS.carried * scale
    if not _plausible(z, scale).all() or carried.any():
        return True
    sigma, layout = fitted.problem.sigma, fitted.problem.layout
    for size, rows, c in zip(
        scale, layout.of_components, layout.components, strict=True
    ):
        sigmas = sigma[rows][np.isfinite(sigma[rows])]
        if len(sigmas) and size * np.median(sigmas) > expected_size(c.quantity.unit):
            return True
    return False


def _robust_start(
    problem: Problem, rank: int, rng: np.random.Generator
) -> tuple[Problem, Floats, Floats]:
    """The solution of the truncated cost over the whole model, by consensus and steps.

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
    whole = _consensus(_weighted(problem), rng)
    whole = replace(whole, expected=expected, units=np.zeros(0))
    few = replace(whole, data=whole.data.sample(SAMPLE)) if whole.many else whole
    theta, weight = np.zeros(len(parameters)), np.zeros(0)
    # A model of p parameters meets p values exactly, so more than half must count
    # (Rousseeuw and Leroy, Robust regression, 1987, theorem 6 of chapter 3).
    share = min(0.5 * (1.0 + (rank + 1) / measured_count(few)), OPTIONS.largest_share)
    for _ in range(OPTIONS.steps):
        r, J = few.linearize_rows(theta)
        z = _unstudentized(few, r)
        scale = z.robust_scale(share)
        before, weight = weight, _weights(z, scale)
        if len(before) and np.abs(weight - before).max() < OPTIONS.still:
            break
        layout = few.layout
        rows = np.sqrt(weight)[z.labels][layout.row] / scale[layout.component]
        theta = theta + _step(few, r, J, rows)
    if few is not whole:
        weight = _weights(_unstudentized(whole, whole.residual(theta)), scale)
    return replace(whole, units=scale), theta, weight


def _weights(z: Studentized, scale: Floats) -> Floats:
    """Weights of configurations for their residuals, shape (G,)."""
    squares = z.statistic(scale)
    cut = z.limit(OPTIONS.stated_chance)
    return np.asarray((cut / (squares + cut)) ** 2)


def _step(problem: Problem, r: Floats, J: Floats, weight: Floats) -> Floats:
    """A Gauss-Newton step with weights for the rows, shape (M,) -> (P,).

    By normal equations, for it only has to lead to the right configurations.
    """
    parameters, count = problem.parameters, len(weight)
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


def _agreeing(problem: Problem, theta: Floats, weight: Floats) -> Flags:
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
        held = _weighted(problem, accepted)
        if held.many:
            held = replace(held, data=held.data.sample(SAMPLE))
        # The solution of accepted configurations is a redescending one away.
        for _ in range(2):
            ones = np.ones(len(held.layout.row))
            theta = theta + _step(held, *held.linearize_rows(theta), ones)
        z = studentized(problem, theta, basis, accepted[failing(problem)])
        scale = _scale(z, accepted)
        plausible = _plausible(z, scale)
        if np.array_equal(plausible, accepted):
            break
        accepted = plausible
        problem = replace(problem, units=problem.units * scale)
    return accepted


# A registration by consensus.


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
    things, labels = few.data.things, few.data.groups()
    targets = [np.flatnonzero(things == k) for k in dict.fromkeys(things.tolist())]
    # Of each target one row more than what is unknown needs.
    parameters, values = few.parameters, measured_count(few) / max(len(few.data), 1)
    unknown = int((parameters.free & parameters.nuisance).sum())
    size = max(ceil(unknown / (max(values, 1.0) * len(targets))) + 1, 3)

    def draw() -> Indices:
        """Rows of some images, each of which tells a pose by all its corners.

        Else of every target, of different configurations where there are.
        """
        if images:
            subset = rng.permutation(few.data.configurations)[: OPTIONS.images]
            return np.flatnonzero(np.isin(labels, subset))
        chosen = []
        for order in map(rng.permutation, targets):
            chosen.append(order[firsts(labels[order])][:size])
        return np.sort(np.concatenate(chosen))

    best, least, agreed = problem, np.inf, 0
    for _ in range(OPTIONS.trials):
        candidate, total = _concentrate(few, draw(), targets)
        if candidate is None:
            continue
        agreed += abs(total - least) <= OPTIONS.same * least < np.inf
        if total < least:
            best, least = candidate, total
        # Two subsets of images that are wrong may agree.
        if agreed >= (3 if images else 1):
            break
    return replace(problem, terms=best.terms)


def _concentrate(
    problem: Problem, rows: Indices, targets: list[Indices]
) -> tuple[Problem | None, float]:
    """Register by some rows, then by the better half of each target, until it stands.

    Returns:
        The problem about its references, and the squares of its better half; None
        where the rows do not say where everything is.
    """
    theta = np.zeros(len(problem.parameters))
    result, total = None, np.inf
    for _ in range(2):
        try:
            start = registered(replace(problem, data=problem.data.rows(rows)), theta)
        except (CalibPinError, np.linalg.LinAlgError):
            break
        result, before = replace(start, data=problem.data), rows
        with np.errstate(over="ignore", invalid="ignore"):
            r = result.residual(theta)[: len(result.sigma)]
            squares = np.where(np.isfinite(r), r**2, np.inf)
        of_rows = np.asarray(np.bincount(result.layout.row, squares), float)
        rows = np.sort(np.concatenate([_half(of_rows, target) for target in targets]))
        total = float(of_rows[rows].sum())
        if np.array_equal(rows, before):
            break
    return result, total


def _half(squares: Floats, rows: Indices) -> Indices:
    """The half of some rows that has the smaller squares, and at least three."""
    count = max(ceil(0.5 * len(rows)), min(len(rows), 3))
    return rows[np.argsort(squares[rows], kind="stable")[:count]]


# What is said of outliers.


def _outliers(fitted: Fit, z: Studentized, scale: Floats) -> tuple[Outlier, ...]:
    """The measurements of the configurations that do not fit, worst first.

    The weights are in the data of the fit; the scale is by quantity, shape (Q,).
    """
    problem, data = fitted.problem, fitted.problem.data
    out = ~_plausible(z, scale)[z.labels] | (data.weight == 0.0)
    if not out.any():
        return ()
    exchanged = dict(_exchanged_pairs(problem, fitted.theta, out, z, scale))
    rows, sizes = np.flatnonzero(out), z.sizes(scale)
    order = rows[np.argsort(-sizes[rows], kind="stable")].tolist()
    numbers = sizes[order].tolist(), data.weight[order].tolist()
    causes = [exchanged.get(row, "") for row in order]
    return tuple(map(Outlier, map(data.source, order), order, *numbers, causes))


def _exchanged_pairs(
    problem: Problem, theta: Floats, out: Flags, z: Studentized, scale: Floats
) -> Iterator[tuple[int, str]]:
    """Rows of pairs each of which fits the values of the other, with their cause."""
    if not 2 <= out.sum() <= OPTIONS.looked_at:
        return
    sizes, data = z.sizes(scale), problem.data
    units = scale * current_units(problem)
    sigma = problem.given_sigma * units[problem.layout.component]
    for block in problem.blocks:
        rows = np.flatnonzero(out[block.rows])
        if not block.data.values.shape[1] or len(rows) < 2:
            continue
        i, j = (rows[k] for k in np.triu_indices(len(rows), 1))
        labels, codes = z.labels[block.rows], block.data.target.codes
        possible = (codes[i] == codes[j]) & (labels[i] != labels[j])
        i, j = i[possible], j[possible]
        fits = []
        for a, b in ((i, j), (j, i)):
            trial = replace(block.data.rows(a), values=block.data.values[b])
            with np.errstate(invalid="ignore", over="ignore"):
                r = RowByRow(block.term, trial).errors(theta)
                size = np.linalg.norm(r / block.table(sigma)[a], axis=1)
            # The parts of wrong values are anywhere in a ball of two pairs of values.
            by_chance = (OPTIONS.stated_chance / max(len(i), 1)) ** (0.5 / r.shape[1])
            fits.append(size < min(OPTIONS.fits, by_chance) * sizes[block.rows][a])
        for k in np.flatnonzero(fits[0] & fits[1]).tolist():
            a, b = int(i[k]) + block.rows.start, int(j[k]) + block.rows.start
            yield a, exchanged_with(data, b)
            yield b, exchanged_with(data, a)


def exchanged_with(data: Observations, row: int) -> str:
    """The cause of an outlier whose values stand at another measurement."""
    return f"exchanged with {data.source(row)}"
