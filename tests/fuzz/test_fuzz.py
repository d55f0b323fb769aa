"""Damaged files, and that the fuzzer sees what it looks for."""

from __future__ import annotations

import argparse
import faulthandler
import os
import random
import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.fuzz import cases, corpus
from tests.fuzz.__main__ import run
from tests.fuzz.cases import Case, Outcome, fault, make_case, outcomes
from tests.fuzz.mutators import damaged

# --- the fuzzer itself -------------------------------------------------------------


CASE = Case("0/0", "report a.csv", "a.csv", {"a.csv": b"x\n1\n"}, "")


def die() -> int:
    faulthandler.disable()  # Its dump would look like a crash of the tests.
    os.kill(os.getpid(), signal.SIGSEGV)
    return 0


def hang() -> int:
    while True:
        pass


def fail() -> int:
    raise KeyError("x")


def swallow() -> int:
    return len(bytearray(cases.MEMORY))


def spoil() -> int:
    Path("a.csv").write_text("")
    os.write(2, b"calib-pin: a.csv: bad\n")  # As C++ does.
    return 1


@pytest.mark.parametrize(
    ("command", "what"),
    [
        (die, "SIGSEGV"),
        (hang, "slow"),
        (swallow, "traceback"),
        (fail, "traceback"),
        (spoil, "written"),
    ],
)
def test_a_process_that_fails(command, what, monkeypatch) -> None:
    monkeypatch.setattr(cases, "main", lambda words: command())
    monkeypatch.setattr(cases, "SECONDS", 0.3)
    monkeypatch.setattr(cases, "PATIENCE", 200.0)  # The machine may be busy.
    ((_, outcome),) = outcomes([CASE])
    assert fault(CASE, outcome) == what


@pytest.mark.parametrize(
    ("status", "said", "what"),
    [
        (0, "", None),
        (2, "calib-pin: note: a\ncalib-pin: note: b\n", None),
        (1, "calib-pin: a.csv: bad\n", None),
        (1, "calib-pin: bad\n", "neither file nor option named"),
        (1, "calib-pin: note: a\ncalib-pin: a.csv: bad\n", "2 lines"),
        (1, f"calib-pin: a.csv: {'x' * 300}\n", "long message"),
        (1, "calib-pin: a.csv: \x1b[2J\n", "unprintable message"),
        (1, "calib-pin: internal error: a.csv\n", "internal error"),
        (0, "a.py:3: RuntimeWarning: overflow\n", "foreign line"),
        (139, "", "status 139"),
    ],
)
def test_what_is_a_failure(status: int, said: str, what: str | None) -> None:
    assert fault(CASE, Outcome(status, said)) == what


def test_after_a_death_the_others_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cases, "main", lambda words: die() if words == ["b"] else 0)
    run = outcomes((Case(word, word, "", {}, "") for word in "abcd"), 2)
    found = {case.name: outcome.status for case, outcome in run}
    assert found == {"a": 0, "b": None, "c": 0, "d": 0}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, bytes]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("corpus"))
        yield corpus.written()


@pytest.mark.slow
def test_damaged_files(files, capsys):
    options = {"first": 0, "minutes": None, "jobs": 1}
    for seed, count in ((19, 50), (1900, 40)):
        asked = argparse.Namespace(seed=seed, cases=count, **options)
        assert run(asked, files) == 0, capsys.readouterr().out


@pytest.mark.slow
def test_the_corpus_is_valid(files: dict[str, bytes]) -> None:
    jobs = [
        Case("", job.words, "", corpus.needed(job.words, files), "")
        for job in corpus.JOBS
    ]
    for case, outcome in outcomes(jobs):
        assert outcome.status in (0, 2), (case.words, outcome)
        assert fault(case, outcome) is None, (case.words, outcome)
    damageable = {name for job in corpus.JOBS for name in job.files.split()}
    for kind in ("urdf", "srdf", "yaml", "csv", "json", "stl", "obj", "ply", "dae"):
        assert any(name.endswith(kind) for name in damageable), kind


@pytest.mark.slow
def test_a_case_is_the_same_in_every_run(files: dict[str, bytes]) -> None:
    first, again = make_case(3, 7, files), make_case(3, 7, dict(files))
    assert first == again
    made = [make_case(3, k, files) for k in range(50)]
    assert len({case.files[case.file] for case in made}) > 45


@pytest.mark.slow
def test_all_mutators_do_something(files: dict[str, bytes]) -> None:
    told = set[str]()
    for k in range(400):
        name = random.Random(k).choice(sorted(files))
        data, how = damaged(random.Random(k), name, files[name])
        told |= set(how.split(", "))
        assert len(data) < 2_000_000
    kinds = {"bytes", "encoding", "lines", "numbers", "words", "sizes"}
    assert told == kinds | {"columns", "elements", "nodes"}
