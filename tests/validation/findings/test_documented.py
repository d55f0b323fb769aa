"""The page of findings has the codes of the package, and no others."""

from __future__ import annotations

import ast
import re
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).parents[3]
CODE = re.compile(r"[a-z]+(-[a-z]+)*")
MAKERS = {"Finding", "Hypothesis", "Other"}


def strings(node: ast.AST) -> Iterator[str]:
    for inner in ast.walk(node):
        if isinstance(inner, ast.Constant) and isinstance(inner.value, str):
            yield inner.value


def test_every_code_has_a_line() -> None:
    page = (ROOT / "docs" / "reference" / "findings.md").read_text("utf-8")
    lines = re.findall(r"^\| `([a-z-]+)` \|", page, re.MULTILINE)
    assert len(set(lines)) == len(lines)
    there: set[str] = set()
    stated: set[str] = set()
    for path in (ROOT / "calib_pin").rglob("*.py"):
        tree = ast.parse(path.read_text("utf-8"))
        there |= set(strings(tree))
        for call in ast.walk(tree):
            if not (isinstance(call, ast.Call) and call.args):
                continue
            if getattr(call.func, "id", "") in MAKERS:
                stated |= {s for s in strings(call.args[0]) if CODE.fullmatch(s)}
    assert len(stated) > 20
    assert stated <= set(lines)
    assert set(lines) <= there
