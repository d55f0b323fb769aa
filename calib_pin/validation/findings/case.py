"""The measurements and the fit in which faults of the data are sought."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np

from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import make_problem
from calib_pin.estimation.problem import Problem, error_table
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices, Observations
from calib_pin.parameterizations.base import expected_size
from calib_pin.progress import Progress
from calib_pin.setup import Setup
from calib_pin.validation.findings.quick_fit import QuickFit, below_sheet, located
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

ROUNDS = 3
"""Most rounds in which they are found."""


LINKS = {"base": "base-link", "tip": "tip-link"}
"""Codes of findings that say which link is measured, by the end of the chain."""


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
        held_out: Validation measurements; None without.
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
    held_out: Observations | None = None
    progress: Progress | None = None
    others: Others = tuple
    accuracies: Mapping[str, ToolAccuracy] = field(default_factory=dict)

    @staticmethod
    def of(
        fitted: Fit,
        chains: Chains,
        held_out: Observations | None = None,
        progress: Progress | None = None,
        others: Others = tuple,
        accuracies: Mapping[str, ToolAccuracy] = {},
    ) -> Case:
        """The case of a whole fit."""
        data = fitted.problem.data
        some, rank = some_of(data)
        problem = replace(fitted.problem, data=some, expected=None)
        return Case(
            chains,
            data,
            QuickFit(problem, fitted.theta, whole=True),
            rank,
            fitted.before,
            fitted,
            held_out,
            progress,
            others,
            accuracies,
        )

    @staticmethod
    def of_robot(
        chains: Chains, data: Observations, setup: Setup, others: Others = tuple
    ) -> Case:
        """The case of measurements that are only compared with a robot.

        Raises:
            CalibPinError: If a part of the measurements cannot be registered.
        """
        some, rank = some_of(data)
        problem = make_problem(chains, some, replace(setup, learned=None))
        problem = replace(problem, data=_without_outliers(problem))
        fit = QuickFit.of(problem, STEPS)
        robot = ~fit.problem.parameters.nuisance
        nominal = np.where(robot, 0.0, fit.theta)
        return Case(chains, data, fit, rank, nominal, others=others)

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
        return self._errors(self.nominal_table[self.fit.problem.data.weight > 0.0])

    @cached_property
    def nominal_table(self) -> Floats:
        """Errors of the registered nominal robot, see `error_table`, shape (N, D)."""
        return error_table(self.fit.problem, self.nominal)

    def _errors(self, table: Floats) -> float:
        problem = self.fit.problem
        sizes = [np.inf if below_sheet(problem) else 0.0]
        for quantity in problem.layout.quantities:
            squares = np.sort(quantity.errors(table) ** 2)
            usual = squares[: int(np.ceil((1.0 - SOME) * len(squares)))]
            if len(usual):
                size = float(np.sqrt(np.mean(usual)))
                sizes.append(size / expected_size(quantity.unit))
        return max(sizes)


def _without_outliers(problem: Problem) -> Observations:
    """Measurements, without weight where the nominal robot fits them far worse."""
    data, zero = problem.data, np.zeros(len(problem.parameters))
    for _ in range(ROUNDS):
        there = located(replace(problem, data=data))
        sigma = there.layout.table(there.given_sigma, len(data))
        table = np.nan_to_num(error_table(there, zero) / sigma, posinf=1e9)
        size = np.sqrt(np.sum(table**2, axis=1))
        out = size > FAR * max(float(np.median(size)), 1.0)
        if not 0.0 < out.mean() <= SOME:
            break
        if np.array_equal(out, data.weight == 0.0):
            break
        data = data.weighted(np.where(out, 0.0, 1.0))
    return data


def some_of(data: Observations) -> tuple[Observations, Indices]:
    """At most so many measurements, evenly over the files, and their places."""
    rank = np.argsort(data.in_order)
    if len(data) <= MEASUREMENTS:
        return data, rank
    ranks = np.linspace(0, len(data) - 1, MEASUREMENTS).astype(np.int64)
    kept = np.isin(rank, ranks)
    return data.rows(kept), rank[kept]
