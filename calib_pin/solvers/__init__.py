"""Solvers; they know functions and arrays, nothing of robots."""

from __future__ import annotations

from calib_pin.solvers.gauss_newton import LeastSquaresResult, Status, gauss_newton

__all__ = ["LeastSquaresResult", "Status", "gauss_newton"]
