"""Knowledge of a fit: by parameters, by errors of the robot, and part by part."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import replace
from typing import Protocol

import numpy as np
import pinocchio as pin
from numpy.typing import NDArray

import calib_pin.validation.result as results
from calib_pin.compiled.threads import serial_blas
from calib_pin.estimation.evidence import VarianceComponent
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
    geometric_columns,
    half_covariance,
    observability,
    practical_directions,
    robot_singular_values,
    visible_nuisances,
)
from calib_pin.estimation.nominal import analyze_structure
from calib_pin.estimation.problem import Problem, absorbed, known_count
from calib_pin.estimation.statistics.variance_components import leverages
from calib_pin.estimation.terms import FRAME, Terms
from calib_pin.kinematics.chains import Robots
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import BlockKey, Booleans, Indices
from calib_pin.parameterizations.base import expected_size
from calib_pin.parameterizations.linearization import ordered_screws
from calib_pin.parameters import ParameterSet
from calib_pin.validation.calibrated_model import CalibratedModel
from calib_pin.validation.findings.facts import still_joints
from calib_pin.validation.model_errors import ModelErrors, quantity_errors

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
) -> results.Identification:
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
        >>> result = calib_pin.identify(calib_pin.load_chain("pa10"), "pose")
        >>> result.identifiability.rank, result.identifiability.everett
        (34, 34)
    """
    problem = nominal_problem(chains, measured, setup_of(setup))
    require_known(problem.terms.values(), problem.setup)
    theta = np.zeros(len(problem.parameters))
    structure, _ = analyze_structure(problem, theta, np.random.default_rng(seed))
    ranks = _ranks(problem, structure, structure.robot, structure.configurations)
    parameters, groups = estimates(problem.parameters, structure)
    errors = robot_errors(problem, structure)
    return results.Identification(parameters, groups, ranks, robot_errors=errors)


def estimates(
    parameters: ParameterSet, structure: Structure, fitted: Estimated | None = None
) -> tuple[tuple[results.ParameterEstimate, ...], tuple[results.CoupledGroup, ...]]:
    """The status of every parameter and the coupled groups, with values of a fit.

    Args:
        parameters: The parameters.
        structure: Their structural analysis.
        fitted: The estimates, if there are any; otherwise values are zero.
    """
    groups, member = list[results.CoupledGroup](), defaultdict[int, list[int]](list)
    alone, weak, names = dict[int, bool](), set[int](), parameters.names
    sigmas = dict[int, float | None]()
    for combination in structure.combinations:
        value, sigma, observable = _estimate(combination, parameters, fitted)
        if len(combination.terms) == 1:
            lead = combination.terms[0][0]
            alone[lead], sigmas[lead] = observable, sigma
            continue
        number = len(groups) + 1
        weak |= set() if observable else {number}
        for position, _ in combination.terms:
            member[position].append(number)
        terms = tuple(results.Coefficient(names[k], c) for k, c in combination.terms)
        text, unit = combination.expression(names), combination.unit
        groups.append(results.CoupledGroup(number, text, unit, value, sigma, terms))
    for k, other in structure.equivalent.items():
        if fitted is not None and sigmas.get(other) is not None:
            sigmas[k] = float(fitted.covariance[k, k] ** 0.5)

    def status(k: int) -> str:
        if not parameters[k].free:
            return "fixed"
        k = structure.equivalent.get(k, k)
        if k in structure.unidentifiable:
            # Hidden at nominal; large errors may have let it move all the same.
            moved = fitted is not None and fitted.directions.hidden[k].any()
            return "weak" if moved else "unidentifiable"
        if k in alone:
            return "identifiable" if alone[k] else "weak"
        return "weak" if weak.issuperset(member[k]) else "coupled"

    theta = np.zeros(len(parameters)) if fitted is None else fitted.theta
    result = list[results.ParameterEstimate]()
    for k, (p, value) in enumerate(zip(parameters, theta.tolist(), strict=True)):
        of_groups = tuple(member.get(k, ()))
        estimate = p.name, p.unit, value, sigmas.get(k), status(k), of_groups
        result.append(results.ParameterEstimate(*estimate))
    return tuple(result), tuple(groups)


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
    scaled = np.where(parameters.nuisance, 0.0, row * parameters.scales)
    weak = float(np.linalg.norm(fitted.directions.weak.T @ scaled))
    observable = weak <= WEAK_PART * float(np.linalg.norm(scaled))
    sigma = float(np.sqrt(max(float(row @ fitted.covariance @ row), 0.0)))
    known = observable and np.isfinite(sigma)
    return float(row @ fitted.theta), sigma if known else None, observable


def fitted_ranks(fitted: Fit) -> results.Identifiability:
    """Ranks and observability of the measurements that were fitted."""
    problem, result = fitted.problem, fitted.result
    s = robot_singular_values(fitted.directions, result.jac, problem.parameters)
    rank, weak = fitted.rank, fitted.directions.weak.shape[1]
    if len(problem.further.priors):
        s = _values_without_priors(fitted)
        rank += len(s) - fitted.directions.robot.shape[1]
        weak = max(len(fitted.structure.robot) - len(s), 0)
    s = s[s > 1e-12 * s.max(initial=0.0)]
    ranks = _ranks(problem, fitted.structure, s, len(problem.data))
    revealed = fitted.directions.revealed
    return replace(ranks, rank=rank, weak=weak, revealed=revealed)


def _values_without_priors(fitted: Fit) -> Floats:
    """Singular values of the robot directions that measurements tell without priors."""
    problem, parameters = fitted.problem, fitted.problem.parameters
    count = len(fitted.result.fun) - len(problem.further.priors)
    fun, jac = fitted.result.fun[:count], fitted.result.jac[:count]
    robot = np.eye(len(parameters))[:, parameters.free & ~parameters.nuisance]
    unit = fitted.unit if np.isfinite(fitted.unit) else 0.0
    values = known_count(problem) - absorbed(problem)
    directions = practical_directions(jac, fun, values, parameters, robot, unit)
    return robot_singular_values(directions, jac, parameters)


def _ranks(
    problem: Problem, structure: Structure, s: Floats, configurations: int
) -> results.Identifiability:
    """Ranks of a structure, with the singular values s of some configurations."""
    ends = (term.frames for term in problem.terms.values())
    frames = {name for both in ends for name in (both.station, both.tool)}
    # Everett's count of a complete model measured by full poses; each of its frames
    # beyond a base and a tool has six more.
    turns = problem.chains.revolute
    everett = int(4 * turns.sum() + 2 * (~turns).sum() + 6 * (len(frames) - 1))
    return results.Identifiability(
        parameters=int(problem.parameters.free.sum()),
        rank=structure.rank,
        structural_rank=structure.rank,
        robot_rank=len(structure.robot),
        gap=structure.gap,
        everett=everett,
        condition=float(s[0] / s[-1]) if len(s) else 0.0,
        singular_values=tuple(s.tolist()),
        structural_values=tuple(structure.singular_values.tolist()),
        observability=observability(s, configurations),
        scale_observable=structure.scaled,
    )


def measurement_leverages(fitted: Fit) -> Floats:
    """The leverage of every measurement in a fit, of very many their mean, (N,)."""
    problem, jac = fitted.problem, fitted.result.jac
    half = half_covariance(jac, fitted.directions.basis, problem.parameters)
    of_values = leverages(problem, jac, half)
    means = np.bincount(problem.layout.row, of_values, len(problem.data))
    return np.asarray(means, float)


def robot_errors(
    system: Terms, structure: Structure, fitted: Estimated | None = None
) -> tuple[results.RobotError, ...]:
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
    sizes = np.array([expected_size(parameter.unit) for parameter in parameters])
    errors = [
        _error(k, row / row[k], columns, parameters, sizes, fitted)
        for k, row in zip(leads.tolist(), C, strict=True)
        if not nuisance[k]
    ]
    errors += _absorbed(leads, C, columns, parameters)
    ranks = {name: k for k, name in enumerate((*KINDS, *system.chains.joints))}
    last = len(ranks)
    errors.sort(key=lambda e: [ranks.get(n, last) for n in (e.kind, e.of[0])])
    return tuple(errors)


def _error(
    lead: int,
    full: Floats,
    columns: Columns,
    parameters: ParameterSet,
    sizes: Floats,
    fitted: Estimated | None,
) -> results.RobotError:
    """An identifiable error by its coefficients in the named directions, (P,)."""
    label, unit = columns.labels[lead], parameters[lead].unit
    row = columns.turned @ full
    terms = [(k, float(row[k])) for k in np.flatnonzero(row).tolist()]
    value, sigma, known = _estimate(Combination((*terms,), unit), parameters, fitted)
    # A minus where the axis points the other way; what comes first says so.
    signs: dict[str, str] = {}
    for k in columns.order:
        if columns.labels[k].kind == label.kind and abs(abs(full[k]) - 1.0) < EQUAL:
            signs.setdefault(columns.labels[k].of, "-" if full[k] < 0.0 else "")
    of = tuple(f"{sign}{of}" for of, sign in signs.items())
    for least in (max(sigma or 0.0, float(SMALL * sizes[lead])), 0.5 * sizes[lead]):
        if main := tuple((k, c) for k, c in terms if abs(c) * sizes[k] >= least):
            break
    expression = Combination(main, unit).expression(parameters.names)
    parts = tuple(results.Coefficient(parameters.names[k], c) for k, c in main)
    given = value, sigma, "identifiable" if known else "weak", (), expression, parts
    return results.RobotError(label.kind, of, unit, *given)


def _absorbed(
    leads: NDArray[np.intp], C: Floats, columns: Columns, parameters: ParameterSet
) -> Iterator[results.RobotError]:
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
        label, within = columns.labels[k], tuple(dict.fromkeys(owners))
        error = label.kind, (label.of,), parameters[k].unit, 0.0, None
        yield results.RobotError(*error, status="absorbed", within=within)


LIMITS = {"m": 0.01, "rad": 0.01, "px": 10.0}
"""Standard deviations up to which a value of a frame or an instrument is known."""

FAR = 10.0
"""Times these from which a deviation says that nothing is known of its direction."""


@serial_blas
def breakdown(
    fitted: Fit, errors: ModelErrors, accuracies: Mapping[str, results.ToolAccuracy]
) -> results.Breakdown:
    """A calibration part by part.

    Args:
        fitted: The fit.
        errors: Errors of the measurements that were fitted.
        accuracies: The expected errors of the tool by chain.
    """
    parts = _Parts(fitted, errors)
    return results.Breakdown(
        accuracies=accuracies,
        stations=tuple(parts.frames(0)),
        tools=tuple(parts.frames(1)),
        chains=tuple(parts.chains()),
        unknown=parts.unknown(),
    )


class _Parts:
    """The parts of a fitted model with the errors of the measurements.

    Attributes:
        covariance: Of all parameters, averaged over the likely sizes of errors, shape
            (P, P).
        open_directions: Directions that are left open, see the function.
    """

    def __init__(self, fitted: Fit, errors: ModelErrors) -> None:
        """Of a fit, and the errors of all measurements that were fitted."""
        self.errors, self.fit, self.problem = errors, fitted, fitted.problem
        likely = [posterior.covariance for posterior in fitted.likely_posteriors]
        self.covariance: Floats = np.mean(likely, axis=0)
        self.open_directions = open_directions(fitted, self.covariance)

    def frames(self, end: int) -> Iterator[results.FrameSummary]:
        """The stations, end 0, or the tools, end 1."""
        by_frame: dict[results.Frame, list[BlockKey]] = {}
        for key, term in self.problem.terms.items():
            by_frame.setdefault(results.frames_of(term)[end][0], []).append(key)
        calibrated = CalibratedModel.create(*self.fit.solved)
        for frame, keys in by_frame.items():
            term, at = self.problem.terms[keys[0]], calibrated.of(keys[0])
            T, chain = (at.tool if end else at.error.base), term.error.chain
            _, index = results.frames_of(term)[end]
            screws = term.error.screws[-FRAME:] if end else term.error.screws[:FRAME]
            theta = self.fit.theta[index]
            twists, _ = ordered_screws(screws, theta, screws[0].frame + 1)
            yield results.FrameSummary(
                frame.name,
                chain.tip if end else chain.base,
                *self._statistics(keys),
                xyz=tuple(T.translation.tolist()),
                rpy=tuple(pin.rpy.matrixToRpy(T.rotation).tolist()),
                sigma=self._deviations(index, np.kron(np.eye(2), T.rotation) @ twists),
                estimated=bool(self.problem.parameters.free[index].any()),
            )

    def chains(self) -> Iterator[results.ChainSummary]:
        """The chains."""
        still = set(still_joints(self.problem))
        for name in self.problem.chains.names:
            chain = self.problem.chains[name]
            keys = [key for key in self.problem.terms if key.chain == name]
            count, errors, _ = self._statistics(keys)
            motionless = tuple(joint for joint in chain.joints if joint in still)
            yield results.ChainSummary(
                name, chain.base, chain.tip, chain.joints, count, errors, motionless
            )

    def _statistics(
        self, keys: Collection[BlockKey]
    ) -> tuple[int, tuple[results.QuantityErrors, ...], tuple[VarianceComponent, ...]]:
        """Number of measurements of some blocks, their accuracy, and noise."""
        data, layout = self.problem.data, self.problem.layout
        mask = np.array([block.key in keys for block in data.blocks])[data.block_of]
        selected = self.errors.at(mask).counted(data.weight)
        errors = quantity_errors(self.problem.layout.quantities, selected)
        kinds = {k for key in keys for k in layout.of_keys[key].tolist()}
        noise = tuple(n for k, n in enumerate(self.fit.noise) if k in kinds)
        return int(mask.sum()), errors, noise

    def _deviations(self, index: Indices, motions: Floats) -> tuple[float, ...]:
        """Standard deviations of a frame along some motions, (6, 6)."""
        if not np.isfinite(covariance := self.covariance[np.ix_(index, index)]).all():
            return ()
        variances = np.diag(motions @ covariance @ motions.T)
        sigma = np.sqrt(np.maximum(variances, 0.0))
        sigma[sigma < 1e-12] = 0.0  # Rounding: it is given.
        sigma[self._unknown(index, motions)] = np.nan
        return tuple(sigma.tolist())

    def unknown(self) -> tuple[str, ...]:
        """Names of the parameters of frames and instruments that are left open."""
        parameters = self.problem.parameters
        known = np.isfinite(self.covariance).all()
        index = np.flatnonzero(self.problem.referred & parameters.free & known)
        open_ = index[self._unknown(index, np.eye(len(index)))]
        return tuple(parameters.names[k] for k in open_)

    def _unknown(self, index: Indices, rows: Floats) -> Booleans:
        """Which sums of some parameters, rows (k, len(index)), nobody knows, (k,)."""
        sizes = np.linalg.norm(rows @ self.open_directions[index], axis=1)
        return np.asarray(sizes > 1.0)


def open_directions(fitted: Fit, covariance: Floats) -> Floats:
    """Directions of frames and instruments that measurements leave open, (P, k).

    They are as long as their deviations by `LIMITS`, and those that nothing shows a
    thousand times as long as an orthonormal one.

    Args:
        fitted: The fit.
        covariance: Of its parameters, shape (P, P).
    """
    problem, parameters = fitted.problem, fitted.problem.parameters
    mask = parameters.free & problem.referred
    for eliminated in problem.station_parameters.values():
        mask[eliminated] = False
    free = np.flatnonzero(mask)
    visible = visible_nuisances(fitted.result.jac, parameters)[free]
    rest = np.linalg.qr(visible, mode="complete")[0][:, visible.shape[1] :]
    limits = np.array([LIMITS.get(p.unit, np.inf) for p in parameters])
    relative = np.nan_to_num(covariance) / np.outer(limits, limits)
    # No other parameter can be beyond its limit.
    index = free[np.diag(relative)[free] > 1.0]
    squares, V = np.linalg.eigh(relative[np.ix_(index, index)])
    far = squares > FAR**2
    identity = np.eye(len(parameters))
    little = V[:, far] * np.sqrt(squares[far])
    return np.hstack([identity[:, free] @ (1e3 * rest), identity[:, index] @ little])
