"""Simulate measurements of a robot whose true errors are known."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError
from calib_pin.estimation.configurations import (
    asked,
    brought_to_contact,
    observable_configurations,
    payloads_in_turn,
)
from calib_pin.estimation.problem import Problem
from calib_pin.kinematics.spatial import Floats
from calib_pin.measurement_models.mixed import absent, assumed_sigma, contact_rows
from calib_pin.observations import AT, Measurements
from calib_pin.parameters import ParameterSet

LEG = 10
"""Rows that are measured from one start where configurations are drawn."""


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


@serial_blas
def simulate(
    problem: Problem,
    theta: Floats,
    rng: np.random.Generator,
    *,
    q: Floats | None = None,
    target: Sequence[str] = (),
    payload: Sequence[str] = (),
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
        q: Configurations, shape (K, n) [rad, m], from which a tool that must touch
            something is brought there; or else
        target: The target of each of them; default all targets in turn. Relative
            distances of one name start at its first configuration, which is no row.
        payload: Payload of each of them; default all payloads in turn.
        count: Number K of random configurations at which the instrument can measure.
        noise: Standard deviation of every component [m, rad]; default that of the
            setup, or of the model. Zero leaves the values exact and without sigmas.
        repeats: Readings per configuration.
        average: Whether the readings of a configuration become one row.

    Returns:
        The measurements, with the standard deviations of their rows.

    Raises:
        OptionError: If a number is out of range, or the problem mixes relative
            distances with others.
        InputError: If the instrument cannot measure at a configuration.

    Example:
        >>> import numpy as np, calib_pin
        >>> from calib_pin.estimation.formulation import nominal_problem
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
    relative = problem.measurement.declaration.relative
    if relative and len(problem.data.parts) > 1:
        raise OptionError(
            "relative distances are simulated by themselves",
            value=problem.measurement.name,
            allowed=", ".join(problem.data.parts),
        )
    if q is None:
        assert count is not None
        starts = -(-count // LEG) if relative else 0
        q, target = observable_configurations(problem, theta, count + starts, rng)
        target = _legs(target, LEG + 1) if relative else target
    else:
        names = tuple(dict.fromkeys(problem.data.target)) or ("",)
        target = tuple(target) or tuple(names[i % len(names)] for i in range(len(q)))
        payload = payload or payloads_in_turn(problem.data, len(q))
        q = _require_observable(problem, theta, q, target, payload)
    payload = tuple(payload) or payloads_in_turn(problem.data, len(q))
    start = None
    if relative:
        q, target, payload, start = _relative(q, target, payload)

    exact = exact_problem(problem, theta, q, target, start, payload).data
    sigma = assumed_sigma(problem.measurement, problem.setup.noise)
    if noise is not None:
        sigma = np.full_like(sigma, noise)
    if average:
        # The mean of K independent readings, drawn at once.
        sigma, repeats = sigma / np.sqrt(repeats), 1
    rows = exact.rows(np.repeat(np.arange(len(exact)), repeats))
    if not sigma.any():
        return rows
    # Mixed rows lack the components of the other models.
    lacking = (
        np.zeros((len(rows), 1), bool) if rows.sigma is None else (np.isinf(rows.sigma))
    )
    draws = np.where(lacking, 0.0, rng.normal(size=(len(rows), len(sigma))) * sigma)
    rows = replace(
        rows,
        values=problem.measurement.disturb(rows.values, draws),
        sigma=np.where(lacking, np.inf, sigma),
    )
    touching = contact_rows(problem.measurement, rows.target)
    if not touching.any():
        return rows
    # Contacts have no values: that they are not exact is that the robot stands so.
    moved, _ = brought_to_contact(
        problem, theta, rows.q, rows.target, touching, draws, rows.payload
    )
    return replace(rows, q=moved)


def exact_problem(
    problem: Problem,
    theta: Floats,
    q: Floats,
    target: Sequence[str],
    start: Floats | None = None,
    payload: Sequence[str] = (),
) -> Problem:
    """The problem with noise-free measurements at other configurations.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).
        q: Joint positions, shape (K, n) [rad, m].
        target: Target of each measurement.
        start: Where relative measurements start, shape (K, n); default the
            configuration before each.
        payload: Payload of each; default `payloads_in_turn`.
    """
    at = asked(problem, q, target, payload, start)
    data = Measurements(
        joints=problem.error.chain.joints,
        q=q,
        model=problem.measurement.name,
        values=problem.predict(theta, at),
        sigma=absent(problem.measurement, target),
        target=at.target,
        payload=at.payload,
        start=at.start,
    )
    return replace(problem, data=data)


def _legs(target: Sequence[str], size: int) -> tuple[str, ...]:
    """Names of the starts of successive rows, behind the point that these look at."""
    points = [target[k // size].rpartition(AT)[0] for k in range(len(target))]
    return tuple(
        f"{point}{AT}{k // size + 1}" if point else str(k // size + 1)
        for k, point in enumerate(points)
    )


def _relative(
    q: Floats, target: Sequence[str], payload: Sequence[str]
) -> tuple[Floats, tuple[str, ...], tuple[str, ...], Floats]:
    """Rows without those that others start from, which are the first of each name.

    The payload at the start stays to the end.

    Raises:
        InputError: If a name has nothing but its start.
    """
    first: dict[str, int] = {}
    for k, name in enumerate(target):
        first.setdefault(name, k)
    rows = [k for k, name in enumerate(target) if first[name] != k]
    several = {target[k] for k in rows}
    alone = [name for name in first if name not in several]
    if alone:
        raise InputError(
            f"the relative distances of '{alone[0]}' have a start and no end",
            column="target",
        )
    names = tuple(target[k] for k in rows)
    starts = [first[name] for name in names]
    return q[rows], names, tuple(payload[k] for k in starts), q[starts]


def _require_observable(
    problem: Problem,
    theta: Floats,
    q: Floats,
    target: Sequence[str],
    payload: Sequence[str],
) -> Floats:
    """Configurations that can be measured; those of a contact where the tool touches.

    Raises:
        InputError: If the instrument cannot measure at a configuration.
    """
    measurement = problem.measurement
    touching = contact_rows(measurement, target)
    seen = np.ones(len(q), bool)
    if touching.any():
        q, seen = brought_to_contact(
            problem, theta, q, target, touching, payload=payload
        )
    seen &= problem.observable(theta, asked(problem, q, target, payload))
    if not seen.all():
        raise InputError(
            f"configuration {int(np.argmin(seen)) + 1} cannot be measured "
            f"({measurement.name}): {measurement.declaration.unmeasurable}"
        )
    return q
