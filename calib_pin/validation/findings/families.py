"""Families of parameters that were not asked for and explain most of what is left.

A robot whose gears are eccentric or whose joints give under load leaves errors that its
geometry cannot explain, and one of which only offsets are estimated leaves those of its
placements. Each family is further columns of the Jacobian, all that it has at once.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import combinations

import numpy as np

from calib_pin.errors import enumerated
from calib_pin.estimation.evidence import Finding
from calib_pin.estimation.problem import EXACT
from calib_pin.estimation.statistics.variance_components import candidates
from calib_pin.parameterizations import PARAMETERIZATIONS
from calib_pin.parameterizations.placement import JointOffset, Placement
from calib_pin.units import DISPLAY
from calib_pin.validation.findings.case import Case
from calib_pin.validation.findings.setup_lines import written

CHANCE = 1e-6
"""Probability by chance below which a family is told."""

LEFT, HALVED = 0.5, 0.25
"""Parts of the sum of squares that one leaves at most, and that make it a warning."""


def lacking(case: Case) -> tuple[tuple[str, ...], float]:
    """The families that explain most, and the part of the squares that they leave.

    None of them, and all of it, where none stands out.
    """
    nothing = (), 1.0
    fit, names = case.fit, case.setup.parameters
    if case.fitted is None or not (names and fit.rms > EXACT):
        return nothing
    placed = any(map(_geometric, names))
    effects = candidates(fit.problem, () if placed else (Placement.name,))
    if effects is None:
        return nothing
    X, kinds = effects.rows(fit.problem, fit.theta), np.array(effects.kinds)
    if not np.isfinite(X).all():
        return nothing
    each = dict.fromkeys(effects.kinds)
    found = []
    for some in (*((kind,) for kind in each), *combinations(each, 2)):
        own = np.isin(kinds, some)
        score = fit.score(X[:, own])
        if score.chance < CHANCE and score.left < LEFT:
            # By Schwarz's criterion: two families explain more than one anyway.
            cost = fit.left * np.log(max(score.left, 1e-300))
            found.append((cost + own.sum() * np.log(fit.left), some, score.left))
    return min(found)[1:] if found else nothing


def _geometric(name: str) -> bool:
    """Whether a family moves origins, and not only zeros of joints."""
    return PARAMETERIZATIONS[name].geometric and name != JointOffset.name


def families(case: Case) -> Iterator[Finding]:
    """The families of parameters that the fit lacks."""
    names, left = lacking(case)
    if not names:
        return
    quantity = case.fit.problem.layout.quantities[0]
    unit, factor = DISPLAY[quantity.unit]
    before = case.fit.errors
    after = before * float(np.sqrt(left))
    # Placements have the offsets of joints.
    covered = {JointOffset.name} if Placement.name in names else set()
    asked = [name for name in case.setup.parameters if name not in covered]
    lines = {"parameters": [*asked, *names]}
    yield Finding(
        "model-lacks",
        "warning" if left < HALVED else "info",
        f"{enumerated(names)}, not estimated here, explains most of it: the "
        f"{quantity.name} errors of a fit fall from {factor * before:.3g} {unit} to "
        f"about {factor * after:.3g} {unit}",
        {"families": ", ".join(names), "rms_before": before, "rms_after": after},
        f"estimate them: --parameters {','.join(lines['parameters'])}, or state in the "
        f"setup file: {written(lines)}",
        lines,
        "residuals-by-joint",
    )
