"""Solvers; they know functions and arrays, nothing of robots."""

from __future__ import annotations

from calib_pin.solvers.differential_evolution import (
    DifferentialEvolution,
    differential_evolution,
)
from calib_pin.solvers.evolution import EvolutionResult
from calib_pin.solvers.gauss_newton import LeastSquaresResult, gauss_newton
from calib_pin.solvers.status import Status

__all__ = [
    "DifferentialEvolution",
    "EvolutionResult",
    "LeastSquaresResult",
    "Status",
    "differential_evolution",
    "gauss_newton",
]
