"""Differential evolution: ours beside the usual alternatives.

All minimize the same cost: space6 with its 24 DH errors and the direction of the plane,
100 distances. Ours are whole calibrations without validation, as the command runs them,
and choose their own box around the nominal robot; the others search one that is about
as large. All but Gauss-Newton may evaluate 150 members in 501 generations; evolutions
of scipy take one first population.

Gauss-Newton knows no box and may leave it: its reach, in half widths, is printed.
Times are the shortest of up to five runs; the loop, which takes most of a minute and so
evens out the noise by itself, runs once.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import partial

import numpy as np
from numpy.typing import NDArray
from scipy import optimize

import calib_pin
from benchmarks.ranger import Ranger
from calib_pin.estimation.formulation import make_problem, nominal_problem
from calib_pin.estimation.problem import Problem
from calib_pin.estimation.solve import PopulationCost
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.plane_distance import PlaneDistance
from calib_pin.setup import SolverSetup
from calib_pin.solvers import gauss_newton

MEMBERS, GENERATIONS, F, CR = 150, 500, 0.6, 0.9

BUDGET = MEMBERS * (GENERATIONS + 1)
"""Evaluations."""

SIZE, TURN = 3e-3, (0.002, -0.001)
"""Largest DH error of the true robot [m, rad], and its plane's u and v."""

BOX = 10e-3
"""Half width of the search [m, rad]."""

ROWS, NOISE = 100, 0.2e-3 / np.sqrt(10.0)
"""Measurements, and their standard deviation [m]."""

Run = Callable[[], tuple[float, str]]
"""Minimizes; returns the cost and what else to say."""


def main() -> None:
    """Print a table."""
    problem, ranger = ranger_problem()
    free = np.flatnonzero(problem.parameters.free)
    bounds = np.tile([-BOX, BOX], (len(free), 1))
    kernel = PopulationCost(problem)

    def costs(members: Floats) -> Floats:
        theta = np.zeros((len(members), len(problem.parameters)))
        theta[:, free] = members
        return kernel(theta)

    first = np.random.default_rng(1).uniform(-BOX, BOX, (MEMBERS, len(free)))
    expected = costs(first)  # Compiles as well.
    np.testing.assert_allclose(ranger.matrices(first.T), expected, rtol=1e-9)
    np.testing.assert_allclose(ranger.vectors(first.T), expected, rtol=1e-9)
    np.testing.assert_allclose(ranger.loop(first[0]), expected[0], rtol=1e-9)

    ours = partial(_ours, problem)
    scipy = partial(_scipy, bounds, first)
    print(
        f"{len(free)} parameters, {ROWS} configurations, {MEMBERS} members, "
        f"{GENERATIONS} generations"
    )
    print(f"{'':<40}{'seconds':>9}{'ratio':>8}{'cost':>10}")
    seconds = _show("calib-pin, tradeoff", partial(ours, "tradeoff"), 5)
    line = partial(_show, reference=seconds)
    line("one Pinocchio loop, 1000 times", partial(_loops, ranger), 3)
    for strategy in ("best/1", "rand/1"):
        line(f"calib-pin, {strategy}", partial(ours, strategy), 3)
    for strategy, name, cost in (
        ("rand1bin", "matrices", ranger.matrices),
        ("best1bin", "matrices", ranger.matrices),
        ("randtobest1bin", "matrices", ranger.matrices),
        ("randtobest1bin", "vectors", ranger.vectors),
    ):
        run = partial(scipy, cost, strategy, vectorized=True)
        line(f"scipy, {strategy}, numpy {name}", run, 2)
    line("scipy, best1bin, Pinocchio loop", partial(scipy, ranger.loop, "best1bin"))
    line("cma, our cost", partial(_cma, costs, bounds), 2)
    line("Gauss-Newton, many starts", partial(_starts, problem, free, seconds))
    line("calib-pin, gauss-newton", partial(_calibrated, problem, SolverSetup()), 5)


def ranger_problem() -> tuple[Problem, Ranger]:
    """100 distances to a plane, and their cost as one would write it."""
    chain = calib_pin.load_chain("space6")
    setup = calib_pin.read_setup(calib_pin.robot_file("space6", "setup.yaml"))
    setup = replace(setup, fixed=("wall.plane.f",))
    nominal = nominal_problem(chain, "plane-distance", setup)
    rng = np.random.default_rng(0)
    free = nominal.parameters.free
    truth = np.where(free, rng.uniform(-SIZE, SIZE, len(free)), 0.0)
    truth[-3:-1] = TURN
    rows = calib_pin.simulate(nominal, truth, rng, count=ROWS, noise=NOISE)
    problem = make_problem(chain, rows, setup)
    model = problem.only.measurement
    assert isinstance(model, PlaneDistance)
    return problem, Ranger(problem, model.planes[0])


def _show(
    name: str, run: Run, repetitions: int = 1, reference: float | None = None
) -> float:
    """One line of the table; returns the shortest time [s]."""
    times = []
    for _ in range(repetitions):
        start = time.perf_counter()
        cost, remark = run()
        times.append(time.perf_counter() - start)
    seconds = min(times)
    ratio = seconds / (reference or seconds)
    print(f"{name:<40}{seconds:9.2f}{ratio:8.1f}{cost:10.4g}  {remark}".rstrip())
    return seconds


def _ours(problem: Problem, strategy: str) -> tuple[float, str]:
    options: dict[str, str | float] = {
        "strategy": strategy,
        "population_size": MEMBERS,
        "mutation": F,
        "recombination": CR,
        "maxiter": GENERATIONS,
        "tol": 0.0,
    }
    return _calibrated(problem, SolverSetup("de", options))


def _calibrated(problem: Problem, solver: SolverSetup) -> tuple[float, str]:
    """A calibration without validation."""
    setup = replace(problem.setup, solver=solver)
    start = time.process_time()
    found = calib_pin.calibrate(
        problem.chains, problem.data, setup, validate=False, seed=2
    )
    each = (time.process_time() - start) / found.solver.evaluations
    return (
        0.5 * found.statistics.chi2,
        f"{1e6 * each:.1f} us each" if found.solver.history else "",
    )


def _loops(ranger: Ranger) -> tuple[float, str]:
    for _ in range(1000):
        cost = ranger.loop(np.zeros(26))
    return cost, ""


def _scipy(
    bounds: Floats,
    first: Floats,
    cost: Callable[[Floats], Floats | float],
    strategy: str,
    *,
    vectorized: bool = False,
) -> tuple[float, str]:
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # That the limit was reached.
        found = optimize.differential_evolution(
            cost,
            bounds,
            strategy=strategy,
            init=first,
            mutation=F,
            recombination=CR,
            maxiter=GENERATIONS,
            tol=0.0,
            polish=False,
            rng=np.random.default_rng(2),
            vectorized=vectorized,
            updating="deferred" if vectorized else "immediate",
        )
    assert found.nfev == BUDGET or vectorized
    return float(found.fun), ""


def _cma(costs: Callable[[Floats], Floats], bounds: Floats) -> tuple[float, str]:
    """CMA-ES from the middle of the box with the same number of evaluations."""
    import cma

    options = {
        "bounds": [-1.0, 1.0],
        "maxfevals": BUDGET,
        "seed": 2,
        "tolfun": 0,
        "tolfunhist": 0,
        "tolx": 0,
        "tolflatfitness": BUDGET,
        "popsize": MEMBERS,
        "verbose": -9,
    }
    half = bounds[:, 1]
    search = cma.CMAEvolutionStrategy(np.zeros(len(half)), 0.3, options)
    while not search.stop():
        members = search.ask()
        search.tell(members, costs(half * np.array(members)).tolist())
    return float(search.result.fbest), ""


def _starts(
    problem: Problem, free: NDArray[np.intp], seconds: float
) -> tuple[float, str]:
    """From random starts in the box for as many seconds."""
    rng, ends, reach = np.random.default_rng(2), [], 0.0
    basis = np.diag(problem.parameters.scales)[:, free]
    begin = time.perf_counter()
    while time.perf_counter() - begin < seconds:
        x = np.zeros(len(problem.parameters))
        x[free] = rng.uniform(-BOX, BOX, len(free))
        found = gauss_newton(problem.linearize, problem.cost, x, basis)
        ends.append(found.cost)
        reach = max(reach, np.abs(found.x).max() / BOX)
    reached = sum(end < 1.001 * min(ends) for end in ends)
    return min(ends), f"{reached} of {len(ends)}, reach {reach:.1f}"
