"""The code blocks of the documents, run and compared as a reader would run them.

The blocks of a page run in their order in one folder:

- `python` is executed; the blocks of a page share their names.
- `console` holds commands behind `$ ` and what they print, compared word by word;
  numbers are compared as numbers, and a line `...` stands for anything.
- `bash` holds commands whose output is not shown.
- `yaml` and `csv` are written to the file that a first line `# name` gives; every YAML
  block must be a setup file, a table of jobs, errors by parameter, or a citation.
- `toml` and `json` must be readable.
- `math` is a formula.
- `<!-- run: COMMAND -->` runs unseen, `<!-- needs: FOLDER -->` copies a folder of the
  real measurements to where the page runs.
"""

from __future__ import annotations

import contextlib
import io
import json
import os
import re
import shlex
import shutil
import subprocess
import sys
import tomllib
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

import calib_pin

ROOT = Path(__file__).parents[2]

LANGUAGES = ("bash", "console", "csv", "json", "math", "python", "toml", "yaml")

CLOSE = 0.05
"""Numbers of an output may differ by this share: other processors round otherwise."""

COUNTED = 0.02
"""Whole numbers may differ by this share: no rank or count below fifty does."""

FILE = re.compile(r"# ([\w.-]+\.(?:yaml|csv))\s*(?:\(.*\))?$")
NUMBER = re.compile(r"[-+]?\d+(?:\.\d+)?(?:e[-+]?\d+)?$")
SHOWN = {"cat", "head", "ls", "python"}
"""Commands beside calib-pin that a page may run."""


@dataclass(frozen=True)
class Block:
    """A fenced block, or a directive in a comment.

    Attributes:
        language: A language, or `run` or `needs` of a directive.
        line: Where it begins, from one.
        text: The lines inside.
    """

    language: str
    line: int
    text: str


def blocks(text: str) -> Iterator[Block]:
    """The blocks of a page in their order."""
    fence, language, start, inside = "", "", 0, list[str]()
    for number, line in enumerate(text.splitlines(), 1):
        bare = line.strip()
        if fence:
            if bare == fence:
                yield Block(language, start, "\n".join(inside) + "\n")
                fence = ""
            else:
                inside.append(line)
        elif opened := re.fullmatch(r"(`{3,})(\S*)", bare):
            fence, language, start, inside = *opened.groups(), number, []
        elif said := re.fullmatch(r"<!-- (run|needs): (.+) -->", bare):
            yield Block(said[1], number, said[2])


def commands(text: str) -> Iterator[tuple[str, list[str]]]:
    """Every command of a console block with the lines that it prints."""
    command, printed = "", list[str]()
    for line in text.splitlines():
        if line.startswith("$ "):
            if command:
                yield command, printed
            command, printed = line[2:], []
        elif command.endswith("\\"):
            command = command[:-1] + line.strip()
        else:
            printed.append(line)
    if command:
        yield command, printed


def difference(expected: list[str], printed: str) -> str:
    """Where an output is not as expected, or nothing.

    Args:
        expected: The lines of a page; `...` stands for any lines.
        printed: All that the command has printed.
    """
    words = printed.split()
    place, loose = 0, False
    for run in _runs(expected):
        if run is None:
            loose = True
            continue
        starts = range(place, len(words) - len(run) + 1) if loose else [place]
        found = next((s for s in starts if _alike(run, words[s : s + len(run)])), None)
        if found is None:
            near = " ".join(words[place : place + len(run) + 10])
            return f"expected '{' '.join(run)}', printed '{near}'"
        place, loose = found + len(run), False
    rest = words[place:]
    return "" if loose or not rest else f"also printed '{' '.join(rest[:30])}'"


def _runs(lines: list[str]) -> Iterator[list[str] | None]:
    """The words between lines of three dots, and None for each of those."""
    run = list[str]()
    for line in lines:
        if line.strip() == "...":
            if run:
                yield run
            yield None
            run = []
        else:
            run.extend(line.split())
    if run:
        yield run


def _alike(expected: list[str], found: list[str]) -> bool:
    return len(expected) == len(found) and all(map(_same, expected, found))


def _same(expected: str, found: str) -> bool:
    cells = expected.split(","), found.split(",")
    if len(cells[0]) == len(cells[1]) > 1:  # A line of a CSV file.
        return all(map(_same, *cells))
    a, b = (word.strip("(),:;%") for word in (expected, found))
    if not (NUMBER.match(a) and NUMBER.match(b)):
        return expected == found
    share = CLOSE if "." in a or "e" in a else COUNTED
    mantissa, _, exponent = a.partition("e")
    decimals = len(mantissa.partition(".")[2])
    digit = 10.0 ** (int(exponent or 0) - decimals) if share == CLOSE else 0.0
    return abs(float(a) - float(b)) <= share * abs(float(a)) + 1.001 * digit


class Reader:
    """Somebody who follows one page in a folder of his own.

    Attributes:
        names: What its Python blocks have defined.
    """

    def __init__(self, page: Path, data: Path | None = None) -> None:
        """Begin a page in the current folder.

        Args:
            page: The document.
            data: Folder of the real measurements, where there is one.
        """
        self.page = page
        self.data = data
        self.names: dict[str, Any] = {"__name__": "__main__"}

    def follow(self) -> None:
        """Do what the page says.

        Raises:
            AssertionError: It does not do what the page says, at which line.
        """
        for block in blocks(self.page.read_text()):
            where = f"{self.page.name}:{block.line}"
            kind = block.language
            assert kind in (*LANGUAGES, "run", "needs"), f"{where}: language '{kind}'"
            try:
                getattr(self, f"_{kind}", lambda _: None)(block)
            except Exception as error:
                message = f"{where}: {type(error).__name__}: {error}"
                raise AssertionError(message) from error

    def _needs(self, block: Block) -> None:
        assert self.data is not None
        shutil.copytree(self.data / block.text, block.text)

    def _run(self, block: Block) -> None:
        status, printed = self._command(block.text)
        assert status == 0, printed

    def _bash(self, block: Block) -> None:
        for line in block.text.replace("\\\n", " ").splitlines():
            if line.partition("#")[0].strip():
                self._run(Block("run", block.line, line))

    def _console(self, block: Block) -> None:
        for command, expected in commands(block.text):
            status, printed = self._command(command)
            if "".join(expected).strip():
                found = difference(expected, printed)
                assert not found, f"{command}: {found}"
            # A page shows the reason of a command that it lets fail.
            failed = status and not expected
            failed |= status == 1 and "calib-pin: " not in "".join(expected)
            assert not failed, f"{command}: {printed}"

    def _python(self, block: Block) -> None:
        lines = "\n" * block.line + block.text  # Tracebacks name the line of the page.
        with contextlib.redirect_stdout(io.StringIO()):
            exec(compile(lines, str(self.page), "exec"), self.names)

    def _yaml(self, block: Block) -> None:
        from calib_pin.cli.jobs import read_jobs
        from calib_pin.io.setup import read_setup

        path = Path(self._written(block))
        keys = yaml.safe_load(block.text)
        if "cff-version" in keys:
            project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
            assert keys["version"] == calib_pin.__version__
            assert keys["license"] == project["license"]
        elif "jobs" in keys:
            read_jobs(path)
        elif not all("." in key for key in keys):
            read_setup(path)

    def _csv(self, block: Block) -> None:
        self._written(block)

    def _written(self, block: Block) -> str:
        """Write a block to the file that it names."""
        first, _, rest = block.text.partition("\n")
        named = FILE.match(first)
        if named is None:
            name, text = f"block{block.line}.{block.language}", block.text
        else:
            name, text = named[1], rest
        Path(name).write_text(text)
        return name

    def _toml(self, block: Block) -> None:
        tomllib.loads(block.text)

    def _json(self, block: Block) -> None:
        json.loads(block.text)

    def _command(self, command: str) -> tuple[int, str]:
        """Status and output of a command as a terminal of 80 columns shows it."""
        words = shlex.split(command, comments=True)
        if words[0] == "calib-pin":
            return _calib_pin(words[1:])
        if words[:2] == ["pip", "install"]:
            return _installable(words[2:])
        if words[0].startswith("scripts/"):
            return _scripted(words)
        assert words[0] in SHOWN, f"unknown command '{words[0]}'"
        if words[0] == "python":
            words[0] = sys.executable
        done = subprocess.run(words, capture_output=True, text=True, check=False)
        return done.returncode, done.stdout + done.stderr


def _calib_pin(words: list[str]) -> tuple[int, str]:
    from calib_pin.cli import main, printing

    # What is told of long work depends on the machine.
    printing.PATIENCE = float("inf")
    out, error = io.StringIO(), io.StringIO()
    with contextlib.redirect_stdout(out), contextlib.redirect_stderr(error):
        status = main(words)
    return status, out.getvalue() + error.getvalue()


def _installable(words: list[str]) -> tuple[int, str]:
    """Whether `pip install` is given this folder, or the package with its extras."""
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    for word in words:
        named = re.fullmatch(r"(\.|[\w-]+)(?:\[([\w,-]+)\])?", word)
        extras = set(named[2].split(",") if named and named[2] else [])
        unknown = extras - project["optional-dependencies"].keys()
        if named is None or named[1] not in (".", project["name"]) or unknown:
            return 1, f"there is no '{word}'"
    return 0, ""


def _scripted(words: list[str]) -> tuple[int, str]:
    """Whether there is a script, and the studies or benchmarks that it is given."""
    script = ROOT / words[0]
    if not (script.is_file() and os.access(script, os.X_OK)):
        return 1, f"there is no '{words[0]}'"
    known = _members(script.name)
    named = []
    for word in words[1:]:
        if word.startswith("-"):
            break
        named.append(word)
    unknown = [word for word in named if known and word not in known]
    return (1, f"{script.name} knows no {unknown}") if unknown else (0, "")


def _members(script: str) -> list[str]:
    if script == "benchmark":
        from benchmarks.__main__ import BENCHMARKS

        return list(BENCHMARKS)
    if script == "reproduce":
        from studies.__main__ import STUDIES

        return list(STUDIES)
    return []
