"""Simulate measurements of a robot whose true errors are known."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from typing import Annotated

import numpy as np

import calib_pin.estimation.nominal as nominal
from calib_pin.compiled.threads import serial_blas
from calib_pin.errors import InputError, OptionError, require_known
from calib_pin.estimation.problem import Problem, assumed_sigma
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import (
    AT,
    UNSTATED,
    BlockKey,
    Booleans,
    Conditions,
    Labels,
    Measurements,
    Observations,
    Targets,
)
from calib_pin.parameterizations import needed_conditions
from calib_pin.parameters import ParameterSet
from calib_pin.setup.arguments import as_array
from calib_pin.setup.values import Value

LEG = 10
"""Rows that are measured from one start where configurations are drawn."""


def draw_errors(parameters: ParameterSet, rng: np.random.Generator) -> Floats:
    """True errors of a robot, uniform within plus and minus the scale, shape (P,).

    Frames, planes and fixed parameters stay at zero, and no compliance, growth or
    backlash is negative: a joint neither rises under its load nor runs ahead.

    Args:
        parameters: The parameters.
        rng: Random generator.
    """
    moved = parameters.free & ~parameters.nuisance
    drawn = rng.uniform(-1.0, 1.0, len(parameters)) * parameters.scales
    lagging = ".hysteresis.backlash"
    units = ("rad/Nm", "m/N", "1/K")
    positive = [p.unit in units or p.name.endswith(lagging) for p in parameters]
    return np.where(moved, np.where(positive, np.abs(drawn), drawn), 0.0)


@serial_blas
def simulate(
    problem: Problem,
    theta: Floats,
    rng: np.random.Generator,
    *,
    key: BlockKey | None = None,
    q: Floats | None = None,
    target: Targets = (),
    places: Mapping[str, Labels] = {},
    conditions: Conditions = UNSTATED,
    count: int | None = None,
    per_configuration: bool = False,
    noise: Annotated[float, Value(least=0.0)] | None = None,
    repeats: Annotated[int, Value(least=1)] = 1,
) -> Observations:
    """Measure a robot with known errors.

    Args:
        problem: Chains, frames and instruments; its data only name the targets.
        theta: True parameter values, shape (P,).
        rng: Random generator.
        key: The block that is measured; default all blocks of the problem.
        q: Configurations, shape (K, n) [rad, m], from which a tool that must touch
            something is brought there. Of several blocks each measures those that its
            instrument can measure. Or else
        target: The target of each of them; default all targets in turn. Relative
            distances of one name start at its first configuration, which is no
            measurement.
        places: Chain, station and tool of each of them, as far as that is stated; by
            default they are of all blocks. Where targets or places are stated, every
            configuration has to be measured.
        conditions: What holds at each of them; by default the payloads are carried in
            turn, and joints come as from one to the next.
        count: Number K of random configurations at which an instrument can measure,
            shared out among the blocks.
        per_configuration: Whether everything that an instrument sees at a configuration
            at once is measured there: an image is many corners, a beam meets one plane
            all the same.
        noise: Standard deviation of every component [m, rad, px]; default that of the
            setup, or of the model. Zero leaves the values exact and without sigmas.
        repeats: Readings per configuration.

    Returns:
        The measurements, with their standard deviations.

    Raises:
        OptionError: If a number is out of range.
        InputError: If the only instrument cannot measure at a configuration, or one of
            several at none; or if a configuration is of no block.

    Examples:
        >>> import numpy as np, calib_pin
        >>> from calib_pin.estimation.formulation import nominal_problem
        >>> chain = calib_pin.load_chain("pa10")
        >>> problem = nominal_problem(chain, "position", calib_pin.Setup())
        >>> rng = np.random.default_rng(1)
        >>> theta = calib_pin.draw_errors(problem.parameters, rng)
        >>> rows = calib_pin.simulate(problem, theta, rng, count=20, noise=1e-5)
        >>> rows.only.values.shape
        (20, 3)
    """
    theta = as_array("theta", [theta], 1, len(problem.parameters))[0]
    q = q if q is None else as_array("q", q, "K", len(problem.data.joints))
    keys = problem.data.keys
    if key is not None:
        require_known("block", str(key), map(str, keys))
        keys = (key,)
    if (q is None) == (count is None):
        raise OptionError("give either configurations or their count")
    if count is not None and count < len(keys):
        allowed = f"{len(keys)} or more"
        raise OptionError("count is too small", value=count, allowed=allowed)
    strict = len(keys) == 1 or bool(len(target) or places)
    masks = _block_masks(keys, places, 0 if q is None else len(q))
    blocks, payloads = [], problem.data.payload.distinct or ("",)
    for number, block in enumerate(keys):
        declared, mask = problem.terms[block].measurement.declaration, masks[block]
        at_once = per_configuration and declared.at_once
        share = (
            int(mask.sum()) if count is None else len(range(number, count, len(keys)))
        )
        carried = _in_turn(payloads, share) if at_once else ()
        if q is None:
            at = _random_rows(problem, theta, block, share, carried, rng)
        elif not share:
            continue
        else:
            held = conditions.rows(mask)
            targets: Targets = _in_turn(nominal.named_targets(problem, block), share)
            if len(target):
                targets = Labels.of(target)[mask]
            if carried and not len(held.payload):
                held = replace(held, payload=Labels.of(carried))
            at = nominal.unmeasured(problem, block, q[mask], targets, held)
        if at_once or count is None:
            at = _measurable(problem, theta, at, at_once, strict)
        if declared.relative:
            at = _without_starts(at)
        elif "direction" in needed_conditions(problem.setup.parameters):
            # What makes a difference is told with the measurements.
            at = replace(at, conditions=replace(at.conditions, source="columns"))
        blocks.append(_noisy_rows(problem, theta, at, rng, noise, repeats))
    return Observations.of(*blocks)


def _block_masks(
    keys: Sequence[BlockKey], places: Mapping[str, Labels], count: int
) -> dict[BlockKey, Booleans]:
    """Which of some configurations each block measures, shape (count,).

    Raises:
        InputError: If one is of no block.
    """
    masks = {key: np.ones(count, bool) for key in keys}
    for kind, labels in places.items():
        for key, mask in masks.items():
            mask &= labels.where(getattr(key, kind))
    orphan = ~np.any([*masks.values()], axis=0)
    if orphan.any():
        reason = f"configuration {int(orphan.argmax()) + 1} is of no block of the setup"
        raise InputError(reason, allowed="; ".join(map(str, keys)))
    return masks


def _noisy_rows(
    problem: Problem,
    theta: Floats,
    at: Measurements,
    rng: np.random.Generator,
    noise: float | None,
    repeats: int,
) -> Measurements:
    """Measurements at configurations of a block; the rest as for `simulate`."""
    term = problem.terms[at.key]
    exact = replace(at, values=problem.predict(theta, at))
    if term.measurement.declaration.contact and problem.setup.gauge:
        gaps = rng.uniform(-1.0, 1.0, (len(exact), term.components))
        gaps *= problem.setup.gauge
        q, _ = nominal.brought_to_contact(problem, theta, at, gaps)
        exact = replace(exact, q=q, values=gaps)
    sigma = assumed_sigma(term, problem.setup)
    if noise is not None:
        sigma = np.full_like(sigma, noise)
    rows = exact.rows(np.repeat(np.arange(len(exact)), repeats))
    if not sigma.any():
        return rows
    draws = rng.normal(size=(len(rows), len(sigma))) * sigma
    sigmas = np.tile(sigma, (len(rows), 1))
    if not rows.values.shape[1]:
        # Contacts have no values: that they are not exact is that the robot stands so.
        stood = nominal.unmeasured(
            problem, at.key, rows.q, rows.target, rows.conditions
        )
        moved, _ = nominal.brought_to_contact(problem, theta, stood, draws)
        return replace(rows, q=moved, sigma=sigmas)
    values = term.measurement.disturb(rows.values, draws)
    return replace(rows, values=values, sigma=sigmas)


def _random_rows(
    problem: Problem,
    theta: Floats,
    key: BlockKey,
    count: int,
    payload: Sequence[str],
    rng: np.random.Generator,
) -> Measurements:
    """Random configurations of a block, those of starts of relative distances added.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).
        key: The block.
        count: Number of configurations that count.
        payload: What is carried at each; none for what is usual.
        rng: Random generator.
    """
    relative = problem.terms[key].measurement.declaration.relative
    count += -(-count // LEG) if relative else 0
    at = nominal.observable_configurations(problem, key, theta, count, rng, payload)
    return replace(at, target=_legs(at.target)) if relative else at


def _in_turn(names: Sequence[str], count: int) -> list[str]:
    """Names in turn, one for each configuration."""
    return [names[k % len(names)] for k in range(count)]


def _legs(target: Labels) -> Labels:
    """Names of the starts of successive rows, behind the point that these look at."""
    names = []
    for k in range(len(target)):
        start = k // (LEG + 1)
        point = target[start].rpartition(AT)[0]
        names.append(f"{point}{AT}{start + 1}" if point else str(start + 1))
    return Labels.of(names)


def _without_starts(at: Measurements) -> Measurements:
    """Configurations without those that others start from, the first of each name.

    The payload at the start stays to the end.

    Raises:
        InputError: If a name has nothing but its start.
    """
    _, first, name = np.unique(at.target.codes, return_index=True, return_inverse=True)
    starts = first[name]
    rows = np.flatnonzero(starts != np.arange(len(starts)))
    several = at.target[rows].distinct
    for alone in at.target.distinct:
        if alone not in several:
            reason = f"the relative distances of '{alone}' have a start and no end"
            raise InputError(reason, column="target")
    begun = at.rows(starts[rows])
    held = replace(at.conditions.rows(rows), payload=begun.conditions.payload)
    return replace(at.rows(rows), conditions=held, start=begun.q)


def _measurable(
    problem: Problem, theta: Floats, at: Measurements, at_once: bool, strict: bool
) -> Measurements:
    """Configurations that can be measured; those of a contact where the tool touches.

    Args:
        problem: The problem.
        theta: Parameter values, shape (P,).
        at: The configurations.
        at_once: Whether all targets are measured that can be seen at each.
        strict: Whether something has to be measured at each.

    Raises:
        InputError: If the instrument cannot measure at a configuration; where others
            may be left out, at none.
    """
    count, declared = len(at.q), problem.terms[at.key].measurement.declaration
    if at_once:
        names = nominal.named_targets(problem, at.key)
        every = Labels(names, np.tile(np.arange(len(names)), count))
        at = replace(at.rows(np.repeat(np.arange(count), len(names))), target=every)
    touches = np.ones(len(at.q), bool)
    if declared.contact:
        q, touches = nominal.brought_to_contact(problem, theta, at)
        at = replace(at, q=q)
    seen = touches & problem.observable(theta, at)
    anything = seen.reshape(count, -1).any(axis=1)
    if not (anything if strict else anything.any()).all():
        which = f"configuration {int(np.argmin(anything)) + 1} cannot be measured"
        reason = f"{which} ({at.key}): {declared.unmeasurable}"
        raise InputError(reason, file=problem.setup.file or None)
    return at if seen.all() else at.rows(seen)
