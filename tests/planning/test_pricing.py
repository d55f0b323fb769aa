"""Few candidates in memory: what is found is as good as with all of them."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import OptionError
from calib_pin.estimation.formulation import nominal_problem
from calib_pin.planning import pricing, search
from calib_pin.planning.criteria import CRITERIA, Criterion, Prediction
from calib_pin.planning.objective import Found
from calib_pin.planning.planned_problem import TipTests, identification
from calib_pin.planning.pricing import WORTH, WorkingSet
from calib_pin.planning.search import Search
from calib_pin.planning.workspace import Workspace
from calib_pin.setup import FrameSetup, Setup
from calib_pin.solvers import Status, exchange

SIZE, COUNT = 400, 13

Searches = Callable[..., Search]


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pricing, "CHUNK", 150)


@pytest.fixture(scope="module")
def searches() -> Searches:
    """Searches among the same candidates: `searches("O1", 60)` with 60 in memory."""
    problem = nominal_problem(
        calib_pin.load_chain("space6"),
        "position",
        Setup(tool_frame=FrameSetup((0.05, 0.08, 0.12))),
    )
    workspace = Workspace.create(problem)

    def make(
        criterion: str, working: int, progress: search.Progress | None = None
    ) -> Search:
        rng = np.random.default_rng(1)
        candidates = workspace.candidates(SIZE, rng)
        _, rows, known = identification(problem, workspace.aims, candidates)
        kind: Criterion
        if criterion == "prediction":
            kind = Prediction(TipTests.of(rows, {"": candidates.q[:100]}).position)
        else:
            kind = CRITERIA[criterion]
        return Search(
            *(rows, workspace, kind, known, candidates, COUNT, rng, progress),
            working=working,
        )

    return make


def positions(whole: Search, found: Found) -> list[int]:
    """The members of a set among all candidates."""
    same = (found.q[:, None] == whole.candidates.q).all(axis=2)
    assert (same.sum(axis=1) == 1).all()
    return [int(k) for k in same.argmax(axis=1)]


def test_no_candidate_improves_what_exchange_has_found(
    searches: Searches, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With all candidates in memory the same excursions would fail, too."""
    few, whole = searches("O1", 60), searches("O1", SIZE)
    found = few.run("exchange")
    assert found.status is Status.CONVERGED
    assert 60 < len(few.table) < SIZE
    subset = whole.selection(positions(whole, found))
    assert subset.cost == pytest.approx(found.cost, abs=1e-7)
    assert exchange(subset).cost > found.cost - 10.0 * WORTH
    # Those in memory alone are worse than all of them by far more than a trifle.
    monkeypatch.setattr(WorkingSet, "grow", lambda *_: False)
    assert found.cost < searches("O1", 60).by_exchange().cost - 0.02


@pytest.mark.parametrize("criterion", ["prediction", "condition"])
def test_greedy_adds_the_best_of_all(criterion: str, searches: Searches) -> None:
    few, whole = searches(criterion, 60), searches(criterion, SIZE)
    found = few.run("greedy")
    chosen = positions(whole, found)
    assert max(chosen) >= 60
    steps = 0
    for k in range(COUNT):
        subset = whole.selection(chosen[:k])
        if np.isfinite(subset.cost):
            _, best = subset.best_to_add()
            subset.add(chosen[k])
            assert best - 1e-7 <= subset.cost < best + 2.0 * WORTH
            steps += 1
    assert steps >= 3


def test_a_pass_that_is_stopped(searches: Searches) -> None:
    told: list[tuple[str, float]] = []

    def progress(stage: str, part: float) -> bool:
        told.append((stage, part))
        return stage == "passes" and part > 0.3

    found = searches("O1", 60, progress).run("exchange")
    assert found.status is Status.STOPPED and np.isfinite(found.cost)
    parts = [part for stage, part in told if stage == "passes"]
    assert parts == sorted(parts) and 0.3 < parts[-1] < 0.5
    # Nothing follows.
    assert told[-1] == ("passes", parts[-1])


def test_chosen_members_need_no_rows_in_memory(searches: Searches) -> None:
    few, whole = searches("O1", 60), searches("O1", SIZE)
    rng = np.random.default_rng(0)
    for _ in range(2):
        chosen = rng.choice(SIZE, COUNT, replace=False)
        assert few.value(chosen) == pytest.approx(whole.value(chosen), rel=1e-9)
    assert few.value(np.arange(3)) == np.inf
    few.count = 4
    with pytest.raises(OptionError):
        few.run("exchange")
