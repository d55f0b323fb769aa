"""The package speaks the words of its field, in output as in docstrings."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

from tests.shared import nodes_of, parsed

ROOT = Path(__file__).parents[1]

REPLACED = {
    r"\bunseen\b|\bnot seen\b": "held out, validation measurements",
    r"what can be known": "identifiability",
    r"left at nominal": "held at nominal",
    r"rows that do not fit": "outliers",
    r"what would tell more": "suggested measurements",
    r"fitted in either case": "registered for both",
    r"when to stop": "accuracy against number of configurations",
    r"\brungs?\b(?!\")": "candidate",
    r"does not help": "no significant gain",
    r"measuring\s+frame": "measurement frame",
    r"stand of the": "station of the",
    r"draw wire": "draw-wire encoder",
    r"give way to gravity": "joint compliance",
    r"\bby turns\b": "alternating",
    r"corrections jump": "discontinuity in joint space",
    r"passed backwards": "traversed from child to parent",
    r"carried along": "transformed by the adjoint",
    r"\bspoiled\b": "skipped",
    r"^(Yes|No|None|Nothing)\.$": "a sentence that says what holds",
    r"\AWhat\b": "the noun",
}
"""Patterns of words that once stood here, and what stands in their place."""

KEYS = {"rungs"}
"""Strings that are keys of files, which do not change."""


def texts(path: Path) -> Iterator[tuple[int, str]]:
    """Line and text of the docstrings and messages of a file, of others all lines."""
    if path.suffix != ".py":
        yield from enumerate(path.read_text().splitlines(), 1)
        return
    for node in nodes_of(parsed(path)):
        if isinstance(node, ast.Constant) and isinstance(node.value, str):
            yield node.lineno, node.value


FILES = sorted(
    [
        *(ROOT / "calib_pin").rglob("*.py"),
        *(ROOT / "calib_pin").rglob("*.html"),
        ROOT / "README.md",
        *(ROOT / "docs").rglob("*.md"),
    ]
)


VAGUE = {"found", "told", "taken", "said", "sought"}
"""Names that say how a value came about, and not what it is."""


def test_names() -> None:
    functions = [
        (path, node)
        for path in FILES
        if path.suffix == ".py"
        for node in nodes_of(parsed(path))
        if isinstance(node, ast.FunctionDef)
    ]
    vague = {
        f"{path.relative_to(ROOT)}:{node.lineno}"
        for path, function in functions
        for node in ast.walk(function)
        if getattr(node, "id", getattr(node, "arg", "")) in VAGUE
        and isinstance(node, ast.Name | ast.arg)
    }
    assert vague == set()


def test_words() -> None:
    # One pattern for all: most texts have none of them.
    words = re.compile("|".join(f"({p})" for p in REPLACED), re.I | re.M)
    found = [
        f"{path.relative_to(ROOT)}:{line}: '{match.group()}', better: {better}"
        for path in FILES
        for line, text in texts(path)
        if text not in KEYS
        for match in words.finditer(text)
        for pattern, better in REPLACED.items()
        if re.fullmatch(pattern, match.group(), re.I | re.M)
    ]
    assert found == []
