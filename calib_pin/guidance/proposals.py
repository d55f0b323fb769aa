"""Where to measure next, and what more rows would tell."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from calib_pin.errors import CalibPinError
from calib_pin.estimation.row_blocks import Priors
from calib_pin.guidance.expectation import WIDE, Expectation
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.collision import Collisions
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Observations
from calib_pin.planning.aims import Aim, Aims, require_plannable
from calib_pin.planning.criteria import Prediction
from calib_pin.planning.plan import TESTS
from calib_pin.planning.planned_problem import (
    STRUCTURE,
    TipTests,
    identification,
)
from calib_pin.planning.selection import Selection
from calib_pin.planning.workspace import Candidates, Workspace
from calib_pin.setup import Setup

MORE = 20
"""Most further rows that are looked ahead to."""

NEAR = 0.02
"""Difference of a joint up to which a planned configuration was measured [rad, m]."""

Left = Callable[[Chains, Setup], tuple[Floats, Sequence[str]]]
"""Reads a plan: configurations, shape (K, n) [rad, m], and their targets."""

Shown = Callable[[Chains, Setup, Floats, str], dict[str, str]]
"""The columns of the measurement file for a configuration and a target."""


@dataclass(frozen=True)
class Proposal:
    """The configuration to measure next.

    Attributes:
        q: Joint positions, shape (n,) [rad, m].
        joints: Names of these.
        cells: The columns of the measurement file that bring the robot there.
        left: Number of configurations of the plan that are left.
    """

    q: Floats
    joints: tuple[str, ...]
    cells: dict[str, str]
    left: int = 0

    @property
    def text(self) -> str:
        """One line."""
        where = ", ".join(f"{name} {value}" for name, value in self.cells.items())
        more = f" ({self.left} of the plan left)" if self.left else ""
        return f"next: {where}{more}"

    def document(self) -> dict[str, Any]:
        """The proposal as plain data."""
        named = zip(self.joints, self.q.tolist(), strict=True)
        return {"joints": dict(named), "cells": self.cells, "left": self.left}


@dataclass(frozen=True)
class Outlook:
    """What further rows would leave of the error of the tool point.

    Attributes:
        next: The first of them; None where nobody knows.
        errors: The error of the tool point after 0, 1, 2, ... of them [m].
    """

    next: Proposal | None = None
    errors: tuple[float, ...] = ()

    def more(self, now: float, limit: float) -> int | None:
        """Number of rows after which an error of now is below a limit [m]."""
        if not self.errors:
            return None
        reach = (
            k for k, e in enumerate(self.errors) if now * e <= limit * self.errors[0]
        )
        return next(reach, None)


class Proposals:
    """Configurations that may be measured, of which the best is proposed.

    Args:
        plan: Reads a plan, of which what is left comes first; None without one.
        collisions: Loads the collisions to avoid.
        shown: Columns for a configuration; default those of the joints, in SI units.
        seed: Seed of the candidates.
    """

    def __init__(
        self,
        plan: Left | None,
        collisions: Callable[[Chains, Setup], Collisions | None] | None,
        shown: Shown | None,
        seed: int,
    ) -> None:
        """Begin without candidates."""
        self._plan, self._collisions, self._seed = plan, collisions, seed
        self._shown = shown
        self._spread: Candidates | None = None

    def outlook(
        self,
        chains: Chains,
        rows: Observations,
        setup: Setup,
        expected: Expectation,
    ) -> Outlook:
        """The next configuration and what more of them would tell."""
        left: list[tuple[Floats, str]] = []
        if self._plan is not None:
            left = _left(*self._plan(chains, setup), rows)
        try:
            selection, at = self._selection(chains, rows, setup, expected, left)
        except (CalibPinError, np.linalg.LinAlgError):
            if not left:
                return Outlook()
            return Outlook(self._proposal(chains, setup, *left[0], len(left)))
        errors = [selection.value]
        for k in range(min(MORE, selection.left)):
            selection.add(k if left else selection.best_to_add()[0])
            errors.append(selection.value)
        first = selection.chosen[0]
        q, aim = at.q[first], self._aims[at.aim[first]]
        following = self._proposal(chains, setup, q, aim.target, len(left))
        return Outlook(following, tuple(errors))

    def _selection(
        self,
        chains: Chains,
        rows: Observations,
        setup: Setup,
        expected: Expectation,
        left: Sequence[tuple[Floats, str]],
    ) -> tuple[Selection, Candidates]:
        """The candidates with what the rows tell already."""
        require_plannable(rows.keys)
        assert expected.model is not None
        fit = expected.model.fit
        found = {} if expected.early else {n.quantity: n.estimate for n in fit.noise}
        noise = {n.partition(" (")[0]: e for n, e in found.items() if e > 0.0}
        parameters = fit.problem.parameters
        errors = parameters.free & ~parameters.nuisance & np.isinf(parameters.priors)
        sizes = np.where(errors, WIDE * parameters.scales, np.inf)
        stated = replace(setup, learned=None, noise={**setup.noise, **noise})
        problem = replace(fit.problem, setup=stated, expected=Priors.alone(sizes))
        aims = Aims.of(problem, rows.keys)
        self._aims: tuple[Aim, ...] = aims.each
        workspace = Workspace.create(problem, None, 0.0, aims)
        if self._spread is None:
            solid = self._collisions and self._collisions(chains, setup)
            rng = np.random.default_rng(self._seed)
            free = replace(workspace, collisions=solid)
            self._spread = free.candidates(STRUCTURE, rng)
            self._spread.require(1)
        spread = at = self._spread
        if left:
            names = [aim.target for aim in aims.each]
            aim = [names.index(t) if t in names else 0 for _, t in left]
            at = Candidates(np.array([q for q, _ in left]), np.array(aim), len(left))
        _, basis, information = identification(problem, aims, spread, rows)
        chain_of = np.array([aim.key.chain for aim in aims.each])[spread.aim]
        tests = TipTests.of(
            basis,
            {
                c: spread.q[chain_of == c][:TESTS]
                for c in dict.fromkeys(chain_of.tolist())
            },
        )
        table = basis.rows(at.q, at.aim)
        criterion = Prediction(tests.position)
        return (
            Selection(table, basis.nuisances, criterion, information, (), len(rows)),
            at,
        )

    def _proposal(
        self, chains: Chains, setup: Setup, q: Floats, target: str, left: int
    ) -> Proposal:
        if self._shown is None:
            named = zip(chains.joints, q.tolist(), strict=True)
            return Proposal(q, chains.joints, {n: f"{x:.4f}" for n, x in named}, left)
        cells = self._shown(chains, setup, q, target)
        return Proposal(q, chains.joints, cells, left)


def _left(
    q: Floats, targets: Sequence[str], rows: Observations
) -> list[tuple[Floats, str]]:
    """The configurations of a plan that were not measured yet, in their order."""
    open_ = list(zip(q, targets, strict=True))
    for k, at in enumerate(rows.q):
        own = rows.target[k]
        near = (
            place
            for place, (there, target) in enumerate(open_)
            if np.abs(there - at).max() < NEAR and target in ("", own)
        )
        if (place := next(near, None)) is not None:
            del open_[place]
    return open_
