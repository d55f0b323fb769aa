"""Solvers on calibration problems: search, Gauss-Newton, and both after one another."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

import calib_pin
from benchmarks.exact import exact_problem
from benchmarks.recovery import CASES, Study
from calib_pin.errors import OptionError
from calib_pin.estimation.fit import fit
from calib_pin.estimation.fitted import Fit
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.setup import Setup, SolverSetup
from calib_pin.solvers import Status
from calib_pin.validation.assessment import estimates, fitted_ranks
from tests.shared import refused

RANGER = calib_pin.read_setup(calib_pin.robot_file("space6", "setup.yaml"))
FEW = {"population_size": 12, "maxiter": 5}
"""A search that is over soon."""


def ranger_problem(
    seed: int, size: float = 1e-3, *, count: int = 60, setup: Setup = RANGER
) -> tuple[Problem, np.ndarray]:
    """`space6` with uniform DH errors up to a size, and the truth [m, rad]."""
    rng = np.random.default_rng(seed)
    nominal = nominal_problem(calib_pin.load_chain("space6"), "plane-distance", setup)
    parameters = nominal.parameters
    moved = parameters.free & ~parameters.nuisance
    drawn = rng.uniform(-size, size, len(parameters))
    truth = np.where(moved, drawn, 0.0)
    rows = calib_pin.simulate(nominal, truth, rng, count=count, noise=1e-4)
    return make_problem(nominal.chains, rows, setup), truth


def solved(problem: Problem, name: str, **evolution: str | float) -> Fit:
    setup = replace(problem.setup, solver=SolverSetup(name, evolution))
    return fit(replace(problem, setup=setup), np.random.default_rng(0))


def scatter(found: Fit) -> float:
    """Standard deviation of unit weight against what the rows state."""
    return found.sigma0 * float(found.problem.units.max(initial=0.0) or 1.0)


def test_hybrid_solves_starts_from_which_gauss_newton_alone_fails() -> None:
    """And large errors reveal directions that the nominal geometry hides."""
    problem, _ = ranger_problem(0, 0.08)
    assert scatter(solved(problem, "gauss-newton")) > 50.0
    found = solved(problem, "hybrid")
    assert scatter(found) < 1.5
    assert found.structure.rank == 24
    assert found.rank == 24 + found.directions.revealed > 24
    # Fixed parameters stay exactly, and what moved is not called without effect.
    fixed = ~found.problem.parameters.free
    assert fixed.any() and (found.theta[fixed] == 0.0).all()
    values, _ = estimates(found.problem.parameters, found.structure, found)
    hidden = [p for p in values if p.status == "unidentifiable"]
    assert all(p.value == 0.0 for p in hidden)
    assert fitted_ranks(found).revealed == found.directions.revealed


def test_all_solvers_agree_on_errors_of_expected_size() -> None:
    problem, _ = ranger_problem(0, count=100)
    plain, search, both = (
        solved(problem, name) for name in ("gauss-newton", "de", "hybrid")
    )
    assert both.result.cost == pytest.approx(plain.result.cost, rel=1e-8)
    assert search.result.cost == pytest.approx(plain.result.cost, rel=1e-2)
    assert search.result.cost >= plain.result.cost * (1.0 - 1e-8)
    assert plain.rank == search.rank == both.rank == 24
    # The search does not wander in directions that nothing sees.
    sigma = np.sqrt(np.diag(plain.covariance))
    assert (np.abs(search.theta - plain.theta) <= 0.5 * sigma + 1e-9).all()
    assert (plain.result.evaluator, search.result.evaluator) == ("pinocchio", "kernel")


def test_two_steps_by_turns_reach_the_joint_solution() -> None:
    """Frames and places, then the robot, until they agree (Wu et al.)."""
    case = CASES["named points"]
    study = Study(case, seed=5)
    truth = study.truth()
    rows = calib_pin.simulate(
        study.problem, truth, study.rng, count=case.rows, noise=5e-5
    )
    problem = make_problem(study.problem.chains, rows, study.problem.setup)
    joint, turns = (solved(problem, name) for name in ("gauss-newton", "two-step"))
    assert turns.problem.setup.solver.name == "two-step"
    assert turns.result.status is Status.CONVERGED
    assert turns.rank == joint.rank == case.rank
    assert turns.result.cost == pytest.approx(joint.result.cost, rel=1e-6, abs=1e-12)
    sigma = np.sqrt(np.diag(joint.covariance)) + 1e-9
    assert (np.abs(turns.theta - joint.theta) <= 1e-3 * sigma + 1e-9).all()


@pytest.mark.parametrize(
    ("options", "status"),
    [
        (FEW, Status.GENERATIONS),
        # A population that met far from a minimum.
        ({"population_size": 12, "tol": 1.0}, Status.COLLAPSED),
    ],
)
def test_a_search_without_a_minimum_is_not_trusted(
    options: dict[str, float], status: Status, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Other readings of the measurements would explain what is left no better.
    monkeypatch.setattr("calib_pin.validation.findings.readings.FAMILIES", ())
    problem, _ = ranger_problem(0, 3e-3)
    setup = replace(RANGER, solver=SolverSetup("de", options))
    result = calib_pin.calibrate(problem.chains, problem.data, setup, validate=False)
    assert result.solver.status == status.value
    assert result.verdict == "untrusted" and "hybrid" in result.reason


def test_a_target_ends_a_search_early() -> None:
    problem, _ = ranger_problem(0, 3e-3)
    least = solved(problem, "gauss-newton").result.cost
    found = solved(problem, "de", target=10.0 * least)
    assert found.result.status is Status.TARGET
    assert found.result.evolution is not None
    history = found.result.evolution.best_history
    assert least < history[-1] <= 10.0 * least < history[-2] < history[0]


def test_nothing_to_search() -> None:
    problem, _ = ranger_problem(0, 0.0, setup=replace(RANGER, fixed=("*",)))
    for name in ("gauss-newton", "de", "hybrid"):
        found = solved(problem, name)
        assert (found.theta == 0.0).all()
        assert (found.rank, found.result.status) == (0, Status.CONVERGED)


def test_a_search_keeps_to_bounds_and_fixed_parameters() -> None:
    setup = replace(RANGER, bounds={"joint_2.dh.a": 2e-4}, fixed=("joint_5.*",))
    problem, truth = ranger_problem(5, 2e-3, setup=setup)
    k = problem.parameters.index("joint_2.dh.a")
    assert abs(truth[k]) > 1e-3
    fixed = [name.startswith("joint_5.") for name in problem.parameters.names]
    for name in ("de", "hybrid"):
        found = solved(problem, name)
        assert found.theta[k] == np.sign(truth[k]) * 2e-4
        assert (found.theta[fixed] == 0.0).all()


def test_priors_few_rows_and_rounding_reveal_nothing() -> None:
    problem, _ = ranger_problem(0, setup=replace(RANGER, prior={"*.dh.*": 2e-3}))
    found = solved(problem, "gauss-newton")
    assert found.rank > 24 and fitted_ranks(found).revealed == 0
    problem, _ = ranger_problem(0, count=3)
    assert fitted_ranks(solved(problem, "gauss-newton")).revealed == 0
    # What 24 directions have explained without noise leaves no 25th to find.
    problem, _ = ranger_problem(1)
    found = solved(problem, "gauss-newton")
    at = problem.data.q, problem.data.target
    exact = exact_problem(found.problem, found.theta, *at)
    again = solved(replace(exact, units=np.zeros(0)), "gauss-newton")
    assert again.rank == 24 and again.evidence is None
    assert np.abs(again.problem.errors(again.theta)).max() < 1e-11


def test_progress_goes_from_stage_to_stage() -> None:
    problem, _ = ranger_problem(0)
    setup = replace(RANGER, solver=SolverSetup("hybrid", FEW))
    seen: list[tuple[str, float]] = []
    calib_pin.calibrate(
        problem.chains,
        problem.data,
        setup,
        progress=lambda stage, part: seen.append((stage, part)),
    )
    stages = list(dict.fromkeys(stage for stage, _ in seen))
    assert stages == ["fit", *(f"check {k} of 5" for k in range(1, 6))]
    parts = [part for _, part in seen]
    assert parts == sorted(parts) and parts[0] == 0.0 and 0.8 < parts[-1] <= 1.0


@pytest.mark.parametrize(
    ("solver", "fields"),
    [
        (SolverSetup("lm"), {"reason": "'lm'"}),
        (SolverSetup("de", {"recombination": 1.5}), {"value": 1.5}),
        (SolverSetup("gauss-newton", {"maxiter": 0}), {"reason": "maxiter"}),
        (SolverSetup("de", {"popsize": 15}), {"reason": "'popsize'"}),
    ],
)
def test_options_that_do_not_exist(solver: SolverSetup, fields: dict[str, Any]) -> None:
    problem, _ = ranger_problem(0, count=10)
    setup = replace(RANGER, solver=solver, file="lab.yaml")
    with refused(OptionError, **fields, file="lab.yaml"):
        fit(replace(problem, setup=setup), np.random.default_rng(0))
