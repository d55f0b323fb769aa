"""The particle swarm on functions with known minima; no robots here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest

from calib_pin.errors import OptionError
from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import EvolutionResult, ParticleSwarm, Status, particle_swarm
from calib_pin.solvers.evolution import Box
from calib_pin.solvers.particle_swarm import _Swarm

WIDE = np.tile([-5.0, 5.0], (5, 1))
QUICK = ParticleSwarm(particles=20, iterations=30)


def sphere(x: Floats) -> Floats:
    return np.sum((x - 1.0) ** 2, axis=1)


def rosenbrock(x: Floats) -> Floats:
    valley = 100 * (x[:, 1:] - x[:, :-1] ** 2) ** 2
    return np.sum(valley + (1 - x[:, :-1]) ** 2, axis=1)


def rastrigin(x: Floats) -> Floats:
    return np.sum((x - 1) ** 2 + 10 - 10 * np.cos(2 * np.pi * (x - 1)), axis=1)


def run(
    costs: Callable[[Floats], Floats] = sphere,
    options: ParticleSwarm = QUICK,
    bounds: Floats = WIDE,
    seed: int = 0,
    **arguments: object,
) -> EvolutionResult:
    rng = np.random.default_rng(seed)
    return particle_swarm(
        costs,
        bounds,
        rng,
        options,
        **arguments,  # type: ignore[arg-type]
    )


@pytest.mark.parametrize(
    ("costs", "bounds", "within"),
    [
        (sphere, WIDE, 2e-3),
        (rosenbrock, WIDE[:2], 0.02),
        (rastrigin, WIDE[:3], 1e-3),
    ],
)
@pytest.mark.parametrize("seed", range(3))
def test_known_minima(
    costs: Callable[[Floats], Floats], bounds: Floats, within: float, seed: int
) -> None:
    options = ParticleSwarm(particles=60, iterations=400, target=1e-6)
    result = run(costs, options, bounds, seed)
    assert result.status is Status.TARGET
    assert result.x == pytest.approx(np.ones(len(bounds)), abs=within)


def test_the_swarm_converges_in_one_basin() -> None:
    options = ParticleSwarm(particles=30, iterations=500, mutation=0.0, tol=1e-6)
    result = run(lambda x: sphere(x) + 1.0, options)
    assert result.status is Status.CONVERGED and result.status.success
    assert result.nit < 500
    assert result.x == pytest.approx(np.ones(5), abs=0.01)


def test_as_printed_it_does_not_converge() -> None:
    options = ParticleSwarm(particles=30, iterations=300, mutation=0.0)
    ours, printed = (
        np.median(
            [run(options=replace(options, inertia=k), seed=s).fun for s in (0, 1)]
        )
        for k in (options.inertia, 1.0)
    )
    assert ours < 1e-10 < 1e-3 < printed


def test_the_same_seed_gives_the_same_bytes() -> None:
    one, two, other = (run(seed=seed) for seed in (3, 3, 4))
    assert one.population.tobytes() == two.population.tobytes()
    assert one.mean_history.tobytes() == two.mean_history.tobytes()
    assert one.x.tobytes() != other.x.tobytes()


def test_particles_stay_within_bounds_and_are_counted() -> None:
    seen: list[Floats] = []

    def costs(x: Floats) -> Floats:
        seen.append(x.copy())
        return x @ np.array([1.0, -1.0, 1.0, 1.0])

    # The minimum is in a corner; one component is fixed, one is narrow.
    bounds = np.array([[-1.0, 1.0], [0.1, 0.3], [0.7, 0.7], [1e-12, 3e-12]])
    options = ParticleSwarm(20, 40, velocity=1.0, crossover=0.5, mutation=0.5, tol=0)
    result = run(costs, options, bounds)
    places = np.concatenate(seen)
    assert (bounds[:, 0] <= places).all() and (places <= bounds[:, 1]).all()
    assert (places[:, 2] == 0.7).all()
    assert result.x[:3] == pytest.approx([-1.0, 0.3, 0.7], rel=0.01)
    assert (len(seen), len(places)) == (result.nit + 1, result.nfev)
    assert result.nfev == options.budget == 20 * 41
    assert result.status is Status.GENERATIONS


def test_the_best_place_is_never_lost() -> None:
    seen: list[float] = []

    def costs(x: Floats) -> Floats:
        seen.append(rastrigin(x).min())
        return rastrigin(x)

    result = run(costs, replace(QUICK, mutation=1.0, crossover=1.0))
    assert result.best_history.tolist() == np.minimum.accumulate(seen).tolist()
    assert all(b <= a for a, b in pairwise(result.best_history))
    assert result.fun == rastrigin(result.x[None])[0] == min(seen)
    assert np.array_equal(result.population_energies, rastrigin(result.population))


def test_x0_are_places_of_the_first_particles() -> None:
    seen: list[Floats] = []

    def costs(x: Floats) -> Floats:
        seen.append(x.copy())
        return sphere(x)

    x0 = np.array([np.ones(5), np.full(5, 2.0)])
    x0.flags.writeable = False
    result = run(costs, x0=x0)
    assert np.array_equal(seen[0][:2], x0)
    assert len(seen[0]) == 20
    assert (result.fun, result.x.tolist()) == (0.0, x0[0].tolist())


def test_what_is_not_feasible_loses() -> None:
    def costs(x: Floats) -> Floats:
        values = sphere(x)
        values[x[:, 0] > 0.5] = np.inf
        values[x[:, 1] > 0.5] = np.nan
        return values

    result = run(costs, ParticleSwarm(particles=40, iterations=300))
    assert result.x == pytest.approx([0.5, 0.5, 1.0, 1.0, 1.0], abs=0.02)
    assert (result.x[:2] <= 0.5).all()


@pytest.mark.parametrize("value", [np.nan, np.inf])
def test_nothing_is_feasible(value: float) -> None:
    result = run(lambda x: np.full(len(x), value))
    assert (result.status, result.nit, result.nfev) == (Status.NOT_FINITE, 0, 20)


def test_the_callback_sees_every_iteration_and_stops() -> None:
    seen: list[int] = []

    def callback(iteration: int, x: Floats, fun: float) -> bool:
        assert sphere(x[None])[0] == fun
        seen.append(iteration)
        return iteration == 5

    result = run(callback=callback)
    assert (result.status, result.nit) == (Status.STOPPED, 5)
    assert seen == [1, 2, 3, 4, 5]


def swarm(Y: Floats, **options: float) -> _Swarm:
    usual = {"particles": len(Y), "iterations": 10, "crossover": 0.0, "mutation": 0.0}
    return _Swarm(
        ParticleSwarm(**(usual | options)),  # type: ignore[arg-type]
        Box.of(np.tile([-1.0, 1.0], (Y.shape[1], 1))),
        Y.copy(),
        np.random.default_rng(0),
    )


def test_velocities_pull_to_the_best_places_and_are_limited() -> None:
    Y = np.full((200, 3), -0.5)
    own, costs = np.full((200, 3), 0.5), np.zeros(200)
    flight = swarm(Y, c1=1.0, c2=0.0, velocity=0.1)
    moved = flight.breed(own, costs)
    # Widths are 2 and no pull is larger than 1.
    assert (moved >= -0.5).all() and (moved <= -0.3).all()
    assert (flight.V == 0.2).mean() == pytest.approx(0.8, abs=0.05)
    flight = swarm(Y, c1=0.0, c2=1.0, velocity=1.0, w=0.5)
    step = flight.breed(own, costs) - Y
    assert step == pytest.approx(0.5 * flight.V)
    assert flight.V.mean() == pytest.approx(0.5, abs=0.05)


def test_a_particle_that_leaves_the_box_loses_its_velocity() -> None:
    Y = np.array([[0.9, 0.0], [0.9, 0.0]])
    flight = swarm(Y, c1=0.0, c2=0.0, inertia=1.0)
    flight.V[:] = [0.4, 0.4]
    flight.breed(Y, np.zeros(2))
    assert flight.V.tolist() == [[0.0, 0.4], [0.0, 0.4]]


def test_blended_pairs_keep_their_middle() -> None:
    Y = np.random.default_rng(1).uniform(-1, 1, (7, 3))
    flight = swarm(Y, crossover=1.0, c2=0.0)
    crossed = flight.breed(Y, np.zeros(7)).copy()
    # All are at their own best places and rest; seven leave one without a mate.
    assert (crossed == Y).all(axis=1).sum() == 1
    assert crossed.mean(axis=0) == pytest.approx(Y.mean(axis=0))
    assert (np.ptp(crossed, axis=0) <= np.ptp(Y, axis=0)).all()


def test_mutations_fade() -> None:
    Y = np.zeros((4000, 3))
    flight = swarm(Y, mutation=0.5)
    for iteration in range(1, 11):
        flight.Y = Y.copy()
        step = np.abs(flight.breed(Y, np.zeros(len(Y))))
        mutated = (step > 0.0).sum(axis=1)
        most = (1 - iteration / 10) ** 2
        assert step.max() <= most and (mutated <= 1).all()
        if iteration < 10:
            assert step.max() == pytest.approx(most, rel=0.05)
            assert mutated.mean() == pytest.approx(0.5, abs=0.05)


@pytest.mark.parametrize(
    ("name", "value", "allowed"),
    [
        ("particles", 1, "a whole number"),
        ("iterations", 0, "a whole number"),
        ("c1", -0.1, "0 to 4"),
        ("c2", np.nan, "0 to 4"),
        ("w", 0.0, "more than 0, up to 2"),
        ("inertia", 1.1, "0 to 1"),
        ("velocity", 0, "more than 0, up"),
        ("crossover", True, "0 to 1"),
        ("mutation", 2.0, "0 to 1"),
        ("target", np.nan, "a number"),
        ("tol", -1.0, "0 or more"),
        ("atol", "0", "0 or more"),
    ],
)
def test_options_that_cannot_be_used(
    name: str, value: object, allowed: str, refused: Callable[..., Any]
) -> None:
    with refused(OptionError, f"{name} cannot be used", value=value, allowed=allowed):
        ParticleSwarm(**{name: value})  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("x0", "fields"),
    [
        (np.ones(5), {"reason": "x0", "value": (5,), "allowed": "(S, 5)"}),
        (np.ones((2, 4)), {"reason": "x0", "value": (2, 4), "allowed": "(S, 5)"}),
        (np.full((2, 5), 6.0), {"reason": "component 0 of row 0", "value": 6.0}),
        (np.ones((21, 5)), {"reason": "more rows", "value": 21, "allowed": "up to 20"}),
    ],
)
def test_places_that_cannot_be_used(
    x0: Floats, fields: dict[str, Any], refused: Callable[..., Any]
) -> None:
    with refused(OptionError, **fields):
        run(x0=x0)
