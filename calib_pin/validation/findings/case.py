"""The measurements and the fit in which faults of the data are sought."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property
from itertools import combinations
from typing import Any

import numpy as np

from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.problem import EXACT, Problem, error_table
from calib_pin.estimation.statistics.variance_components import candidates
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices, Observations
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.parameterizations.base import expected_size
from calib_pin.parameterizations.placement import JointOffset, Placement
from calib_pin.progress import Progress
from calib_pin.setup import Setup
from calib_pin.validation.findings.quick_fit import (
    CHANCE,
    QuickFit,
    below_sheet,
    trimmed,
)
from calib_pin.validation.result import ToolAccuracy

MEASUREMENTS = 300
"""Measurements that are looked at; more do not make it clearer."""

DOUBTFUL = 0.5
"""Remaining errors, in expected sizes of an error, from which explanations are sought.

A calibrated robot leaves less, unless its gears and links bend.
"""


FOREIGN = 20.0
"""Errors of a nominal robot, in the same sizes, that hardly any robot has."""

ABSURD = 200.0
"""Errors of a nominal robot, in the same sizes, that no robot has."""


REBUILT = 60.0
"""Correction of an origin, in the same sizes, that makes another robot of it."""

FAR = 8.0
"""Errors of an outlier, in medians of those of the nominal robot."""

SOME = 0.1
"""Largest part of the measurements that are outliers of it; more are another fault."""

STEPS = 8
"""Most steps of the fit to measurements that a robot is compared with."""

LACKING = 0.5
"""Part of the sum of squares that they leave at most."""

Others = Callable[[], Iterable[Chains]]
"""Chains with the same joints of other robots that may have been measured; asked only
where no robot explains the errors."""


@dataclass(frozen=True)
class Case:
    """Measurements, and a robot that was fitted to them.

    Attributes:
        chains: The nominal chains.
        data: The measurements that were fitted, with the weights of the fit.
        fit: The solution before some of them, in the order of the blocks.
        rank: Place of each of these in the order of the files, among all, (N,).
        nominal: Parameter values of the registered nominal robot, shape (P,).
        fitted: The whole fit; None where measurements are only compared with a robot.
        progress: Told how far the search for explanations is.
        others: Other robots that may have been measured.
        accuracies: Accuracy to expect of each chain; empty where nothing is known.
    """

    chains: Chains
    data: Observations
    fit: QuickFit
    rank: Indices
    nominal: Floats
    fitted: Fit | None = None
    progress: Progress | None = None
    others: Others = tuple
    accuracies: Mapping[str, ToolAccuracy] = field(default_factory=dict)

    @staticmethod
    def of(fitted: Fit, chains: Chains, *more: Any, **named: Any) -> Case:
        """The case of a whole fit, with further attributes."""
        data = fitted.problem.data
        some, rank = some_of(data)
        problem = replace(fitted.problem, data=some, expected=None)
        fit = QuickFit(problem, fitted.theta, whole=True)
        return Case(chains, data, fit, rank, fitted.before, fitted, *more, **named)

    @staticmethod
    def of_robot(
        chains: Chains, data: Observations, setup: Setup, others: Others = tuple
    ) -> Case:
        """The case of measurements that are only compared with a robot.

        Raises:
            CalibPinError: If a part of the measurements cannot be registered.
        """
        none = Case.of_none(chains, data, setup, others)
        problem = none.fit.problem
        fit = QuickFit.of(replace(problem, data=_without_outliers(problem)), STEPS)
        nominal = np.where(fit.problem.parameters.nuisance, fit.theta, 0.0)
        return replace(none, fit=fit, nominal=nominal)

    @staticmethod
    def of_none(
        chains: Chains, data: Observations, setup: Setup, others: Others = tuple
    ) -> Case:
        """The case of measurements on which no robot can be registered.

        Raises:
            CalibPinError: If they make no problem.
        """
        some, rank = some_of(data)
        problem = make_problem(chains, some, replace(setup, learned=None))
        zero = np.zeros(len(problem.parameters))
        return Case(chains, data, QuickFit(problem, zero), rank, zero, others=others)

    def unit(self, joint: str) -> str:
        """Unit of a joint's position; one that is in no chain turns."""
        return "rad" if self.turns(joint) else "m"

    def turns(self, joint: str) -> bool:
        """Whether a joint turns; one that is in no chain does."""
        joints, revolute = self.chains.joints, self.chains.revolute
        return joint not in joints or bool(revolute[joints.index(joint)])

    @property
    def setup(self) -> Setup:
        """The setup of the fit."""
        return self.fit.problem.setup

    @property
    def informed(self) -> bool:
        """Whether errors of the robot were fitted; few measurements only compare."""
        return self.fitted is not None or self.fit.redundant

    @cached_property
    def doubtful(self) -> bool:
        """Whether errors are left that ask for an explanation.

        Without a whole fit nobody judges corrections that are as large as a robot. With
        one, it may have been fitted to measurements as small as the errors of a robot.
        """
        if not self.errors_left <= (DOUBTFUL if self.informed else FOREIGN):
            return True
        known = self.fitted is not None and self.fit.largest_correction <= REBUILT
        return self.errors_nominal > (ABSURD if known else FOREIGN)

    @cached_property
    def errors_left(self) -> float:
        """Remaining errors, rms in expected sizes of an error, of the worst quantity.

        Neither what was set aside counts, nor the largest of the others: a beam that
        grazes its plane errs by far more than they do.
        """
        return self._errors(self.fit.table)

    @cached_property
    def errors_nominal(self) -> float:
        """The same of the registered nominal robot."""
        table = error_table(self.fit.problem, self.nominal)
        return self._errors(table[self.fit.problem.data.weight > 0.0])

    def _errors(self, table: Floats) -> float:
        sizes = [np.inf if below_sheet(self.fit.problem) else 0.0]
        for quantity in self.fit.problem.layout.quantities:
            squares = np.sort(quantity.errors(table) ** 2)
            usual = squares[: int(np.ceil((1.0 - SOME) * len(squares)))]
            if len(usual):
                size = float(np.sqrt(np.mean(usual)))
                sizes.append(size / expected_size(quantity.unit))
        return max(sizes)

    @cached_property
    def lacking(self) -> tuple[tuple[str, ...], float]:
        """Families that explain most, and the part of the squares that they leave.

        None of them, and all of it, where none stands out. One or two families of
        parameters that were not asked for are tried at once, with all columns that they
        add to the Jacobian; placements where only joint offsets were estimated.
        """
        fit, names = self.fit, self.setup.parameters
        if self.fitted is None or not names or fit.rms <= EXACT:
            return (), 1.0
        families = [PARAMETERIZATIONS[name] for name in names]
        placed = any(f.geometric and f.name != JointOffset.name for f in families)
        effects = candidates(fit.problem, () if placed else (Placement.name,))
        if effects is None:
            return (), 1.0
        X, kinds = effects.rows(fit.problem, fit.theta), np.array(effects.kinds)
        if not np.isfinite(X).all():
            return (), 1.0
        each, found = dict.fromkeys(effects.kinds), []
        for some in (*((kind,) for kind in each), *combinations(each, 2)):
            own = np.isin(kinds, some)
            if own.sum() >= fit.problem.data.configurations:
                continue  # They explain whatever a configuration errs by.
            score = fit.score(X[:, own])
            if score.chance < CHANCE and score.left < LACKING:
                # By Schwarz's criterion: two families explain more than one anyway.
                cost = fit.left * np.log(max(score.left, 1e-300))
                found.append((cost + own.sum() * np.log(fit.left), some, score.left))
        return min(found)[1:] if found else ((), 1.0)


def _without_outliers(problem: Problem) -> Observations:
    """Measurements, without weight where the nominal robot fits them far worse."""
    size = np.sqrt(trimmed(problem)[1])
    out = size > FAR * max(float(np.median(size)), 1.0)
    few = out.mean() <= SOME
    return problem.data.weighted(np.where(out & few, 0.0, 1.0))


def some_of(data: Observations) -> tuple[Observations, Indices]:
    """At most so many measurements, evenly over the files, and their places."""
    rank = np.argsort(data.in_order)
    if len(data) <= MEASUREMENTS:
        return data, rank
    ranks = np.linspace(0, len(data) - 1, MEASUREMENTS).astype(np.int64)
    kept = np.isin(rank, ranks)
    return data.rows(kept), rank[kept]
