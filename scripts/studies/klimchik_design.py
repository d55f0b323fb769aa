"""Configurations that are planned for the accuracy at stated test poses.

The criterion is that of case D, the predicted variance of the position there. All
reference points are measured at every configuration, which `calib_pin.plan` does not
know: it gives each configuration a point of its own.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cache

import numpy as np

from calib_pin.estimation.formulation import nominal_problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.planning.criteria import Information, Prediction
from calib_pin.planning.planned_problem import TipTests, identification
from calib_pin.planning.rows import IdentificationRows
from calib_pin.planning.search import Search
from calib_pin.planning.workspace import Workspace
from studies.klimchik_arm import (
    REACH,
    Settings,
    configurations,
    measure,
    task_poses,
    truth,
)
from studies.klimchik_model import calibrated, robot, setup_of
from studies.shared import summary

RANDOM, PLANNED = "random", "planned"
"""The two ways to choose configurations for the test poses."""

DESIGN = 2015
"""Seed of the test poses and the plan."""

STRUCTURE = 300
"""Candidates for the identifiability analysis."""


@dataclass(frozen=True)
class Design:
    """The expected accuracy at the test poses of a set of configurations.

    Attributes:
        rows: Identification matrices of the configurations.
        tests: Test poses, shape (T, 6) [rad].
        criterion: Predicted error of the tool at the test poses.
        workspace: Constraints on the configurations.
        known: Prior information matrix.
    """

    rows: IdentificationRows
    tests: Floats
    criterion: Prediction
    workspace: Workspace
    known: Floats

    @staticmethod
    @cache
    def create(settings: Settings) -> Design:
        """The design of the nominal robot; the test poses are the same for all."""
        rng = np.random.default_rng(DESIGN)
        sigma = settings.noise / np.sqrt(settings.repeats)
        setup = replace(
            setup_of(known=True), noise={"position": float(sigma)}, region=REACH
        )
        problem = nominal_problem(robot(), "position", setup)
        workspace = Workspace.create(problem)
        spread = workspace.candidates(STRUCTURE, rng)
        _, rows, known = identification(problem, workspace.aims, spread)
        tests = task_poses(settings.tests, rng)
        criterion = Prediction(TipTests.of(rows, spread, tests).position)
        return Design(rows, tests, criterion, workspace, known)

    def predicted(self, q: Floats) -> float:
        """Root-mean-square error at the test poses that noise leaves [m]."""
        rows = self.rows.rows(q, np.zeros(len(q), int))
        U = rows.reshape(-1, rows.shape[2])
        found = Information.of(self.known + U.T @ U, self.rows.nuisances)
        return np.inf if found is None else self.criterion.value(found, len(q))


def plan_poses(settings: Settings) -> Floats:
    """Configurations with the least predicted error at the test poses, (N, 6)."""
    design, rng = Design.create(settings), np.random.default_rng(DESIGN)
    search = Search(
        design.rows,
        design.workspace,
        design.criterion,
        design.known,
        design.workspace.candidates(settings.candidates, rng),
        settings.count,
        rng,
        starts=settings.starts,
    )
    return search.run("auto").q


@dataclass(frozen=True)
class Planned:
    """Accuracy at the test poses after a calibration.

    Attributes:
        predicted: Root-mean-square error that noise leaves of the nominal robot [m].
        errors: Errors of the tool's position, shape (T,) [m].
    """

    predicted: float
    errors: Floats

    def numbers(self) -> dict[str, float]:
        """The numbers that are written."""
        return {"predicted_rms_m": self.predicted} | summary(self.errors, "m")


def at_test_poses(
    settings: Settings, planned: Floats, rng: np.random.Generator
) -> dict[str, Planned]:
    """Calibrate the same stiff robot at planned and at random configurations."""
    design = Design.create(settings)
    problem, theta = truth(rng, settings.length, settings.angle)
    true = problem.only.error.poses(design.tests, problem.only.values(theta)[0])
    result = {}
    for name, q in (
        (RANDOM, configurations(settings.count, rng)),
        (PLANNED, planned),
    ):
        rows = measure(
            problem, theta, q, rng, noise=settings.noise, repeats=settings.repeats
        )
        found = calibrated(rows, setup_of(known=True)).model.of().poses(design.tests)
        errors = np.linalg.norm((found - true)[:, :3, 3], axis=1)
        result[name] = Planned(design.predicted(q), errors)
    return result
