"""The particle swarm on functions with known minima; no robots here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from calib_pin.errors import OptionError
from calib_pin.kinematics.spatial import Floats
from calib_pin.solvers import EvolutionResult, ParticleSwarm, Status, particle_swarm
from tests.solvers.test_differential_evolution import rastrigin, rosenbrock, sphere

WIDE = np.tile([-5.0, 5.0], (5, 1))
QUICK = ParticleSwarm(particles=20, iterations=30)


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
def test_known_minima(
    costs: Callable[[Floats], Floats], bounds: Floats, within: float
) -> None:
    options = ParticleSwarm(particles=60, iterations=400, target=1e-6)
    result = run(costs, options, bounds)
    assert result.status is Status.TARGET
    assert result.x == pytest.approx(np.ones(len(bounds)), abs=within)


def test_the_swarm_converges_in_one_basin() -> None:
    """As printed, without inertia below 1, it does not."""
    options = ParticleSwarm(particles=30, iterations=300, mutation=0.0, tol=1e-6)
    result = run(lambda x: sphere(x) + 1.0, options)
    assert result.status is Status.CONVERGED and result.nit < 300
    assert result.x == pytest.approx(np.ones(5), abs=0.01)
    printed = run(lambda x: sphere(x) + 1.0, replace(options, inertia=1.0))
    assert printed.status is Status.GENERATIONS
    again, other = (run(lambda x: sphere(x) + 1.0, options, seed=s) for s in (0, 4))
    assert again.population.tobytes() == result.population.tobytes()
    assert other.x.tobytes() != result.x.tobytes()


def test_particles_stay_within_bounds_and_are_counted() -> None:
    seen, told = list[Floats](), list[int]()

    def costs(x: Floats) -> Floats:
        seen.append(x.copy())
        return x @ np.array([1.0, -1.0, 1.0, 1.0])

    # The minimum is in a corner; one component is fixed, one is narrow.
    bounds = np.array([[-1.0, 1.0], [0.1, 0.3], [0.7, 0.7], [1e-12, 3e-12]])
    options = ParticleSwarm(20, 40, velocity=1.0, crossover=0.5, mutation=0.5, tol=0)
    result = run(costs, options, bounds, callback=lambda n, *_: told.append(n))
    places = np.concatenate(seen)
    assert (bounds[:, 0] <= places).all() and (places <= bounds[:, 1]).all()
    assert (places[:, 2] == 0.7).all()
    assert result.x[:3] == pytest.approx([-1.0, 0.3, 0.7], rel=0.01)
    assert (len(seen), len(places)) == (result.nit + 1, result.nfev)
    assert told == [*range(1, result.nit + 1)]
    assert result.nfev == options.budget == 20 * 41
    assert result.status is Status.GENERATIONS


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


def test_places_that_cannot_be_used(refused: Callable[..., Any]) -> None:
    for x0, value in (
        (np.ones(5), (5,)),
        (np.ones((2, 4)), (2, 4)),
        (np.full((2, 5), 6.0), 6.0),
        (np.ones((21, 5)), 21),
    ):
        with refused(OptionError, value=value):
            run(x0=x0)
