"""What a job knows so far, and what more rows are worth."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from calib_pin.errors import CalibPinError, enumerated
from calib_pin.estimation.evidence import TRUSTED, Finding
from calib_pin.guidance.expectation import Expectation
from calib_pin.guidance.proposals import Outlook
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Observations
from calib_pin.setup import Setup
from calib_pin.validation.assessment import robot_errors
from calib_pin.validation.findings import find
from calib_pin.validation.findings.case import Case, Others
from calib_pin.validation.held_out import check
from calib_pin.validation.judgement import judge
from calib_pin.validation.model_errors import fitted_errors

WORTH, AHEAD = 0.9, 5
"""Part of the expected error that so many further rows may leave to be worth it, where
no limit is stated."""


@dataclass(frozen=True)
class State:
    """What the rows so far tell.

    Attributes:
        rows: Number of rows.
        aside: Number of those that are set aside.
        verdict: The verdict so far; empty as long as there is none.
        reason: Its reason.
        near: Expected error of the tool point near the rows [m]; NaN where unknown.
        workspace: The same over the workspace.
        bound: Upper bound of that with 95 % confidence.
        unknown: Errors of the robot that more rows would tell.
        limit: The error that is to be reached [m]; None where none is stated.
        more: Number of rows that reach it; None where nobody knows, or none do.
        further: What a few more rows leave of the error over the workspace [m].
        worth: Whether these are worth it.
    """

    rows: int
    aside: int
    verdict: str = ""
    reason: str = ""
    near: float = np.nan
    workspace: float = np.nan
    bound: float = np.nan
    unknown: tuple[str, ...] = ()
    limit: float | None = None
    more: int | None = None
    further: float = np.nan

    @property
    def reached(self) -> bool:
        """Whether more rows are not needed."""
        if self.verdict not in TRUSTED:
            return False
        if self.limit is not None:
            return self.bound <= self.limit
        return self.further > WORTH * self.workspace

    @property
    def text(self) -> str:
        """One line."""
        aside = f", {self.aside} set aside" if self.aside else ""
        words = [f"{self.rows} rows{aside}"]
        words.append(self.verdict.upper() if self.verdict else "no verdict yet")
        if self.verdict and self.verdict not in TRUSTED:
            words[-1] += f" ({self.reason.partition(';')[0]})"
        if np.isfinite(self.workspace):
            near = f"near {_mm(self.near)}, " if np.isfinite(self.near) else ""
            words.append(
                f"expected error {near}over the workspace {_mm(self.workspace)} (95 %: "
                f"below {_mm(self.bound)})"
            )
        elif self.reason:
            words.append(self.reason)
        if self.unknown:
            words.append(f"still unknown: {enumerated(self.unknown, 60)}")
        return "; ".join([*words, *filter(None, [self._worth])])

    @property
    def _worth(self) -> str:
        if self.limit is not None and self.more:
            return f"about {self.more} more reach {_mm(self.limit)}"
        if self.limit is None and np.isfinite(self.further):
            return f"{AHEAD} more leave {_mm(self.further)}"
        return ""

    @property
    def conclusion(self) -> str:
        """Why more rows are not needed, one line."""
        if self.limit is not None:
            return f"reached: below {_mm(self.limit)} over the workspace"
        return (
            f"enough: {AHEAD} more rows would only lower {_mm(self.workspace)} to "
            f"{_mm(self.further)} over the workspace"
        )

    def document(self) -> dict[str, Any]:
        """The state as plain data; None for what is not known."""
        found = {**vars(self), "reached": self.reached}
        unknown = {k for k, v in found.items() if isinstance(v, float) and np.isnan(v)}
        return {k: None if k in unknown else v for k, v in found.items()}


def assess(
    chains: Chains,
    rows: Observations,
    expected: Expectation,
    outlook: Outlook,
    limit: float | None,
    count: int,
    aside: int,
    seed: int,
    seek: bool,
) -> tuple[State, tuple[Finding, ...]]:
    """The state of rows that were fitted, and what is wrong with them.

    Args:
        chains: The nominal chains.
        rows: The rows.
        expected: Their fit.
        outlook: What more rows would tell.
        limit: The error that is to be reached [m].
        count: Number of all rows.
        aside: Number of those that are set aside.
        seed: Seed of the folds.
        seek: Whether to seek faults of all rows; they have been sought otherwise.
    """
    model = expected.model
    assert model is not None
    known = State(count, aside, limit=limit)
    if expected.early:
        return known, ()
    try:
        errors = fitted_errors(model, rows)
        held_out = check(model, rows, seed, validate=False)
        found = judge(chains, model, errors, held_out, seed, seek=seek)
    except CalibPinError as error:
        return State(count, aside, reason=str(error), limit=limit), ()
    verdict, reason = found.verdict
    _, workspace = found.worst
    numbers: dict[str, Any] = {}
    if workspace is not None:
        every = [a.measured for a in found.accuracies.values() if a.measured]
        now, bound = workspace.calibrated.position, workspace.bound.position
        numbers |= {"workspace": now, "bound": bound}
        numbers |= {"near": max(e.calibrated.position for e in every)} if every else {}
        if len(outlook.errors) > AHEAD:
            further = now * outlook.errors[AHEAD] / outlook.errors[0]
            numbers |= {"further": further}
        if limit is not None:
            numbers |= {"more": outlook.more(bound, limit)}
    fit = model.fit
    unknown = tuple(
        f"{error.kind} of {' + '.join(error.of)}"
        for error in robot_errors(fit.problem, fit.structure, fit)
        if error.status == "weak"
    )
    numbers |= {"unknown": unknown, "limit": limit}
    state = State(count, aside, verdict, reason, **numbers)
    return state, tuple(f for f in found.findings if f.severity != "info")


def doubtful(chains: Chains, expected: Expectation) -> bool:
    """Whether rows are so far from the robot that they may be read wrong."""
    return expected.model is not None and Case.of(expected.model.fit, chains).doubtful


def causes(
    chains: Chains, rows: Observations, setup: Setup, others: Others
) -> tuple[Finding, ...]:
    """What is wrong with all rows, where no robot explains them."""
    try:
        found = find(Case.of_robot(chains, rows, setup, others))
    except CalibPinError:
        return ()
    return found.causes


def _mm(size: float) -> str:
    return f"{1e3 * size:.2g} mm"
