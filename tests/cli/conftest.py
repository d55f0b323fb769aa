"""A small robot with measurements of every kind, as files in a folder of its own."""

from __future__ import annotations

import hashlib
import shutil
import sys
from collections.abc import Callable, Sequence
from contextlib import chdir
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import click
import pytest

import calib_pin.cli.application as cli_app
from calib_pin.cli import main
from calib_pin.cli.options import asked_workers
from calib_pin.errors import InputError, OutputError
from calib_pin.viewer.scene import Scene
from tests.cli.files import DRAW
from tests.cli.files import undrawn as undrawn_pages
from tests.shared import refused

ARM = Path(__file__).with_name("arm.urdf").read_text()

ERRORS = "joint2.joint-offset.q: 2.0e-3\njoint3.joint-offset.q: -3.0e-3\n"
OPPOSITE = "joint2.joint-offset.q: -2.0e-3\njoint3.joint-offset.q: 3.0e-3\n"

PLANE = """\
model: plane-distance
parameters: [joint-offset]
planes:
  wall: {normal: [1, 0.2, 0.3], offset: -1.8}
"""

SETUP = "tip: tool\nparameters: [joint-offset]\nnoise: {position: 1.0e-4}\n"


@dataclass(frozen=True)
class Run:
    """What a command left behind; `error` is what its last line is about."""

    status: int
    out: str
    err: str
    error: Exception | None


@pytest.fixture(scope="session")
def workshop(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The files; made once, and never to be changed."""
    folder = tmp_path_factory.mktemp("workshop")
    for name, text in {
        "arm.urdf": ARM,
        "errors.yaml": ERRORS,
        "opposite.yaml": OPPOSITE,
        "none.yaml": "joint1.placement.x: 0\n",
        "plane.yaml": PLANE,
        "setup.yaml": SETUP,
    }.items():
        (folder / name).write_text(text)
    position = "--model position --noise 1e-4"
    with chdir(folder), undrawn_pages():
        for words in (
            f"simulate arm.urdf {position} --count 40 --errors errors.yaml "
            "--parameters joint-offset -o rows.csv --truth truth.urdf",
            f"simulate truth.urdf {position} --count 25 --seed 2 --errors none.yaml "
            "-o new.csv",
            f"simulate arm.urdf {position} --count 25 --seed 3 --errors opposite.yaml "
            "--parameters joint-offset -o foreign.csv",
            "simulate arm.urdf --model pose --count 20 --seed 4 -o poses.csv",
            "simulate arm.urdf --setup plane.yaml --count 40 --seed 5 -o distances.csv",
            "calibrate arm.urdf rows.csv --setup setup.yaml -o done --quiet",
            "calibrate arm.urdf new.csv --setup setup.yaml -o later --quiet",
        ):
            assert main(words.split()) == 0, words
    return folder


@pytest.fixture
def here(workshop: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A copy of the files, as the working folder."""
    folder = tmp_path / "work"
    shutil.copytree(workshop, folder)
    monkeypatch.chdir(folder)
    return folder


@pytest.fixture
def alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """An empty folder, as the working folder."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(autouse=True)
def undrawn(request: pytest.FixtureRequest, monkeypatch: pytest.MonkeyPatch) -> None:
    """What takes the longest is left out, unless a test asks for it.

    Pages have no figures but where it asks for `drawn`, and no explanation is looked
    for but where it asks for `sought`. Stages are not told, however slow the machine.
    """
    monkeypatch.setattr("calib_pin.cli.printing.PATIENCE", float("inf"))
    if "sought" not in request.fixturenames:
        request.getfixturevalue("unsought")
    # By the same patch as a test itself, which undoes the last change first.
    for place in () if "drawn" in request.fixturenames else DRAW:
        monkeypatch.setattr(place, lambda *about: [])


@pytest.fixture
def drawn() -> None:
    """Pages and folders with their figures."""


@pytest.fixture
def sought() -> None:
    """Explanations are looked for where measurements do not fit."""


@pytest.fixture
def run(
    capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> Callable[..., Run]:
    """Run a command in this process."""
    errors: list[Exception | None] = []
    application = cli_app.application

    def watched(given: Sequence[str]) -> Callable[..., Any]:
        def app(*arguments: Any, **options: Any) -> Any:
            try:
                return application(given)(*arguments, **options)
            except Exception as error:
                errors[-1] = error
                raise

        return app

    monkeypatch.setattr(cli_app, "application", watched)

    def run(words: str | Sequence[str]) -> Run:
        capsys.readouterr()
        errors.append(None)
        status = main(words.split() if isinstance(words, str) else words)
        return Run(status, *capsys.readouterr(), errors[-1])

    return run


@pytest.fixture
def fails(
    run: Callable[..., Run], listing: Callable[[Path], dict[str, str]]
) -> Callable[..., Run]:
    """A command that prints one line, on the error stream, and touches no file.

    What follows the command are parts of its line.
    """

    def check(words: str | Sequence[str], *parts: str) -> Run:
        folder = Path.cwd()
        before = listing(folder)
        result = run(words)
        assert (result.status, result.out) == (1, "")
        assert result.err.startswith("calib-pin: ") and "internal" not in result.err
        assert result.err.count("\n") == 1 and len(result.err) < 600
        for part in parts:
            assert part in result.err, result.err
        assert listing(folder) == before
        return result

    return check


@pytest.fixture
def refuses(fails: Callable[..., Run]) -> Callable[..., None]:
    """A command that refuses its input: `refuses(words, line=3, ...)`, see `refused`.

    It prints one line, which is that of the error, and touches no file of the working
    folder. Where the error has no fields, `text` are parts of its line.
    """

    def check(
        words: str | Sequence[str], text: str | Sequence[str] = (), **fields: Any
    ) -> None:
        result = fails(words, *((text,) if isinstance(text, str) else text))
        if text:
            assert isinstance(result.error, click.ClickException | OutputError)
        else:
            assert result.err == f"calib-pin: {' '.join(str(result.error).split())}\n"
            with refused(InputError, **fields):
                raise result.error or AssertionError("nothing was refused")

    return check


@pytest.fixture
def withholds(
    run: Callable[..., Run], listing: Callable[[Path], dict[str, str]]
) -> Callable[[str], Run]:
    """A command that tells its result, and why it writes nothing of it."""

    def check(words: str) -> Run:
        before = listing(Path.cwd())
        result = run(words)
        assert result.status == 2
        assert result.out.splitlines()[-1].startswith("wrote nothing")
        assert listing(Path.cwd()) == before
        return result

    return check


@pytest.fixture
def inside(monkeypatch: pytest.MonkeyPatch) -> None:
    """Jobs of a fleet are done in this process, whatever is asked for."""
    patient = partial(asked_workers, patience=1e9)
    monkeypatch.setattr(
        "calib_pin.cli.fleet.asked_workers",
        lambda count, cluster, **_: patient(count, cluster),
    )


@pytest.fixture
def opened(monkeypatch: pytest.MonkeyPatch) -> list[Scene]:
    """Scenes that are shown in windows nobody opens; viser is not needed for that."""
    scenes: list[Scene] = []

    class Window:
        def __init__(self, title: str, port: int) -> None:
            self.port = 8081 if port == 8080 else port
            self.url = f"http://localhost:{self.port}/?token=abc"

        def show(self, scene: Scene) -> None:
            scenes.append(scene)

        def run(self) -> None:
            raise KeyboardInterrupt

        def close(self) -> None:
            pass

    server = SimpleNamespace(Window=Window)
    monkeypatch.setitem(sys.modules, "calib_pin.viewer.server", server)  # type: ignore[arg-type]
    monkeypatch.setattr("calib_pin.errors.find_spec", lambda _: True)
    return scenes


@pytest.fixture
def listing() -> Callable[[Path], dict[str, str]]:
    """Every file and folder below a folder, with a hash of its content."""

    def listing(folder: Path) -> dict[str, str]:
        return {
            str(path.relative_to(folder)): hashlib.sha256(path.read_bytes()).hexdigest()
            if path.is_file()
            else "folder"
            for path in sorted(folder.rglob("*"))
        }

    return listing
