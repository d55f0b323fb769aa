"""Identifiability: which estimates mean something, without and with a fit."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace

import numpy as np

from calib_pin.estimation.directions import (
    half_covariance,
    practical_directions,
    robot_singular_values,
)
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import (
    Stated,
    nominal_problem,
    require_known,
    setup_of,
)
from calib_pin.estimation.identifiability import Structure, everett_count, observability
from calib_pin.estimation.nominal import analyze_structure
from calib_pin.estimation.problem import Problem, distinct_values
from calib_pin.estimation.statistics.distributions import chi_square_quantile
from calib_pin.kinematics.chains import Robots
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey
from calib_pin.parameters import ParameterSet
from calib_pin.solvers import LeastSquaresResult
from calib_pin.solvers.status import Status
from calib_pin.validation.result import (
    Correlation,
    CoupledGroup,
    Identifiability,
    Identification,
    ParameterEstimate,
    Term,
)
from calib_pin.validation.robot_errors import WEAK_PART, Estimated, robot_errors

CORRELATED = 0.95
"""Absolute correlation above which two estimates are reported as a pair."""


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
    require_known(problem.parts.values(), problem.setup)
    theta = np.zeros(len(problem.parameters))
    found, _ = analyze_structure(problem, theta, np.random.default_rng(seed))
    parameters, groups = estimates(problem.parameters, found)
    values, count = found.robot, found.configurations
    ranks = _ranks(problem, found, values, count)
    errors = robot_errors(problem, found)
    return Identification(parameters, groups, ranks, robot_errors=errors)


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
    theta = np.zeros(len(parameters)) if fitted is None else fitted.theta
    groups: list[CoupledGroup] = []
    member: dict[int, list[int]] = {}
    alone: dict[int, bool] = {}
    sigmas: dict[int, float | None] = {}
    weak: set[int] = set()
    for combination in structure.combinations:
        row = combination.row(len(parameters))
        known, sigma = True, None
        if fitted is not None:
            known = fitted.directions.weak_part(row, parameters) <= WEAK_PART
            deviation = float(np.sqrt(row @ fitted.covariance @ row))
            sigma = deviation if known and np.isfinite(deviation) else None
        if len(combination.terms) == 1:
            position = combination.terms[0][0]
            alone[position], sigmas[position] = known, sigma
            continue
        number = len(groups) + 1
        if not known:
            weak.add(number)
        for position, _ in combination.terms:
            member.setdefault(position, []).append(number)
        groups.append(
            CoupledGroup(
                number=number,
                expression=combination.expression(parameters.names),
                unit=combination.unit,
                value=float(row @ theta),
                sigma=sigma,
                terms=tuple(Term(parameters[k].name, c) for k, c in combination.terms),
            )
        )

    for position, other in structure.alike.items():
        if fitted is not None and alone.get(other) and sigmas[other] is not None:
            sigmas[position] = float(fitted.covariance[position, position] ** 0.5)

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

    return tuple(
        ParameterEstimate(
            name=parameter.name,
            unit=parameter.unit,
            value=float(theta[k]),
            sigma=sigmas.get(k),
            status=status(k),
            groups=tuple(member.get(k, ())),
        )
        for k, parameter in enumerate(parameters)
    ), tuple(groups)


def fitted_ranks(fitted: Fit) -> Identifiability:
    """Ranks and observability of the measurements that were fitted."""
    problem, s = fitted.problem, fitted.singular_values
    rank, weak = fitted.rank, fitted.directions.weak.shape[1]
    if problem.further.priors:
        s = _told(fitted)
        rank += len(s) - fitted.directions.robot.shape[1]
        weak = max(len(fitted.structure.robot) - len(s), 0)
    return replace(
        _ranks(
            problem,
            fitted.structure,
            s[s > 1e-12 * s.max(initial=0.0)],
            len(problem.data),
        ),
        rank=rank,
        weak=weak,
        revealed=fitted.directions.revealed,
        correlated=tuple(_correlated(fitted)),
    )


def _told(fitted: Fit) -> Floats:
    """Singular values of the robot directions that measurements tell without priors."""
    problem, parameters = fitted.problem, fitted.problem.parameters
    count = len(fitted.result.fun) - problem.further.priors
    fun, jac = fitted.result.fun[:count], fitted.result.jac[:count]
    robot = np.eye(len(parameters))[:, parameters.free & ~parameters.nuisance]
    unit = fitted.unit if np.isfinite(fitted.unit) else 0.0
    told = practical_directions(
        jac, fun, problem.count - problem.absorbed, parameters, robot, unit
    )
    return robot_singular_values(told, jac, parameters)


def _ranks(
    problem: Problem, structure: Structure, s: Floats, configurations: int
) -> Identifiability:
    """Ranks of a structure, with the singular values s of some configurations."""
    scopes = [part.scope for part in problem.parts.values()]
    frames = {scope.station for scope in scopes} | {scope.tool for scope in scopes}
    return Identifiability(
        parameters=int(problem.parameters.free.sum()),
        rank=structure.rank,
        structural_rank=structure.rank,
        robot_rank=len(structure.robot),
        gap=structure.gap,
        everett=everett_count(problem.chains.revolute, len(frames)),
        condition=float(s[0] / s[-1]) if len(s) else 0.0,
        singular_values=tuple(float(value) for value in s),
        structural_values=tuple(float(value) for value in structure.singular_values),
        observability=observability(s, configurations),
        weak=0,
        revealed=0,
        correlated=(),
        scale_observable=structure.scaled,
    )


def _correlated(fitted: Fit) -> Iterator[Correlation]:
    """Pairs of identifiable sums of the robot whose estimates move together."""
    parameters = fitted.problem.parameters
    rows, names = [], []
    for combination in fitted.structure.combinations:
        row = combination.row(len(parameters))
        if parameters[combination.terms[0][0]].nuisance:
            continue
        if fitted.directions.weak_part(row, parameters) <= WEAK_PART:
            rows.append(row)
            names.append(combination.expression(parameters.names))
    if not rows or not np.isfinite(fitted.covariance).all():
        return
    C = np.array(rows)
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
