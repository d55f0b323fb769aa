"""Simulate measurements of a robot whose true errors are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib_pin.errors import InputError, OptionError
from calib_pin.measurements import Measurements
from calib_pin.parameters import ParameterSet
from calib_pin.problem import Problem, assumed_sigma, observable_configurations
from calib_pin.spatial import Floats

__all__ = ["draw_errors", "simulate"]


def draw_errors(parameters: ParameterSet, rng: np.random.Generator) -> Floats:
    """True errors of a robot, uniform within plus and minus the scale, shape (P,).

    Frames, planes and fixed parameters stay at zero, and no compliance is negative: a
    joint does not rise under its load.

    Args:
        parameters: The parameters.
        rng: Random generator.
    """
    moved = parameters.free & ~parameters.nuisance
    drawn = rng.uniform(-1.0, 1.0, len(parameters)) * parameters.scales
    loaded = np.array([p.unit in ("rad/Nm", "m/N") for p in parameters], bool)
    return np.where(moved, np.where(loaded, np.abs(drawn), drawn), 0.0)


def simulate(
    problem: Problem,
    theta: Floats,
    rng: np.random.Generator,
    *,
    q: Floats | None = None,
    target: Sequence[str] = (),
    count: int | None = None,
    noise: float | None = None,
    repeats: int = 1,
    average: bool = False,
) -> Measurements:
    """Measure a robot with known errors.

    Args:
        problem: Chain, frames and instrument; its rows only name the targets.
        theta: True parameter values, shape (P,).
        rng: Random generator.
        q: Configurations, shape (K, n) [rad, m]; or else
        target: The target of each of them; default all targets in turn.
        count: Number K of random configurations at which the instrument can measure.
        noise: Standard deviation of every component [m, rad]; default that of the
            setup, or of the model. Zero leaves the values exact and without sigmas.
        repeats: Readings per configuration.
        average: Whether the readings of a configuration become one row.

    Returns:
        The measurements, with the standard deviations of their rows.

    Raises:
        OptionError: If a number is out of range.
        InputError: If the instrument cannot measure at a configuration.

    Example:
        >>> import numpy as np, calib_pin
        >>> from calib_pin.problem import nominal_problem
        >>> chain = calib_pin.load_chain("pa10")
        >>> problem = nominal_problem(chain, "position", calib_pin.Setup())
        >>> rng = np.random.default_rng(1)
        >>> theta = calib_pin.draw_errors(problem.parameters, rng)
        >>> rows = calib_pin.simulate(problem, theta, rng, count=20, noise=1e-5)
        >>> rows.values.shape
        (20, 3)
    """
    for name, number, least in (("count", count, 1), ("repeats", repeats, 1)):
        if number is not None and number < least:
            raise OptionError(f"{name} is too small", value=number, allowed="1 or more")
    if noise is not None and not 0.0 <= noise < np.inf:
        raise OptionError("noise is out of range", value=noise, allowed="0 or more")
    if (q is None) == (count is None):
        raise OptionError("give either configurations or their count")
    if q is None:
        assert count is not None
        q, target = observable_configurations(problem, theta, count, rng)
    else:
        names = tuple(dict.fromkeys(problem.data.target)) or ("",)
        target = tuple(target) or tuple(names[i % len(names)] for i in range(len(q)))
        _require_observable(problem, theta, q, target)

    exact = problem.about(theta, q, target).data
    sigma = assumed_sigma(problem.measurement, problem.setup.noise)
    if noise is not None:
        sigma = np.full_like(sigma, noise)
    if average:
        # The mean of K independent readings, drawn at once.
        sigma, repeats = sigma / np.sqrt(repeats), 1
    rows = exact.rows(np.repeat(np.arange(len(exact)), repeats))
    if not sigma.any():
        return rows
    draws = rng.normal(size=(len(rows), len(sigma))) * sigma
    return replace(
        rows,
        values=problem.measurement.disturb(rows.values, draws),
        sigma=np.tile(sigma, (len(rows), 1)),
    )


def _require_observable(
    problem: Problem, theta: Floats, q: Floats, target: Sequence[str]
) -> None:
    of_robot, own = problem.split(theta)
    T = problem.error.poses(q, of_robot)
    seen = problem.measurement.observable(T, own, target)
    if not seen.all():
        raise InputError(
            f"configuration {int(np.argmin(seen)) + 1} cannot be measured "
            f"({problem.measurement.name}): the beam misses the plane, meets it too "
            "flat or too far away"
        )
