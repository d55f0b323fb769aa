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

SIZE, COUNT = 700, 13

MINIMAX = ("O3", "condition")

Searches = Callable[..., Search]


@pytest.fixture(autouse=True)
def small_chunks(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pricing, "CHUNK", 150)


@pytest.fixture
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


@pytest.mark.parametrize(
    "criterion",
    ["prediction", "O1", *(pytest.param(k, marks=pytest.mark.slow) for k in MINIMAX)],
)
def test_no_candidate_improves_what_exchange_has_found(
    criterion: str, searches: Searches
) -> None:
    """With all candidates in memory the same excursions would fail, too."""
    few, whole = searches(criterion, 60), searches(criterion, SIZE)
    found = few.run("exchange")
    assert found.status is Status.CONVERGED
    assert 60 < len(few.table) < SIZE
    subset = whole.selection(positions(whole, found))
    assert subset.cost == pytest.approx(found.cost, abs=1e-7)
    assert exchange(subset).cost > found.cost - 10.0 * WORTH


@pytest.mark.parametrize("criterion", ["prediction", "O1", "condition"])
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


def test_more_candidates_bring_more(
    searches: Searches, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Those in memory alone are worse than all of them by far more than a trifle."""
    best = searches("O1", 60).by_exchange().cost
    monkeypatch.setattr(WorkingSet, "grow", lambda *_: False)
    assert best < searches("O1", 60).by_exchange().cost - 0.02


def test_the_start_may_be_anywhere(searches: Searches) -> None:
    """All criteria of about the same value as with all candidates in memory.

    Both end in local optima, whose costs here differ by some hundredths.
    """
    for criterion in ("prediction", "O1"):
        few, whole = (searches(criterion, n).by_exchange() for n in (60, SIZE))
        assert few.cost < whole.cost + 0.05


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
    for _ in range(5):
        chosen = rng.choice(SIZE, COUNT, replace=False)
        assert few.value(chosen) == pytest.approx(whole.value(chosen), rel=1e-9)
    assert few.value(np.arange(3)) == np.inf


def test_genes_rank_no_more_than_they_can(
    searches: Searches, monkeypatch: pytest.MonkeyPatch
) -> None:
    whole = searches("O1", SIZE)
    for limit in (90, SIZE):
        monkeypatch.setattr(search, "GENES", limit)
        few = searches("O1", 60, lambda stage, part: stage == "ga" and part > 0.1)
        last = max(positions(whole, few.run("ga")))
        assert 60 <= last < limit
        assert (last < 90) == (limit == 90)


@pytest.mark.parametrize("method", ["pso", "gradient"])
def test_starts_are_drawn_among_all(method: str, searches: Searches) -> None:
    few = searches("O1", 60, lambda stage, part: stage == method and part > 0.02)
    found = few.run(method)
    assert found.status is Status.STOPPED
    assert np.isfinite(found.cost) and found.q.shape == (COUNT, 6)


def test_too_few_to_determine_anything(searches: Searches) -> None:
    few = searches("O1", 60)
    few.count = 4
    with pytest.raises(OptionError, match="cannot determine"):
        few.run("exchange")
