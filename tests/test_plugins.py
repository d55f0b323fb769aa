"""Members of families from other packages."""

from __future__ import annotations

import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from calib_pin.errors import CalibPinError
from calib_pin.plugins import Members, extensions

GROUP = "calib_pin.tests"


@pytest.fixture(autouse=True)
def fresh() -> Iterator[None]:
    extensions.cache_clear()
    yield
    extensions.cache_clear()


def install(folder: Path, package: str, entries: str, code: str = "") -> None:
    """A package with entry points, as pip would leave it in a folder."""
    info = folder / f"{package}-1.0.dist-info"
    info.mkdir(parents=True)
    (info / "METADATA").write_text(f"Name: {package}\nVersion: 1.0\n")
    (info / "entry_points.txt").write_text(f"[{GROUP}]\n{entries}\n")
    (folder / f"{package}.py").write_text(code)


def test_bundled_members_come_first(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "outside_a", "b = outside_a:B\na = outside_a:A", "A, B = 1, 2\n")
    monkeypatch.syspath_prepend(tmp_path)
    assert dict(Members(GROUP, {"z": 0})) == {"z": 0, "a": 1, "b": 2}
    assert list(Members(GROUP, {"z": 0})) == ["z", "a", "b"]
    assert len(Members(GROUP, {})) == 2 and "c" not in Members(GROUP, {})


def test_nothing_is_loaded_before_it_is_looked_at(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "outside_lazy", "x = outside_lazy", "")
    monkeypatch.syspath_prepend(tmp_path)
    family = Members(GROUP, {"z": 0})
    assert family["z"] == 0
    assert "outside_lazy" not in sys.modules
    assert "x" in family and "outside_lazy" in sys.modules


@pytest.mark.parametrize(
    ("code", "reason"),
    [
        ("raise RuntimeError('no\\nlicense')", "RuntimeError: no license"),
        ("import not_there_at_all", "ModuleNotFoundError: No module named"),
        ("", "has no attribute 'X'"),
    ],
)
def test_a_broken_plugin_is_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, code: str, reason: str
) -> None:
    name = f"broken_{abs(hash(code))}"
    install(tmp_path, name, f"x = {name}:X", code)
    monkeypatch.syspath_prepend(tmp_path)
    family = Members(GROUP, {"z": 0})
    with pytest.raises(CalibPinError, match="cannot be loaded") as caught:
        list(family)
    text = str(caught.value)
    assert reason in text and f"the plug-in 'x' of {name}" in text
    assert "\n" not in text
    assert family["z"] == 0


def test_the_name_of_a_bundled_member_is_taken(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "outside_clash", "z = outside_clash:Z", "Z = 1\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(CalibPinError, match=r"'z' .* has the name of a bundled member"):
        list(Members(GROUP, {"z": 0}))


def test_two_packages_cannot_share_a_name(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, "outside_one", "x = outside_one:X", "X = 1\n")
    install(tmp_path, "outside_two", "x = outside_two:X", "X = 2\n")
    monkeypatch.syspath_prepend(tmp_path)
    with pytest.raises(CalibPinError, match=r"'x' .* is there twice"):
        list(Members(GROUP, {}))
