"""Cases: a command with a damaged file, run in a process that may die of it."""

from __future__ import annotations

import hashlib
import multiprocessing
import os
import random
import re
import resource
import shutil
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

CASES_OF_A_WORKER = 400
"""Cases after which a process is replaced, so that its memories do not add up."""


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
        memory: Most memory of the process so far [bytes].
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


class Pool:
    """Processes that run cases, each with limits of its own.

    They are forked from this one, which has loaded and compiled everything.
    """

    def __init__(self, jobs: int = 1) -> None:
        """Nothing is started yet."""
        self._jobs = jobs

    def run(self, cases: Iterable[Case]) -> Iterator[tuple[Case, Outcome]]:
        """The outcomes of cases, as they come."""
        todo = iter(cases)
        idle = [_Worker() for _ in range(self._jobs)]
        busy: dict[Connection, _Worker] = {}
        try:
            while True:
                while idle and (case := next(todo, None)) is not None:
                    worker = idle.pop()
                    worker.start(case)
                    busy[worker.pipe] = worker
                if not busy:
                    return
                for pipe in wait(list(busy), timeout=1.0):
                    worker = busy.pop(pipe)  # type: ignore[call-overload]
                    yield worker.case, worker.outcome()
                    idle.append(worker.fresh())
                for worker in busy.values():
                    if time.monotonic() > worker.deadline:
                        worker.process.kill()
        finally:
            for worker in (*idle, *busy.values()):
                worker.process.kill()
                worker.process.join()


class _Worker:
    """A process that runs one case after the other."""

    case: Case

    def __init__(self) -> None:
        context = multiprocessing.get_context("fork")
        self.pipe, theirs = context.Pipe()
        self.process = context.Process(
            target=_serve, args=(self.pipe, theirs), daemon=True
        )
        self.process.start()
        theirs.close()
        self.deadline = 0.0
        self._done = 0

    def start(self, case: Case) -> None:
        self.case = case
        self.deadline = time.monotonic() + PATIENCE * SECONDS
        self.pipe.send(case)

    def outcome(self) -> Outcome:
        self._done += 1
        try:
            found: Outcome = self.pipe.recv()
            return found
        except EOFError:
            self.process.join()
            self._done = CASES_OF_A_WORKER
            code = -(self.process.exitcode or 0)
            if time.monotonic() > self.deadline:
                return Outcome(None, "hang")
            return Outcome(None, signal.Signals(code).name if code > 0 else "exit")

    def fresh(self) -> _Worker:
        """This process, or another in its place."""
        if self._done < CASES_OF_A_WORKER:
            return self
        self.pipe.close()
        self.process.kill()
        self.process.join()
        return _Worker()


class _TooLong(BaseException):
    """A case takes longer than it may."""


def _serve(ours: Connection, pipe: Connection) -> None:
    """Run the cases that come through a pipe, until nobody holds its other end."""
    ours.close()
    _limit_memory()
    # Figures take a hundred times longer than reading what they show.
    calib_pin.cli.calibrate.draw_calibration = lambda *about: []  # type: ignore
    signal.signal(signal.SIGPROF, _stop)
    with tempfile.TemporaryDirectory() as folder:
        work = Path(folder, "work")
        while True:
            try:
                case = pipe.recv()
            except EOFError:
                return
            shutil.rmtree(work, ignore_errors=True)
            pipe.send(_outcome(case, work))


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
