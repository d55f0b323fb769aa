"""Damaged files, and that the fuzzer sees what it looks for."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.fuzz import cases, corpus
from tests.fuzz.cases import Case, Outcome, Pool, fault, make_case
from tests.fuzz.mutators import damaged
from tests.fuzz.reduction import reduced, smallest

ROOT = Path(__file__).parents[2]


def fuzz(*options: str) -> None:
    run = subprocess.run(
        [sys.executable, "-m", "tests.fuzz", *options],
        cwd=ROOT,
        capture_output=True,
        text=True,
    )
    assert run.returncode == 0, run.stdout + run.stderr


def test_damaged_files() -> None:
    fuzz("--cases", "300", "--seed", "19")


@pytest.mark.slow
def test_many_damaged_files() -> None:
    fuzz("--cases", "5000", "--seed", "1900", "--no-reduction")


# --- the fuzzer itself -------------------------------------------------------------


@pytest.fixture
def running(
    monkeypatch: pytest.MonkeyPatch,
) -> Callable[[Callable[[list[str]], int]], Outcome]:
    """The outcome of a case whose command is a function."""

    def run(command: Callable[[list[str]], int]) -> Outcome:
        monkeypatch.setattr(cases, "main", command)
        monkeypatch.setattr(cases, "SECONDS", 0.5)
        ((_, outcome),) = Pool().run([CASE])
        return outcome

    return run


CASE = Case("0/0", "report a.csv", "a.csv", {"a.csv": b"x\n1\n"}, "")


def die(_: list[str]) -> int:
    os.kill(os.getpid(), signal.SIGSEGV)
    return 0


def hang(_: list[str]) -> int:
    while True:
        pass


def wait(_: list[str]) -> int:
    signal.pause()
    return 0


def swallow(_: list[str]) -> int:
    return len(bytearray(cases.MEMORY))


def fail(_: list[str]) -> int:
    raise KeyError("x")


def saying(text: str, status: int) -> Callable[[list[str]], int]:
    def say(_: list[str]) -> int:
        os.write(2, text.encode())  # As C++ does.
        return status

    return say


def spoil(_: list[str]) -> int:
    Path("a.csv").write_text("")
    return saying("calib-pin: a.csv: bad\n", 1)([])


@pytest.mark.parametrize(
    ("command", "what"),
    [
        (die, "SIGSEGV"),
        (hang, "slow"),
        (wait, "hang"),
        (swallow, "traceback"),
        (fail, "traceback"),
        (saying("", 0), None),
        (saying("calib-pin: note: a\ncalib-pin: note: b\n", 2), None),
        (saying("calib-pin: a.csv: bad\n", 1), None),
        (saying("calib-pin: bad; see --help\n", 1), None),
        (saying("calib-pin: bad\n", 1), "neither file nor option named"),
        (saying("", 1), "0 lines"),
        (saying("calib-pin: note: a\ncalib-pin: a.csv: bad\n", 1), "2 lines"),
        (saying(f"calib-pin: a.csv: {'x' * 300}\n", 1), "long message"),
        (saying("calib-pin: a.csv: \x1b[2J\n", 1), "unprintable message"),
        (saying("calib-pin: internal error: a.csv\n", 1), "internal error"),
        (saying("a.py:3: RuntimeWarning: overflow\n", 0), "foreign line"),
        (saying("", 139), "status 139"),
        (spoil, "written"),
    ],
)
def test_what_is_a_failure(command, what, running, monkeypatch) -> None:
    monkeypatch.setattr(cases, "PATIENCE", 6.0 if command is hang else 2.0)
    assert fault(CASE, running(command)) == what


def test_after_a_death_the_others_run(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(cases, "main", lambda words: die([]) if words == ["b"] else 0)
    run = Pool(2).run(Case(word, word, "", {}, "") for word in "abcd")
    found = {case.name: outcome.status for case, outcome in run}
    assert found == {"a": 0, "b": None, "c": 0, "d": 0}


def test_the_smallest_file() -> None:
    left = [1000]
    found = smallest(
        [b"%d\n" % k for k in range(100)],
        lambda parts: b"7\n" in parts and b"42\n" in parts,
        left,
    )
    assert found == [b"7\n", b"42\n"]


def test_the_smallest_file_of_a_case(monkeypatch: pytest.MonkeyPatch) -> None:
    def command(_: list[str]) -> int:
        return die([]) if b"bad" in Path("a.csv").read_bytes() else 0

    monkeypatch.setattr(cases, "main", command)
    text = b"".join(b"%d,good\n" % k for k in range(30)) + b"31,bad,1\n32,good\n"
    case = Case("0/0", "report a.csv", "a.csv", {"a.csv": text}, "")
    assert reduced(case, "SIGSEGV").files == {"a.csv": b"bad"}


@pytest.fixture(scope="module")
def files(tmp_path_factory: pytest.TempPathFactory) -> Iterator[dict[str, bytes]]:
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(tmp_path_factory.mktemp("corpus"))
        yield corpus.written()


def test_the_corpus_is_valid(files: dict[str, bytes]) -> None:
    jobs = [
        Case("", job.words, "", corpus.needed(job.words, files), "")
        for job in corpus.JOBS
    ]
    for case, outcome in Pool().run(jobs):
        assert outcome.status in (0, 2), (case.words, outcome)
        assert fault(case, outcome) is None, (case.words, outcome)
    damageable = {name for job in corpus.JOBS for name in job.files.split()}
    for kind in ("urdf", "srdf", "yaml", "csv", "json", "stl", "obj", "ply", "dae"):
        assert any(name.endswith(kind) for name in damageable), kind


def test_a_case_is_the_same_in_every_run(files: dict[str, bytes]) -> None:
    first, again = make_case(3, 7, files), make_case(3, 7, dict(files))
    assert first == again
    assert (
        len(
            {
                make_case(3, k, files).files[make_case(3, k, files).file]
                for k in range(50)
            }
        )
        > 45
    )


def test_all_mutators_do_something(files: dict[str, bytes]) -> None:
    told = set[str]()
    for k in range(400):
        name = random.Random(k).choice(sorted(files))
        data, how = damaged(random.Random(k), name, files[name])
        told |= set(how.split(", "))
        assert len(data) < 2_000_000
    kinds = {"bytes", "encoding", "lines", "numbers", "words", "sizes"}
    assert told == kinds | {"columns", "elements", "nodes"}
