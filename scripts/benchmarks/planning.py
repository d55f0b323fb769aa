"""Choosing configurations: trials by first order against fresh factorizations."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

import calib_pin
from benchmarks.timing import best, show
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.io.collision import load_collisions
from calib_pin.kinematics.spatial import Floats
from calib_pin.observations import Indices
from calib_pin.planning.criteria import CRITERIA, Criterion, Selection
from calib_pin.planning.planned_problem import identification
from calib_pin.planning.search import Search
from calib_pin.planning.workspace import Workspace
from calib_pin.setup import FrameSetup, Setup

TOOL = FrameSetup((0.05, 0.03, 0.1))


class Factored(Selection):
    """A subset that factors the information matrix of every trial anew."""

    def _best(self, candidates: Indices, sign: float) -> tuple[int, float]:
        """The best of all trials by their costs."""
        costs = [
            self._evaluate(self._M + sign * self.rows[k].T @ self.rows[k])[1]
            for k in candidates
        ]
        return int(candidates[np.argmin(costs)]), min(costs)


class Fresh(Search):
    """A search on such subsets."""

    def selection(
        self, chosen: Sequence[int] = (), table: Floats | None = None
    ) -> Selection:
        """A subset of the candidates under the criterion."""
        known, nuisances = self.known, self.rows.nuisances
        return Factored(self.table, nuisances, self.criterion, known, chosen)


def main() -> None:
    """D-criterion and condition number on a 6R, and collision checks."""
    for size, count in ((500, 74), (10_000, 50)):
        _exchange("O1", size, count, fresh=size <= 500)
    _exchange("condition", 500, 15, fresh=True)
    _plan()
    _collisions()


def _search(
    criterion: Criterion, size: int, count: int, kind: type[Search] = Search
) -> Search:
    """A search among candidates of a 6R measured by positions."""
    chain = calib_pin.load_chain("example:ur10_robot", tip="tool0")
    problem = nominal_problem(chain, "position", Setup(tool_frame=TOOL))
    workspace, rng = Workspace.create(problem), np.random.default_rng(0)
    candidates = workspace.candidates(size, rng)
    _, rows, known = identification(problem, workspace.aims, candidates)
    return kind(rows, workspace, criterion, known, candidates, count, rng)


def _exchange(name: str, size: int, count: int, *, fresh: bool) -> None:
    criterion = CRITERIA[name]
    search = _search(criterion, size, count)
    found, greedy = search.by_exchange(), search.by_greedy()
    # A search keeps the set that it begins with, so each run is a new one.
    runs = [_search(criterion, size, count) for _ in range(5)]
    seconds = best(lambda: runs.pop().by_exchange(), 5)
    label = f"{name}, {count} of {size}"
    if fresh:
        other = _search(criterion, size, count, Fresh)
        show(label, seconds, "fresh factorizations", best(other.by_exchange, 1))
    else:
        show(label, seconds)
    print(f"{'':<40}{'':>14}cost {found.cost:.6f}, greedy {greedy.cost:.6f}")


def _plan() -> None:
    """A whole plan as users get it."""
    chain = calib_pin.load_chain("space6")
    setup = Setup(tool_frame=TOOL)
    seconds = best(lambda: calib_pin.plan(chain, "position", 15, setup), 3)
    plan = calib_pin.plan(chain, "position", 15, setup)
    print(
        f"{'plan, 15 configurations of a 6R':<40}{1e3 * seconds:9.1f} ms  predicted "
        f"tool-point uncertainty {1e3 * plan.value:.4f} mm, random baseline "
        f"{1e3 * plan.random:.4f} mm"
    )


def _collisions() -> None:
    """Self-collision of arms with meshes."""
    for name, tip in (("panda", "panda_link8"), ("ur10_robot", "tool0")):
        chain = calib_pin.load_chain(f"example:{name}", tip=tip)
        collisions = load_collisions(chain)
        assert collisions is not None
        q = chain.random_configurations(1000, np.random.default_rng(0))
        seconds = best(lambda collisions=collisions, q=q: collisions.free(q), 3)
        show(f"1000 collision checks, {name}", seconds)
