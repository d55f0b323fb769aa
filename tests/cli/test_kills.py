"""Runs that are killed while they write over an earlier result.

`CALIB_PIN_KILLS` is the number of kills by each signal; half of them are aimed at the
moments of writing. The tests of `tests/io/test_files.py` fail at every single call;
here the processes, the signals and the moments are real.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from calib_pin.cli import main
from tests.cli.files import figures

KILLS = int(os.environ.get("CALIB_PIN_KILLS", "4"))
KINDS = {
    "figures": "--figures out/figures",
    "figures elsewhere": "--figures pictures",
    "learned": "--learned gaussian-process --figures out/figures",
}
INPUTS = ("first.csv", "second.csv")
TEMPORARY = ".calib-pin-*"

pytestmark = [
    pytest.mark.slow,
    # The children have one thread that matters, and no other one writes files.
    pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning"),
]


@pytest.fixture
def rows(here: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Two inputs by turns, so that the old set is never the new one."""
    monkeypatch.setattr("calib_pin.cli.requests.draw_calibration", figures)
    for seed, name in enumerate(INPUTS):
        words = (
            "simulate arm.urdf --model position --count 30 --noise 2e-5 --seed "
            f"{seed} --parameters joint-offset,transmission -o {name}"
        )
        assert main(words.split()) == 0


def words_of(kind: str, file: str) -> list[str]:
    words = f"calibrate arm.urdf {file} --setup setup.yaml -o out --force --quiet"
    return f"{words} {KINDS[kind]}".split()


def started(words: list[str]) -> int:
    """The process id of a run."""
    child = os.fork()
    if child:
        return child
    status = 99
    try:
        null = os.open(os.devnull, os.O_RDWR)
        for stream in range(3):
            os.dup2(null, stream)
        status = main(words)
    except KeyboardInterrupt:  # Before the command could take it.
        status = 130
    finally:
        os._exit(status)


def ended(child: int) -> int:
    """Exit status, negative for a signal."""
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])


def writing(folders: tuple[Path, ...]) -> bool:
    """Whether a run writes, or has left what it wrote."""
    return any(any(folder.glob(TEMPORARY)) for folder in folders)


def kill(child: int, number: int, wait: Callable[[], bool]) -> int:
    while wait():
        found, status = os.waitpid(child, os.WNOHANG)
        if found:
            return os.waitstatus_to_exitcode(status)
    os.kill(child, number)
    return ended(child)


def assert_one_run() -> None:
    """What a reader finds is of one run; it reads that before anything is checked."""
    status = main(["evaluate", "out/calibration.json", "new.csv", "--json"])
    assert status in (0, 2)
    stated = json.loads(Path("out/calibration.json").read_text())
    held: dict[str, str | None] = {
        name: hashlib.sha256(path.read_bytes()).hexdigest()
        for path in Path("out").rglob("*")
        if path.is_file() and (name := str(path.relative_to("out")))[0] != "."
    }
    del held["calibration.json"]
    held["report.html"] = None
    assert held == stated["files"]
    assert f'content="{stated["run"]}"' in Path("out/report.html").read_text()


def trials() -> Iterator[tuple[int, str, bool]]:
    """Number, input, and whether the kill is aimed at the writing."""
    for number in range(-(-KILLS // len(KINDS))):
        yield number, INPUTS[number % 2], number % 4 < 2


# What clears up clears up whatever was written; what is killed does not.
@pytest.mark.parametrize(
    ("name", "kind"),
    [
        *(("SIGKILL", kind) for kind in KINDS),
        ("SIGINT", "figures elsewhere"),
        ("SIGTERM", "figures"),
    ],
)
def test_a_killed_run_leaves_one_result(name: str, kind: str, rows: None) -> None:
    number = signal.Signals[name]
    chance = random.Random(f"{name} {kind}")
    folders = Path("out"), Path("out/figures"), Path("pictures")
    begin = time.monotonic()
    assert main(words_of(kind, INPUTS[1])) in (0, 2)
    took = time.monotonic() - begin
    assert_one_run()
    for trial, file, aimed in trials():
        child = started(words_of(kind, file))
        if aimed:
            while not writing(folders):
                time.sleep(1e-4)
            moment = time.monotonic() + chance.uniform(0.0, 0.06)
        else:
            moment = time.monotonic() + chance.uniform(0.0, 1.2 * took)
        status = kill(child, number, lambda at=moment: time.monotonic() < at)
        assert status in (0, 2, -number, 128 + number), status
        assert number == signal.SIGKILL or not writing(folders), "it cleared up"
        assert_one_run()
        if trial % 5 == 4 or kind != "learned":
            following = words_of(kind, INPUTS[(trial + 1) % 2])
            assert main(following) in (0, 2)
            assert not writing(folders)
            assert_one_run()
