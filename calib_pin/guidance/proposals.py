"""Where to measure next, and what more rows would tell."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from calib_pin.errors import OptionError
from calib_pin.guidance.fitted import Fitted
from calib_pin.io.collision import load_collisions
from calib_pin.io.measured_columns import joints_in, read_positions
from calib_pin.io.measurements import encode_configurations
from calib_pin.io.table import Table, read_table
from calib_pin.kinematics.chains import Chains
from calib_pin.kinematics.collision import Collisions
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices, Observations, states_sigmas
from calib_pin.planning.criteria import Prediction
from calib_pin.planning.planned_problem import TipTests, identification
from calib_pin.planning.search import Search
from calib_pin.planning.workspace import Aims, Candidates, Workspace, require_plannable
from calib_pin.setup import Setup
from calib_pin.validation.tool_accuracy import SAMPLES

MORE = 20
"""Most further rows that are looked ahead to."""

TOGETHER = 15
"""Configurations that are planned together where no plan is left. After five random
rows of a tracker, 20 such ones are worth 30 random ones; the best next one again and
again takes 25 (`scripts/benchmark watch`, its part `plan`)."""

NEAR = 0.02
"""Difference of a joint up to which a planned configuration was measured [rad, m]."""

Planned = tuple[Floats, Sequence[str]]
"""Configurations, shape (N, n) [rad, m], and their targets."""


@dataclass(frozen=True)
class Proposal:
    """The configuration to measure next.

    Attributes:
        q: Joint positions, shape (n,) [rad, m].
        joints: Names of these.
        cells: Columns of the measurement file that bring the robot there.
        remaining: Number of configurations of the plan that are left.
    """

    q: Floats
    joints: tuple[str, ...]
    cells: dict[str, str]
    remaining: int = 0

    @property
    def text(self) -> str:
        """One line."""
        where = ", ".join(f"{name} {value}" for name, value in self.cells.items())
        return f"next: {where}" + f" ({self.remaining} planned)" * (self.remaining > 0)

    def document(self) -> dict[str, Any]:
        """The proposal as plain data."""
        q = dict(zip(self.joints, self.q.tolist(), strict=True))
        return {"joints": q, "cells": self.cells, "left": self.remaining}


@dataclass
class Proposals:
    """Configurations that may be measured, of which the best is proposed.

    Attributes:
        file: The measurement file, whose columns name the joints; None without one.
        plan: File of a plan, of which the rest comes first; None without one.
        srdf: Pairs of links that need no collision check.
        package_dirs: Folders of the packages that the robot names.
    """

    file: Path | None
    plan: Path | None
    srdf: Path | None
    package_dirs: Sequence[Path]
    _known: tuple[Workspace, Candidates] | None = None
    _degrees: bool | None = None
    _together: tuple[Floats, Indices] | None = None

    def check(self, chains: Chains, setup: Setup) -> None:
        """Read the plan, and what says which collisions count.

        Raises:
            InputError: If one of the files cannot be used.
        """
        self._planned(chains, setup)
        if self.srdf is not None:
            self._collisions(chains, setup)

    def _planned(self, chains: Chains, setup: Setup) -> Planned:
        """The configurations of the plan; none without one."""
        if self.plan is None:
            return np.zeros((0, len(chains.joints))), []
        return _rows(read_table(self.plan, columns=setup.columns), chains, setup)

    def _collisions(self, chains: Chains, setup: Setup) -> Collisions | None:
        folders, pairs = self.package_dirs, self.srdf
        return load_collisions(
            chains, setup.obstacles, srdf=pairs, package_dirs=folders
        )

    def ahead(
        self, fitted: Fitted, all_rows: Observations
    ) -> tuple[Proposal | None, tuple[float, ...]]:
        """The next configuration, and the error of the tool point after more of them.

        The error is that after 0, 1, ... further rows [m]; of instruments that cannot
        be planned for, and before there is a fit, nothing is known.

        Raises:
            CalibPinError: If a file cannot be used, or no configuration is allowed.
        """
        q, targets = self._planned(fitted.chains, fitted.setup)
        rest, first = _unmeasured((q, targets), (all_rows.q, all_rows.target)), None
        if rest:
            first = self._proposal(fitted, q[rest[0]], targets[rest[0]], len(rest))
        if fitted.model is None:
            return first, ()
        try:
            search, names = self._search(fitted)
            table = None
            if rest:
                aimed = [targets[k] for k in rest]
                aim = [names.index(name) if name in names else 0 for name in aimed]
                table = search.rows.rows(q[rest], np.array(aim))
            selection = search.selection(table=table)
            errors = [selection.value]
            for k in range(min(MORE, selection.left)):
                selection.add(k if rest else selection.best_to_add()[0])
                errors.append(selection.value)
            if first is None:
                first = self._proposal(fitted, *self._best(search, names, all_rows), 0)
        except (OptionError, np.linalg.LinAlgError):
            return first, ()
        return first, tuple(errors)

    def _best(
        self, search: Search, names: list[str], all_rows: Observations
    ) -> tuple[Floats, str]:
        """The best one of those that were planned together and are left, if any."""
        q, aim = self._together or (np.zeros((0, 0)), np.zeros(0, np.intp))
        rest = _unmeasured((q, [names[k] for k in aim]), (all_rows.q, all_rows.target))
        if not rest:
            plan = search.run("auto")
            q, aim = self._together = plan.q, plan.aim
            rest = [*range(len(q))]
        table = search.rows.rows(q[rest], aim[rest])
        best = rest[search.selection(table=table).best_to_add()[0]]
        return q[best], names[int(aim[best])]

    def _search(self, fitted: Fitted) -> tuple[Search, list[str]]:
        """A search with all that the rows tell already, and the names of targets."""
        keys, model = fitted.rows.keys, fitted.model
        assert model is not None
        require_plannable(keys)
        noise = {} if fitted.early else {n.quantity: n for n in model.noise}
        # What rows state weighs them; what is planned then is measured as they are.
        given = states_sigmas(fitted.rows)
        sizes = {k: n.given if given else n.estimate for k, n in noise.items()}
        sigmas = {k.partition(" (")[0]: size for k, size in sizes.items() if size > 0.0}
        setup = replace(fitted.setup, noise={**fitted.setup.noise, **sigmas})
        setup, none = replace(setup, learned=None), np.zeros(0)
        problem = replace(fitted.informed, setup=setup, units=none)
        aims = Aims.of(problem, keys)
        if self._known is None:
            rng = np.random.default_rng(fitted.seed)
            solid = self._collisions(fitted.chains, setup)
            workspace = Workspace.create(problem, solid, aims)
            self._known = workspace, workspace.candidates(SAMPLES, rng)
        workspace, spread = self._known
        _, rows, information = identification(problem, aims, spread, fitted.rows)
        search = Search(
            rows,
            workspace,
            Prediction(TipTests.of(rows, spread).position),
            information,
            spread,
            max(1, min(TOGETHER, len(spread.q))),
            np.random.default_rng(fitted.seed),
            # From random sets it ends no lower.
            starts=0,
        )
        return search, [aim.target for aim in aims.each]

    def _proposal(self, fitted: Fitted, q: Floats, target: str, count: int) -> Proposal:
        """A configuration in the names, units and signs of the measurement file."""
        chains, joints = fitted.chains, fitted.setup.joints
        if self._degrees is None and self.file is not None:  # As its header stays.
            given = read_table(self.file, columns=fitted.setup.columns).columns.items()
            turned = {name for name, column in given if column.unit == "deg"}
            self._degrees = not turned.isdisjoint((*chains.joints, *joints))
        degrees = bool(self._degrees)
        table = encode_configurations(
            chains, q[None], [target], joints=joints, degrees=degrees
        )
        header, row = (line.split(",") for line in table.decode().splitlines()[-2:])
        cells = {
            name: cell if name == "target" else f"{float(cell):.{3 if degrees else 4}f}"
            for name, cell in zip(header, row, strict=True)
        }
        return Proposal(q, chains.joints, cells, count)


def remaining(plan: Table, rows: Table, chains: Chains, setup: Setup) -> list[int]:
    """Positions of the rows of a plan that a file does not have yet.

    Raises:
        InputError: If one of them has not the joints.
    """
    return _unmeasured(_rows(plan, chains, setup), _rows(rows, chains, setup))


def _rows(table: Table, chains: Chains, setup: Setup) -> Planned:
    """Configurations, shape (N, n) [rad, m], and their targets."""
    named, joint_columns = joints_in(table, chains, setup.joints)
    return read_positions(named, chains, joint_columns), table.labels("target")


def _unmeasured(plan: Planned, rows: Planned) -> list[int]:
    """Positions of planned configurations that no row has; each row has one."""
    rest = [*range(len(plan[0]))]
    for q, target in zip(*rows, strict=True):
        for k in rest:
            if np.abs(plan[0][k] - q).max() < NEAR and plan[1][k] in ("", target):
                rest.remove(k)
                break
    return rest
