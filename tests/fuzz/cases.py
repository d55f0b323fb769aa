"""Cases: a command with a damaged file, run in a process that may die of it."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import random
import re
import resource
import signal
import sys
import tempfile
import time
import warnings
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass
from multiprocessing.connection import Connection, wait
from pathlib import Path

import calib_pin.cli.calibrate
from calib_pin.cli import main
from tests.fuzz.corpus import JOBS, needed
from tests.fuzz.mutators import damaged

SECONDS = 10.0
"""Longest time of a case, of its processor; the machine may be busy."""

PATIENCE = 6.0
"""Times as long until a case that does not even count time is killed."""

MEMORY = 2 << 30
"""Most memory of a case [bytes]."""

LONGEST = 300
"""Longest line on standard error, in characters."""


@dataclass(frozen=True)
class Case:
    """A command line and its files.

    Attributes:
        name: Seed and number, from which it can be made again.
        words: The command line.
        file: The damaged file.
        files: Content of all files by name.
        how: What damaged it.
    """

    name: str
    words: str
    file: str
    files: Mapping[str, bytes]
    how: str


@dataclass(frozen=True)
class Outcome:
    """What a case left behind.

    Attributes:
        status: Exit status; None where the process died or was killed.
        err: What stands on standard error, or how the process ended.
        seconds: Time of its processor.
        memory: Most memory of the process [bytes].
        changed: Files that are there afterwards and were not before, or differ.
    """

    status: int | None
    err: str
    seconds: float = 0.0
    memory: int = 0
    changed: tuple[str, ...] = ()


def make_case(seed: int, number: int, corpus: Mapping[str, bytes]) -> Case:
    """Case `number` of a seed; it depends on no other."""
    name = f"{seed}/{number}"
    rng = random.Random(name)
    job = rng.choices(JOBS, [job.weight for job in JOBS])[0]
    file = rng.choice(job.files.split())
    data, how = damaged(rng, file, corpus[file])
    files = needed(job.words, corpus) | {file: data}
    return Case(name, job.words, file, files, how)


def fault(case: Case, outcome: Outcome) -> str | None:
    """The rule that an outcome breaks, in a few words; None if it breaks none."""
    status, err = outcome.status, outcome.err
    lines = err.splitlines()
    if status is None:
        return err
    if outcome.seconds > SECONDS:
        return "slow"
    if outcome.memory > MEMORY:
        return "memory"
    if "Traceback" in err:
        return "traceback"
    if "internal error" in err:
        return "internal error"
    if status not in (0, 1, 2):
        return f"status {status}"
    if any(not line.startswith("calib-pin: ") for line in lines):
        return "foreign line"
    if any(len(line) > LONGEST for line in lines):
        return "long message"
    if not all(line.isprintable() for line in lines):
        return "unprintable message"
    if status == 1 and len(lines) != 1:
        return f"{len(lines)} lines"
    named = any(name in err for name in case.files) or re.search("--[a-z]", err)
    if status == 1 and not named:
        return "neither file nor option named"
    if status == 1 and outcome.changed:
        return "written"
    return None


def outcomes(cases: Iterable[Case], jobs: int = 1) -> Iterator[tuple[Case, Outcome]]:
    """The outcomes of cases as they come, each of a process with limits of its own.

    They are forked from this one, which has loaded and compiled everything.
    """
    todo, running = iter(cases), dict[Connection, _Child]()
    try:
        while True:
            while len(running) < jobs and (case := next(todo, None)) is not None:
                child = _Child(case)
                running[child.pipe] = child
            if not running:
                return
            for pipe in wait(list(running), timeout=1.0):
                child = running.pop(pipe)  # type: ignore[call-overload]
                yield child.case, child.outcome()
            for child in running.values():
                if time.monotonic() > child.deadline:
                    child.process.kill()
    finally:
        for child in running.values():
            child.process.kill()
            child.process.join()


class _Child:
    """A process that runs a case."""

    def __init__(self, case: Case) -> None:
        context = multiprocessing.get_context("fork")
        self.case = case
        self.pipe, theirs = context.Pipe(duplex=False)
        self.process = context.Process(target=_run, args=(case, theirs), daemon=True)
        self.process.start()
        theirs.close()
        self.deadline = time.monotonic() + PATIENCE * SECONDS

    def outcome(self) -> Outcome:
        with self.pipe:
            try:
                found: Outcome = self.pipe.recv()
            except EOFError:
                self.process.join()
                code = -(self.process.exitcode or 0)
                hung = time.monotonic() > self.deadline
                died = signal.Signals(code).name if code > 0 else "exit"
                return Outcome(None, "hang" if hung else died)
        self.process.join()
        return found


class _TooLong(BaseException):
    """A case takes longer than it may."""


def _run(case: Case, pipe: Connection) -> None:
    """Send the outcome of a case."""
    _limit_memory()
    # Figures take a hundred times longer than reading what they show.
    calib_pin.cli.calibrate.draw_calibration = lambda *about: []  # type: ignore
    signal.signal(signal.SIGPROF, _stop)
    with tempfile.TemporaryDirectory() as folder:
        pipe.send(_outcome(case, Path(folder, "work")))


def _limit_memory() -> None:
    pages = Path("/proc/self/statm").read_text().split()
    reserved = (int(pages[0]) - int(pages[1])) * resource.getpagesize()
    _, most = resource.getrlimit(resource.RLIMIT_AS)
    resource.setrlimit(resource.RLIMIT_AS, (reserved + MEMORY, most))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))


def _stop(*_: object) -> None:
    raise _TooLong


def _outcome(case: Case, work: Path) -> Outcome:
    work.mkdir()
    for name, data in case.files.items():
        path = work / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(data)
    os.chdir(work)
    before = _hashes(work)
    began = time.process_time()
    with tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        # What C++ prints goes past `sys.stderr`.
        os.dup2(out.fileno(), 1)
        os.dup2(err.fileno(), 2)
        sys.stdout = os.fdopen(1, "w", closefd=False, encoding="utf-8")
        sys.stderr = os.fdopen(2, "w", closefd=False, encoding="utf-8")
        with warnings.catch_warnings():
            # In a process of its own each would be the first.
            warnings.simplefilter("always", RuntimeWarning)
            signal.setitimer(signal.ITIMER_PROF, SECONDS)
            try:
                status = main(case.words.split())
            except _TooLong:
                status = None
            except BaseException as error:
                status = 3
                print(f"Traceback: {error!r}", file=sys.stderr)
            signal.setitimer(signal.ITIMER_PROF, 0.0)
        sys.stdout.flush()
        sys.stderr.flush()
        err.seek(0)
        said = err.read(1 << 20).decode(errors="backslashreplace")
    seconds = time.process_time() - began
    after = _hashes(work)
    return Outcome(
        status,
        "slow" if status is None else said,
        seconds,
        resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * 1024,
        tuple(sorted(n for n in after | before if after.get(n) != before.get(n))),
    )


def _hashes(folder: Path) -> dict[str, str]:
    files = (path for path in folder.rglob("*") if path.is_file())
    return {
        str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
        for path in files
    }
