"""Solvers; they know functions and arrays, nothing of robots."""

from __future__ import annotations

from calib_pin.solvers.alternation import alternation
from calib_pin.solvers.differential_evolution import (
    DifferentialEvolution,
    differential_evolution,
)
from calib_pin.solvers.evolution import EvolutionResult
from calib_pin.solvers.exchange import exchange, greedy
from calib_pin.solvers.gauss_newton import LeastSquaresResult, gauss_newton
from calib_pin.solvers.genetic import genetic_selection
from calib_pin.solvers.gradient import projected_descent
from calib_pin.solvers.particle_swarm import ParticleSwarm, particle_swarm
from calib_pin.solvers.status import Status

__all__ = [
    "DifferentialEvolution",
    "EvolutionResult",
    "LeastSquaresResult",
    "ParticleSwarm",
    "Status",
    "alternation",
    "differential_evolution",
    "exchange",
    "gauss_newton",
    "genetic_selection",
    "greedy",
    "particle_swarm",
    "projected_descent",
]
