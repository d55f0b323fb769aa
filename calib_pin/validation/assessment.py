"""Identifiability: which estimates mean something, without and with a fit."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import (
    Stated,
    nominal_problem,
    require_known,
    setup_of,
)
from calib_pin.estimation.identifiability import (
    KINDS,
    Columns,
    Combination,
    Directions,
    Structure,
    combinations,
    everett_count,
    geometric_columns,
    half_covariance,
    observability,
    practical_directions,
    robot_singular_values,
)
from calib_pin.estimation.nominal import analyze_structure
from calib_pin.estimation.problem import Problem, absorbed, distinct_values, known_count
from calib_pin.estimation.statistics.distributions import chi_square_quantile
from calib_pin.estimation.terms import Terms
from calib_pin.kinematics.chains import Robots
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey
from calib_pin.parameterizations.base import expected_size
from calib_pin.parameters import ParameterSet
from calib_pin.solvers import LeastSquaresResult
from calib_pin.solvers.status import Status
from calib_pin.validation.result import (
    Coefficient,
    Correlation,
    CoupledGroup,
    Identifiability,
    Identification,
    ParameterEstimate,
    RobotError,
)

CORRELATED = 0.95
"""Absolute correlation above which two estimates are reported as a pair."""

WEAK_PART = 0.1
"""Part of a sum in directions held at nominal from which it counts as weak."""

SMALL = 1e-3
"""Weight of a term, by that of the first, below which it does not matter."""

EQUAL = 0.02
"""Difference of coefficients up to which terms of one kind are a plain sum."""


class Estimated(Protocol):
    """Estimates of parameters, those of a fit or of a plan for one."""

    @property
    def theta(self) -> Floats:
        """Parameter values, shape (P,)."""

    @property
    def covariance(self) -> Floats:
        """Their covariance, shape (P, P)."""

    @property
    def directions(self) -> Directions:
        """The directions that are estimated and those held at nominal."""


def identify(
    chains: Robots,
    measured: str | Sequence[BlockKey],
    setup: Stated = None,
    *,
    seed: int = 0,
) -> Identification:
    """The identifiability of a robot by how it is measured, without measurements.

    Args:
        chains: The nominal chains.
        measured: Name of the measurement model, or the blocks that could be measured.
        setup: Estimated and known quantities.
        seed: Seed of the random configurations.

    Raises:
        OptionError: If a name does not exist, or the instrument lacks a reference.

    Examples:
        >>> import calib_pin
        >>> found = calib_pin.identify(calib_pin.load_chain("pa10"), "pose")
        >>> found.identifiability.rank, found.identifiability.everett
        (34, 34)
    """
    problem = nominal_problem(chains, measured, setup_of(setup))
    require_known(problem.terms.values(), problem.setup)
    theta = np.zeros(len(problem.parameters))
    found, _ = analyze_structure(problem, theta, np.random.default_rng(seed))
    ranks = _ranks(problem, found, found.robot, found.configurations)
    errors, told = robot_errors(problem, found), estimates(problem.parameters, found)
    return Identification(*told, ranks, robot_errors=errors)


def registration_reason(problem: Problem, result: LeastSquaresResult) -> str:
    """The reason why a registration must not be trusted; empty where it may be.

    Args:
        problem: The problem whose nuisances were fitted.
        result: Outcome of the fit.
    """
    if result.status is Status.NOT_FINITE:
        return result.status.advice
    parameters = problem.parameters
    A = (result.jac * parameters.scales)[:, parameters.free & parameters.nuisance]
    rank = int(np.linalg.matrix_rank(A)) if A.size else 0
    values = distinct_values(problem)
    if rank and values <= rank:
        return (
            f"{values} measured values are used up by the {rank} unknowns of base, "
            "tool and instrument; measure more configurations"
        )
    return "" if result.status.success else result.status.advice


def estimates(
    parameters: ParameterSet, structure: Structure, fitted: Estimated | None = None
) -> tuple[tuple[ParameterEstimate, ...], tuple[CoupledGroup, ...]]:
    """The status of every parameter and the coupled groups, with values of a fit.

    Args:
        parameters: The parameters.
        structure: Their structural analysis.
        fitted: The estimates, if there are any; otherwise values are zero.
    """
    groups, member = list[CoupledGroup](), defaultdict[int, list[int]](list)
    alone, weak, names = dict[int, bool](), set[int](), parameters.names
    sigmas = dict[int, float | None]()
    for combination in structure.combinations:
        value, sigma, told = _estimate(combination, parameters, fitted)
        if len(combination.terms) == 1:
            lead = combination.terms[0][0]
            alone[lead], sigmas[lead] = told, sigma
            continue
        number = len(groups) + 1
        weak |= set() if told else {number}
        for position, _ in combination.terms:
            member[position].append(number)
        terms = tuple(Coefficient(names[k], c) for k, c in combination.terms)
        known = combination.expression(names), combination.unit, value, sigma, terms
        groups.append(CoupledGroup(number, *known))
    for k, other in structure.alike.items():
        if fitted is not None and sigmas.get(other) is not None:
            sigmas[k] = float(fitted.covariance[k, k] ** 0.5)

    def status(k: int) -> str:
        if not parameters[k].free:
            return "fixed"
        k = structure.alike.get(k, k)
        if k in structure.unidentifiable:
            # Hidden at nominal; large errors may have let it move all the same.
            moved = fitted is not None and fitted.directions.hidden[k].any()
            return "weak" if moved else "unidentifiable"
        if k in alone:
            return "identifiable" if alone[k] else "weak"
        return "weak" if weak.issuperset(member[k]) else "coupled"

    theta = np.zeros(len(parameters)) if fitted is None else fitted.theta
    found = list[ParameterEstimate]()
    for k, (p, value) in enumerate(zip(parameters, theta.tolist(), strict=True)):
        own = value, sigmas.get(k), status(k), tuple(member.get(k, ()))
        found.append(ParameterEstimate(p.name, p.unit, *own))
    return tuple(found), tuple(groups)


def _estimate(
    combination: Combination, parameters: ParameterSet, fitted: Estimated | None
) -> tuple[float, float | None, bool]:
    """Value and deviation of a sum of parameters, and whether measurements tell it.

    Args:
        combination: The sum.
        parameters: The parameters.
        fitted: The estimates, if there are any; otherwise the value is zero.
    """
    if fitted is None:
        return 0.0, None, True
    row = combination.row(len(parameters))
    told = fitted.directions.weak_part(row, parameters) <= WEAK_PART
    sigma = float(np.sqrt(max(float(row @ fitted.covariance @ row), 0.0)))
    known = told and np.isfinite(sigma)
    return float(row @ fitted.theta), sigma if known else None, told


def fitted_ranks(fitted: Fit) -> Identifiability:
    """Ranks and observability of the measurements that were fitted."""
    problem, s = fitted.problem, fitted.singular_values
    rank, weak = fitted.rank, fitted.directions.weak.shape[1]
    if len(problem.further.priors):
        s = _told(fitted)
        rank += len(s) - fitted.directions.robot.shape[1]
        weak = max(len(fitted.structure.robot) - len(s), 0)
    s = s[s > 1e-12 * s.max(initial=0.0)]
    found = _ranks(problem, fitted.structure, s, len(problem.data))
    found = replace(found, rank=rank, weak=weak, correlated=tuple(_correlated(fitted)))
    return replace(found, revealed=fitted.directions.revealed)


def _told(fitted: Fit) -> Floats:
    """Singular values of the robot directions that measurements tell without priors."""
    problem, parameters = fitted.problem, fitted.problem.parameters
    count = len(fitted.result.fun) - len(problem.further.priors)
    fun, jac = fitted.result.fun[:count], fitted.result.jac[:count]
    robot = np.eye(len(parameters))[:, parameters.free & ~parameters.nuisance]
    unit = fitted.unit if np.isfinite(fitted.unit) else 0.0
    told = practical_directions(
        jac, fun, known_count(problem) - absorbed(problem), parameters, robot, unit
    )
    return robot_singular_values(told, jac, parameters)


def _ranks(
    problem: Problem, structure: Structure, s: Floats, configurations: int
) -> Identifiability:
    """Ranks of a structure, with the singular values s of some configurations."""
    of_terms = [term.frames for term in problem.terms.values()]
    frames = {own.station for own in of_terms} | {own.tool for own in of_terms}
    everett = everett_count(problem.chains.revolute, len(frames))
    condition = float(s[0] / s[-1]) if len(s) else 0.0
    free, rank = int(problem.parameters.free.sum()), structure.rank
    ranks = free, rank, rank, len(structure.robot), structure.gap, everett
    values = tuple(s.tolist()), tuple(structure.singular_values.tolist())
    told = *ranks, condition, *values, observability(s, configurations)
    return Identifiability(*told, scale_observable=structure.scaled)


def _correlated(fitted: Fit) -> Iterator[Correlation]:
    """Pairs of identifiable sums of the robot whose estimates move together."""
    parameters, every = fitted.problem.parameters, fitted.structure.combinations
    own = [c for c in every if not parameters[c.terms[0][0]].nuisance]
    own = [c for c in own if _estimate(c, parameters, fitted)[2]]
    if not own or not np.isfinite(fitted.covariance).all():
        return
    names = [combination.expression(parameters.names) for combination in own]
    C = np.array([combination.row(len(parameters)) for combination in own])
    covariance = C @ fitted.covariance @ C.T
    sigma = np.sqrt(np.diag(covariance))
    with np.errstate(divide="ignore", invalid="ignore"):
        correlation = covariance / np.outer(sigma, sigma)
    for i, j in np.argwhere(np.tril(np.abs(correlation) > CORRELATED, -1)).tolist():
        yield Correlation(names[j], names[i], float(correlation[i, j]))


def leverages(fitted: Fit) -> Floats:
    """The leverage of every measurement in a fit, of very many their mean, (N,)."""
    problem, jac = fitted.problem, fitted.result.jac
    half = half_covariance(jac, fitted.directions.basis, problem.parameters)
    count = len(problem.data)
    if problem.many:
        return np.full(count, half.shape[1] / max(count, 1))
    row = problem.layout.row
    found = np.sum((jac[: len(row)] @ half) ** 2, axis=1)
    return np.asarray(np.bincount(row, found, count), float)


def chi2_interval(dof: int) -> tuple[float, float]:
    """The interval that holds chi-square in 95 of 100 cases if all sigmas are right."""
    return chi_square_quantile(dof, 0.975), chi_square_quantile(dof, 0.025)


def robot_errors(
    system: Terms, structure: Structure, fitted: Estimated | None = None
) -> tuple[RobotError, ...]:
    """The identifiable errors of a robot, each direction once, and those in frames.

    Base, tool and instrument are eliminated first: what a frame absorbs is no error of
    the robot. Then come the directions of `geometric_columns` in their order, so that
    there are as many errors as independent ones of the robot.

    Args:
        system: The robot and how it is measured.
        structure: Its structural analysis.
        fitted: The estimates, if there are any; otherwise values are zero.
    """
    parameters, nuisance = structure.parameters, structure.parameters.nuisance
    columns, free = geometric_columns(system, parameters), parameters.free
    order = np.array([*np.flatnonzero(free & nuisance), *columns.order], np.intp)
    A = np.zeros((len(structure.relations), len(parameters)))
    A[:, free] = structure.relations
    pivots, rows = combinations((A @ columns.turned)[:, order], structure.rank)
    leads, C = order[np.array(pivots, np.intp)], np.zeros((len(rows), len(parameters)))
    # Columns are scaled by the expected sizes; the coefficients are not.
    C[:, order] = rows / parameters.scales[order]
    given, pairs = (columns, parameters, fitted), zip(leads.tolist(), C, strict=True)
    found = [_error(k, row / row[k], *given) for k, row in pairs if not nuisance[k]]
    found += _absorbed(leads, C, columns, parameters)
    ranks = {name: k for k, name in enumerate((*KINDS, *system.chains.joints))}
    last = len(ranks)
    return tuple(
        sorted(found, key=lambda e: [ranks.get(n, last) for n in (e.kind, e.of[0])])
    )


def _error(
    lead: int,
    full: Floats,
    columns: Columns,
    parameters: ParameterSet,
    fitted: Estimated | None,
) -> RobotError:
    """An identifiable error by its coefficients in the named directions, (P,)."""
    label, unit, row = (
        columns.labels[lead],
        parameters[lead].unit,
        columns.turned @ full,
    )
    terms = [(k, float(row[k])) for k in np.flatnonzero(row).tolist()]
    value, sigma, told = _estimate(Combination((*terms,), unit), parameters, fitted)
    sizes = np.array([expected_size(p.unit) for p in parameters])
    # A minus where the axis points the other way; what comes first says so.
    signs: dict[str, str] = {}
    for k in columns.order:
        if columns.labels[k].kind == label.kind and abs(abs(full[k]) - 1.0) < EQUAL:
            signs.setdefault(columns.labels[k].of, "-" if full[k] < 0.0 else "")
    of = tuple(f"{sign}{of}" for of, sign in signs.items())
    for least in (max(sigma or 0.0, float(SMALL * sizes[lead])), 0.5 * sizes[lead]):
        if kept := tuple((k, c) for k, c in terms if abs(c) * sizes[k] >= least):
            break
    expression = Combination(kept, unit).expression(parameters.names)
    named = tuple(Coefficient(parameters.names[k], c) for k, c in kept)
    known = value, sigma, "identifiable" if told else "weak", ()
    return RobotError(label.kind, of, unit, *known, expression, named)


def _absorbed(
    leads: NDArray[np.intp], C: Floats, columns: Columns, parameters: ParameterSet
) -> Iterator[RobotError]:
    """Errors that base, tool or instrument take along, so that none is known.

    Args:
        leads: Leading direction of each sum that is known, shape (k,).
        C: These sums by the named directions, shape (k, P).
        columns: The named directions.
        parameters: The parameters.
    """
    weights = np.abs(C * [expected_size(p.unit) for p in parameters])
    heavy = weights > SMALL * weights[np.arange(len(C)), leads, None]
    for k in columns.order:
        takers = leads[heavy[:, k]]
        if k in leads or not len(takers) or not parameters.nuisance[takers].all():
            continue
        owners = (parameters[p].name.rpartition(".")[0] for p in takers.tolist())
        label, unit = columns.labels[k], parameters[k].unit
        own = label.kind, (label.of,), unit, 0.0, None, "absorbed"
        yield RobotError(*own, tuple(dict.fromkeys(owners)))
