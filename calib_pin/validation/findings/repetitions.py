"""Copies of measurements, and repetitions that take the place of configurations."""

from __future__ import annotations

from collections.abc import Iterator

import numpy as np

from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.problem import EXACT, distinct_values
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices, Observations
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.places import named, without

CHANCE = 1e-3
"""Probability that noise repeats all digits of one of the measurements."""

DIGITS = 12
"""Decimal places that are looked at."""

REPEATED = 3.0
"""Measurements of a thing at a configuration, in the mean, from which they are many."""

SHARE = 0.5
"""Part of the measurements at one configuration from which it is told."""

ROUNDED = 1e-13
"""Scatter that is the rounding of a mean [m, rad, px]."""


def repetitions(case: Case) -> Iterator[Finding]:
    """Copies, few configurations, and most measurements at one configuration."""
    yield from _copies(case)
    data = case.data
    labels = np.unique(_things_there(data), return_inverse=True)[1]
    configurations, repeats = data.configurations, len(data) / (labels.max() + 1)
    problem = case.fit.problem
    free = int(problem.parameters.free.sum())
    if repeats >= REPEATED and distinct_values(problem) < 2 * free:
        yield Finding(
            "few-configurations",
            "warning",
            f"{len(data)} measurements are at only {configurations} distinct "
            f"configurations: repetitions tell the noise, not the {free} unknowns",
            {
                "configurations": float(configurations),
                "measurements": float(len(data)),
                "unknowns": float(free),
            },
            "measure other configurations instead of repeating these",
        )
        return
    there = np.bincount(labels)
    most = int(np.argmax(there))
    if there[most] > max(SHARE * len(data), REPEATED):
        row = int(np.argmax(labels == most))
        yield Finding(
            "one-configuration",
            "warning",
            f"{there[most]} of {len(data)} measurements are at one configuration "
            f"({named(data, [row])})",
            {"there": float(there[most]), "all": float(len(data))},
            "measure other configurations as well",
        )


def _copies(case: Case) -> Iterator[Finding]:
    """Measurements that are equal to another one to the last digit."""
    data = case.data
    rows = _equal(data)
    if not len(rows) or _by_chance(case, len(rows)):
        return
    found = rows.tolist()
    copies = "is a copy" if len(found) == 1 else "are copies"
    count = "1 measurement" if len(found) == 1 else f"{len(found)} measurements"
    yield Finding(
        "copied-measurements",
        "warning",
        f"{count} of {len(data)} {copies} of others to the last digit, which count "
        f"twice: {named(data, found)}",
        {"copies": float(len(found)), "all": float(len(data))},
        *without(data, found, "leave them out"),
    )


def _equal(data: Observations) -> Indices:
    """Measurements that repeat all numbers of one before them in the files."""
    place, found = np.empty(len(data), np.int64), []
    place[data.in_order] = np.arange(len(data))
    for block, rows in zip(data.blocks, data.slices, strict=True):
        if block.values.shape[1] == 0:
            continue  # Of contacts the joint positions are what is measured.
        own = np.arange(rows.start, rows.stop)
        own = own[np.argsort(place[own])]
        things = data.things()[own, None].astype(float)
        start = block.start if block.start.size else block.q[:, :0]
        columns = (things, *(part[own - rows.start] for part in (block.q, start)))
        table = np.column_stack([block.values[own - rows.start], *columns])
        # Where the first number is there once, the others need not be compared.
        _, which, counts = np.unique(
            table[:, 0], return_inverse=True, return_counts=True
        )
        some = np.flatnonzero(counts[which] > 1)
        if len(some):
            first = np.unique(table[some], axis=0, return_index=True)[1]
            found += own[np.delete(some, first)].tolist()
    return np.array(sorted(found, key=place.__getitem__), np.int64)


def _by_chance(case: Case, pairs: int) -> bool:
    """Whether noise may repeat the digits of so many measurements.

    Two values of normal noise fall on one step of their grid with the probability
    `step / (2 sqrt(pi) sigma)` where the step is small.
    """
    sigma = case.fit.rms * float(np.median(case.fit.problem.given_sigma))
    # A robot that is not as its model leaves more in a fit than an instrument scatters.
    sigma = min(sigma, _scatter(case.data) or sigma)
    if not np.isfinite(sigma) or case.fit.rms < EXACT:
        return True  # Exact measurements repeat themselves.
    chances = [
        np.prod(np.minimum(_steps(block.values) / (2.0 * np.sqrt(np.pi) * sigma), 1.0))
        for block in case.data.blocks
        if block.values.shape[1]
    ]
    repeated = len(case.data) - case.data.configurations + pairs
    return float(max(chances)) * repeated > CHANCE


def _things_there(data: Observations) -> Indices:
    """Label of the measurements of one thing at one configuration, shape (N,)."""
    return np.asarray(data.groups() * (data.things().max() + 1) + data.things())


def _scatter(data: Observations) -> float:
    """Scatter of what was measured several times; zero where nothing scatters."""
    squares, left, same = 0.0, 0, _things_there(data)
    for block, rows in zip(data.blocks, data.slices, strict=True):
        own = np.unique(same[rows], return_inverse=True)[1]
        there = np.bincount(own)
        for column in block.values.T[:3]:
            mean = np.bincount(own, column) / there
            squares += float(np.sum((column - mean[own]) ** 2))
            left += len(own) - len(there)
    scatter = float(np.sqrt(squares / max(left, 1)))
    return scatter if scatter > ROUNDED else 0.0


def _steps(values: Floats) -> Floats:
    """Decimal steps of the grid on which the values of each column lie, shape (D,)."""
    digits = np.full(values.shape[1], DIGITS)
    for k in range(DIGITS)[::-1]:
        digits[np.abs(np.round(values, k) - values).max(axis=0) < 1e-13] = k
    return np.asarray(10.0 ** -digits.astype(float))
