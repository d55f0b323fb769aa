"""Machine code on disk, and what becomes of it when it is damaged."""

from __future__ import annotations

import importlib.util
from collections.abc import Callable
from itertools import count
from pathlib import Path
from typing import Any

import numba
import pytest

from calib_pin.compiled import blocks

MODULE = """from calib_pin.compiled.blocks import compiled

@compiled
def double(x):
    return 2.0 * x
"""

numbers = count()


@pytest.fixture
def loaded(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Callable[[], Any]:
    """A compiled function, as every process finds it anew."""
    # Its machine code lies beside it, whatever is set outside.
    monkeypatch.setattr(numba.config, "CACHE_DIR", "")
    file = tmp_path / "machine.py"
    file.write_text(MODULE)

    def load() -> Any:
        spec = importlib.util.spec_from_file_location(f"machine{next(numbers)}", file)
        assert spec is not None and spec.loader is not None
        module = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(module)
        assert module.double(2.0) == 4.0
        return module.double

    return load


def from_disk(function: Any) -> bool:
    return sum(function.stats.cache_hits.values()) == 1


def test_machine_code_is_kept(loaded: Callable[[], Any]) -> None:
    assert [from_disk(loaded()) for _ in range(3)] == [False, True, True]


@pytest.mark.parametrize(
    ("kind", "damage"),
    [("nbi", "empty"), ("nbi", "half"), ("nbi", "folder"), ("nbc", "bit")],
)
def test_what_is_damaged_is_compiled_again(
    tmp_path: Path, loaded: Callable[[], Any], kind: str, damage: str
) -> None:
    loaded()
    (file,) = (tmp_path / "__pycache__").glob(f"*.{kind}")
    data = bytearray(file.read_bytes())
    if damage == "folder":
        file.unlink()
        file.mkdir()
    else:
        data[len(data) // 2] ^= 1
        half = bytes(data[: len(data) // 2])
        changed = {"empty": b"", "half": half, "bit": bytes(data)}
        file.write_bytes(changed[damage])
    assert not from_disk(loaded())
    assert from_disk(loaded()) == (damage != "folder")


def test_without_a_folder(
    loaded: Callable[[], Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A read-only installation compiles anew in every process."""

    def refuse(function: object) -> None:
        raise RuntimeError("cannot cache function: no locator available")

    monkeypatch.setattr(blocks, "Cache", refuse)
    assert [from_disk(loaded()) for _ in range(2)] == [False, False]
