"""The folder of a calibration: it travels, it is of one run, and it clears up."""

from __future__ import annotations

import hashlib
import importlib.metadata
import itertools
import json
import os
import random
import re
import shutil
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import pytest

from calib_pin.cli import main
from calib_pin.io.files import COMMIT
from tests.cli.files import document

POSITION = "calibrate arm.urdf rows.csv --setup setup.yaml"
EVALUATE = "evaluate {}/calibration.json new.csv"
FILES = {
    *("arm.urdf", "calibration.json", "measurements.csv"),
    *("nominal.urdf", "report.html"),
}
NEWER = "calibrate arm.urdf new.csv --setup setup.yaml -o done --force --quiet"
BAD = "calibrate arm.urdf few.csv --setup setup.yaml -o done --force"
"""Three rows, which are too few for a corrected URDF."""


def names(folder: str = "done") -> set[str]:
    found = Path(folder).rglob("*")
    return {str(path.relative_to(folder)) for path in found if path.is_file()}


def assert_one_run(folder: str, killed: bool = False) -> None:
    """Everything in the folder is in the manifest, and as it says.

    A killed run leaves what it has begun, under names that nothing else has.
    """
    stated = document(folder)
    for name, content in stated["files"].items():
        data = Path(folder, name).read_bytes()
        expected = None if name == "report.html" else hashlib.sha256(data).hexdigest()
        assert content == expected, name
    found = {name for name in names(folder) if not (killed and name[0] == ".")}
    assert found == {*stated["files"], "calibration.json"}
    page = Path(folder, "report.html").read_text()
    assert f'<meta name="calib-pin-run" content="{stated["run"]}">' in page


@pytest.fixture
def few(here: Path) -> None:
    Path("few.csv").write_text("\n".join(Path("rows.csv").read_text().split("\n")[:4]))


# --- what it holds -----------------------------------------------------------------


def test_every_file_is_of_one_run(here, run):
    assert_one_run("done")
    assert names("done") == FILES
    assert Path("done/nominal.urdf").read_bytes() == Path("arm.urdf").read_bytes()


def test_the_id_is_that_of_the_result(here, run):
    words = f"{POSITION} -o again --quiet"
    assert run(words).status == 0
    assert document("again")["run"] == document("done")["run"]
    assert document("later")["run"] != document("done")["run"]
    assert re.fullmatch("[0-9a-f]{16}", document("done")["run"])


# --- where it goes -----------------------------------------------------------------


def test_a_folder_on_its_own(here, run, tmp_path, monkeypatch, opened):
    away = tmp_path / "away"
    away.mkdir()
    for name in ("done", "later", "new.csv"):
        shutil.move(name, away / name)
    Path("arm.urdf").unlink()
    monkeypatch.chdir(away)
    for words in (
        EVALUATE.format("done"),
        "compensate done/calibration.json targets.csv -o commands.csv",
        "compare done/calibration.json later/calibration.json",
        "view done/calibration.json new.csv --port 5",
    ):
        Path("targets.csv").write_text("x,y,z\n0.6,0.2,0.7\n")
        result = run(words)
        assert (result.status, result.err) == (0, ""), words
    assert len(opened) == 1
    monkeypatch.chdir(away / "done")
    assert run("evaluate calibration.json ../new.csv").status == 0


def test_an_example_robot_where_there_are_none(alone, monkeypatch, run):
    # The robot has no errors but those that are fitted: it does gain.
    words = "example:panda --model position --tip panda_link8"
    words += " --parameters joint-offset"
    assert run(f"simulate {words} --count 20 -o rows.csv").status == 0
    options = "--tip panda_link8 --parameters joint-offset --holdout 0.25"
    words = f"calibrate example:panda rows.csv {options} -o out --quiet"
    assert run(words).status == 0

    def none(name: str) -> None:
        raise importlib.metadata.PackageNotFoundError(name)

    monkeypatch.setattr(importlib.metadata, "distribution", none)
    # And from another working folder.
    monkeypatch.chdir("/")
    file = alone / "out/calibration.json"
    assert run(["evaluate", str(file), str(alone / "rows.csv")]).status == 0


def test_the_folder_of_the_input(here, run, fails):
    fails(f"{POSITION} -o .", "arm.urdf: is an input")
    Path("arm.urdf").rename("original.urdf")
    words = "calibrate original.urdf rows.csv --setup setup.yaml -o ."
    assert run(words).status == 0
    assert {"original.urdf", "rows.csv", *FILES} < names(".")
    assert run(EVALUATE.format(".")).status == 0


def test_its_own_nominal_robot_is_calibrated_again(here, run, fails):
    words = "calibrate done/nominal.urdf new.csv --setup setup.yaml -o done"
    assert run(words).status == 1
    inode = Path("done/nominal.urdf").stat().st_ino
    assert run(f"{words} --force").status == 0
    assert Path("done/nominal.urdf").stat().st_ino == inode, "it was not touched"
    assert_one_run("done")
    assert run("evaluate done/calibration.json rows.csv").status == 0
    # The corrected one would be replaced.
    fails("calibrate done/arm.urdf rows.csv -o done --force", "done/arm.urdf")


# --- mixed sets --------------------------------------------------------------------


@pytest.mark.parametrize(
    ("command", "name"),
    [
        *(("evaluate", name) for name in sorted(FILES)),
        ("compare", "arm.urdf"),
        ("compensate", "report.html"),
        ("view", "calibration.json"),
    ],
)
def test_a_mixed_set_is_refused(command, name, here, fails, opened):
    if name == "nominal.urdf":
        Path("done", name).write_text("<robot/>")
    else:
        shutil.copy(f"later/{name}", f"done/{name}")
    Path("targets.csv").write_text("x,y,z\n0.6,0.2,0.7\n")
    words = {
        "evaluate": EVALUATE.format("done"),
        "compare": "compare done/calibration.json later/calibration.json",
        "compensate": "compensate done/calibration.json targets.csv -o out.csv",
        "view": "view done/calibration.json",
    }
    found = "done/" if name == "calibration.json" else f"done/{name}: "
    fails(words[command], found, "the files of one run")
    assert opened == []


def test_what_is_not_needed_may_be_absent(here, run):
    for name in FILES - {"calibration.json"}:
        Path("done", name).unlink()
        assert run(EVALUATE.format("done")).status == 0


# --- over an earlier run -----------------------------------------------------------


def test_an_earlier_run_goes_as_a_whole(few, run):
    Path("done/notes.txt").write_text("mine")
    other = Path("arm.urdf").read_text().replace('name="arm"', 'name="other"')
    Path("other.urdf").write_text(other)
    result = run(BAD.replace("arm.urdf", "other.urdf"))
    assert result.status == 2
    # The corrected URDF of another robot would pass for one of this run.
    assert result.err.count("\n") == 1 and "removed done/arm.urdf" in result.err
    assert names() == {*FILES - {"arm.urdf"}, "notes.txt"}


@pytest.mark.parametrize("manifest", ["hostile", "foreign", "absent"])
def test_of_another_manifest_nothing_is_removed(manifest, few, run):
    """Not even what one that names other folders rightly lists."""
    found, text = document("done"), "[" * 100_000
    Path("precious.txt").write_text("mine")
    if manifest == "hostile":
        found["files"]["../precious.txt"] = "0" * 64
    else:
        del found["files"], found["run"]
    if manifest != "foreign":
        text = json.dumps(found)
    Path("done/calibration.json").write_text(text)
    if manifest == "absent":
        assert run(EVALUATE.format("done")).status == 0
    result = run(BAD)
    assert result.status == 2
    assert "removed" not in result.err and "note: done/arm.urdf" in result.err
    assert names() == FILES and Path("precious.txt").read_text() == "mine"
    assert "files" in document("done")


# --- nothing is written by what fails ----------------------------------------------


def test_a_page_that_cannot_be_made(here, run, listing, monkeypatch):
    def fail(*_: object, **__: object) -> bytes:
        raise MemoryError

    monkeypatch.setattr("calib_pin.report.html.html_report", fail)
    before = listing(here)
    assert run(f"{POSITION} -o done --force --figures pictures").status == 1
    assert listing(here) == before


def process(words: str, **more: Any) -> subprocess.CompletedProcess[str]:
    program = f"{sys.executable} -m calib_pin {words}"
    return subprocess.run(program, shell=True, capture_output=True, text=True, **more)


@pytest.mark.slow
def test_a_limit_of_the_size_of_files(here, listing):
    """A real write that fails: nothing is torn, nothing is left."""
    before = listing(here)

    def limit() -> None:
        import resource

        signal.signal(signal.SIGXFSZ, signal.SIG_IGN)
        resource.setrlimit(resource.RLIMIT_FSIZE, (8192, 8192))

    result = process(f"{POSITION} -o done --force --quiet", preexec_fn=limit)
    assert result.returncode == 1 and "File too large" in result.stderr
    assert listing(here) == before


# --- signals -----------------------------------------------------------------------


@pytest.mark.parametrize(
    ("number", "status"), [(signal.SIGTERM, 143), (signal.SIGINT, 130)]
)
def test_a_signal_before_the_decision(number, status, here, run, listing, monkeypatch):
    before = listing(here)
    handlers = [signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM)]

    def stop(*_: object) -> None:
        assert list(Path("done").glob(".calib-pin-*"))
        signal.raise_signal(number)

    monkeypatch.setattr("calib_pin.cli.printing.show", stop)
    result = run(f"{POSITION} -o done --force --figures pictures")
    assert (result.status, result.err.count("\n")) == (status, 1)
    assert listing(here) == before
    assert handlers == [signal.getsignal(s) for s in (signal.SIGINT, signal.SIGTERM)]


def test_a_signal_after_the_decision(here, run, monkeypatch):
    replace = os.replace
    names: list[str] = []

    def stopped(source: Any, path: Any) -> None:
        names.append(Path(path).name)
        if len(names) == 3:
            signal.raise_signal(signal.SIGTERM)
        replace(source, path)

    monkeypatch.setattr(os, "replace", stopped)
    assert run(NEWER).status == 143
    assert names[0] == COMMIT and {*names[1:]} == FILES
    assert_one_run("done")
    assert document("done")["measurements"]["files"][0]["file"] == "new.csv"


# --- a run that is killed while it writes -------------------------------------------


# `tests/io/test_files.py` fails at every single call; here the process and its end are
# real, and a reader looks at what is left.
@pytest.mark.filterwarnings("ignore:.*fork.*:DeprecationWarning")
@pytest.mark.parametrize(("call", "kept"), [(1, "rows.csv"), (3, "new.csv")])
def test_a_killed_run_leaves_one_result(call, kept, here, run, monkeypatch):
    """The old one before the decision, the new one behind it."""
    replace, calls = os.replace, itertools.count(1)

    def killed(source: Any, path: Any) -> None:
        if next(calls) == call:
            os.kill(os.getpid(), signal.SIGKILL)
        replace(source, path)

    child = os.fork()
    if not child:
        monkeypatch.setattr(os, "replace", killed)
        try:
            main(NEWER.split())
        finally:
            os._exit(99)
    _, status = os.waitpid(child, 0)
    assert os.waitstatus_to_exitcode(status) == -signal.SIGKILL
    assert run(EVALUATE.format("done")).status == 0
    assert document("done")["measurements"]["files"][0]["file"] == kept


@pytest.mark.slow
def test_a_run_that_is_killed_at_any_moment(here, run):
    """Half of the kills are aimed at the writing; `CALIB_PIN_KILLS` is their number."""
    rng, begin = random.Random(0), time.monotonic()
    words = [sys.executable, "-m", "calib_pin", *NEWER.split()]
    subprocess.run(words, check=True)
    took = time.monotonic() - begin
    for number in range(int(os.environ.get("CALIB_PIN_KILLS", "10"))):
        file = ("rows.csv", "new.csv")[number // 2 % 2]
        child = subprocess.Popen([file if w == "new.csv" else w for w in words])
        if number % 2:
            while child.poll() is None and not any(Path("done").glob(".calib-pin-*")):
                time.sleep(1e-4)
        time.sleep(rng.uniform(0.0, 0.05 if number % 2 else 1.2 * took))
        child.kill()
        assert child.wait() in (0, -signal.SIGKILL)
        # What a reader finds is of one run; it reads that before anything is checked.
        assert run(EVALUATE.format("done")).status == 0
        assert_one_run("done", killed=True)
