"""Measurements of several models in one table: joined, split by model, and looked up.

Each model declares its columns of values and of residual components; the table holds
those of all models side by side. A target is prefixed with the name of its model.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from calib_pin.measurement_models.catalog import declared
from calib_pin.observations import (
    PART,
    PLUS,
    Measurements,
    require_alike,
    rows_by_part,
)

Parts = Mapping[str, tuple[NDArray[np.intp], Measurements]]
"""By model: its row indices, and these rows in its own columns with plain targets.

A plain target is the name of a target without the prefix of its model.
"""


def concatenate(parts: Sequence[Measurements]) -> Measurements:
    """Join measurements of the same chain, of one model or of several.

    With several models, a row fills only the columns of its own; see `Measurements`.

    Raises:
        InputError: If the joints differ, or only some rows of one model have standard
            deviations.
    """
    if any(part.model != parts[0].model for part in parts):
        parts = _side_by_side(parts)
    return Measurements.concatenate(parts)


def among(data: Measurements, model: str) -> Measurements:
    """The same measurements in the columns of several models.

    They are returned unchanged if one of their own models is not among these.

    Args:
        data: The measurements.
        model: Names of the models, joined by plus signs.
    """
    names = model.split(PLUS)
    if data.model == model or not set(data.parts) <= set(names):
        return data
    none = data.rows(np.zeros(len(data), bool))
    empty = [
        replace(none, model=name, values=np.zeros((0, _layout(name)[0])), sigma=None)
        for name in names
    ]
    return concatenate([*empty, data])


def by_part(data: Measurements) -> Parts:
    """The measurements split by model; a model without measurements has no entry.

    The split is cached in the measurements: a fit asks for it at every evaluation.
    """
    known: dict[str, Parts] = vars(data)
    if "_by_part" not in known:
        known["_by_part"] = _split(data)
    return known["_by_part"]


def targets_of(data: Measurements, model: str) -> tuple[str, ...]:
    """The plain target of each row of one model; empty in the other rows."""
    if data.model == model:
        return data.target
    result = [""] * len(data)
    if model in by_part(data):
        rows, part = by_part(data)[model]
        for row, name in zip(rows.tolist(), part.target, strict=True):
            result[row] = name
    return tuple(result)


def repeated_targets(data: Measurements) -> tuple[str, ...]:
    """The plain target of each row whose target needs several configurations.

    An example is a socket: its rows are informative only together. Empty in the other
    rows.
    """
    result = ("",) * len(data)
    for model in data.parts:
        if declared(model).naming.configurations > 1:
            targets = targets_of(data, model)
            result = tuple(a or b for a, b in zip(result, targets, strict=True))
    return result


def _layout(model: str) -> tuple[int, int]:
    """Number of value columns and of residual components of a model."""
    stated = declared(model)
    return len(stated.values), len(stated.components)


def _split(data: Measurements) -> Parts:
    if len(data.parts) == 1:
        return {data.model: (np.arange(len(data)), data)} if len(data) else {}
    rows = rows_by_part(data.target)
    result, a, b = {}, 0, 0
    for model in data.parts:
        width, components = _layout(model)
        if model in rows:
            part, sigma = data.rows(rows[model]), None
            if part.sigma is not None:
                sigma = part.sigma[:, b : b + components]
            result[model] = (
                rows[model],
                replace(
                    part,
                    model=model,
                    values=part.values[:, a : a + width],
                    sigma=None if sigma is None or np.isnan(sigma).any() else sigma,
                    target=tuple(name[len(model) + 1 :] for name in part.target),
                ),
            )
        a, b = a + width, b + components
    return result


def _side_by_side(parts: Sequence[Measurements]) -> list[Measurements]:
    """Measurements of different models in the columns of all of them.

    Raises:
        InputError: If only some rows of one model have standard deviations.
    """
    names = tuple(dict.fromkeys(name for part in parts for name in part.parts))
    widths = np.cumsum([(0, 0), *(_layout(name) for name in names)], axis=0)
    at = {name: (widths[k], widths[k + 1]) for k, name in enumerate(names)}
    stated: dict[str, bool] = {}
    result = []
    for part in parts:
        values = np.zeros((len(part), widths[-1][0]))
        sigma = np.full((len(part), widths[-1][1]), np.inf)
        for name, (rows, alone) in by_part(part).items():
            (a, b), (c, d) = at[name]
            values[rows, a:c] = alone.values
            sigma[rows, b:d] = np.nan if alone.sigma is None else alone.sigma
            has_sigma = alone.sigma is not None
            require_alike(part, stated.setdefault(name, has_sigma) == has_sigma)
        target = part.target
        if len(part.parts) == 1:
            target = tuple(f"{part.model}{PART}{name}" for name in target)
        model = PLUS.join(names)
        result.append(
            replace(part, model=model, values=values, sigma=sigma, target=target)
        )
    return result
