"""A watched job whose rows come one by one."""

from __future__ import annotations

import os
import time
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import calib_pin
from calib_pin.errors import InputError
from calib_pin.guidance import Event, Watch
from calib_pin.guidance.proposals import Proposals
from calib_pin.guidance.watch import SETTLED
from calib_pin.kinematics.chains import Chains
from calib_pin.observations import Measurements, Observations
from calib_pin.setup import FrameSetup, LimitSetup, Setup
from tests.shared import simulated

NOISE = 5e-5
PLACES = Setup(
    base_frame=FrameSetup((2.0, 1.0, 0.5), (0.1, 0.2, 1.0)),
    tool_frame=FrameSetup((0.05, 0.03, 0.1)),
)
OFFSETS = Setup(parameters=("joint-offset",))


@pytest.fixture(scope="module")
def chains() -> Chains:
    return Chains.of(calib_pin.load_chain("space6"))


@pytest.fixture(scope="module")
def rows(chains: Chains) -> Measurements:
    truth = replace(PLACES, parameters=OFFSETS.parameters)
    problem, _ = simulated("position", truth, 24, 1.0, 3, robot=chains, noise=NOISE)
    return replace(problem.data.only, sigma=None)


class Silent:
    """Proposes nothing, which takes half the time of a look."""

    def ahead(self, *_: object) -> tuple[None, tuple[float, ...]]:
        return None, ()


class Job:
    """Files that are written row by row."""

    def __init__(
        self, chains: Chains, rows: Measurements, folder: Path, setup: Setup = OFFSETS
    ) -> None:
        self.chains, self.rows, self.setup = chains, rows, setup
        self.file, self.time = folder / "rows.csv", 0
        self.error: InputError | None = None
        self.watch = Watch(self.read, [self.file], Silent())  # type: ignore[arg-type]

    def proposing(self, plan: Path | None = None) -> Proposals:
        """From now on it proposes configurations."""
        self.watch.proposals = Proposals(None, plan, None, ())
        return self.watch.proposals

    def read(self) -> tuple[Chains, Setup, Observations]:
        if self.error is not None:
            raise self.error
        return self.chains, self.setup, Observations.of(self.there)

    def look(self, places: Sequence[int] | int) -> list[Event]:
        """The events when these rows, or so many, are there."""
        some = np.arange(places) if isinstance(places, int) else np.array(places)
        self.there = self.rows.rows(some)
        self.time += 1
        self.file.write_text(f"{self.time}\n")
        os.utime(self.file, (self.time, self.time))
        return [*self.watch.look()]


@pytest.fixture
def job(chains: Chains, rows: Measurements, tmp_path: Path) -> Job:
    return Job(chains, rows, tmp_path)


def displaced(rows: Measurements, k: int, size: float) -> Measurements:
    values = rows.values.copy()
    values[k] += [0.0, size, 0.0]
    return replace(rows, values=values)


def texts(events: Sequence[Event], kind: str) -> list[str]:
    return [event.text for event in events if event.kind == kind]


def wrong(events: Sequence[Event]) -> list[str]:
    return [e.numbers["place"] for e in events if e.numbers.get("wrong")]


def test_before_frames_are_determined_it_says_what_is_missing(job: Job):
    said = job.look(2)
    assert [event.kind for event in said][-1] == "waiting"
    assert "6 measured values are used up" in said[-1].text
    assert job.watch.fit is None and job.watch.state is None


def test_a_wrong_row_is_told_and_set_aside_until_it_is_corrected(job: Job):
    clean = job.rows
    assert wrong(job.look(14)) == []
    job.rows = displaced(clean, 14, 2e-3)
    said = job.look(15)
    assert wrong(said) == ["row 14"]
    (event,) = [e for e in said if e.kind == "row"]
    assert event.numbers["size"] == pytest.approx(2e-3, rel=0.2)
    assert event.numbers["sigma"] < 5 * NOISE and "set aside" in event.text
    assert job.watch.state is not None and job.watch.state.aside == 1
    assert wrong(job.look(16)) == []
    job.rows = clean
    said = job.look(17)
    assert "removed" in {e.kind for e in said} and wrong(said) == []
    assert job.watch.state.aside == 0 and job.watch.state.rows == 17


def test_the_same_line_twice_is_told(job: Job):
    job.look(12)
    assert wrong(job.look([*range(12), 11])) == ["row 12"]


def test_clean_rows_are_not_accused_and_accuracy_grows(job: Job):
    said = [job.look(k) for k in range(4, 13)]
    assert [place for events in said for place in wrong(events)] == []
    first, last = (
        next(e.numbers["workspace"] for e in said[k] if e.kind == "state")
        for k in (4, 8)
    )
    assert last < first < 1e-3
    assert job.watch.state is not None and job.watch.state.verdict == "good"


def test_a_first_look_finds_the_wrong_ones_among_many(job: Job):
    job.rows = displaced(job.rows, 5, 5e-3)
    assert wrong(job.look(24)) == ["row 5"]


def test_the_job_goes_on_where_its_file_is(job: Job, chains: Chains, tmp_path: Path):
    job.rows = displaced(job.rows, 16, 5e-3)
    for k in (16, 17, 18, 19):
        job.look(k)
    anew = Job(chains, job.rows, tmp_path)
    anew.time = 100
    anew.look(19)
    first, second = job.watch.state, anew.watch.state
    assert first is not None and second is not None
    assert (first.rows, first.aside, first.verdict) == (19, 1, second.verdict)
    assert second.aside == 1
    assert first.workspace == pytest.approx(second.workspace, rel=1e-6)


def test_several_rows_that_disagree_are_fitted_with_the_others(job: Job):
    moved = job.rows.values.copy()
    moved[10:] += [0.004, 0.003, 0.0]
    job.rows = replace(job.rows, values=moved)
    job.look(10)
    said = [job.look(k) for k in (11, 12, 13, 18)]
    assert wrong(said[0]) == ["row 10"]
    assert any(
        e.numbers["code"] == "instrument-moved"
        for s in said
        for e in s
        if e.kind == "finding"
    )


def test_a_joint_that_counts_the_other_way_is_named(job: Job):
    q = job.rows.q * [1, 1, -1, 1, 1, 1]
    job.rows = replace(job.rows, q=q)
    found = [e for e in job.look(13) if e.kind == "finding"]
    assert found[0].numbers["code"] == "joint-reversed"
    assert found[0].numbers["setup"]["joints"]


@pytest.mark.slow
def test_a_limit_is_reached_once(chains: Chains, rows: Measurements, tmp_path: Path):
    first = Job(chains, rows, tmp_path)
    first.look(9)
    assert first.watch.state is not None
    limit = 0.75 * first.watch.state.bound
    setup = replace(OFFSETS, limit=LimitSetup(position=limit))
    job = Job(chains, rows, tmp_path, setup)
    job.proposing()
    job.look(9)
    state = job.watch.state
    assert state is not None and state.more and not state.reached
    assert f"about {state.more} more reach" in state.text
    job.watch.proposals = Silent()  # type: ignore[assignment]
    said = [e for k in (16, 20, 24) for e in job.look(k)]
    assert len(texts(said, "reached")) == 1
    assert job.watch.state is not None and job.watch.state.bound <= limit


def test_the_next_configuration_is_that_of_the_plan_then_a_new_one(
    job: Job, chains: Chains
):
    header = ",".join(chains.joints)
    cells = [",".join(map(str, q)) for q in job.rows.q[8:11].tolist()]
    plan = job.file.with_name("plan.csv")
    plan.write_text("\n".join([header, *cells]) + "\n")
    job.proposing(plan)
    job.look(8)
    assert job.watch.next is not None and job.watch.next.remaining == 3
    np.testing.assert_allclose(job.watch.next.q, job.rows.q[8])
    job.look([*range(8), 9])
    assert job.watch.next.remaining == 2
    np.testing.assert_allclose(job.watch.next.q, job.rows.q[8])
    job.look(11)
    assert job.watch.next.remaining == 0
    q = job.watch.next.q
    assert ((chains.lower <= q) & (q <= chains.upper)).all()


def test_what_was_planned_together_is_measured_one_after_another(job: Job):
    proposals = job.proposing()
    job.look(9)
    assert job.watch.next is not None
    first, together = job.watch.next.q, proposals._together
    assert together is not None and any((first == q).all() for q in together[0])
    job.look(10)  # Elsewhere: what was planned is still to be measured.
    assert proposals._together is together
    q = job.rows.q.copy()
    q[10] = first
    job.rows = replace(job.rows, q=q)
    job.look(11)
    second = job.watch.next.q
    assert not np.allclose(first, second)
    assert any((second == q).all() for q in together[0])


def test_nothing_is_told_while_nothing_changes(job: Job):
    job.look(6)
    assert [*job.watch.look()] == []


def test_what_is_being_written_is_waited_for(job: Job, monkeypatch):
    """Half a second, also where the clock of another computer is ahead."""
    pauses = list[float]()
    monkeypatch.setattr(time, "sleep", pauses.append)
    job.look(6)
    job.time = int(time.time()) + 100_000
    said = job.look(5)
    assert pauses == [0.0, SETTLED]
    assert "removed" in {event.kind for event in said}
    assert job.watch.state.rows == 5


def test_a_file_that_cannot_be_read_is_told_once(job: Job):
    job.look(6)
    job.error = InputError("cannot be read", file=job.file, line=3)
    (event,) = job.look(7)
    assert event.kind == "problem" and "rows.csv:3" in event.text
    assert job.look(7) == []
    job.error = None
    assert texts(job.look(7), "state") or texts(job.look(8), "waiting")


def test_events_are_plain_data(job: Job):
    from json import dumps, loads

    job.proposing()
    events = [*job.look(3), *job.look(12)]
    assert {e.kind for e in events} >= {"waiting", "row", "state", "next"}
    for event in events:
        assert loads(dumps(event.document()))["text"] == event.text
